# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The action types of the package control_msgs, where it is installed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from manip_sim.ros.optional_packages import import_optional


@dataclass(frozen=True)
class ActionTypes:
    """
    Types with ``Goal``, ``Feedback`` and ``Result``, such as those of ``control_msgs.action``.

    :ivar parallel_gripper_command: None in older versions of the package, which do not have it
    """

    follow_joint_trajectory: Any
    gripper_command: Any
    parallel_gripper_command: Any = None


def load_action_types() -> ActionTypes | None:
    """Return the types of the package, or None if it is not installed."""
    action = import_optional('control_msgs.action')
    if action is None:
        return None
    return ActionTypes(action.FollowJointTrajectory, action.GripperCommand,
                       getattr(action, 'ParallelGripperCommand', None))
