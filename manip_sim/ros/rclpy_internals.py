# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What rclpy has no public name for: of the releases of ROS 2 Jazzy, 7.1, and in one place."""

from __future__ import annotations

from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError, WaitSet
from rclpy.node import Node
from rclpy.parameter import Parameter

__all__ = ['parameter_overrides', 'RCLError', 'UnknownROSArgsError', 'WaitSet']


def parameter_overrides(node: Node) -> dict[str, Parameter]:
    """Return what was given to a node at its start, declared or not; it may be changed."""
    overrides: dict[str, Parameter] = node._parameter_overrides
    return overrides
