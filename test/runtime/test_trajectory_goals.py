# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Goals of FollowJointTrajectory: how each of them can end, with the codes of ros2_controllers."""

import contextlib
import math

import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import DivergenceError
from manip_sim.runtime.action_goals import Ending, GoalCode, GoalError
from manip_sim.runtime.trajectory_goal import (
    JointTolerance, Tolerances, TrajectoryGoal, TrajectoryRequest)

J1, J2, J3 = 'robot0_joint1', 'robot0_joint2', 'robot0_joint3'


def test_a_tolerance_is_for_the_joint_that_it_names_and_leaves_the_default_of_what_it_omits():
    tolerances = Tolerances([J3, J1, J2], [J1, J2, J3], [JointTolerance(J2, position=0.1)], 0.5)
    np.testing.assert_array_equal(tolerances.position, [math.inf, math.inf, 0.1])
    np.testing.assert_array_equal(tolerances.velocity, [0.5, 0.5, 0.5])
    tolerances = Tolerances([J3, J1, J2], [J1, J2, J3], [JointTolerance(J1, velocity=0.2)], 0.5)
    np.testing.assert_array_equal(tolerances.position, [math.inf] * 3)
    np.testing.assert_array_equal(tolerances.velocity, [0.5, 0.2, 0.5])


def test_the_smallest_tolerance_is_exceeded_without_a_warning():
    tolerances = Tolerances([J1, J2], [J1, J2], [JointTolerance(J2, position=5e-324)])
    assert tolerances.violated(np.array([0.0, 1.0]), np.zeros(2)) == (
        f"the position of joint '{J2}' is 1 off, its tolerance is 4.941e-324")
    assert tolerances.violated(np.zeros(2), np.zeros(2)) == ''


class Actor:
    """Runs a simulation in which goals are watched as the node watches them."""

    def __init__(self, operator):
        self.operator = operator
        self.simulation = operator.simulation
        self.goals = []

    def request(self, joints, times_s=(1.0,), positions=((0.3,),), **more):
        return TrajectoryRequest(joints, times_s, positions, **more)

    def start(self, *joints, part='arm', **more):
        goal = TrajectoryGoal(self.simulation.robot, part, self.request(joints or (J1,), **more),
                              self.simulation.time_ns)
        self.simulation.robot.apply(goal.command, period_s=0.01)
        self.goals.append(goal)
        return goal

    def run(self, seconds, until=None):
        """Run so long, or until a goal has ended; return the seconds that it took."""
        for period in range(round(seconds * 100)):
            if until is not None and until.outcome is not None:
                return period * 0.01
            self.simulation.advance(5)
            for goal in self.goals:
                goal.check(self.simulation)
        return seconds

    def push(self, torque, joint=0):
        """Push a joint with a torque from now on [N m]."""
        self.simulation.data.qfrc_applied[joint] = torque

    def stiffness(self):
        """Return the stiffness of the servo of the first joint [N m/rad]."""
        return float(self.simulation.model.actuator_gainprm[0, 0])


@pytest.fixture
def panda(panda_op):
    return Actor(panda_op)


def at_most(position=0.0, velocity=0.0, joint=J1):
    return (JointTolerance(joint, position, velocity),)


def ended(goal):
    return goal.outcome and (goal.outcome.ending, goal.outcome.code)


SUCCESS = (Ending.SUCCEEDED, GoalCode.SUCCESSFUL)
PATH = (Ending.ABORTED, GoalCode.PATH_TOLERANCE_VIOLATED)
LATE = (Ending.ABORTED, GoalCode.GOAL_TOLERANCE_VIOLATED)
INVALID = (Ending.ABORTED, GoalCode.INVALID_GOAL)


def test_codes_are_those_of_control_msgs():
    # As in FollowJointTrajectory.action.
    assert {code.name: code.value for code in GoalCode} == {
        'SUCCESSFUL': 0, 'INVALID_GOAL': -1, 'INVALID_JOINTS': -2, 'OLD_HEADER_TIMESTAMP': -3,
        'PATH_TOLERANCE_VIOLATED': -4, 'GOAL_TOLERANCE_VIOLATED': -5}


