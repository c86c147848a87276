# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish images of the chosen cameras, rendered in a thread of its own while subscribed to."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
import json
import sys
import time
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header, String

from manip_sim.errors import ManipSimError
from manip_sim.frame_names import FrameNames
from manip_sim.interface.parameters import periods_per_image
from manip_sim.interface.topics import Topic
from manip_sim.interface.world_topics import topics_of_cameras, truths
from manip_sim.models.cameras import ImageSettings
from manip_sim.rendering.gl import choose_gl
from manip_sim.rendering.intrinsics import Intrinsics, intrinsics_of
from manip_sim.rendering.jpeg import JPEG_FORMAT, jpeg_of
from manip_sim.rendering.offscreen import BACKGROUND, Picture
from manip_sim.ros.feature import Feature
from manip_sim.ros.lazy_publishers import create_publisher, Output
from manip_sim.ros.messages import stamp_of
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.point_clouds import PointCloudMaker
from manip_sim.runtime.camera_thread import CameraThread, CameraView, Shot
from manip_sim.sensing.images import CameraSensing, ImageNoise
from manip_sim.simulation import Simulation
from manip_sim.simulation.snapshots import Snapshot, take_snapshot, VisibleWorld

_PLUMB_BOB = 'plumb_bob'
#: Of images, by the kind of their numbers.
_ENCODINGS = {'u': 'rgb8', 'f': '32FC1', 'i': '32SC1'}
#: How long the start waits for OpenGL [s].
_READY_S = 10.0


def image(head: Header, pixels: NDArray[Any]) -> Image:
    """
    Return an image: ``rgb8`` of bytes with shape (h, w, 3), ``32FC1`` or ``32SC1`` of (h, w).

    :param pixels: contiguous, the top row first
    """
    message = Image(header=head, height=pixels.shape[0], width=pixels.shape[1],
                    encoding=_ENCODINGS[pixels.dtype.kind],
                    is_bigendian=sys.byteorder == 'big', step=pixels.strides[0])
    # rclpy takes an array.array as it is, and checks anything else byte by byte.
    content = array('B')
    content.frombytes(pixels.data.cast('B'))
    message.data = content
    return message


def jpeg(head: Header, rgb: NDArray[np.uint8]) -> CompressedImage:
    """
    Return an image as JPEG.

    :param rgb: shape (h, w, 3), the top row first
    """
    return CompressedImage(header=head, format=JPEG_FORMAT, data=array('B', jpeg_of(rgb)))


def camera_info(found: Intrinsics) -> CameraInfo:
    """Return the intrinsics of a camera without distortion; the header is empty."""
    return CameraInfo(
        width=found.width, height=found.height, distortion_model=_PLUMB_BOB, d=[0.0] * 5,
        k=[found.fx, 0.0, found.cx, 0.0, found.fy, found.cy, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[found.fx, 0.0, found.cx, 0.0, 0.0, found.fy, found.cy, 0.0, 0.0, 0.0, 1.0, 0.0])


def body_names(model: mujoco.MjModel) -> str:
    """Return the names of all bodies and the background by their labels, as JSON."""
    return json.dumps({BACKGROUND: 'background',
                       **{body: model.body(body).name for body in range(model.nbody)}})


class ImageOutputs:
    """
    The topics of the images of one camera, as they are measured or exact.

    :param outputs: by the end of their names
    """

    def __init__(self, outputs: Mapping[str, Output], found: Intrinsics) -> None:
        makers: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
            'color/image_raw': (image, ('rgb',)), 'color/image_raw/compressed': (jpeg, ('rgb',)),
            'depth/image_raw': (image, ('depth',)),
            'depth/points': (PointCloudMaker(found).make, ('depth', 'rgb')),
            'labels/image_raw': (image, ('labels',))}
        #: What makes their messages, and of which fields of a picture; the first must be there.
        self._topics = [(outputs[name], *maker) for name, maker in makers.items()
                        if name in outputs]

    def wanted(self) -> tuple[bool, bool, bool]:
        """Return whether colours, depth and labels have subscribers."""
        wanted = {field for output, _, fields in self._topics if output.wanted for field in fields}
        return 'rgb' in wanted, 'depth' in wanted, 'labels' in wanted

    def publish(self, head: Header, picture: Picture, noise: ImageNoise | None) -> None:
        rgb, depth = picture.rgb, picture.depth
        if noise is not None:
            rgb = None if rgb is None else noise.on_colours(rgb)
            depth = None if depth is None else noise.on_depth(depth)
        found = {'rgb': rgb, 'depth': depth, 'labels': picture.labels}
        for output, make, fields in self._topics:
            if found[fields[0]] is not None and output.wanted:
                output.publish(make(head, *(found[field] for field in fields)))


