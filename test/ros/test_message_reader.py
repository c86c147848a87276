# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Messages that are read in place are those of rclpy's own deserialization, for any bytes."""

from array import array
import math
import struct

import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')

from builtin_interfaces.msg import Time  # noqa: E402
from geometry_msgs.msg import (  # noqa: E402
    Point, Pose, PoseStamped, Quaternion, Twist, TwistStamped, Vector3, Wrench, WrenchStamped)
from hypothesis import given, strategies as st  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import (  # noqa: E402
    Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout)
from visualization_msgs.msg import Marker  # noqa: E402

from manip_sim.errors import CommandError  # noqa: E402
from manip_sim.ros import messages  # noqa: E402
from manip_sim.ros.messages import MessageReader  # noqa: E402

TEXTS = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9)
#: Of any bits, so that NaN comes with any of its signs and contents.
FLOATS = st.floats() | st.binary(min_size=8, max_size=8).map(
    lambda bits: struct.unpack('<d', bits)[0])
STAMPS = st.builds(Time, sec=st.integers(-2**31, 2**31 - 1), nanosec=st.integers(0, 2**32 - 1))
HEADERS = st.builds(Header, stamp=STAMPS, frame_id=TEXTS)
NUMBERS = st.lists(FLOATS, max_size=8)
VECTORS = st.builds(Vector3, x=FLOATS, y=FLOATS, z=FLOATS)
POINTS = st.builds(Point, x=FLOATS, y=FLOATS, z=FLOATS)
POSES = st.builds(Pose, position=POINTS, orientation=st.builds(
    Quaternion, x=FLOATS, y=FLOATS, z=FLOATS, w=FLOATS))
TWISTS = st.builds(Twist, linear=VECTORS, angular=VECTORS)
SIZES = st.integers(0, 2**32 - 1)
MESSAGES = st.one_of(
    st.builds(JointState, header=HEADERS, name=st.lists(TEXTS, max_size=5), position=NUMBERS,
              velocity=NUMBERS, effort=NUMBERS),
    st.builds(Float64MultiArray, data=NUMBERS, layout=st.builds(
        MultiArrayLayout, data_offset=SIZES, dim=st.lists(st.builds(
            MultiArrayDimension, label=TEXTS, size=SIZES, stride=SIZES), max_size=3))),
    TWISTS,
    st.builds(TwistStamped, header=HEADERS, twist=TWISTS),
    st.builds(PoseStamped, header=HEADERS, pose=POSES),
    st.builds(WrenchStamped, header=HEADERS, wrench=st.builds(
        Wrench, force=VECTORS, torque=VECTORS)),
    st.builds(Marker, header=HEADERS, ns=TEXTS, id=st.integers(-2**31, 2**31 - 1), pose=POSES,
              points=st.lists(POINTS, max_size=3), text=TEXTS, frame_locked=st.booleans()))
#: Places in the bytes of a message and what is written there.
CHANGES = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=4)


def values_of(message):
    """Return the values of all fields, with the bits of doubles instead of these."""
    if isinstance(message, float):
        return struct.pack('<d', message)
    if isinstance(message, array):
        return message.typecode, message.tobytes()
    if isinstance(message, (list, tuple)):
        return [values_of(item) for item in message]
    if hasattr(message, 'get_fields_and_field_types'):
        return {name: values_of(getattr(message, name))
                for name in message.get_fields_and_field_types()}
    return message


def read_by(read, data):
    """Return the values of the message that a function reads, or why there is none."""
    try:
        return values_of(read(data))
    except CommandError as error:
        return str(error)


def check(reader, message_type, data):
    expected = read_by(lambda data: messages.read_command(message_type, data), data)
    assert read_by(reader.read, data) == expected


def spoilt(data, changes, length):
    data = bytearray(data[:length])
    for place, value in changes:
        if data:
            data[place % len(data)] = value
    return bytes(data)