def test_goal_succeeds_when_the_joints_stand_at_the_last_point_and_not_before(panda):
    goal = panda.start(J1, J2, positions=[[0.3, 0.4]])
    panda.run(0.99)
    assert goal.outcome is None
    assert 0.0 <= panda.run(1.0, until=goal) < 0.1
    assert ended(goal) == SUCCESS and goal.outcome.reason == 'the goal is reached'
    np.testing.assert_allclose(panda.operator.where(J1, J2), [0.3, 0.4], atol=1e-3)
    assert abs(panda.operator.speed(J1)) < 0.01


def test_first_ending_counts(panda):
    goal = panda.start()
    panda.run(2.0, until=goal)
    assert not goal.cancel()
    goal.abort('too late')
    assert ended(goal) == SUCCESS


def test_goal_that_passes_its_last_point_fast_is_not_reached(panda):
    goal = panda.start(goal_tolerance=at_most(position=10.0))
    # Ten metres off would do, but not a joint that moves.
    panda.run(0.98)
    panda.push(60.0)
    panda.run(0.06)
    assert abs(panda.operator.speed(J1)) > 0.01 and goal.outcome is None
    assert panda.run(2.0, until=goal) > 0.0
    assert ended(goal) == SUCCESS


def test_way_so_far_is_told_as_desired_and_actual(panda):
    goal = panda.start(J2, J1, positions=[[0.4, 0.3]], velocities=[[0.0, 0.0]])
    start = panda.operator.where(J2, J1)
    panda.run(0.5)
    view = goal.view
    assert view.time_ns == panda.simulation.time_ns
    # Half way of a cubic from rest to rest, whose speed is 1.5 times the mean there.
    np.testing.assert_allclose(view.desired[0], (np.add(start, [0.4, 0.3])) / 2.0, atol=1e-9)
    np.testing.assert_allclose(view.desired[1], 1.5 * np.subtract([0.4, 0.3], start), atol=1e-9)
    np.testing.assert_array_equal(view.position, panda.operator.where(J2, J1))
    np.testing.assert_array_equal(
        view.velocity, [panda.operator.speed(J2), panda.operator.speed(J1)])
    panda.run(2.0, until=goal)
    np.testing.assert_array_equal(goal.view.desired, [[0.4, 0.3], [0.0, 0.0], [0.0, 0.0]])


@pytest.mark.full
@pytest.mark.parametrize(('factor', 'expected'), [(0.9, LATE), (1.1, SUCCESS)])
def test_joint_that_stays_away_from_the_last_point_is_judged_by_the_goal_tolerance(
        panda, factor, expected):
    panda.push(-20.0)
    error = 20.0 / panda.stiffness()
    goal = panda.start(goal_tolerance=at_most(position=factor * error), goal_time_s=0.3)
    elapsed = panda.run(3.0, until=goal)
    assert ended(goal) == expected
    if expected == LATE:
        assert elapsed == pytest.approx(1.31, abs=0.011)
        assert f"the position of joint '{J1}' is {error:.3g}" in goal.outcome.reason
        # It does not press against what holds it any more.
        panda.run(1.0)
        assert panda.operator.where(J1)[0] == pytest.approx(0.3 - 2.0 * error, rel=0.02)


@pytest.mark.full
@pytest.mark.parametrize('goal_time_s', [0.0, -1.0])
def test_without_a_goal_time_the_goal_waits_as_long_as_it_takes(panda, goal_time_s):
    panda.push(-20.0)
    goal = panda.start(goal_tolerance=at_most(position=10.0 / panda.stiffness()),
                       goal_time_s=goal_time_s)
    panda.run(3.0)
    assert goal.outcome is None and goal.command.handle.status is Status.DONE
    panda.push(0.0)
    panda.run(1.0, until=goal)
    assert ended(goal) == SUCCESS


