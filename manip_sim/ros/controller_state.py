# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What controllers want and get, as joint_trajectory_controller tells it."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from manip_sim.simulation.state import ControllerState

try:
    from control_msgs.msg import JointTrajectoryControllerState
except ModuleNotFoundError as missing:
    if str(missing.name).split('.')[0] != 'control_msgs':
        raise
    JointTrajectoryControllerState = None

#: The type of ``<part>/controller_state``.
MESSAGE_TYPE: Any = JointTrajectoryControllerState or JointTrajectory


def controller_state(stamp: Time, state: ControllerState) -> Any:
    """
    Return the state of the controllers of a part's joints.

    Without the package control_msgs it is a ``JointTrajectory`` with four points, which are the
    fields of ``control_msgs/JointTrajectoryControllerState``: reference, feedback, error, output.
    """
    reference = state.reference
    error = [reference.position - state.position, reference.velocity - state.velocity]
    for difference in error:
        difference[reference.gives_effort] = 0.0
    points = {
        'reference': _point(
            np.where(reference.gives_effort, state.position, reference.position),
            np.where(reference.gives_effort, state.velocity, reference.velocity),
            np.where(reference.gives_effort, 0.0, reference.acceleration), reference.effort),
        'feedback': _point(state.position, state.velocity, None, state.effort),
        'error': _point(*error),
        'output': _point(effort=state.effort)}
    message = MESSAGE_TYPE()
    message.header.stamp = stamp
    message.joint_names = list(state.names)
    if JointTrajectoryControllerState is None:
        message.points = list(points.values())
    else:
        for name, point in points.items():
            setattr(message, name, point)
    return message


def _point(position: Any = None, velocity: Any = None, acceleration: Any = None,
           effort: Any = None) -> JointTrajectoryPoint:
    fields = {'positions': position, 'velocities': velocity, 'accelerations': acceleration,
              'effort': effort}
    return JointTrajectoryPoint(
        **{name: values.tolist() for name, values in fields.items() if values is not None})
