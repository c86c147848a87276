# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Streams of velocities, of end effectors and bases: each is reached when the next is due."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.commands import BaseTwist
from manip_sim.control.law.records import (
    blank_motion, blank_state, FIELDS, MOTION, MOTION_FIELDS, records)
from manip_sim.control.servos import Servos
from manip_sim.control.setpoints import SetpointGenerator
from manip_sim.derived import Derived


class Stream:
    """
    The messages of a stream of some coordinates, and the motion that they ask for.

    :param limit: of accelerations [1/s^2], shape (n,)
    """

    #: Of arrays that compiled code reads.
    shapes: Mapping[str, tuple[str | int, ...]] = {
        '_state': ('d', 'n', len(FIELDS)), '_motion': ('d', 'n', len(MOTION_FIELDS))}

    def __init__(self, limit: FloatArray) -> None:
        self._state, self._motion = blank_state(limit), blank_motion(len(limit))

    def set(self, longest_s: float, hold_s: float) -> None:
        """
        Change what counts as a stream.

        :param longest_s: longest interval between messages [s]
        :param hold_s: how long a stream goes on after a message was due [s]; 0: two intervals
        """
        joints = records(self._state)
        joints['longest'], joints['hold'] = longest_s, hold_s

    @property
    def motion(self) -> Any:
        """The motion until the next message, records of ``MOTION``, shape (n,), a view."""
        return records(self._motion, MOTION)


class VelocityStream(Stream):
    """
    The velocities of a stream, such as twists of an end effector or a base, all in one frame.

    The velocity ramps from message to message within one message interval, so that nothing jerks
    where control periods are shorter. The first one is reached within a control period.

    :param jump: acceleration that the stream itself has not [1/s^2], shape (n,)
    """

    def __init__(self, jump: FloatArray) -> None:
        super().__init__(jump)
        self._duration_s = 0.0

    def take(self, velocity: FloatArray, present: Callable[[], FloatArray], now_s: float,
             period_s: float, messages: int = 1, sent_s: float = 0.0) -> None:
        """
        Take in the velocity of a message.

        :param velocity: [1/s], shape (n,)
        :param present: returns the velocity now, which counts if the stream begins [1/s], shape
            (n,)
        :param now_s: simulation time [s]
        :param period_s: length of a control period [s]
        :param messages: how many messages came since the last call, of which this is the last
        :param sent_s: when it was sent, by any clock [s]; 0: unknown
        """
        from manip_sim.control.law.streams import take_alone  # It imports numba.
        from manip_sim.control.law.streams import velocities_at, wait
        joints, motion = records(self._state), self.motion
        if joints['arrived'][0] == now_s:
            # Of two messages at one instant the newer counts, and the schedule knows of one.
            before, own = velocities_at(motion, now_s), np.zeros(len(velocity))
        else:
            wait(joints, np.arange(len(joints)), np.ascontiguousarray(velocity, dtype=np.float64),
                 float(period_s), float(messages), float(sent_s), True)
            taken = take_alone(joints, now_s)
            if not taken:
                return
            before = velocities_at(motion, now_s) if taken > 1 else present()
            own = np.abs(joints['own'])
            self._duration_s = max(joints['interval'][0], period_s) if taken > 1 else period_s
        motion['velocity'], motion['own'] = velocity, own
        motion['slope'] = (velocity - before) / self._duration_s
        motion['reached'] = now_s + self._duration_s


class BaseTwists:
    """
    The twists of a mobile base, which become velocities of the setpoints of its joints.

    They are given in the frame of the base, which turns with it.

    :param servos: of all driven joints
    :param setpoints: of all driven joints
    """

    remembered = ('_stream',)

    def __init__(self, servos: Servos, setpoints: SetpointGenerator) -> None:
        self._servos, self._setpoints = servos, setpoints
        self._stream: VelocityStream | None = None
        self._derived = Derived()

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
        self._stream.take(
            command.twist,
            lambda: _turned(self._setpoints.velocity[joints],
                            -float(data.qpos[self._servos.qpos[joints[2]]])),
            now_s, period_s, command.messages, command.sent_s)
        self.refresh()

    def refresh(self) -> Any:
        """Return the twist until the next message, records of ``MOTION``, shape (3,), a view."""
        assert self._stream is not None
        # Compiled code keeps its address.
        room = self._derived.of.setdefault('twist', records(blank_motion(3), MOTION))
        room[:] = self._stream.motion
        return room


def _turned(twist: FloatArray, yaw: float) -> FloatArray:
    """Return a twist along x and y and about z in a frame that is turned by minus ``yaw``."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([cos * twist[0] - sin * twist[1], sin * twist[0] + cos * twist[1], twist[2]])
