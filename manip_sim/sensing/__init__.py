# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What is measured: the instruments of a model, and the noise and delay of what they read."""
