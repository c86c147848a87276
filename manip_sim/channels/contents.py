# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A channel, and the fields of its messages: the one place where messages are made.

In the bytes of a message that is serialized once (CDR), stamp and numbers are replaced.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
import io
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.interface.topics import Scope, Topic, topics_of_cameras, truths
from manip_sim.rendering import Intrinsics
from manip_sim.sensing.instruments import (
    ACCELEROMETER, GYRO, IMU, Instrument, MAGNETIC_FIELD, ORIENTATION, RANGE, VALUES, WRENCH)
from manip_sim.sensing.lidars import Lidar
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

        :param message: of ROS, or of ``manip_sim.records.recorder``
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


#: Types of ``<part>/controller_state``: with control_msgs, and without.
CONTROL_MSGS, CONTROLLER_STATE = (
    'control_msgs/JointTrajectoryControllerState', 'trajectory_msgs/JointTrajectory')
#: Arrays of numbers of a controller's state, each of a number for each joint.
ROWS = 9
#: First entry of a covariance whose sensor is missing (sensor_msgs/Imu).
_NONE = -1.0
#: Rows of a tactile sensor: depths, and speeds of sliding along two tangents.
_TACTILE_CHANNELS = 3
#: sensor_msgs/Range
_INFRARED = 1
#: sensor_msgs/PointField, by the kinds and sizes of numbers.
_DATATYPES = {'f4': 7, 'u2': 4}
#: x, y, z, the number of the ring and two bytes to fill up.
_RING_POINT = np.dtype({'names': [*'xyz', 'ring'], 'formats': [*[np.float32] * 3, np.uint16],
                        'itemsize': 16})
#: Size of the header of serialized data, which says how the data is encoded (OMG CDR) [bytes];
#: what follows is aligned from there.
_ENCODING_SIZE = 4
#: A stamp and the bits of doubles that no name contains, because they are not valid UTF-8.
_MARKED_NS = 0x71FEFDFC * 1_000_000_000 + 0x3AFBFAF9
_MARKED_BITS = 0x6AFFFEFD_F8000000


def doubles(numbers: FloatArray) -> array[float]:
    """Return doubles as rclpy takes them without a check of each."""
    return array('d', np.asarray(numbers, np.float64).tobytes())


def vector(numbers: FloatArray) -> Fields:
    """Return a vector, shape (3,), or a quaternion x, y, z, w, shape (4,)."""
    return dict(zip('xyzw', numbers.tolist()))


def clock(head: Fields, _: FloatArray) -> Fields:
    """Return the time; no numbers are used."""
    return {'clock': head['stamp']}


def joint_state(names: Sequence[str]) -> Make:
    """Return what makes joint states of positions, velocities and efforts, shape (3 n,)."""
    def make(head: Fields, numbers: FloatArray) -> Fields:
        rows = map(doubles, numbers.reshape(3, len(names)))
        return {'header': head, 'name': list(names),
                **dict(zip(('position', 'velocity', 'effort'), rows))}
    return make


def wrench(head: Fields, numbers: FloatArray) -> Fields:
    """Return a wrench: force and torque, shape (6,)."""
    return {'header': head,
            'wrench': {'force': vector(numbers[:3]), 'torque': vector(numbers[3:])}}


def pose(head: Fields, numbers: FloatArray) -> Fields:
    """Return a pose: position and quaternion x, y, z, w, shape (7,)."""
    return {'header': head,
            'pose': {'position': vector(numbers[:3]), 'orientation': vector(numbers[3:])}}


def twist(head: Fields, numbers: FloatArray) -> Fields:
    """Return a twist: linear and angular velocity, shape (6,)."""
    return {'header': head,
            'twist': {'linear': vector(numbers[:3]), 'angular': vector(numbers[3:])}}


def odometry(child_frame: str) -> Make:
    """Return what makes odometry of a pose and a twist in the axes of a frame, shape (13,)."""
    def make(head: Fields, numbers: FloatArray) -> Fields:
        return {'header': head, 'child_frame_id': child_frame,
                **{name: {name: fields_of(head, part)[name]} for name, fields_of, part in (
                    ('pose', pose, numbers[:7]), ('twist', twist, numbers[7:]))}}
    return make