def test_joint_that_leaves_the_path_ends_the_goal_and_is_not_pressed_further(panda):
    goal = panda.start(positions=[[1.0]], path_tolerance=at_most(position=0.05))
    panda.run(0.5)
    assert goal.outcome is None
    panda.push(-150.0)
    assert panda.run(1.0, until=goal) < 0.3
    assert ended(goal) == PATH
    assert goal.outcome.reason.startswith(f"on the way, the position of joint '{J1}' is ")
    held = panda.operator.where(J1)[0]
    panda.push(0.0)
    panda.run(2.0)
    # It brakes, and does not spring to where it should have been.
    assert abs(panda.operator.where(J1)[0] - held) < 0.3
    assert panda.operator.where(J1)[0] < 0.5
    assert abs(panda.operator.speed(J1)) < 1e-6


def test_path_is_that_of_the_trajectory_and_not_of_a_setpoint_that_waits(panda):
    # The setpoint waits for a joint that is held: it is never far ahead.
    goal = panda.start(positions=[[1.5]], path_tolerance=at_most(position=0.5))
    panda.push(-87.0)
    assert panda.run(2.0, until=goal) < 1.0
    assert ended(goal) == PATH


def test_velocity_on_the_path_has_a_tolerance_too(panda):
    goal = panda.start(positions=[[1.0]], path_tolerance=at_most(velocity=0.2))
    panda.run(0.5)
    assert goal.outcome is None
    panda.push(-80.0)
    panda.run(0.5, until=goal)
    assert ended(goal) == PATH and 'the velocity of joint' in goal.outcome.reason


def test_tolerance_of_minus_one_takes_the_default_away(panda):
    goal = panda.start(goal_tolerance=at_most(velocity=-1.0), path_tolerance=at_most(-1.0, -1.0))
    panda.run(0.98)
    panda.push(60.0)
    assert panda.run(1.0, until=goal) == pytest.approx(0.02, abs=0.011)
    assert abs(panda.operator.speed(J1)) > 0.01
    assert ended(goal) == SUCCESS


def test_trajectory_that_is_slowed_down_succeeds_later_unless_the_client_sets_a_time(panda):
    request = {'times_s': [0.1], 'positions': [[1.0]]}
    goal = panda.start(**request)
    slowed = goal.command.slowed
    assert slowed > 5.0
    elapsed = panda.run(3.0, until=goal)
    assert ended(goal) == SUCCESS and elapsed == pytest.approx(0.1 * slowed, abs=0.1)
    goal = panda.start(times_s=[0.1], positions=[[0.0]], goal_time_s=0.2)
    assert panda.run(3.0, until=goal) == pytest.approx(0.31, abs=0.02)
    assert ended(goal) == LATE
    assert f'slowed down by the factor {goal.command.slowed:.3g}' in goal.outcome.reason


def test_late_goal_tells_also_a_small_factor_that_it_was_slowed_down_by(panda):
    factor = panda.start(times_s=[0.1], positions=[[1.0]]).command.slowed
    goal = panda.start(times_s=[0.1 * factor / 1.3], positions=[[1.0]], goal_time_s=0.01)
    assert 1.1 < goal.command.slowed < 1.9
    panda.run(3.0, until=goal)
    assert f'slowed down by the factor {goal.command.slowed:.3g}' in goal.outcome.reason


def test_goal_that_starts_later_waits_and_its_end_counts_from_its_stamp(panda):
    panda.run(0.1)
    now_s = panda.simulation.time_s
    goal = panda.start(start_ns=panda.simulation.time_ns + 500_000_000, goal_time_s=0.1,
                       path_tolerance=at_most(position=0.01))
    panda.run(0.4)
    assert goal.outcome is None
    np.testing.assert_array_equal(goal.view.desired[0], goal.view.position)
    assert panda.operator.where(J1)[0] == pytest.approx(0.0, abs=1e-6)
    panda.run(3.0, until=goal)
    assert ended(goal) == SUCCESS
    assert panda.simulation.time_s - now_s == pytest.approx(1.5, abs=0.1)


