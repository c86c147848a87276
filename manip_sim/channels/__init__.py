# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The table of all readings of a simulation, for nodes, records and descriptions; without ROS."""
