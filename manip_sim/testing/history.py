# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of many control periods as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.ros.messages import nanoseconds_of


@dataclass(frozen=True, eq=False)
class JointHistory:
    """
    States of joints, one row for each control period.

    :ivar names: of the joints
    :ivar time_s: stamps [s], shape (t,)
    :ivar position: [rad or m], shape (t, n)
    :ivar velocity: [rad/s or m/s], shape (t, n)
    :ivar effort: [N m or N], shape (t, n)
    """

    names: tuple[str, ...]
    time_s: FloatArray
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray


@dataclass(frozen=True, eq=False)
class WrenchHistory:
    """
    Wrenches, one row for each control period.

    :ivar frame: of the numbers
    :ivar time_s: stamps [s], shape (t,)
    :ivar force: [N], shape (t, 3)
    :ivar torque: [N m], shape (t, 3)
    """

    frame: str
    time_s: FloatArray
    force: FloatArray
    torque: FloatArray


def joint_history(messages: Sequence[Any]) -> JointHistory:
    """Return ``sensor_msgs.msg.JointState`` messages, at least one, of the same joints."""
    position, velocity, effort = (
        np.array([getattr(message, field) for message in messages])
        for field in ('position', 'velocity', 'effort'))
    return JointHistory(tuple(messages[0].name), _times(messages), position, velocity, effort)


def wrench_history(messages: Sequence[Any]) -> WrenchHistory:
    """Return ``geometry_msgs.msg.WrenchStamped`` messages, at least one, of the same frame."""
    force, torque = (
        np.array([[vector.x, vector.y, vector.z] for message in messages
                  for vector in [getattr(message.wrench, field)]])
        for field in ('force', 'torque'))
    return WrenchHistory(messages[0].header.frame_id, _times(messages), force, torque)


def _times(messages: Sequence[Any]) -> FloatArray:
    return np.array([nanoseconds_of(message.header.stamp) * 1e-9 for message in messages])