def controller_state(names: Sequence[str], kind: str) -> Make:
    """
    Return what makes states of controllers, of numbers as ``controller_numbers`` returns them.

    Without the package control_msgs they are a ``JointTrajectory`` with four points, which are
    the fields of ``control_msgs/JointTrajectoryControllerState``: reference, feedback, error,
    output.

    :param names: of the joints, n
    :param kind: :data:`CONTROL_MSGS` or :data:`CONTROLLER_STATE`
    """
    fields = ('positions', 'velocities', 'accelerations', 'effort')

    def make(head: Fields, numbers: FloatArray) -> Fields:
        rows = numbers.reshape(ROWS, len(names)).tolist()
        points = {
            'reference': dict(zip(fields, rows)),
            'feedback': dict(zip(('positions', 'velocities', 'effort'), rows[4:])),
            'error': dict(zip(fields, rows[7:])), 'output': {'effort': rows[6]}}
        return {'header': head, 'joint_names': list(names),
                **(points if kind == CONTROL_MSGS else {'points': [*points.values()]})}
    return make


def multi_array(*sizes: tuple[str, int]) -> Make:
    """Return what makes arrays of numbers with the labels and sizes of their dimensions."""
    strides = np.cumprod([size for _, size in reversed(sizes)])[::-1].tolist()

    def make(_: Fields, numbers: FloatArray) -> Fields:
        return {'layout': {'dim': [{'label': label, 'size': size, 'stride': stride}
                                   for (label, size), stride in zip(sizes, strides)]},
                'data': doubles(numbers)}
    return make


def _imu(found: Instrument) -> Make:
    fields = (('orientation', 'framequat', ORIENTATION), ('angular_velocity', 'gyro', GYRO),
              ('linear_acceleration', 'accelerometer', ACCELEROMETER))
    there = {name: [0.0 if kind in found.types else _NONE, *[0.0] * 8] for name, kind, _ in fields}

    def make(head: Fields, numbers: FloatArray) -> Fields:
        return {'header': head, **{name: vector(numbers[places]) for name, _, places in fields},
                **{f'{name}_covariance': values for name, values in there.items()}}
    return make


def _range(found: Instrument) -> Make:
    def make(head: Fields, numbers: FloatArray) -> Fields:
        # MuJoCo gives -1 or the cutoff where there is nothing, REP 117 wants +Inf.
        value = float(numbers[0]) if 0.0 <= numbers[0] < found.reach else np.inf
        return {'header': head, 'radiation_type': _INFRARED, 'max_range': found.reach,
                'range': value}
    return make