def test_goal_that_starts_later_ends_when_another_one_takes_a_joint_before(panda):
    start_ns = panda.simulation.time_ns + 500_000_000
    goal = panda.start(J1, J2, positions=[[0.3, 0.4]], start_ns=start_ns)
    panda.run(0.1)
    assert goal.outcome is None
    panda.operator.follow('arm', [J2], [1.0], [[0.1]], start_ns=start_ns - 100_000_000)
    panda.run(0.01)
    assert ended(goal) == INVALID
    panda.run(2.0)
    assert panda.operator.where(J1)[0] == pytest.approx(0.0, abs=1e-6)
    assert panda.operator.where(J2)[0] == pytest.approx(0.1, abs=1e-3)


def test_time_of_a_goal_begins_when_its_command_is_taken_over(panda):
    panda.push(-20.0)
    goal = TrajectoryGoal(
        panda.simulation.robot, 'arm', panda.request(
            [J1], goal_tolerance=at_most(position=1e-6), goal_time_s=0.2), 0)
    panda.goals.append(goal)
    panda.run(0.5)
    assert goal.outcome is None and goal.view.time_ns == panda.simulation.time_ns
    panda.simulation.robot.apply(goal.command, period_s=0.01)
    assert panda.run(3.0, until=goal) == pytest.approx(1.21, abs=0.011)


def test_end_of_a_goal_whose_stamp_is_past_counts_from_the_stamp(panda):
    panda.run(0.5)
    goal = panda.start(start_ns=panda.simulation.time_ns - 400_000_000, goal_time_s=0.2,
                       goal_tolerance=at_most(position=1e-12))
    # 0.6 s are left of the trajectory.
    assert panda.run(2.0, until=goal) == pytest.approx(0.81, abs=0.011)
    assert ended(goal) == LATE


def test_cancelled_goal_brakes_at_once_and_stays(panda):
    goal = panda.start(positions=[[1.5]])
    panda.run(0.5)
    where, speed = panda.operator.where(J1)[0], panda.operator.speed(J1)
    assert goal.cancel()
    assert goal.outcome.ending is Ending.CANCELED
    panda.run(1.0)
    braked = panda.operator.where(J1)[0]
    # The acceleration limit is at least a tenth of a second from the velocity limit.
    assert where < braked < where + speed * 0.12
    panda.run(1.0)
    assert panda.operator.where(J1)[0] == pytest.approx(braked, abs=1e-6)


def test_cancelled_goal_that_starts_later_leaves_what_runs_alone(panda):
    runs = panda.start(positions=[[0.5]])
    panda.run(0.1)
    later = panda.start(positions=[[-0.5]], start_ns=panda.simulation.time_ns + 500_000_000)
    panda.run(0.2)
    assert later.cancel()
    panda.run(2.0, until=runs)
    assert ended(runs) == SUCCESS
    assert panda.operator.where(J1)[0] == pytest.approx(0.5, abs=1e-3)


def test_newer_goal_takes_the_joints(panda):
    older = panda.start(positions=[[1.0]])
    panda.run(0.5)
    newer = panda.start(positions=[[-0.2]])
    panda.run(0.02)
    assert ended(older) == INVALID
    assert older.outcome.reason == 'a newer command has taken over'
    panda.run(2.0, until=newer)
    assert ended(newer) == SUCCESS
    assert panda.operator.where(J1)[0] == pytest.approx(-0.2, abs=1e-3)


def test_command_that_takes_one_joint_ends_the_goal_and_the_others_come_to_rest(panda):
    goal = panda.start(J1, J2, positions=[[1.0, 1.0]])
    panda.run(0.5)
    where = panda.operator.where(J2)[0]
    panda.operator.go({J1: 0.0})
    panda.run(0.02)
    assert ended(goal) == INVALID
    panda.run(2.0)
    assert panda.operator.where(J1)[0] == pytest.approx(0.0, abs=1e-3)
    assert where < panda.operator.where(J2)[0] < where + 0.2