@given(MESSAGES, st.lists(CHANGES, min_size=1, max_size=4), st.integers(0, 500))
def test_bytes_that_were_spoiled_are_read_as_rclpy_reads_them(message, several, length):
    reader, data = MessageReader(type(message)), serialize_message(message)
    check(reader, type(message), data)
    for changes in several:
        check(reader, type(message), spoilt(data, changes, length))
        check(reader, type(message), spoilt(data, changes, None))
    # What was spoiled must not spoil what comes after it.
    check(reader, type(message), data)


@given(MESSAGES, st.binary(min_size=400, max_size=400))
def test_messages_with_other_stamps_and_numbers_are_read_in_place(message, noise):
    reader, data = MessageReader(type(message)), serialize_message(message)
    check(reader, type(message), data)
    (layout,) = reader._layouts
    # Other bits wherever the layout does not compare: stamps, doubles and what lies between.
    noise = (noise * (len(data) // len(noise) + 1))[:len(data)]
    other = bytes(old if compared else new for old, new, compared in zip(
        data, noise, layout._compared))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(messages, 'read_command', None)
        found = values_of(reader.read(other))
    assert found == values_of(deserialize_message(other, type(message)))


@given(MESSAGES, MESSAGES)
def test_clients_that_send_other_layouts_take_turns(one, other):
    for message_type in {type(one), type(other)}:
        reader = MessageReader(message_type)
        for message in (one, other) * 2:
            check(reader, message_type, serialize_message(message))


def joint_state(names, numbers, **fields):
    return bytes(serialize_message(JointState(name=names, position=numbers, **fields)))


def test_arrays_of_a_message_stay_when_the_next_one_is_read():
    reader = MessageReader(JointState)
    positions = [reader.read(joint_state(['a', 'b'], [0.1 * n, 0.2])).position for n in range(4)]
    assert [list(position) for position in positions] == [[0.1 * n, 0.2] for n in range(4)]


def test_stamps_and_numbers_cost_no_deserialization_and_other_names_do(monkeypatch):
    read, count = messages.read_command, []

    def counted(message_type, data):
        count.append(data)
        return read(message_type, data)
    monkeypatch.setattr(messages, 'read_command', counted)
    reader = MessageReader(JointState)
    header = Header(stamp=Time(sec=7, nanosec=8))
    for data, deserialized in (
            (joint_state(['a', 'b'], [0.1, 0.2]), 1),
            (joint_state(['a', 'b'], [-math.inf, math.nan], header=header), 1),
            (joint_state(['a', 'c'], [0.1, 0.2]), 2),
            (joint_state(['a', 'b'], [0.1]), 3),
            (joint_state(['a', 'b'], [], velocity=[0.1, 0.2]), 4),
            (joint_state(['a', 'c'], [0.3, 0.2]), 4),
            (joint_state(['a', 'b'], [0.3, 0.2]), 4)):
        assert values_of(reader.read(data)) == values_of(deserialize_message(data, JointState))
        assert len(count) == deserialized


def test_layouts_of_many_clients_are_forgotten():
    reader = MessageReader(JointState)
    for n in range(100):
        check(reader, JointState, joint_state([f'joint{n}'], [0.1]))
    assert len(reader._layouts) < 10
    large = joint_state(['a' * 100_000], [0.1])
    for _ in range(2):
        check(reader, JointState, large)
    assert all(layout.fits(0, len(large)) is False for layout in reader._layouts)


@pytest.mark.parametrize('begin', [b'\0\0', b'\0\2', b'\0\3', b'\1\1', b'\0\7'])
def test_data_in_another_encoding_is_read_by_rclpy(begin):
    data = joint_state(['a'], [0.1])
    reader = MessageReader(JointState)
    check(reader, JointState, data)
    for _ in range(2):
        check(reader, JointState, begin + data[2:])
    assert len(reader._layouts) == 1


def test_a_message_with_the_most_significant_byte_first_is_read_by_rclpy():
    data = b'\0\0\0\0' + struct.pack('>IIIxxxxd', 0, 0, 1, 0.5)
    reader = MessageReader(Float64MultiArray)
    for _ in range(2):
        assert list(reader.read(data).data) == [0.5]
    assert not reader._layouts
