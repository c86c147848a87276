# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The page itself, without ROS: the scene that shows a model, and the panels."""
