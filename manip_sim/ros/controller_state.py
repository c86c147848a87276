# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Reference and measured state of controllers, as joint_trajectory_controller publishes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from manip_sim.arrays import FloatArray
from manip_sim.ros.optional_packages import import_optional
from manip_sim.simulation.state import ControllerState

JointTrajectoryControllerState: Any = getattr(
    import_optional('control_msgs.msg'), 'JointTrajectoryControllerState', None)

#: The type of ``<part>/controller_state``.
MESSAGE_TYPE: Any = JointTrajectoryControllerState or JointTrajectory
#: Number of rows of :func:`controller_numbers`.
ROWS = 9


def controller_numbers(state: ControllerState) -> FloatArray:
    """
    Return the numbers of a message; without a setpoint the reference is the measured state.

    :returns: rows, of n joints each: position, velocity, acceleration and effort of the reference;
        measured position, velocity and effort; error of position and velocity; shape (9 n,)
    """
    reference, gives = state.reference, state.reference.gives_effort
    position, velocity, acceleration = (
        reference.position, reference.velocity, reference.acceleration)
    if gives.any():
        position = np.where(gives, state.position, position)
        velocity = np.where(gives, state.velocity, velocity)
        acceleration = np.where(gives, 0.0, acceleration)
    return np.concatenate([
        position, velocity, acceleration, reference.effort,
        state.position, state.velocity, state.effort,
        position - state.position, velocity - state.velocity])


def controller_state(names: Sequence[str], stamp: Time, numbers: FloatArray) -> Any:
    """
    Return the state of the controllers of a part's joints.

    Without the package control_msgs it is a ``JointTrajectory`` with four points, which are the
    fields of ``control_msgs/JointTrajectoryControllerState``: reference, feedback, error, output.

    :param names: of the joints, n
    :param numbers: as :func:`controller_numbers` returns them, shape (9 n,)
    """
    rows = numbers.reshape(ROWS, len(names))
    points = {'reference': _point(*rows[:4]), 'feedback': _point(rows[4], rows[5], None, rows[6]),
              'error': _point(*rows[7:]), 'output': _point(effort=rows[6])}
    message = MESSAGE_TYPE()
    message.header.stamp = stamp
    message.joint_names = list(names)
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
