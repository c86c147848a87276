# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Topics, services and parameters of the node, as tables without ROS."""
