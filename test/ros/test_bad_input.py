# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Messages that must change nothing, be counted, and be explained once a second."""

import math
import time

from builtin_interfaces.msg import Duration
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

NAN, INF = math.nan, math.inf
J1 = 'robot0_joint1'
FINGER = 'gripper0_right_finger_joint1'


def action(*numbers):
    return Float64MultiArray(data=list(numbers))


def joints(names, position=(), velocity=(), effort=()):
    return JointState(name=list(names), position=list(position), velocity=list(velocity),
                      effort=list(effort))


def trajectory(names, *points):
    return JointTrajectory(joint_names=list(names), points=list(points))


def point(positions, sec=1, **fields):
    return JointTrajectoryPoint(positions=positions, time_from_start=Duration(sec=sec), **fields)


REJECTED = {
    'arm/command': [
        (action(), 'must have 7 numbers, got'),
        (action(0.0), 'must have 7 numbers, got'),
        (action(*[0.0] * 8), 'must have 7 numbers, got'),
        (action(NAN, *[0.0] * 6), 'must be finite'),
        (action(*[0.0] * 6, -INF), 'must be finite')],
    'right/gripper/command': [
        (action(), 'must have 1 number, got'),
        (action(1.0, 1.0), 'must have 1 number, got'),
        (action(NAN), 'must be finite')],
    'arm/joint_command': [
        (joints([], [0.0]), 'no joint is named'),
        (joints(['elbow']), "no joint 'elbow'"),
        (joints(['elbow'], [0.0]), "no joint 'elbow'"),
        (joints(['joint2'], [0.0]), "did you mean 'robot0_joint2'? available: robot0_joint1, "),
        (joints([FINGER], [0.0]), 'that can be commanded'),
        (joints([J1, J1], [0.0, 0.1]), 'named twice'),
        (joints([J1], [0.0, 0.1]), 'must have 1 number, got'),
        (joints([J1], [INF]), 'must be finite'),
        (joints([J1], [0.1], [0.1]), 'does not use the field velocity'),
        (joints([J1], [0.1], [0.1, NAN]), 'velocity must have'),
        (joints([J1], effort=[1.0]), 'does not use the field effort')],
    'arm/impedance_command': [
        (action(), 'must have 5 numbers for each of 7 joints, got 0'),
        (action(*[0.1] * 7), 'position, velocity, effort, stiffness, damping of all'),
        (action(*[0.1] * 35), "'robot0_joint1' is in position mode, not in impedance mode")],
    'right/force_mode': [
        (action(), 'must have 18 numbers, got 0'),
        (action(*[0.1] * 18), 'must be 0 or 1 for each axis'),
        (action(*[1.0] * 18), 'needs effort mode and a cartesian_stiffness.right')],
    'right/gripper/joint_command': [
        (joints([FINGER], [-INF]), 'must be finite'),
        (joints([J1], [0.0]), 'has no joint'),
        (joints([FINGER], velocity=[1.0]), 'does not use the field velocity')],
    'joint_command': [
        (joints([], [0.0]), 'no joint is named'),
        (joints([J1, 'elbow'], [0.2, 0.2]), "no joint 'elbow'"),
        (joints([FINGER, J1], [0.02]), 'must have 2 numbers, got 1'),
        (joints([J1], [0.1], effort=[0.1]), 'does not use the field effort')],
    'arm/joint_trajectory': [
        (trajectory([], point([])), 'no joint is named'),
        (trajectory(['elbow'], point([0.1])), "no joint 'elbow'"),
        (trajectory(['elbow']), "no joint 'elbow'"),
        (trajectory([J1], point([0.1, 0.2])), 'must have 1 number at each of 1 point'),
        (trajectory([J1], point([NAN])), 'must be finite'),
        (trajectory([J1], point([0.1], sec=-1)), 'must not be negative'),
        (trajectory([J1], point([0.1]), point([0.2], 2, velocities=[1.0])), 'velocities'),
        (trajectory([J1], point([0.1], effort=[1.0])), 'not supported in trajectories')],
}


@pytest.mark.full
@pytest.mark.parametrize('topic', REJECTED)
def test_bad_messages_change_nothing_and_are_explained(topic, serve, client):
    log = client.log()
    node = serve()
    start = client.state()
    part = topic.rsplit('/', 1)[0] if '/' in topic else topic
    # Those of an arm's end effector count for the arm.
    statistics = node.commands.robots[0].statistics['arm' if part == 'right' else part]
    for message, reason in REJECTED[topic]:
        # What is like the one before is told a second later.
        while not any(reason in line for line in log):
            count = statistics.rejected
            client.publish(topic, message)
            client.spin_until(lambda n=count: statistics.rejected == n + 1)
            client.executor.spin_once(timeout_sec=0.2)
    end = client.state()
    np.testing.assert_allclose(end.position, start.position, atol=1e-3)
    assert statistics.accepted == 0


@pytest.mark.full
@pytest.mark.parametrize('topic, message', [
    ('arm/command', action(*[1e308] * 7)),
    ('right/gripper/command', action(1e308)),
    ('arm/joint_command', joints([J1], [-1e308])),
    ('joint_command', joints([FINGER], [1e308])),
    ('arm/joint_trajectory', trajectory([J1], point([1e308], sec=3)))])
def test_huge_numbers_are_clamped_and_the_state_stays_finite(topic, message, serve, client):
    node = serve(stepping='free')
    client.publish(topic, message)
    client.spin_until(
        lambda: sum(s.clamped for s in node.commands.robots[0].statistics.values()) > 0)
    states = client.listen(JointState, 'joint_states', 10)
    client.spin_until(lambda: len(states) > 200)
    for state in states[-5:]:
        assert np.isfinite([state.position, state.velocity, state.effort]).all()
    assert node.simulation.diverged is None


@pytest.mark.full
def test_ten_thousand_messages_in_a_second_are_survived(serve, client):
    log = client.log()
    node = serve()
    publisher = client.publisher(Float64MultiArray, 'arm/command', 1)
    bad, good = action(NAN), action(*[0.0] * 7)
    begin = time.monotonic()
    for n in range(10_000):
        publisher.publish(bad if n % 2 else good)
    statistics = node.commands.robots[0].statistics['arm']
    # The last one is kept, whatever came before it.
    client.spin_until(lambda: statistics.rejected > 0)
    publisher.publish(good)
    client.spin_until(lambda: statistics.accepted > 0)
    state = client.state()
    elapsed_s = time.monotonic() - begin
    assert np.isfinite([state.position, state.velocity, state.effort]).all()
    assert sum('must have' in line for line in log) <= elapsed_s + 1
