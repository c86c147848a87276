# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Each number of a message stands in the field that it is for, and the stamp in the header."""

import numpy as np
import pytest

from manip_sim.channels import contents
from manip_sim.ros import messages
from manip_sim.ros.messages import SerializedMessage

STAMP = messages.stamp_of(12_000_000_034)
HEAD = {'stamp': {'sec': 12, 'nanosec': 34}, 'frame_id': 'frame'}


def numbers_of(message):
    """Return the fields of a vector or quaternion in the order of the ROS definition."""
    return [getattr(message, name) for name in message.get_fields_and_field_types()]


def test_a_stamp_has_whole_seconds_and_the_nanoseconds_that_are_left():
    assert (STAMP.sec, STAMP.nanosec) == (12, 34)
    assert messages.nanoseconds_of(STAMP) == 12_000_000_034
    clock = messages.message_of('rosgraph_msgs/Clock', contents.clock(HEAD, np.empty(0)))
    assert clock.clock == STAMP


def test_joint_states_are_positions_then_velocities_then_efforts():
    names = ['a', 'b']
    message = messages.message_of(
        'sensor_msgs/JointState', contents.joint_state(names)(HEAD, np.arange(6.0)))
    assert (message.header.stamp, message.name) == (STAMP, names)
    assert list(message.position) == [0.0, 1.0]
    assert list(message.velocity) == [2.0, 3.0]
    assert list(message.effort) == [4.0, 5.0]


@pytest.mark.parametrize(('make', 'halves', 'count'), [
    (contents.wrench, lambda m: (m.wrench.force, m.wrench.torque), 6),
    (contents.twist, lambda m: (m.twist.linear, m.twist.angular), 6),
    (contents.pose, lambda m: (m.pose.position, m.pose.orientation), 7)])
def test_two_halves_of_numbers_go_to_the_two_fields_in_their_order(make, halves, count):
    message = messages.message_of(f'geometry_msgs/{make.__name__.capitalize()}Stamped',
                                  make(HEAD, np.arange(1.0, 1.0 + count)))
    assert (message.header.stamp, message.header.frame_id) == (STAMP, 'frame')
    first, second = halves(message)
    assert numbers_of(first) + numbers_of(second) == list(range(1, 1 + count))
    assert [first.x, first.y, first.z, second.x] == [1.0, 2.0, 3.0, 4.0]


def test_what_is_no_message_is_returned_as_it_is_made():
    made = SerializedMessage(lambda stamp, numbers: (stamp.sec, numbers.tolist()), 2)
    assert not made.patches
    assert made.at(3_000_000_000, np.array([1.0, 2.0])) == (3, [1.0, 2.0])


def test_a_message_whose_numbers_cannot_be_replaced_is_made_anew():
    # The name tells the first number, which the bytes of another message would not.
    def make(stamp, numbers):
        return messages.message_of('sensor_msgs/JointState', contents.joint_state(
            [f'joint{numbers[0]:g}'])(HEAD, numbers))
    serialized = SerializedMessage(make, 3)
    assert not serialized.patches
    assert serialized.at(0, np.array([5.0, 0.0, 0.0])).name == ['joint5']
