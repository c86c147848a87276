# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Target poses that come regularly are followed without stops, and within all limits."""

from end_effector_operator import distance, operator_of, turned
import numpy as np
import pytest


def sine(times, values, frequency_hz):
    """Return amplitude and delay [s] of what follows sin(2 pi f t)."""
    rate = 2.0 * np.pi * frequency_hz
    waves = np.stack([np.sin(rate * times), np.cos(rate * times), np.ones(len(times))], axis=1)
    along, across, _ = np.linalg.lstsq(waves, values, rcond=None)[0]
    return np.hypot(along, across), np.arctan2(-across, along) / rate


@pytest.mark.full
@pytest.mark.parametrize(('name', 'mode', 'rate', 'frequency_hz', 'radius'), [
    ('Panda', 'position', 100, 1.0, 0.05), ('Panda', 'position', 50, 1.0, 0.05),
    ('Panda', 'position', 100, 2.0, 0.02), ('Panda', 'effort', 100, 1.0, 0.05),
    ('Panda', 'effort', 50, 2.0, 0.02), ('UR5e', 'position', 100, 2.0, 0.01),
    ('Kinova3', 'velocity', 50, 1.0, 0.03), ('Baxter', 'position', 100, 1.0, 0.02),
    # Joints need more than their acceleration limits.
    ('Panda', 'position', 100, 2.0, 0.03), ('UR5e', 'position', 100, 2.0, 0.03)])
def test_a_circle_is_followed_one_and_a_half_intervals_late(
        name, mode, rate, frequency_hz, radius):
    op = operator_of(name, mode=mode, period_s=1.0 / rate)
    start, rotation = op.pose
    times, places, turns = [], [], []
    for period in range(round(2.2 * rate)):
        time_s = period / rate
        angle, size = 2.0 * np.pi * frequency_hz * time_s, radius * min(1.0, time_s)
        op.go_to((start + size * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0]),
                  turned([0.0, 0.0, 1.0], 2.0 * size * np.sin(angle)) @ rotation))
        op.run(1.0 / rate)
        if time_s >= 1.2:
            times.append(time_s + 1.0 / rate)
            places.append(op.pose[0])
            turn = op.pose[1] @ rotation.T
            turns.append(np.arctan2(turn[1, 0], turn[0, 0]))
    for values, whole in ((np.array(places)[:, 1], radius), (turns, 2.0 * radius)):
        amplitude, lag_s = sine(np.array(times), values, frequency_hz)
        assert 0.98 < amplitude / whole < 1.02
        assert lag_s == pytest.approx(1.5 / rate, abs=0.0015)
    assert np.ptp(np.array(places)[:, 2]) < 1e-3


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'effort'])
def test_a_stream_that_stops_goes_on_for_two_intervals_and_ends_at_the_last_pose(mode):
    op = operator_of('Panda', mode=mode)
    start, rotation = op.pose
    for period in range(40):
        last = start + [0.0, 0.003 * period, 0.0]
        op.go_to((last, rotation))
        op.run(op.period_s)
    assert op.twist[1] == pytest.approx(0.3, abs=0.01)
    farthest = []
    # The next message was due now.
    op.run(2.0 * op.period_s, lambda: farthest.append(op.twist[1]))
    assert min(farthest) > 0.28
    op.run(2.0, lambda: farthest.append(op.pose[0][1]))
    assert distance(op.pose, (last, rotation))[0] < 1e-3
    assert np.abs(op.twist).max() < 2e-3


def line_speeds(op, interval_s, messages):
    """Return the speeds of the end effector along a line on which poses come at 0.2 m/s."""
    start, rotation = op.pose
    speeds = []
    for message in range(messages):
        op.go_to((start + [0.0, 0.2 * interval_s * message, 0.0], rotation))
        op.run(interval_s, lambda: speeds.append(op.twist[1]))
    return np.array(speeds)


@pytest.mark.full
@pytest.mark.parametrize(('longest_s', 'ripple'), [(0.105, 0.15), (0.3, 0.002)])
def test_slow_poses_are_followed_without_stops_if_they_are_admitted(longest_s, ripple):
    op = operator_of('Panda')
    op.robot.set_stream('arm', longest_s=longest_s)
    speeds = line_speeds(op, 0.2, 9)[120:]
    assert speeds.mean() == pytest.approx(0.2, rel=0.05)
    assert (np.ptp(speeds) < ripple) == (ripple < 0.1)


def test_of_two_poses_at_one_instant_the_newer_one_counts_as_two_messages():
    places = []
    for alone in (False, True):
        op = operator_of('Panda')
        start, rotation = op.pose
        for period in range(40):
            pose = start + [0.0, 0.003 * period, 0.0], rotation
            if not alone:
                op.go_to((start + [0.0, 0.0, 0.01], turned([1.0, 0.0, 0.0], 0.1) @ rotation))
            op.go_to(pose, messages=1 + alone)
            op.run(op.period_s)
        places.append(op.simulation.data.qpos.tolist())
    assert places[0] == places[1]


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'effort'])
def test_poses_that_are_followed_are_not_told_to_be_out_of_reach(mode):
    op = operator_of('Panda', mode=mode, period_s=0.02)
    start, rotation = op.pose
    for period in range(150):
        way = 0.05 * np.sin(0.1 * period + np.arange(6))
        op.go_to((start + way[:3], turned([0.0, 0.0, 1.0], 2.0 * way[3]) @ rotation))
        op.run(op.period_s)
    assert op.report.counts['unreachable'] == 0


@pytest.mark.full
@pytest.mark.parametrize(('radius', 'slowed'), [(0.03, False), (0.06, True)])
def test_a_circle_that_asks_for_more_than_the_joints_can_do_is_told(radius, slowed):
    op = operator_of('Panda')
    start, rotation = op.pose
    for period in range(120):
        angle, size = 0.04 * np.pi * period, radius * min(1.0, 0.01 * period)
        op.go_to((start + size * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0]), rotation))
        op.run(op.period_s)
    assert (op.report.slowed > 0) == slowed
    assert not slowed or op.report.texts['slowed'] == (
        'right: the stream of poses is slowed down to keep to the limits of the joints')


@pytest.mark.parametrize(('hold_s', 'expected_s'), [(0.0, 0.02), (0.15, 0.15)])
def test_a_stream_of_poses_goes_on_for_as_long_as_it_is_held(hold_s, expected_s):
    op = operator_of('Panda')
    op.robot.set_stream('right', hold_s=hold_s)
    line_speeds(op, op.period_s, 30)
    speeds = []
    op.run(0.5, lambda: speeds.append(op.twist[1]))
    slower = np.flatnonzero(np.array(speeds) < 0.19)[0] * op.period_s
    assert slower == pytest.approx(expected_s, abs=0.021)


@pytest.mark.full
def test_a_stream_faster_than_the_limit_of_the_end_effector_is_followed_at_the_limit():
    op = operator_of('Panda')
    op.robot.joints.cartesian.set('right', 'linear_velocity', 0.2)
    start, rotation = op.pose
    speeds = []
    for period in range(60):
        op.go_to((start + [0.0, 0.005 * period, 0.0], rotation))
        op.run(op.period_s)
        speeds.append(np.linalg.norm(op.twist[:3]))
    assert max(speeds) < 0.21
    assert speeds[-1] == pytest.approx(0.2, abs=0.01)
    op.run(3.0)
    assert distance(op.pose, (start + [0.0, 0.295, 0.0], rotation))[0] < 1e-3
