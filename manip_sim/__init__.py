# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated manipulators served over ROS 2: models, simulation and the node."""
