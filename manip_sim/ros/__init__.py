# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node: how a simulation is seen and commanded over ROS 2; what it builds on needs no ROS."""