def _values(found: Instrument) -> Make:
    label = ' of '.join(filter(None, (found.types[0], found.elements[0])))
    if found.types[0] == 'tactile' and found.length % _TACTILE_CHANNELS == 0:
        return multi_array((f'{label}: depth, slip, slip', _TACTILE_CHANNELS),
                           ('taxels', found.length // _TACTILE_CHANNELS))
    return multi_array((label, found.length))


#: By kind: returns what makes the messages of an instrument.
OF_INSTRUMENTS: dict[str, Callable[[Instrument], Make]] = {
    IMU: _imu, RANGE: _range, VALUES: _values, WRENCH: lambda _: wrench,
    MAGNETIC_FIELD: lambda _: lambda head, numbers: {
        'header': head, 'magnetic_field': vector(numbers)}}


def laser_scan(lidar: Lidar, period_s: float) -> Make:
    """
    Return what makes scans of a planar lidar of ranges, shape (samples,), all of one instant.

    :param period_s: time between two scans [s]
    """
    rays = lidar.rays
    about = {
        'angle_min': rays.angle_min, 'angle_increment': rays.angle_increment,
        'angle_max': rays.angle_min + (rays.samples - 1) * rays.angle_increment,
        'scan_time': period_s, 'range_min': rays.range_min, 'range_max': rays.range_max}
    return lambda head, ranges: {
        'header': head, **about, 'ranges': array('f', ranges.astype(np.float32).tobytes())}


def ring_cloud(lidar: Lidar) -> Make:
    """Return what makes points of ranges of rings, shape (rings * samples,), NaN for nothing."""
    rings, samples, _ = lidar.directions.shape

    def make(head: Fields, ranges: FloatArray) -> Fields:
        finite = np.where(np.isfinite(ranges), ranges, np.nan).reshape(rings, samples)
        points = np.zeros((rings, samples), _RING_POINT)
        for axis, name in enumerate('xyz'):
            points[name] = finite * lidar.directions[..., axis]
        points['ring'] = np.arange(rings)[:, np.newaxis]
        return point_cloud(head, points)
    return make


def point_cloud(head: Any, points: NDArray[Any]) -> Fields:
    """
    Return points in rows, some of which may be NaN.

    :param points: contiguous, of a type with fields, shape (h, w)
    """
    of_type: Mapping[str, Any] = points.dtype.fields or {}
    content = array('B')
    content.frombytes(points.view(np.uint8).data.cast('B'))
    return {
        'header': head, 'height': points.shape[0], 'width': points.shape[1],
        'is_bigendian': sys.byteorder == 'big', 'point_step': points.itemsize,
        'row_step': points.strides[0], 'is_dense': False, 'data': content, 'fields': [
            {'name': name, 'offset': offset, 'datatype': _DATATYPES[kind.str[1:]], 'count': 1}
            for name, (kind, offset, *_) in of_type.items()]}


#: ``format`` of the messages as image_transport writes it, whatever the order of colours inside.
JPEG_FORMAT = 'rgb8; jpeg compressed bgr8'
#: The default of image_transport_plugins.
_QUALITY = 95


def jpeg_of(rgb: NDArray[np.uint8]) -> bytes:
    """
    Return an image as JPEG.

    :param rgb: shape (h, w, 3), the top row first
    """
    from PIL.Image import fromarray
    stream = io.BytesIO()
    fromarray(rgb).save(stream, 'JPEG', quality=_QUALITY)
    return stream.getvalue()


_PLUMB_BOB = 'plumb_bob'
#: Of images, by the kind of their numbers.
_ENCODINGS = {'u': 'rgb8', 'f': '32FC1', 'i': '32SC1'}
#: x, y, z and the colour as a packed number, as in PCL's PointXYZRGB.
_POINT = np.dtype([(name, np.float32) for name in ('x', 'y', 'z', 'rgb')])


@dataclass(frozen=True)
class ImageChannel:
    """
    A topic of a camera.

    :ivar topic: name, type, meaning and QoS
    :ivar parts: of a picture, which ``make`` takes after a header; none for intrinsics. A picture
        without the first one is not published
    :ivar make: returns the fields of a message
    """

    topic: Topic
    parts: tuple[str, ...]
    make: Callable[..., Fields]


def image_channels(camera: str, found: Intrinsics, depth: bool) -> list[ImageChannel]:
    """
    Return the channels of what a camera sees, and of its intrinsics.

    :param found: its intrinsics
    :param depth: whether there are depth images
    """
    info = partial(camera_info, found)
    makers: dict[str, tuple[Callable[..., Fields], tuple[str, ...]]] = {
        'color/image_raw': (image, ('rgb',)),
        'color/image_raw/compressed': (compressed_image, ('rgb',)),
        'color/camera_info': (info, ()),
        'depth/image_raw': (image, ('depth',)),
        'depth/camera_info': (info, ()),
        'depth/points': (PointCloudMaker(found).make, ('depth', 'rgb')),
        'labels/image_raw': (image, ('labels',))}
    rows = {row.name.removeprefix(f'{camera}/'): row for row in topics_of_cameras({camera: depth})}
    return [ImageChannel(rows[name], parts, make) for name, (make, parts) in makers.items()
            if name in rows]


def image(head: Fields, pixels: NDArray[Any]) -> Fields:
    """
    Return an image: ``rgb8`` of bytes with shape (h, w, 3), ``32FC1`` or ``32SC1`` of (h, w).

    :param pixels: contiguous, the top row first
    """
    # rclpy takes an array.array as it is, and checks anything else byte by byte.
    content = array('B')
    content.frombytes(pixels.data.cast('B'))
    return {'header': head, 'height': pixels.shape[0], 'width': pixels.shape[1],
            'encoding': _ENCODINGS[pixels.dtype.kind], 'is_bigendian': sys.byteorder == 'big',
            'step': pixels.strides[0], 'data': content}


def compressed_image(head: Fields, rgb: NDArray[np.uint8]) -> Fields:
    """
    Return an image as JPEG.

    :param rgb: shape (h, w, 3), the top row first
    """
    return {'header': head, 'format': JPEG_FORMAT, 'data': array('B', jpeg_of(rgb))}


def camera_info(found: Intrinsics, head: Fields) -> Fields:
    """Return the intrinsics of a camera without distortion."""
    projection = np.array([
        [found.fx, 0.0, found.cx, 0.0], [0.0, found.fy, found.cy, 0.0], [0.0, 0.0, 1.0, 0.0]])
    return {'header': head, 'width': found.width, 'height': found.height,
            'distortion_model': _PLUMB_BOB, 'd': [0.0] * 5, 'k': projection[:, :3].ravel(),
            'r': np.eye(3).ravel(), 'p': projection.ravel()}


class PointCloudMaker:
    """Makes organised point clouds of the depth images of one camera."""

    def __init__(self, found: Intrinsics) -> None:
        #: Point of the ray of a pixel at a depth of one, shape (w,) and (h, 1).
        self._right = ((np.arange(found.width) - found.cx) / found.fx).astype(np.float32)
        self._down = ((np.arange(found.height) - found.cy) / found.fy).astype(
            np.float32)[:, np.newaxis]
        self._points = np.empty((found.height, found.width, 4), dtype=np.float32)

    def make(self, head: Fields, depth: NDArray[Any], rgb: NDArray[np.uint8] | None) -> Fields:
        """
        Return the points that a camera sees, in its optical frame, one for each pixel.

        :param depth: along the view [m], +Inf where there is nothing, shape (h, w)
        :param rgb: shape (h, w, 3), or None for points without colours, which are white
        """
        points = self._points
        points[..., 2] = np.where(np.isfinite(depth), depth, np.nan)
        np.multiply(points[..., 2], self._right, out=points[..., 0])
        np.multiply(points[..., 2], self._down, out=points[..., 1])
        colours = points.view(np.uint8)[..., 12:]
        # In memory the last byte of the number comes first: blue, green, red.
        colours[..., :3] = 255 if rgb is None else rgb[..., ::-1]
        colours[..., 3] = 0
        return point_cloud(head, points.view(_POINT)[..., 0])


class PatchedBytes:
    """
    The bytes of messages that differ in their stamps and numbers only.

    ``serialize`` is called once with marked numbers; where these are found in the serialized
    data, others are written later.

    :param serialize: returns the bytes of the message for a time [ns] and for numbers, shape
        (count,)
    """

    def __init__(self, serialize: Callable[[int, FloatArray], bytes], count: int) -> None:
        marks = _MARKED_BITS + np.arange(count, dtype=np.uint64)
        self._buffer = bytearray(serialize(_MARKED_NS, marks.view(np.float64)))
        self._content = memoryview(self._buffer)
        aligned = memoryview(self._buffer)[_ENCODING_SIZE:]
        self._words = np.frombuffer(aligned, np.uint32, len(aligned) // 4)
        self._doubles = np.frombuffer(aligned, np.float64, len(aligned) // 8)
        bits = self._doubles.view(np.uint64)
        self._places = np.flatnonzero(np.isin(bits, marks))
        #: Index of the number of each place.
        self._sources = (bits[self._places] - np.uint64(_MARKED_BITS)).astype(np.int64)
        self._in_order = np.array_equal(self._sources, np.arange(count))
        seconds, nanoseconds = divmod(_MARKED_NS, 1_000_000_000)
        self._seconds = np.flatnonzero(self._words == seconds)
        self._nanoseconds = np.flatnonzero(self._words == nanoseconds)

    def cut(self, size: int) -> None:
        """Cut off the bytes behind the message."""
        self._content = self._content[:size]

    def at(self, time_ns: int, numbers: FloatArray) -> bytes:
        """
        Return the bytes of a message.

        :param time_ns: simulation time [ns]
        """
        self._words[self._seconds], self._words[self._nanoseconds] = divmod(
            time_ns, 1_000_000_000)
        self._doubles[self._places] = numbers if self._in_order else numbers[self._sources]
        return bytes(self._content)
