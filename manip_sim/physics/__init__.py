# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The model of a world and its data: steps, forces, divergence, spawning; no control."""