def test_command_for_other_joints_leaves_a_goal_alone(panda):
    goal = panda.start(J1)
    panda.operator.go({J2: 0.5})
    panda.run(2.0, until=goal)
    assert ended(goal) == SUCCESS


def held_at_the_end(panda):
    """Return a goal whose trajectory has ended and which is not reached."""
    panda.push(-20.0)
    goal = panda.start(goal_tolerance=at_most(position=1e-6))
    panda.run(1.5)
    assert goal.outcome is None
    return goal


def explode(panda):
    panda.simulation.data.qvel[0] = 1e6


@pytest.mark.full
@pytest.mark.parametrize('prepare', [lambda panda: panda.start(), held_at_the_end],
                         ids=['on the way', 'after the end'])
@pytest.mark.parametrize(('interfere', 'reason'), [
    (lambda p: p.operator.go({J1: 0.0}), 'a newer command has taken over'),
    (lambda p: p.operator.follow('arm', [], [], []), 'ended by an empty trajectory'),
    (lambda p: p.simulation.robot.set_control_mode('arm', 'effort'),
     'the control mode is effort now'),
    (lambda p: p.simulation.reset(), 'the simulation was reset'),
    (explode, 'the physics diverged at ')],
    ids=['command', 'stop', 'mode', 'reset', 'divergence'])
def test_what_interferes_ends_the_goal_and_is_told(panda, prepare, interfere, reason):
    goal = prepare(panda)
    panda.run(0.1)
    interfere(panda)
    with contextlib.suppress(DivergenceError):
        panda.run(0.02)
    goal.check(panda.simulation)
    assert ended(goal) == INVALID
    assert goal.outcome.reason.startswith(reason)


@pytest.mark.parametrize(('end', 'reason'), [
    (lambda panda, goal: panda.operator.go({J1: 0.0}), 'a newer command has taken over'),
    (lambda panda, goal: panda.operator.follow('arm', [], [], []), 'ended by an empty trajectory'),
    (lambda panda, goal: panda.simulation.robot.withdraw(goal.command, 'broken'), 'broken')],
    ids=['replaced', 'stopped', 'aborted'])
def test_goal_that_had_ended_before_the_physics_diverged_says_how(panda, end, reason):
    goal = panda.start()
    panda.run(0.1)
    # Both happen before the goal is checked again.
    panda.goals.clear()
    end(panda, goal)
    panda.run(0.02)
    explode(panda)
    with contextlib.suppress(DivergenceError):
        panda.run(0.02)
    assert panda.simulation.diverged is not None and goal.outcome is None
    goal.check(panda.simulation)
    assert ended(goal) == INVALID
    assert goal.outcome.reason == reason


def test_goal_whose_command_still_waits_ends_when_the_physics_diverges(panda):
    goal = TrajectoryGoal(panda.simulation.robot, 'arm', panda.request([J1]),
                          panda.simulation.time_ns)
    goal.check(panda.simulation)
    assert goal.outcome is None
    explode(panda)
    with contextlib.suppress(DivergenceError):
        panda.run(0.02)
    assert goal.command.handle.status is Status.WAITING
    goal.check(panda.simulation)
    assert ended(goal) == INVALID
    assert goal.outcome.reason.startswith('the physics diverged at ')


def test_goal_with_a_command_that_failed_is_aborted(panda):
    goal = panda.start()
    goal.command.handle.end(Status.ABORTED, 'broken')
    panda.run(0.01)
    assert ended(goal) == INVALID and goal.outcome.reason == 'broken'


