# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Properties of what is read of messages with commands, for any messages."""

from array import array
import math

import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')

from builtin_interfaces.msg import Duration  # noqa: E402
from geometry_msgs.msg import Twist  # noqa: E402
from hypothesis import given, settings, strategies as st  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

from manip_sim.errors import CommandError  # noqa: E402
from manip_sim.ros.messages import (  # noqa: E402
    nanoseconds_of, read_command, stamp_of, trajectory_fields)

NUMBERS = st.lists(st.floats(), max_size=4)
NAMES = st.lists(st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=5),
                 max_size=4)
POINTS = st.lists(st.builds(
    JointTrajectoryPoint, positions=NUMBERS, velocities=st.just([]) | NUMBERS,
    accelerations=st.just([]) | NUMBERS, effort=st.just([]) | st.just([]) | NUMBERS,
    time_from_start=st.builds(Duration, sec=st.integers(-2**31, 2**31 - 1),
                              nanosec=st.integers(0, 2**32 - 1))), max_size=4)
TRAJECTORIES = st.builds(JointTrajectory, joint_names=NAMES, points=POINTS)
MESSAGES = TRAJECTORIES | st.builds(Float64MultiArray, data=NUMBERS) | st.builds(
    JointState, name=NAMES, position=NUMBERS, velocity=NUMBERS, effort=NUMBERS)


@given(MESSAGES)
def test_a_message_that_was_written_is_read(message):
    # As text, for NaN is not equal to itself.
    assert str(read_command(type(message), serialize_message(message))) == str(message)


@pytest.mark.full
@settings(max_examples=200)
@given(MESSAGES, st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=3),
       st.integers(0, 400))
def test_bytes_that_were_spoiled_are_read_or_rejected(message, changes, length):
    data = bytearray(serialize_message(message)[:length])
    for place, value in changes:
        if data:
            data[place % len(data)] = value
    try:
        found = read_command(type(message), bytes(data))
    except CommandError as error:
        assert str(error).isprintable()
    else:
        assert type(found) is type(message)


@given(TRAJECTORIES)
def test_the_fields_of_a_trajectory_are_those_of_its_points_or_it_is_rejected(message):
    points = message.points
    if any(len(point.effort) for point in points):
        with pytest.raises(CommandError, match='not supported in trajectories'):
            trajectory_fields('arm', message)
        return
    times_s, positions, velocities, accelerations = trajectory_fields('arm', message)
    assert [round(time_s * 1e9) for time_s in times_s] == pytest.approx(
        [p.time_from_start.sec * 10**9 + p.time_from_start.nanosec for p in points], abs=1000)
    for name, values in (('positions', positions), ('velocities', velocities),
                         ('accelerations', accelerations)):
        expected = [list(getattr(point, name)) for point in points]
        found = [row.tolist() for row in values] if values is not None else None
        if not any(expected):
            assert not found
        else:
            assert repr(found) == repr(expected)


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_a_stamp_keeps_every_nanosecond(time_ns):
    stamp = stamp_of(time_ns)
    assert nanoseconds_of(stamp) == time_ns
    assert 0 <= stamp.nanosec < 10**9


@pytest.fixture(scope='module')
def base():
    """Return what reads twists for a mobile base, without a node."""
    from types import SimpleNamespace

    from manip_sim.models import compose
    from manip_sim.ros.command_subscribers import CommandSubscribers
    from manip_sim.simulation import Simulation
    robot = Simulation(compose('PandaOmron')).robot
    robot.set_control_mode('base', 'velocity')
    return robot, lambda message: CommandSubscribers._twist(
        SimpleNamespace(_parse=robot.parse), 'base', message)


@given(st.lists(st.just(0.0) | st.floats(), min_size=6, max_size=6))
def test_a_twist_moves_a_base_forward_sideways_and_about_its_axis_or_is_rejected(base, numbers):
    robot, read = base
    message = Twist()
    linear, angular = message.linear, message.angular
    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = numbers
    planar = not (linear.z or angular.x or angular.y)
    if not planar or not all(map(math.isfinite, (linear.x, linear.y, angular.z))):
        with pytest.raises(CommandError, match='^base: '):
            read(message)
        return
    (command,) = read(message)
    low, high = robot.joints.clamps(command.indices).T
    for value, wanted, least, most in zip(command.twist, (linear.x, linear.y, angular.z),
                                          low, high):
        assert value == min(max(wanted, least), most)


def test_an_array_of_doubles_is_taken_as_it_is():
    message = Float64MultiArray(data=array('d', [1.0, math.pi]))
    assert read_command(Float64MultiArray, serialize_message(message)).data == message.data
