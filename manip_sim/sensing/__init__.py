# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Measurements: the instruments of a model, and the noise and delay of their readings."""