@pytest.mark.parametrize(('more', 'code', 'text'), [
    ({'joints': ['joint9']}, 'INVALID_JOINTS', "has no joint 'joint9'"),
    ({'joints': []}, 'INVALID_JOINTS', 'no joint is named'),
    ({'joints': [J1, J1]}, 'INVALID_JOINTS', 'is named twice'),
    ({'path_tolerance': at_most(1.0, joint='elbow')}, 'INVALID_JOINTS', "the joint 'elbow'"),
    ({'times_s': []}, 'INVALID_GOAL', 'a goal needs at least one point'),
    ({'times_s': [2.0, 1.0], 'positions': [[0.1], [0.2]]}, 'INVALID_GOAL', 'must increase'),
    ({'positions': [[0.1, 0.2]]}, 'INVALID_GOAL', 'must have 1 number'),
    ({'positions': [[math.nan]]}, 'INVALID_GOAL', 'must be finite'),
    ({'positions': [[2.95]]}, 'INVALID_GOAL', 'is 2.95, its range ends at 2.897'),
    ({'velocities': [[0.1]]}, 'INVALID_GOAL', 'must stand still at the last point'),
    ({'goal_tolerance': at_most(-0.5)}, 'INVALID_GOAL', r'or -1 for none, got -0\.5'),
    ({'goal_tolerance': at_most(velocity=math.nan)}, 'INVALID_GOAL', 'got nan'),
    ({'path_tolerance': (JointTolerance(J1, acceleration=-3.0),)}, 'INVALID_GOAL', 'got -3'),
    ({'goal_time_s': -0.5}, 'INVALID_GOAL', 'goal_time_tolerance must not be negative'),
    ({'start_ns': 10**14}, 'INVALID_GOAL', 'set use_sim_time'),
    ({'start_ns': 10_000_000}, 'OLD_HEADER_TIMESTAMP', r'the trajectory ended 0\.990 s ago')])
def test_goal_that_cannot_be_is_rejected_with_its_code(panda, more, code, text):
    panda.run(2.0)
    joints = more.pop('joints', [J1])
    before = panda.simulation.robot.joints.busy_parts
    with pytest.raises(GoalError, match=text) as error:
        panda.start(*(joints or [()]), **more) if joints else TrajectoryGoal(
            panda.simulation.robot, 'arm', panda.request([]), panda.simulation.time_ns)
    assert error.value.code is GoalCode[code]
    assert panda.simulation.robot.joints.busy_parts == before


@pytest.mark.parametrize(('speed', 'fits'), [(-4.4e-17, True), (1e-7, True), (2e-7, False)])
def test_what_rounding_leaves_of_the_last_velocity_is_none(panda, speed, fits):
    panda.run(0.5)
    with contextlib.nullcontext() if fits else pytest.raises(GoalError, match='stand still'):
        goal = panda.start(velocities=[[speed]])
        panda.run(2.0, until=goal)
        assert ended(goal) == SUCCESS


def test_a_goal_is_late_in_the_first_period_after_its_time_and_no_slowing_is_told(panda):
    panda.run(0.5)
    begin_ns = panda.simulation.time_ns
    goal = panda.start(times_s=[0.6, 1.0], positions=[[0.1], [0.3]], goal_time_s=0.3,
                       goal_tolerance=at_most(position=1e-12))
    panda.run(3.0, until=goal)
    assert ended(goal) == LATE and 'slowed' not in goal.outcome.reason
    assert goal.view.time_ns - begin_ns == 1_310_000_000


def test_a_trajectory_that_ends_now_by_its_stamp_is_followed_and_an_older_one_is_not(panda):
    panda.run(2.0)
    start_ns = panda.simulation.time_ns - 1_000_000_000
    with pytest.raises(GoalError) as error:
        panda.start(start_ns=start_ns - 1)
    assert error.value.code is GoalCode.OLD_HEADER_TIMESTAMP
    goal = panda.start(start_ns=start_ns)
    panda.run(2.0, until=goal)
    assert ended(goal) == SUCCESS


@pytest.mark.parametrize('end', [-2.8973, 2.8973])
@pytest.mark.parametrize(('tolerance', 'most'), [((), 0.01), (at_most(0.1), 0.1),
                                                 (at_most(0.001), 0.001)])
