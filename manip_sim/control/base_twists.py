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

    def follow(self, command: BaseTwist, data: mujoco.MjData, now_s: float, duration_s: float
               ) -> None:
        """
        Set velocities of the setpoints that the twist still owns.

        The slide joints of the base do not turn with it. So the twist is limited in the frame of
        the base: limits of single joints would let it slide sideways.

        :param now_s: simulation time since the last reset [s]
        :param duration_s: length of the interval [s]
        """
        assert self._stream is not None
        twist, yaw = self._stream.at(now_s + duration_s), self._yaw(command, data)
        limit = self._servos.acceleration_limit[command.joints]
        if len(command.indices) == len(command.joints):
            before = self._setpoints.velocity[command.joints]
            present = _turned(before, -yaw)
            twist = _approached(present, twist, limit, duration_s)
            velocity = _turned(twist, yaw + (present[2] + twist[2]) / 2.0 * duration_s)
            limit = np.maximum(limit, np.abs(velocity - before) / duration_s)
        else:
            velocity = _turned(twist, yaw)
        self._setpoints.ramp_to(command.indices, velocity[command.columns], duration_s,
                                limit[command.columns])

    def _yaw(self, command: BaseTwist, data: mujoco.MjData) -> float:
        return float(data.qpos[self._servos.qpos[command.joints[2]]])


def _turned(twist: FloatArray, yaw: float) -> FloatArray:
    """Return a twist along x and y and about z in a frame that is turned by minus ``yaw``."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([cos * twist[0] - sin * twist[1], sin * twist[0] + cos * twist[1], twist[2]])


def _approached(present: FloatArray, wanted: FloatArray, limit: FloatArray, duration_s: float
                ) -> FloatArray:
    """
    Return the twist after an interval, on the straight line from the present to the wanted one.

    With the acceleration of turning, that of the slide joints stays within their limit, or within
    twice the acceleration of turning if that is more.

    :param limit: of the accelerations of the joints forward, side and yaw, shape (3,)
    """
    linear, change = min(limit[0], limit[1]), wanted - present
    turning = math.hypot(present[0], present[1]) * abs(present[2])
    most = min(linear, math.sqrt(max(linear, 2.0 * turning)**2 - turning**2)) * duration_s
    distance = math.hypot(change[0], change[1])
    if distance > most:
        change[:2] *= most / distance
    change[2] = min(max(change[2], -limit[2] * duration_s), limit[2] * duration_s)
    return present + change
