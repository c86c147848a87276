# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What users see of the node: its topics, services and parameters, as tables without ROS."""
