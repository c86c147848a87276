# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Publish channels while they have subscribers; all messages of an instant have its stamp.

Images of the chosen cameras are rendered in a thread of their own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
import json
import time
from typing import Any

from builtin_interfaces.msg import Time
import mujoco
import numpy as np
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from manip_sim.arrays import FloatArray
from manip_sim.channels.contents import Channel, Fields, image_channels, ImageChannel, stamp_fields
from manip_sim.channels.kinds import (
    clock_channel, instrument_channels, lidar_channel, object_channels, offered_channel,
    robot_channels)
from manip_sim.errors import ManipSimError, ModelError
from manip_sim.frame_names import FrameNames
from manip_sim.interface.offered_sensors import Offered, offered_topics, SensorSettings
from manip_sim.interface.parameters import periods_per_image
from manip_sim.interface.topics import (
    BY_NAME, JointNames, Scope, Topic, topics_of_instruments, truths)
from manip_sim.models.cameras import ImageSettings, LidarModel
from manip_sim.quoting import one_line
from manip_sim.rendering.offscreen import BACKGROUND, choose_gl, Intrinsics, intrinsics_of, Picture
from manip_sim.ros.feature import create_output, create_publisher, Feature, NodeContext, Output
from manip_sim.ros.messages import (
    checked, CONTROLLER_TYPE, message_class, message_of, nanoseconds_of, SerializedMessage)
from manip_sim.runtime.camera_thread import CameraThread, CameraView, Shot
from manip_sim.sensing.images import CameraSensing, ImageNoise
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.simulation.snapshots import Snapshot, take_snapshot, VisibleWorld

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
        self._all = present
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
        """Check which channels have subscribers, and return whether any has."""
        self._subscribed = tuple(publisher for publisher in self._all.values() if publisher.look())
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


#: Time that the start waits for OpenGL [s].
_READY_S = 10.0


def body_names(model: mujoco.MjModel) -> str:
    """Return the names of all bodies and the background by their labels, as JSON."""
    return json.dumps({BACKGROUND: 'background',
                       **{body: model.body(body).name for body in range(model.nbody)}})


def _create_output(context: NodeContext, row: Topic) -> Output:
    """Create an output whose messages are published at once, not in a thread of states."""
    return Output(create_publisher(context, row), context.log)


class ImageOutputs:
    """The topics of the images of one camera, as they are measured or exact."""

    def __init__(self, context: NodeContext, channels: Iterable[ImageChannel]) -> None:
        self._topics = [(channel, _create_output(context, channel.topic)) for channel in channels]

    def wanted(self) -> tuple[bool, bool, bool]:
        """Return whether colours, depth and labels have subscribers."""
        parts = {part for channel, output in self._topics if output.wanted
                 for part in channel.parts}
        return 'rgb' in parts, 'depth' in parts, 'labels' in parts

    def publish(self, head: Fields, picture: Picture, noise: ImageNoise | None) -> None:
        rgb, depth = picture.rgb, picture.depth
        if noise is not None:
            rgb = None if rgb is None else noise.on_colours(rgb)
            depth = None if depth is None else noise.on_depth(depth)
        parts = {'rgb': rgb, 'depth': depth, 'labels': picture.labels}
        for channel, output in self._topics:
            if parts[channel.parts[0]] is not None and output.wanted:
                output.publish(message_of(channel.topic.type, channel.make(
                    head, *(parts[part] for part in channel.parts))))


class CameraPublishers:
    """
    The topics of one camera.

    :param name: of the camera
    :param depth: whether there are depth images
    :param sensing: its noise and latency
    """

    def __init__(self, context: NodeContext, name: str, intrinsics: Intrinsics, depth: bool,
                 sensing: CameraSensing[Snapshot]) -> None:
        self._context = context
        self.view = CameraView(name, intrinsics.width, intrinsics.height)
        self.sensing = sensing
        model = context.simulation.model
        self._frame_id = context.frame_prefix + FrameNames(model).opticals[model.camera(name).id]
        channels = image_channels(name, intrinsics, depth)
        self._seen = [channel for channel in channels if channel.parts]
        self._images = {False: ImageOutputs(context, self._seen)}
        self._infos = [(channel, _create_output(context, channel.topic)) for channel in channels
                       if not channel.parts]
        self._names = _create_output(context, BY_NAME['<camera>/labels/names'].filled_in(name))

    def publish_truth(self) -> None:
        """Also publish exact images, below ``truth/``, if noise or latency of images is set."""
        if True in self._images or not self.sensing.sensing.settings.measures_images:
            return
        rows = truths([channel.topic for channel in self._seen])
        self._context.table += rows
        self._images[True] = ImageOutputs(self._context, [
            replace(channel, topic=row) for channel, row in zip(self._seen, rows)])

    def wanted(self, exact: bool) -> tuple[bool, bool, bool]:
        """Return whether colours, depth and labels have subscribers, of exact images or others."""
        images = self._images.get(exact)
        return (False, False, False) if images is None else images.wanted()

    def have_subscribers(self) -> bool:
        return any((*self.wanted(False), *self.wanted(True), self.infos_wanted()))

    def infos_wanted(self) -> bool:
        return any(output.wanted for _, output in self._infos)

    def publish_names(self, names: str) -> None:
        """Publish the names of the labels, as :func:`body_names` returns them."""
        self._names.publish(String(data=names))

    def publish_infos(self, time_ns: int) -> None:
        for channel, output in self._infos:
            if output.wanted:
                output.publish(message_of(channel.topic.type, channel.make(self._head(time_ns))))

    def _head(self, time_ns: int) -> Fields:
        return {'stamp': stamp_fields(time_ns), 'frame_id': self._frame_id}

    def publish(self, shot: Shot) -> None:
        """Publish what the camera saw, and the intrinsics for that instant."""
        time_ns = shot.snapshot.time_ns
        self._images[shot.view.exact].publish(self._head(time_ns), shot.picture, shot.noise)
        if not shot.view.exact:
            self.publish_infos(time_ns)


