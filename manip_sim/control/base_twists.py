# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How a mobile base follows twists in its own frame, which turns with it."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.commands import BaseTwist
from manip_sim.control.servos import Servos
from manip_sim.control.setpoints import SetpointGenerator
from manip_sim.control.velocity_stream import VelocityStream


class BaseTwists:
    """
    The twists of a mobile base, which become velocities of the setpoints of its joints.

    :param servos: of all driven joints
    :param setpoints: of all driven joints
    """

    remembered = ('_stream',)

    def __init__(self, servos: Servos, setpoints: SetpointGenerator) -> None:
        self._servos, self._setpoints = servos, setpoints
        self._stream: VelocityStream | None = None

    def forget(self) -> None:
        """Let the next twist be the first of a stream."""
        self._stream = None

    def begin(self, command: BaseTwist, data: mujoco.MjData, now_s: float, period_s: float,
              drives: bool) -> None:
        """
        Take in a twist.

        :param now_s: simulation time since the last reset [s]
        :param period_s: length of a control period [s]
        :param drives: whether the base follows a twist now, so that this may continue a stream
        """
        joints = command.joints
        if self._stream is None or not drives:
            self._stream = VelocityStream(self._servos.acceleration_limit[joints])
        self._stream.set(*self._setpoints.stream_settings(int(joints[0])))
        present = _turned(self._setpoints.velocity[joints], -self._yaw(command, data))
        self._stream.take(
            command.twist, present, now_s, period_s, command.messages, command.sent_s)

    def wanted(self, ends_s: FloatArray) -> FloatArray:
        """
        Return the twists at the ends of intervals, shape (k, 3).

        :param ends_s: simulation time since the last reset [s], shape (k,)
        """
        assert self._stream is not None
        return np.array([self._stream.at(end_s) for end_s in ends_s.tolist()])

    def _yaw(self, command: BaseTwist, data: mujoco.MjData) -> float:
        return float(data.qpos[self._servos.qpos[command.joints[2]]])


def _turned(twist: FloatArray, yaw: float) -> FloatArray:
    """Return a twist along x and y and about z in a frame that is turned by minus ``yaw``."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([cos * twist[0] - sin * twist[1], sin * twist[0] + cos * twist[1], twist[2]])