def test_the_last_point_may_be_beyond_the_range_by_the_tolerance(panda, end, tolerance, most):
    for share, starts in ((0.99, True), (1.01, False)):
        point = end + np.sign(end) * share * most
        if starts:
            panda.start(positions=[[point]], goal_tolerance=tolerance)
            continue
        with pytest.raises(GoalError, match='its range ends at') as error:
            panda.start(positions=[[point]], goal_tolerance=tolerance)
        assert error.value.code is GoalCode.INVALID_GOAL


@pytest.mark.parametrize(('speed', 'stands'), [
    (0.0099, True), (-0.0099, True), (0.0101, False), (-0.0101, False)])
def test_a_joint_stands_still_below_a_hundredth_per_second(panda, speed, stands):
    goal = panda.start(goal_tolerance=at_most(position=10.0))
    panda.run(0.01)
    goal.command.handle.end(Status.DONE)
    panda.simulation.data.joint(J1).qvel[0] = speed
    goal.check(panda.simulation)
    assert (ended(goal) == SUCCESS) == stands


def test_goal_in_another_mode_is_rejected(panda):
    panda.simulation.robot.set_control_mode('arm', 'velocity')
    with pytest.raises(GoalError, match='in position or impedance mode only') as error:
        panda.start()
    assert error.value.code is GoalCode.INVALID_GOAL


def test_tolerance_of_a_joint_of_the_part_that_does_not_move_is_left_aside(panda):
    goal = panda.start(goal_tolerance=at_most(1e-12, joint=J3))
    panda.run(2.0, until=goal)
    assert ended(goal) == SUCCESS


@pytest.mark.full
def test_last_point_a_little_beyond_the_range_is_met_at_its_end(panda):
    goal = panda.start(positions=[[2.9]], times_s=[3.0])
    panda.run(5.0, until=goal)
    assert ended(goal) == SUCCESS and goal.command.clamped == 1


@pytest.mark.full
@pytest.mark.parametrize('robot', ['UR5e', 'Baxter', 'PandaOmron', 'GR1'])
def test_goals_for_all_parts_of_a_robot_succeed_with_the_default_tolerances(operator_of, robot):
    actor = Actor(operator_of(robot))
    simulation, goals = actor.simulation, []
    for name, part in simulation.robot.parts.items():
        if part.gripper is None and part.actuators and part.atomic == (name,):
            joints = actor.operator.joints_of(name)
            limits = simulation.robot.limits(name)
            target = np.clip(np.add(actor.operator.where(*joints), 0.05), *limits.T)
            goals.append(actor.start(*joints, part=name, times_s=[0.5], positions=[target]))
    actor.run(1.0)
    assert [ended(goal) for goal in goals] == [SUCCESS] * len(goals)


@pytest.mark.parametrize('ahead_ns', [0, 10_000_000], ids=['at once', 'at a time'])
def test_what_is_desired_on_the_way_is_where_the_trajectory_is_at_any_time(panda, ahead_ns):
    panda.run(1.0)
    panda.simulation.reset()
    panda.run(1.0)
    goal = panda.start(
        times_s=[2.0], positions=[[0.3]], path_tolerance=at_most(position=0.05),
        start_ns=ahead_ns and panda.simulation.time_ns + ahead_ns)
    panda.run(1.0)
    setpoint = panda.simulation.robot.controller_state('arm').reference
    assert 0.1 < goal.view.desired[0][0] < 0.2 and goal.outcome is None
    np.testing.assert_allclose(goal.view.desired[0][0], setpoint.position[0], atol=1e-9)
    np.testing.assert_allclose(goal.view.desired[1][0], setpoint.velocity[0], atol=1e-9)


def test_the_goal_time_passes_as_slowly_as_the_trajectory(panda):
    panda.simulation.robot.set_speed_scaling(0.25)
    panda.run(1.0)
    goal = panda.start(goal_time_s=0.2)
    assert panda.run(3.0, until=goal) == 3.0
    assert panda.run(3.0, until=goal) < 1.4
    assert goal.outcome is not None and goal.outcome.ending is Ending.SUCCEEDED
