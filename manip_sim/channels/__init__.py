# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What can be read of a simulation, for nodes, records and descriptions; without ROS."""
