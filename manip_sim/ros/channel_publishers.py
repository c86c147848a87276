# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish channels while they have subscribers; all messages of an instant have its stamp."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message

from manip_sim.arrays import FloatArray
from manip_sim.channels.contents import Channel, Fields
from manip_sim.channels.kinds import (
    clock_channel, instrument_channels, lidar_channel, object_channels, offered_channel,
    robot_channels)
from manip_sim.errors import ManipSimError, ModelError
from manip_sim.interface.offered_sensors import Offered, offered_topics, SensorSettings
from manip_sim.interface.profiles import JointNames
from manip_sim.interface.topics import Scope, topics_of_instruments
from manip_sim.models.cameras import LidarModel
from manip_sim.quoting import one_line
from manip_sim.ros.feature import create_output, Feature, NodeContext
from manip_sim.ros.messages import (
    checked, CONTROLLER_TYPE, message_class, message_of, nanoseconds_of, SerializedMessage)
from manip_sim.simulation import SimulatedRobot, Simulation

#: Fields with names of joints.
_JOINT_NAMES = ('name', 'joint_names')
#: Robots by the scope of their topics.
Robots = Mapping[Scope, SimulatedRobot]


class Publication:
    """The publisher of a channel."""

    def __init__(self, context: NodeContext, channel: Channel) -> None:
        self._context, self._channel = context, channel
        self.output = create_output(context, channel.topic)
        self._present = channel.read, _serialized(channel), channel.every

    def follow(self, channel: Channel) -> None:
        """Publish another channel of the same topic from now on; any thread may call this."""
        zeros, before, message = np.zeros(channel.count), self._channel, self._present[1]
        is_alike = before.count == channel.count and before.fields(0, zeros) == channel.fields(
            0, zeros)
        self._channel = channel
        self._present = channel.read, message if is_alike else _serialized(channel), channel.every

    def prepare(self) -> None:
        """Prepare the first message, in any thread."""
        self._present[1].prepare()

    def look(self) -> bool:
        """Return whether there are subscribers, and messages for them."""
        return self.output.has_subscribers

    def publish(self, simulation: Simulation) -> None:
        """Publish the present instant, if it is due."""
        read, message, every = self._present
        if every == 1 or self._context.thread.is_due(every):
            numbers = read(simulation)
            if numbers is not None:
                self.output.publish(message.at(simulation.time_ns, numbers))


class OfferedPublication(Publication):
    """The publisher of a channel that another package writes; it ends with the first failure."""

    _works = True

    def look(self) -> bool:
        return self._works and super().look()

    def publish(self, simulation: Simulation) -> None:
        if not self._works:
            return
        try:
            message = _written(self._channel, simulation)
            if message is not None:
                self.output.publish(message)
        except Exception as error:  # Code of another package may raise anything.
            self._works, channel = False, self._channel
            self._context.log.failure(
                'sensors', f'{channel.topic.name} ends, sensor {channel.offer}', error)


def _serialized(channel: Channel) -> SerializedMessage:
    def make(stamp: Time, numbers: FloatArray) -> Any:
        return message_of(channel.topic.type, channel.fields(nanoseconds_of(stamp), numbers))
    return SerializedMessage(make, channel.count, channel.patches)


def _written(channel: Channel, simulation: Simulation) -> Any:
    """Return the message of the present instant that another package writes, or None."""
    return channel.written(checked(message_class(channel.topic.type)), simulation)


class ChannelPublishers(Feature):
    """
    Publishers of channels, which come and go with these.

    Exact values, below ``truth/``, are published too once noise or latency of a channel is set.

    :param channels: returns the channels of a world with robots; the exact ones of a group follow
        the group
    :param every: number of control periods for each message of any of them
    """

    def __init__(self, context: NodeContext,
                 channels: Callable[[Robots], Iterable[Iterable[Channel]]],
                 every: int = 1) -> None:
        self._context, self._channels = context, channels
        self._all: dict[str, Publication] = {}
        #: Channels whose exact values are not published.
        self._alone: list[Channel] = []
        self._subscribed: tuple[Publication, ...] = ()
        #: ``matches`` of the inbox when subscribers were looked for; None: look for them again.
        self._seen: int | None = None
        self.world_changed()
        context.thread.observe(self.publish, every, self.look)

    def started(self) -> None:
        self._prepare()

    def _prepare(self) -> None:
        for publication in self._all.values():
            publication.prepare()

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        self.world_changed()

    def robot_removed(self, scope: Scope) -> None:
        self._follow({other: robot for other, robot in self._context.robots.items()
                      if other != scope})

    def world_changed(self) -> None:
        """Create the publishers of new channels, and destroy the publishers of removed ones."""
        self._follow(self._context.robots)

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        if any(channel.differs for channel in self._alone):
            self.world_changed()

    def _present(self, robots: Robots) -> Iterator[Channel]:
        self._alone = []
        for group in map(list, self._channels(robots)):
            yield from group
            for channel in group:
                if channel.exact is None:
                    continue
                if channel.differs or channel.exact.topic.name in self._all:
                    yield channel.exact
                else:
                    self._alone.append(channel)

    def _follow(self, robots: Robots) -> None:
        before, table = self._all, self._context.table
        present: dict[str, Publication] = {}
        for channel in self._present(robots):
            name = channel.topic.name
            if name in before:
                present[name] = before[name]
                present[name].follow(channel)
            else:
                if not any(row.name == name for row in table):
                    table.append(channel.topic)
                present[name] = (Publication if channel.write is None else OfferedPublication)(
                    self._context, channel)
        self._all, self._seen = present, None
        gone = before.keys() - present.keys()
        if gone:
            # Afterwards the simulation's thread reads none of them.
            self._context.thread.call(self.look)
        for name in gone:
            before[name].output.close(self._context.node)
        table[:] = [row for row in table if row.name not in gone]
        if self._context.is_built:  # Before, the first state should not wait for it.
            self._prepare()

    def look(self) -> bool:
        """Return whether any channel has subscribers; checks which ones if some came or went."""
        matches = None if self._context.inbox is None else self._context.inbox.matches
        if matches is None or matches != self._seen:
            # Noted first: others may come while they are checked.
            self._seen = matches
            self._subscribed = tuple(
                publication for publication in self._all.values() if publication.look())
        return bool(self._subscribed)

    def publish(self, simulation: Simulation) -> None:
        """Publish the present instant of channels that had subscribers at the last check."""
        for publication in self._subscribed:
            publication.publish(simulation)