class Cameras(Feature):
    """
    The chosen cameras: due snapshots go to the thread that renders, its images to the topics.

    :param chosen: settings of their images, by the name of the camera
    :raises ModelError: if a camera is orthographic
    :ivar names: of the cameras
    """

    def __init__(self, context: NodeContext, chosen: Mapping[str, ImageSettings]) -> None:
        self._context = context
        simulation, model = context.simulation, context.simulation.model
        self._publishers = {name: CameraPublishers(
            context, name, intrinsics_of(model, name, images.width, images.height), images.depth,
            CameraSensing(name, simulation.instruments.sensing_of(
                int(model.cam_bodyid[model.camera(name).id]))))
            for name, images in chosen.items()}
        self.names = list(self._publishers)
        self._renderer: CameraThread | None = None
        self._unable: ManipSimError | None = None
        self._counts: Counter[str] = Counter()
        self._rendering_s: dict[str, float] = {}
        self.world_changed()
        publish_rate = 1.0 / context.thread.period_s
        for name, images in chosen.items():
            every = periods_per_image(publish_rate, images.rate_hz, f'camera.{name}.rate')
            self._watch(name, every)
            context.notes.append(
                f'camera {name}: {images.width} x {images.height}, {publish_rate / every:.4g} Hz, '
                f'on {name}/color/image_raw'
                + (f' and {name}/depth/image_raw' if images.depth else ''))

    @property
    def failed(self) -> ManipSimError | None:
        """The reason for missing images, or None."""
        return self._unable or (self._renderer.failed if self._renderer is not None else None)

    def start(self) -> None:
        """Start the thread that renders; without OpenGL log an error, and go on without images."""
        if not self._publishers:
            return
        try:
            self._renderer = CameraThread(
                choose_gl(), VisibleWorld(self._context.simulation.plan),
                [camera.view for camera in self._publishers.values()], self._publish,
                self._report_failure)
        except ManipSimError as error:
            self._unable = error
            self._report_failure(error)
        else:
            self._renderer.start(_READY_S)

    def world_changed(self) -> None:
        """Publish the names of the labels that the simulation has now."""
        names = body_names(self._context.simulation.model) if self._publishers else ''
        for publishers in self._publishers.values():
            publishers.publish_names(names)

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        for publishers in self._publishers.values():
            publishers.publish_truth()

    def _report_failure(self, error: ManipSimError) -> None:
        self._context.node.get_logger().error(f'no images: {error}; everything else works')

    def close(self) -> None:
        """End the thread that renders; if rendering hangs, it is abandoned."""
        if self._renderer is not None and not self._renderer.stop():
            self._context.node.get_logger().error('rendering hangs; its thread is abandoned')

    def _watch(self, camera: str, every: int) -> None:
        """Request an image of a camera every so many control periods from now on."""
        publishers, thread = self._publishers[camera], self._context.thread

        def record(simulation: Simulation) -> None:
            publishers.sensing.record(take_snapshot(simulation))

        def observe(simulation: Simulation) -> None:
            if thread.is_due(every):
                self._order(publishers, simulation)
        # Later images must not depend on subscribers.
        thread.observe(record, 1, lambda: publishers.sensing.delays)
        thread.observe(observe, every, publishers.have_subscribers)

    def _order(self, publishers: CameraPublishers, simulation: Simulation) -> None:
        renderer, measured, exact = (
            self._renderer, publishers.wanted(False), publishers.wanted(True))
        can_render = renderer is not None and renderer.failed is None
        if not any(measured) or not can_render:
            publishers.publish_infos(simulation.time_ns)
        if renderer is None or not can_render:
            return
        now = take_snapshot(simulation)
        if any(measured):
            seen, noise = publishers.sensing.measured(now)
            # As with states, the stamp is the time of the cycle that publishes it.
            renderer.order(publishers.view, replace(seen, time_ns=now.time_ns), *measured, noise)
        if any(exact):
            renderer.order(replace(publishers.view, exact=True), now, *exact)

    def _publish(self, shot: Shot) -> None:
        name = shot.view.camera
        begin_s = time.perf_counter()
        self._publishers[name].publish(shot)
        if shot.view.exact:
            return
        self._counts[name] += 1
        self._rendering_s[name] = (self._rendering_s.get(name, 0.0) + shot.took_s
                                   + time.perf_counter() - begin_s)

    def statistics(self, elapsed_s: float) -> dict[str, object]:
        """
        Return rate and wall time per image since the last call, and how many were left out so far.

        :param elapsed_s: wall time since the last call [s]
        """
        values: dict[str, object] = {}
        for name in self.names:
            count, took_s = self._counts.pop(name, 0), self._rendering_s.pop(name, 0.0)
            values[f'{name}.rate'] = f'{count / elapsed_s:.1f}' if elapsed_s > 0.0 else '0.0'
            values[f'{name}.milliseconds'] = f'{took_s / count * 1e3:.1f}' if count else '-'
            values[f'{name}.left_out'] = (
                self._renderer.left_out[name] if self._renderer is not None else 0)
        return values
