# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of following trajectories: when they start, what they replace, how they end."""

import numpy as np
import pytest

from sampling import Driven, sampled

from manip_sim.control.commands import Status
from manip_sim.control.trajectory import Trajectory
from manip_sim.errors import CommandError

J1, J2, J5 = 'robot0_joint1', 'robot0_joint2', 'robot0_joint5'
SECOND_NS = 10**9


@pytest.fixture
def op(panda_op):
    """Return an operator of the Panda at a time that is not zero."""
    panda_op.run(0.5)
    return panda_op


def smooth(t):
    """Return the smooth step from 0 to 1."""
    s = np.clip(t, 0.0, 1.0)
    return 3.0 * s**2 - 2.0 * s**3


def test_arm_follows_a_trajectory_of_two_joints(op):
    goals, errors = np.array([[0.3, -0.2], [0.1, 0.4]]), []
    oracle = Trajectory(np.array([1.0, 2.0]), goals)
    oracle.begin_at(np.array(op.where(J1, J5)), np.zeros(2))
    first = op.simulation.step_count
    op.follow('arm', [J1, J5], [1.0, 2.0], goals)
    op.run(2.5, lambda: errors.append(np.array(op.where(J1, J5)) - oracle.at(
        (op.simulation.step_count - first) * 0.002)[0]))
    assert np.abs(errors).max() < 1e-3
    np.testing.assert_allclose(op.where(J1, J5), goals[-1], atol=1e-4)


def test_joints_that_are_not_named_stay(op):
    before = op.simulation.robot.state().position
    op.follow('arm', [J2], [0.5], [[0.4]])
    op.run(1.0)
    others = np.delete(op.simulation.robot.state().position - before, 1)
    np.testing.assert_allclose(others, 0.0, atol=1e-3)


def test_a_trajectory_begins_while_one_that_came_before_it_still_waits(op):
    now_ns, before = op.simulation.time_ns, np.array(op.where(J1, J2))
    waiting = op.follow('arm', [J1], [0.5], [[before[0] + 0.2]], start_ns=now_ns + 10**9).handle
    handle = op.follow('arm', [J2], [0.5], [[before[1] + 0.2]], start_ns=now_ns + 10**8).handle
    op.run(0.8)
    assert (handle.status, waiting.status) == (Status.DONE, Status.RUNNING)
    np.testing.assert_allclose(op.where(J1, J2), before + [0.0, 0.2], atol=1e-3)
    op.run(1.0)
    assert waiting.status is Status.DONE


@pytest.mark.full
@pytest.mark.parametrize('delay_s', [0.0, -0.003, -0.1, -0.2])
def test_time_runs_from_the_stamp_also_where_that_is_past(op, delay_s):
    start_ns = op.simulation.time_ns + round(delay_s * 1e9)
    times = np.arange(0.05, 1.01, 0.05)
    points = 0.4 * smooth(times)[:, None]
    speeds = (0.4 * 6.0 * (times - times**2))[:, None]
    handle = op.follow('arm', [J1], times, points, speeds, start_ns=start_ns).handle
    errors = []

    def compare():
        since_s = (op.simulation.time_ns - start_ns) * 1e-9
        errors.append(op.where(J1)[0] - 0.4 * smooth(since_s))

    op.run(1.0 + delay_s - 0.011, compare)
    assert handle.status is Status.RUNNING
    # What was missed is made good on the way to the first point to come, then it is in time.
    assert np.abs(errors[12:]).max() < 2e-3
    op.run(0.03, compare)
    assert handle.status is Status.DONE
    op.run(0.3, compare)
    assert abs(errors[-1]) < 1e-4