def robot_states(context: NodeContext) -> ChannelPublishers:
    """Return the publishers of the states of robots."""
    return ChannelPublishers(context, lambda robots: [
        [_with_names(channel, context.joint_names) for channel in robot_channels(
            robot, scope, context.frame_prefix, CONTROLLER_TYPE)]
        for scope, robot in robots.items()])


def _with_names(channel: Channel, names: JointNames) -> Channel:
    """Return a channel whose messages name joints as others do."""
    if not names.by_own:
        return channel

    def make(head: Fields, numbers: FloatArray) -> Fields:
        return {key: names.public(value) if key in _JOINT_NAMES else value
                for key, value in channel.make(head, numbers).items()}
    return replace(channel, make=make,
                   exact=None if channel.exact is None else _with_names(channel.exact, names))


def clock(context: NodeContext) -> ChannelPublishers:
    """Return the publisher of the simulation time."""
    return ChannelPublishers(context, lambda _: [[clock_channel()]])


def object_states(context: NodeContext) -> ChannelPublishers:
    """Return the publishers of objects, of the arena and of actuators of no part."""
    return ChannelPublishers(
        context, lambda _: [object_channels(context.simulation, context.frame_prefix)])


class InstrumentPublishers(ChannelPublishers):
    """
    The publishers of the instruments of a world.

    :raises ManipSimError: if the parameter ``sensors`` cannot be used
    :ivar rates_hz: of the sensors with fewer messages than control periods [Hz]
    """

    def __init__(self, context: NodeContext) -> None:
        simulation = context.simulation
        settings = SensorSettings(context.parameters.value('sensors'), [
            sensor.name for sensor, *_ in topics_of_instruments(simulation, context.robots)],
            1.0 / context.thread.period_s)
        if settings.noise:
            simulation.instruments.set_noise(settings.noise)
        self.rates_hz = settings.rates_hz
        super().__init__(context, lambda robots: ([channel] for channel in instrument_channels(
            simulation, robots, settings.every, settings.noise, context.frame_prefix)))


class OfferedSensors(ChannelPublishers):
    """The publishers of sensors of other packages; those that cannot be used are logged."""

    def __init__(self, context: NodeContext) -> None:
        self._context, self._warn = context, context.node.get_logger().warning
        self._of: dict[Scope, list[Channel]] = {}
        self._add(context.robots)
        super().__init__(context, lambda robots: [
            channels for scope, channels in self._of.items() if scope in robots])

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        self._add({scope: robot})
        self.world_changed()

    def robot_removed(self, scope: Scope) -> None:
        super().robot_removed(scope)
        del self._of[scope]

    def _add(self, robots: Robots) -> None:
        ours = {channel.topic.name for channels in self._of.values() for channel in channels}
        self._of.update((scope, []) for scope in robots)
        for offered in offered_topics(
                robots, [row for row in self._context.table if row.name not in ours],
                lambda line: self._warn(one_line(line))):
            name = offered.topic.name
            try:
                if name not in ours:
                    self._of[offered.scope].append(self._tried(offered))
            except ManipSimError as error:
                self._warn(one_line(f'{name}: sensor {offered.offer} cannot be used: {error}'))

    def _tried(self, offered: Offered) -> Channel:
        simulation = self._context.simulation
        try:
            # A trial, by an instance of its own, which may remember what it has published.
            trial, channel = (offered_channel(
                offered, simulation, self._context.frame_prefix) for _ in range(2))
            serialize_message(_written(trial, simulation) or message_class(trial.topic.type)())
        except ManipSimError:
            raise
        except Exception as error:  # Code of another package may raise anything.
            raise ModelError(f'{type(error).__name__}: {error}') from error
        return channel


def lidar_scans(context: NodeContext, lidar: LidarModel) -> ChannelPublishers:
    """Return the publishers of a lidar."""
    period_s = context.thread.period_s
    channel = lidar_channel(context.simulation, lidar, period_s, context.frame_prefix)
    context.notes.append(
        f'lidar {lidar.name}: {lidar.rays.rings} x {lidar.rays.samples} rays, '
        f'{1.0 / (period_s * channel.every):.4g} Hz, on {channel.topic.name}')
    return ChannelPublishers(context, lambda _: [[channel]], channel.every)
