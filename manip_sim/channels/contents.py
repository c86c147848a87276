# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The fields of messages, by header and numbers: the one place where messages are made."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.channels.channel import Fields, Make
from manip_sim.sensing.instruments import (
    ACCELEROMETER, GYRO, IMU, Instrument, MAGNETIC_FIELD, ORIENTATION, RANGE, VALUES, WRENCH)
from manip_sim.sensing.lidars import Lidar

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


def _magnetic_field(_: Instrument) -> Make:
    return lambda head, numbers: {'header': head, 'magnetic_field': vector(numbers)}


#: By kind: returns what makes the messages of an instrument.
OF_INSTRUMENTS: dict[str, Callable[[Instrument], Make]] = {
    IMU: _imu, RANGE: _range, VALUES: _values, MAGNETIC_FIELD: _magnetic_field,
    WRENCH: lambda _: wrench}


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
