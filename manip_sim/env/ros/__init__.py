# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The environment of a task that drives a node in lock-step; it needs rclpy."""

from manip_sim.env.ros.node_env import NodeEnv

__all__ = ['NodeEnv']
