# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Tests of robot controllers with pytest: a fixture that starts a node, and counts simulated time.

The fixture ``sim_node`` comes with the package; this imports neither ROS nor MuJoCo by itself.
"""
