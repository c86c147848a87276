# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A channel: numbers that can be read of a simulation, with their topic and their message."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from manip_sim.arrays import FloatArray
from manip_sim.interface.topics import Scope, Topic
from manip_sim.interface.world_topics import truths
from manip_sim.sensing.robot_sensing import RobotSensing
from manip_sim.simulation import Simulation

#: Fields of a message by name; messages in it are mappings too.
Fields = dict[str, Any]
#: Returns the fields of a message for its header and its numbers.
Make = Callable[[Fields, FloatArray], Fields]
#: Returns the numbers of the present instant; None if there is nothing to publish.
Read = Callable[[Simulation], FloatArray | None]


@dataclass(frozen=True, eq=False)
class Channel:
    """
    Numbers that can be read, and the messages that they are published in.

    :ivar topic: name, type, meaning and QoS
    :ivar read: returns the numbers, shape (count,)
    :ivar make: returns the fields of a message
    :ivar count: length of the numbers
    :ivar frame: ``frame_id`` of the messages
    :ivar every: number of control periods for each message
    :ivar patches: whether messages differ in their stamps and doubles only
    :ivar write: of a sensor of another package: fills a message in place of ``read`` and ``make``,
        may raise anything, and returns False to publish no message
    :ivar offer: this package, for messages
    :ivar exact: the channel of exact numbers below ``truth/``; None if these are exact
    :ivar sensing: noise and latency of the numbers
    :ivar is_noisy: whether they are noisy when all settings are zero
    """

    topic: Topic
    read: Read
    make: Make
    count: int
    frame: str = ''
    every: int = 1
    patches: bool = True
    write: Callable[[Any, Simulation], bool | None] | None = None
    offer: str = ''
    exact: Channel | None = None
    sensing: RobotSensing | None = None
    is_noisy: bool = False

    @property
    def differs(self) -> bool:
        """True if the numbers may differ from the exact ones."""
        return self.is_noisy or self.sensing is not None and self.sensing.settings.measures

    def fields(self, time_ns: int, numbers: FloatArray) -> Fields:
        """
        Return the fields of a message.

        :param time_ns: simulation time [ns]
        :param numbers: shape (count,)
        """
        return self.make({'stamp': stamp_fields(time_ns), 'frame_id': self.frame}, numbers)

    def written(self, message: Any, simulation: Simulation) -> Any:
        """
        Fill a new message of the present instant by the sensor of another package.

        :param message: of ROS, or of ``manip_sim.records.record_file``
        :returns: the message; None if there is nothing to publish
        :raises Exception: anything
        """
        assert self.write is not None
        if hasattr(message, 'header'):
            head = message.header
            head.stamp.sec, head.stamp.nanosec = stamp_fields(simulation.time_ns).values()
            head.frame_id = self.frame
        return None if self.write(message, simulation) is False else message

    def beside(self, exact: Read, row: Topic, scope: Scope, sensing: RobotSensing,
               is_noisy: bool = False) -> Channel:
        """Return the channel with one of exact numbers; ``row`` is its topic without ``scope``."""
        (truth,) = truths([row])
        return replace(self, sensing=sensing, is_noisy=is_noisy, exact=replace(
            self, topic=replace(truth, name=scope.topic(truth.name), type=self.topic.type),
            read=exact))


def stamp_fields(time_ns: int) -> Fields:
    """Return the fields of a stamp for a simulation time [ns]."""
    return {'sec': time_ns // 1_000_000_000, 'nanosec': time_ns % 1_000_000_000}