class CameraPublishers:
    """
    The topics of one camera.

    :param name: of the camera
    :param depth: whether there are depth images
    :param sensing: its noise and latency
    """

    def __init__(self, context: NodeContext, name: str, found: Intrinsics, depth: bool,
                 sensing: CameraSensing[Snapshot]) -> None:
        self._context = context
        self._found = found
        self._rows = topics_of_cameras({name: depth})
        self.view = CameraView(name, found.width, found.height)
        self.sensing = sensing
        model = context.simulation.model
        self._frame_id = context.frame_prefix + FrameNames(model).opticals[model.camera(name).id]
        self._info = camera_info(found)
        outputs = self._create(self._rows)
        self._images = {False: ImageOutputs(outputs, found)}
        self._names = outputs['labels/names']
        self._infos = [output for topic, output in outputs.items() if 'camera_info' in topic]

    def _create(self, rows: list[Topic]) -> dict[str, Output]:
        return {row.name.partition(f'{self.view.camera}/')[2]: Output(
            create_publisher(self._context, row), self._context.log) for row in rows}

    def publish_truth(self) -> None:
        """Also publish exact images, below ``truth/``, if noise or latency of images is set."""
        if True in self._images or not self.sensing.sensing.settings.measures_images:
            return
        rows = truths(self._rows)
        self._context.table += rows
        self._images[True] = ImageOutputs(self._create(rows), self._found)

    def wanted(self, exact: bool) -> tuple[bool, bool, bool]:
        """Return whether colours, depth and labels have subscribers, of exact images or others."""
        images = self._images.get(exact)
        return (False, False, False) if images is None else images.wanted()

    def have_subscribers(self) -> bool:
        return any((*self.wanted(False), *self.wanted(True), self.infos_wanted()))

    def infos_wanted(self) -> bool:
        return any(info.wanted for info in self._infos)

    def publish_names(self, names: str) -> None:
        """Publish the names of the labels, as :func:`body_names` returns them."""
        self._names.publish(String(data=names))

    def publish_infos(self, time_ns: int) -> None:
        self._info.header = Header(stamp=stamp_of(time_ns), frame_id=self._frame_id)
        for output in self._infos:
            if output.wanted:
                output.publish(self._info)

    def publish(self, shot: Shot) -> None:
        """Publish what the camera saw, and the intrinsics for that instant."""
        head = Header(stamp=stamp_of(shot.snapshot.time_ns), frame_id=self._frame_id)
        self._images[shot.view.exact].publish(head, shot.picture, shot.noise)
        if not shot.view.exact:
            self.publish_infos(shot.snapshot.time_ns)


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
        """Why there are no images, or None."""
        return self._unable or (self._renderer.failed if self._renderer is not None else None)

    def start(self) -> None:
        """Start the thread that renders; without OpenGL log an error, and go on without images."""
        if not self._publishers:
            return
        try:
            self._renderer = CameraThread(
                choose_gl(), VisibleWorld(self._context.simulation.plan),
                [found.view for found in self._publishers.values()], self._publish,
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
        # What is seen later must not depend on who subscribes.
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
            # The stamp is that of the cycle that publishes it, as those of states.
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
