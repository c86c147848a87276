# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How a mobile base follows twists in its own frame, which turns with it."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.simulation.commands import BaseTwist
from manip_sim.simulation.servos import Servos
from manip_sim.simulation.setpoints import SetpointGenerator
from manip_sim.simulation.velocity_stream import VelocityStream


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
        indices = command.indices
        if self._stream is None or not drives:
            self._stream = VelocityStream(self._servos.acceleration_limit[indices])
        self._stream.set(*self._setpoints.stream_settings(int(indices[0])))
        yaw = float(data.qpos[self._servos.qpos[indices[2]]])
        present = _turned(self._setpoints.velocity[indices], -yaw)
        self._stream.take(
            command.twist, present, now_s, period_s, command.messages, command.sent_s)

    def follow(self, command: BaseTwist, data: mujoco.MjData, now_s: float, duration_s: float
               ) -> None:
        """
        Set velocities of setpoints; the slide joints of the base do not turn with it.

        :param now_s: simulation time since the last reset [s]
        :param duration_s: length of the interval [s]
        """
        assert self._stream is not None
        twist = self._stream.at(now_s + duration_s)
        yaw = float(data.qpos[self._servos.qpos[command.indices[2]]])
        self._setpoints.ramp_to(command.indices, _turned(twist, yaw), duration_s)


def _turned(twist: FloatArray, yaw: float) -> FloatArray:
    """Return a twist along x and y and about z in a frame that is turned by minus ``yaw``."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([cos * twist[0] - sin * twist[1], sin * twist[0] + cos * twist[1], twist[2]])