def test_trajectory_that_is_slowed_down_as_its_points_are_past_begins_now(op):
    op.run(0.5)
    command = op.follow('arm', [J1], [0.3, 0.6], [[0.8], [1.6]],
                        start_ns=op.simulation.time_ns - SECOND_NS // 2)
    # A tenth of a second is left for 1.6 rad.
    assert command.slowed == pytest.approx(1.5 * 16.0 / 2.175, rel=0.01)
    arm = Driven(op.simulation, 'arm')
    with sampled(arm) as samples:
        op.run(0.1 * command.slowed - 0.02)
        assert command.handle.status is Status.RUNNING
        op.run(1.0)
    assert samples.velocity[:, 0].max() == pytest.approx(2.175, rel=0.01)
    assert command.handle.status is Status.DONE
    assert op.where(J1)[0] == pytest.approx(1.6, abs=1e-3)


def test_trajectory_that_has_ended_is_rejected(op):
    with pytest.raises(CommandError, match=r'^arm: the trajectory ended 0\.100 s ago, by its '
                                           r'stamp$'):
        op.follow('arm', [J1], [0.1, 0.3], [[0.1], [0.2]],
                  start_ns=op.simulation.time_ns - 400_000_000)


def test_stamp_of_another_clock_is_rejected_with_a_hint(op):
    with pytest.raises(CommandError, match=r'^arm: the trajectory would start in \d+ s of '
                                           r'simulation time, by its stamp: set use_sim_time in '
                                           r'the node that sends it, or leave the stamp zero$'):
        op.follow('arm', [J1], [1.0], [[0.1]], start_ns=1_760_000_000 * SECOND_NS)


def test_until_a_later_trajectory_starts_what_runs_goes_on(op):
    first = op.follow('arm', [J1], [1.0], [[0.5]]).handle
    op.run(0.1)
    begin_ns = op.simulation.time_ns + SECOND_NS // 2
    second = op.follow('arm', [J1], [1.0], [[-0.3]], start_ns=begin_ns).handle
    places = []
    op.run(0.5, lambda: places.append(op.where(J1)[0]))
    np.testing.assert_allclose(places, 0.5 * smooth(0.1 + np.arange(1, 51) * 0.01), atol=1e-3)
    assert (first.status, second.status) == (Status.RUNNING, Status.RUNNING)
    op.run(0.02)
    assert first.status is Status.REPLACED
    op.run(1.1)
    assert second.status is Status.DONE
    assert op.where(J1)[0] == pytest.approx(-0.3, abs=1e-3)


def test_goal_goes_on_until_a_later_trajectory_starts_and_may_be_done_before(op):
    (goal,) = op.go({J1: 0.3})
    later = op.follow('arm', [J1], [0.5], [[0.0]],
                      start_ns=op.simulation.time_ns + 2 * SECOND_NS).handle
    op.run(1.9)
    assert goal.status is Status.DONE
    assert op.where(J1)[0] == pytest.approx(0.3, abs=1e-3)
    op.run(0.7)
    assert later.status is Status.DONE


def test_goal_takes_a_joint_from_a_trajectory_that_has_not_started(op):
    later = op.follow('arm', [J1, J2], [0.5], [[0.3, 0.3]],
                      start_ns=op.simulation.time_ns + SECOND_NS // 2).handle
    (before,) = op.where(J1)
    op.go({J1: before})
    op.run(1.5)
    assert later.status is Status.DONE
    assert later.error.shape == (1,)
    np.testing.assert_allclose(op.where(J1, J2), [before, 0.3], atol=1e-3)


def test_start_inside_a_period_counts_from_the_stamp(op):
    start_ns = op.simulation.time_ns + 3_000_000
    op.follow('arm', [J1], [1.0], [[0.4]], start_ns=start_ns)
    op.run(0.5)
    since_s = (op.simulation.time_ns - start_ns) * 1e-9
    assert op.where(J1)[0] == pytest.approx(0.4 * smooth(since_s), abs=1e-3)


def test_newer_trajectory_goes_on_from_where_and_how_fast_the_older_one_is(op):
    arm = Driven(op.simulation, 'arm')
    older = op.follow('arm', [J1], [1.0], [[0.5]]).handle
    with sampled(arm) as samples:
        op.run(0.5)
        op.follow('arm', [J1], [1.0], [[0.0]])
        op.run(1.3)
    assert older.status is Status.REPLACED
    velocity, acceleration = samples.velocity[:, 0], np.diff(samples.velocity[:, 0]) / 0.002
    assert velocity[249] == pytest.approx(0.75, abs=0.02)
    # The cubic begins with the velocity of the older one and needs 6 x / t^2 + 4 v / t.
    assert np.abs(acceleration).max() < 1.1 * (6.0 * 0.25 + 4.0 * 0.75)
    assert samples.position[-1, 0] == pytest.approx(0.0, abs=1e-3)


def test_stream_of_trajectories_that_overlap_is_smooth(op):
    # As a servo sends them: 100 times a second, the first points past, a velocity at the end.
    arm, ahead = Driven(op.simulation, 'arm'), np.arange(0.0, 0.2, 0.01)
    begin_s = op.simulation.time_s
    with sampled(arm) as samples:
        for _ in range(100):
            now_s = op.simulation.time_s - begin_s
            times = now_s - 0.1 + ahead
            points = 0.2 * (1.0 - np.cos(2.0 * np.maximum(times, 0.0)))[:, None]
            speeds = (0.4 * np.sin(2.0 * np.maximum(times, 0.0)))[:, None]
            handle = op.follow('arm', [J1], ahead, points, speeds,
                               start_ns=op.simulation.time_ns - 100_000_000).handle
            op.run(0.01)
        op.run(1.0)
    time = np.arange(1, 501) * 0.002
    np.testing.assert_allclose(samples.position[:500, 0], 0.2 * (1.0 - np.cos(2.0 * time)),
                               atol=2e-3)
    assert np.abs(np.diff(samples.velocity[:500, 0]) / 0.002).max() < 2.0
    assert handle.status is Status.DONE
    # It comes to rest at the last point.
    assert samples.velocity[-1, 0] == pytest.approx(0.0, abs=1e-4)
    assert samples.position[-1, 0] == pytest.approx(points[-1, 0], abs=1e-3)


def test_goal_takes_over_from_a_trajectory_without_a_jolt(op):
    arm = Driven(op.simulation, 'arm')
    handle = op.follow('arm', [J1], [1.0], [[0.5]]).handle
    limit = op.simulation.robot.joints.servos.acceleration_limit[0]
    with sampled(arm) as samples:
        op.run(0.5)
        op.go({J1: 0.1})
        op.run(1.5)
    assert handle.status is Status.REPLACED
    assert samples.position[-1, 0] == pytest.approx(0.1, abs=1e-3)
    assert np.abs(np.diff(samples.velocity[:, 0]) / 0.002).max() < 1.2 * limit


def test_end_velocity_brakes_softly_and_comes_back_to_the_last_point(op):
    arm = Driven(op.simulation, 'arm')
    limit = op.simulation.robot.joints.servos.acceleration_limit[0]
    handle = op.follow('arm', [J1], [0.8], [[0.4]], [[1.0]]).handle
    with sampled(arm) as samples:
        op.run(0.8)
        assert handle.status is Status.DONE
        op.run(2.0)
    after = samples.velocity[400:, 0]
    assert after[0] == pytest.approx(1.0, abs=0.05)
    assert np.abs(np.diff(after) / 0.002).max() < 1.3 * limit
    assert samples.position[:, 0].max() == pytest.approx(0.4 + 0.5 / limit, abs=0.02)
    assert samples.position[-1, 0] == pytest.approx(0.4, abs=1e-3)


def test_trajectory_that_is_too_fast_is_slowed_down_as_a_whole_and_says_so(op):
    start = np.array(op.where(J1, J5))
    goals = np.array([[0.8, 0.3], [1.5, 0.4]])
    command = op.follow('arm', [J1, J5], [0.2, 0.4], goals)
    oracle = Trajectory(np.array([0.2, 0.4]), goals)
    oracle.begin_at(start, np.zeros(2))
    speeds = np.abs([oracle.at(t)[1] for t in np.linspace(0.0, 0.4, 401)]).max(axis=0)
    factor = (speeds / [2.175, 2.61]).max()
    assert command.slowed == pytest.approx(factor, rel=5e-3)
    arm, errors, step = Driven(op.simulation, 'arm'), [], op.simulation.step_count
    with sampled(arm) as samples:
        op.run(0.4 * factor + 0.1, lambda: errors.append(np.array(op.where(J1, J5)) - oracle.at(
            (op.simulation.step_count - step) * 0.002 / command.slowed)[0]))
    assert np.abs(samples.velocity[:, 0]).max() <= 1.01 * 2.175
    # The path is kept; what the torque limits do not allow at once is a few milliradians.
    assert np.abs(errors).max() < 0.02
    assert command.handle.status is Status.DONE


def test_trajectory_within_the_limits_is_not_slowed_down(op):
    assert op.follow('arm', [J1], [1.0], [[0.5]]).slowed == 1.0


def test_trajectory_that_is_absurdly_fast_is_rejected(op):
    with pytest.raises(CommandError, match=r"^joint 'robot0_joint1' would have to move at .* per "
                                           r'second, its limit is 2\.175$'):
        op.follow('arm', [J1], [1e-5], [[2.0]])


def test_joint_that_is_named_is_the_one_that_exceeds_its_limit_most(op):
    # The one that is faster may also move faster, by more than that.
    with pytest.raises(CommandError, match=r"^joint 'robot0_joint1' would"):
        op.follow('arm', [J1, 'robot0_joint5'], [1e-5], [[2.0, 2.2]])
    # Both have the same limit.
    with pytest.raises(CommandError, match=r"^joint 'robot0_joint3' would"):
        op.follow('arm', [J1, 'robot0_joint3'], [1e-5], [[1.0, 1.0 + 1e-9]])


@pytest.mark.parametrize(('times', 'positions', 'velocities'), [
    ([1.0, 100.0], [[0.0], [0.1]], [[1e308], [1e308]]), ([1.0], [[0.1]], [[1e200]])])
def test_numbers_that_are_finite_and_huge_are_rejected_and_change_nothing(op, times, positions,
                                                                          velocities):
    with pytest.raises(CommandError, match='is not finite|would have to move at'):
        op.follow('arm', [J1], times, positions, velocities)
    op.run(0.3)
    assert op.simulation.diverged is None
    assert np.isfinite(op.simulation.data.act).all()
    assert abs(op.where(J1)[0]) < 1e-6
    op.go({J1: 0.2})
    op.run(1.0)
    assert op.where(J1)[0] == pytest.approx(0.2, abs=1e-3)


def test_huge_positions_of_a_joint_without_limits_are_rejected(operator_of):
    op = operator_of('Kinova3')
    endless = next(j for j in op.joints_of('arm') if not op.simulation.model.joint(j).limited[0])
    with pytest.raises(CommandError, match='is not finite|would have to move at'):
        op.follow('arm', [endless], [1.0, 2.0], [[1e308], [-1e308]])


def test_positions_past_the_limits_are_clamped_and_counted(op):
    command = op.follow('arm', [J2], [1.0, 2.0], [[0.1], [9.0]])
    assert command.clamped == 1
    np.testing.assert_allclose(command.trajectory.positions, [[0.1], [1.7628]])


def test_empty_trajectory_for_some_joints_stops_those_softly(op):
    arm = Driven(op.simulation, 'arm')
    limit = op.simulation.robot.joints.servos.acceleration_limit
    command = op.follow('arm', [J1, J2], [1.0], [[0.5, 0.5]])
    with sampled(arm) as samples:
        op.run(0.5)
        (here,) = op.where(J1)
        op.follow('arm', [J1], [], [])
        op.run(1.0)
    assert command.handle.status is Status.DONE
    assert op.where(J2)[0] == pytest.approx(0.5, abs=1e-3)
    way = 0.75**2 / (2.0 * limit[0])
    assert op.where(J1)[0] - here == pytest.approx(way, abs=0.02)
    assert np.abs(np.diff(samples.velocity[250:, 0]) / 0.002).max() < 1.3 * limit[0]


def test_trajectory_of_many_points_is_ready_within_a_moment(op):
    times = np.arange(1, 10_001) * 0.01
    start = op.simulation.robot.robot_model.init_qpos
    points = 0.3 * np.sin(times)[:, None] * np.ones((1, 7)) + start
    command = op.follow('arm', op.joints_of('arm'), times, points)
    op.run(0.2)
    assert command.handle.status is Status.RUNNING
    assert command.slowed == 1.0


def test_joints_may_come_in_any_order(op):
    at = dict(zip([J1, J5], op.where(J1, J5)))
    op.follow('arm', [J5, J1], [0.8], [[at[J5] + 0.1, at[J1] + 0.2]])
    op.run(1.2)
    np.testing.assert_allclose(op.where(J1, J5), [at[J1] + 0.2, at[J5] + 0.1], atol=1e-4)


@pytest.mark.full
@pytest.mark.parametrize('velocities', [None, [[0.5]]])
@pytest.mark.parametrize('goal', [-0.5, 0.3, 1.1])
def test_trajectory_that_begins_in_motion_keeps_to_the_velocity_limit_too(op, goal, velocities):
    op.follow('arm', [J1], [1.0], [[1.0]], [[2.0]])
    op.run(0.95)
    assert op.simulation.robot.joints.setpoints.velocity[0] > 1.5
    command = op.follow('arm', [J1], [0.05], [[goal]], velocities)
    assert command.slowed > 1.5
    speeds = []
    op.run(command.trajectory.end_s, lambda: speeds.append(
        op.simulation.robot.joints.setpoints.velocity[0]))
    # It takes hardly longer than it has to.
    assert 0.75 * 2.175 < np.abs(speeds).max() <= 1.01 * 2.175
