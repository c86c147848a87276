# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Publish images of the chosen cameras, rendered in a thread of its own while subscribed to.

The thread gets snapshots from the physics, which never waits for it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
import json
import threading
import time

import mujoco
from rclpy.parameter import Parameter
from std_msgs.msg import String

from manip_sim.channels.contents import Fields, image_channels, ImageChannel, stamp_fields
from manip_sim.errors import ManipSimError
from manip_sim.frame_names import FrameNames
from manip_sim.interface.parameters import periods_per_image
from manip_sim.interface.topics import BY_NAME, Topic, truths
from manip_sim.rendering import (
    BACKGROUND, cannot_render, choose_gl, Intrinsics, intrinsics_of, OffscreenRenderer, Picture)
from manip_sim.ros.feature import create_publisher, Feature, NodeContext, Output
from manip_sim.ros.messages import message_of
from manip_sim.sensing.images import CameraSensing, ImageNoise
from manip_sim.simulation import Simulation
from manip_sim.simulation.snapshots import Snapshot, take_snapshot, VisibleWorld

THREAD_NAME = 'cameras'
#: Time that a running rendering may still take when the thread is to end [s].
_LAST_S = 2.0


@dataclass(frozen=True)
class CameraView:
    """
    A camera and the size of its images.

    :ivar camera: its name
    :ivar width: [pixels], as ``height``
    :ivar exact: whether its images are exact beside others that are measured
    """

    camera: str
    width: int
    height: int
    exact: bool = False


@dataclass(frozen=True, eq=False)
class Shot:
    """
    A picture of a camera, with its instant.

    :ivar view: the camera
    :ivar snapshot: of the instant
    :ivar picture: colours, depth, labels: at least the requested ones
    :ivar took_s: wall time of the rendering [s]; 0 if an earlier picture is used again
    :ivar noise: to be added to the picture, or None
    """

    view: CameraView
    snapshot: Snapshot
    picture: Picture
    took_s: float
    noise: ImageNoise | None = None


@dataclass(frozen=True, eq=False)
class _Order:
    view: CameraView
    snapshot: Snapshot
    rgb: bool
    depth: bool
    labels: bool
    noise: ImageNoise | None

    def is_met_by(self, shot: Shot) -> bool:
        return (self.view.camera == shot.view.camera
                and self.snapshot.shows_the_same_as(shot.snapshot)
                and (shot.picture.rgb is not None or not self.rgb)
                and (shot.picture.depth is not None or not self.depth)
                and (shot.picture.labels is not None or not self.labels))


class CameraThread:
    """
    A thread that renders, with an OpenGL context and an ``MjData`` of its own.

    For each camera the newest snapshot counts: one that has not been rendered when the next comes
    is left out.

    :param way: to render, as :func:`manip_sim.rendering.offscreen.choose_gl` returns it
    :param world: as it is at the start
    :param views: the cameras
    :param deliver: is called in this thread with each shot
    :param report_failure: is called in this thread with the error that ends the rendering
    :ivar left_out: how many snapshots of each camera were not rendered because newer ones came
    :ivar failed: why nothing is rendered, or None
    """

    def __init__(self, way: str, world: VisibleWorld, views: list[CameraView],
                 deliver: Callable[[Shot], None],
                 report_failure: Callable[[ManipSimError], None]) -> None:
        self._way = way
        self._world = world
        self._size = max(view.width for view in views), max(view.height for view in views)
        self._deliver = deliver
        self._report_failure = report_failure
        self._orders: dict[CameraView, _Order] = {}
        self._shots: dict[CameraView, Shot] = {}
        self._wake = threading.Condition()
        self._stopping = False
        self._ready = threading.Event()
        self.left_out: Counter[str] = Counter()
        self.failed: ManipSimError | None = None
        # A rendering that hangs must not keep the process alive.
        self._thread = threading.Thread(target=self._run, name=THREAD_NAME, daemon=True)

    def start(self, timeout_s: float) -> None:
        """
        Start the thread, and wait until OpenGL is ready or has failed.

        :param timeout_s: how long to wait at most [s]
        """
        self._thread.start()
        self._ready.wait(timeout_s)

    def order(self, view: CameraView, snapshot: Snapshot, rgb: bool, depth: bool,
              labels: bool = False, noise: ImageNoise | None = None) -> None:
        """
        Request a shot of a view, and return at once.

        :param rgb: whether colours are needed
        :param depth: whether depth is needed
        :param labels: whether the ids of bodies are needed
        :param noise: that the shot hands on; the rendered picture is exact
        """
        if self.failed is not None:
            return
        with self._wake:
            if view in self._orders:
                self.left_out[view.camera] += 1
            self._orders[view] = _Order(view, snapshot, rgb, depth, labels, noise)
            self._wake.notify()

    def stop(self, timeout_s: float = _LAST_S) -> bool:
        """
        End the thread.

        :param timeout_s: how long to wait for a rendering that runs [s]
        :returns: whether it has ended; if not, the process must end by ``os._exit``
        """
        with self._wake:
            self._stopping = True
            self._wake.notify()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    # ------------------------------------------------------------------ in the thread

    def _run(self) -> None:
        try:
            self._serve()
        except Exception as error:  # OpenGL and MuJoCo raise many types.
            self.failed = error if isinstance(error, ManipSimError) else cannot_render(error)
            if not self._stopping:
                self._report_failure(self.failed)
        finally:
            self._ready.set()
            self._shots.clear()

    def _serve(self) -> None:
        renderer = OffscreenRenderer(self._world.model, *self._size, self._way)
        try:
            self._ready.set()
            while True:
                for order in self._wait():
                    if self._stopping:
                        return
                    if order.snapshot.plan is not self._world.plan:
                        self._world = VisibleWorld(order.snapshot.plan)
                        renderer.replace_model(self._world.model)
                    self._meet(order, renderer)
                if self._stopping:
                    return
        finally:
            renderer.close()

    def _wait(self) -> list[_Order]:
        with self._wake:
            while not (self._orders or self._stopping):
                self._wake.wait()
            orders, self._orders = self._orders, {}
        return list(orders.values())

    def _meet(self, order: _Order, renderer: OffscreenRenderer) -> None:
        if order.view.camera not in self._world.cameras:  # Deleted with its object.
            return
        last = next(filter(order.is_met_by, self._shots.values()), None)
        if last is not None:
            self._deliver(Shot(order.view, order.snapshot, last.picture, 0.0, order.noise))
            return
        begin_s, view = time.perf_counter(), order.view
        self._world.show(order.snapshot)
        picture = renderer.render(self._world.data, view.camera, view.width, view.height,
                                  order.rgb, order.depth, order.labels)
        shot = Shot(view, order.snapshot, picture, time.perf_counter() - begin_s, order.noise)
        self._shots[view] = shot
        self._deliver(shot)


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
    :ivar names: takes the names of the labels, as :func:`body_names` returns them
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
        self.names = _create_output(context, BY_NAME['<camera>/labels/names'].filled_in(name))

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
        return any((*self.wanted(False), *self.wanted(True),
                    *(output.wanted for _, output in self._infos)))

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

    :raises ModelError: if a camera is orthographic
    :ivar names: of the cameras
    """

    def __init__(self, context: NodeContext) -> None:
        self._context, chosen = context, context.composition.cameras
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
            publishers.names.publish(String(data=names))

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
