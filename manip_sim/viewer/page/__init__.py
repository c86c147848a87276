# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The page itself, without ROS: what a model looks like, and what is on the panels."""
