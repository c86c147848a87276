# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read serialized messages: data that is too large, or not a message, is rejected."""

from __future__ import annotations

from functools import partial
import struct
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from manip_sim.control.command_parser import MAX_POINTS
from manip_sim.errors import CommandError, ManipSimError, MessageError
from manip_sim.ros.messages import seconds_of

#: More than any command but a trajectory needs [bytes].
_MAX_SIZE = 2**18
#: Enough for the points of many joints with velocities and accelerations [bytes].
_MAX_TRAJECTORY_SIZE = 2**24
_MAX_JOINTS = 1000
#: Size of the header of serialized data, which says how the data is encoded [bytes].
_ENCODING_SIZE = 4


def read_message(message_type: Any, data: bytes, most: int = _MAX_SIZE, what: str = 'a command',
                 error: type[ManipSimError] = MessageError) -> Any:
    """
    Return the message that was serialized.

    rclpy makes Python objects of a message in one call, in which no other thread runs: 100 000
    points of a trajectory would stop the physics for more than a second. So sizes are checked
    first.

    :param most: size of the data at most [bytes], but of a trajectory
    :param what: has this size at most, for the message
    :param error: the exception to raise
    :raises ManipSimError: that exception, if the data is too large, or not a message of this type
    """
    trajectory = message_type is JointTrajectory
    if trajectory:
        most = _MAX_TRAJECTORY_SIZE
    if len(data) > most:
        raise error(f'the message has {len(data)} bytes, {what} has {most} at most')
    try:
        if trajectory:
            _check_counts(data)
        return deserialize_message(data, message_type)
    except (struct.error, RuntimeError) as cause:
        raise error('the data cannot be read as a message of the type '
                    f'{message_type.__name__}') from cause


#: The same for a command, which raises ``CommandError``.
read_command = partial(read_message, error=CommandError)


def trajectory_fields(part: str, message: JointTrajectory) -> tuple[Any, Any, Any, Any]:
    """
    Return the times of a trajectory's points [s], and positions, velocities and accelerations.

    Velocities and accelerations that no point has are None.

    :param part: that it is for, named in errors
    :raises CommandError: if a point has an effort
    """
    points = message.points
    times_s = [seconds_of(point.time_from_start) for point in points]
    positions, velocities, accelerations = (
        None if all(not len(getattr(p, name)) for p in points)
        else [np.asarray(getattr(p, name)) for p in points]
        for name in ('positions', 'velocities', 'accelerations'))
    if any(len(p.effort) for p in points):
        raise CommandError(f'{part}: effort is not supported in trajectories, leave it empty')
    return times_s, positions or [], velocities, accelerations


def _check_counts(data: bytes) -> None:
    """Check how many names and points a serialized ``JointTrajectory`` has (OMG CDR, 9.3)."""
    number = struct.Struct('<I' if data[1:2] == b'\x01' else '>I')

    def read(offset: int) -> tuple[int, int]:
        """Return the number at the next multiple of four bytes, and where it ends."""
        offset += -offset % 4
        value: int = number.unpack_from(data, offset)[0]
        return value, offset + 4
    # The header begins with a stamp of 8 bytes; then a frame, the names of joints and the points.
    length, offset = read(_ENCODING_SIZE + 8)
    count, offset = read(offset + length)
    if count > _MAX_JOINTS:
        raise CommandError(f'a trajectory may have at most {_MAX_JOINTS} joints, got {count}')
    for _ in range(count):
        length, offset = read(offset)
        offset += length
    count, _ = read(offset)
    if count > MAX_POINTS:
        raise CommandError(f'a trajectory may have at most {MAX_POINTS} points, got {count}')
