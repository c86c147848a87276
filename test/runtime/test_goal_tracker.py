# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Goals of actions in the simulation's thread: how they start and end, also in lock-step."""

from queue import Empty, SimpleQueue
import time

import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import UnknownNameError
from manip_sim.models import compose, World
from manip_sim.models.robots import Panda, UR5e
from manip_sim.runtime import SimulationThread
from manip_sim.runtime.action_goals import Ending, GoalTracker, GripperGoal, GripperRequest
from manip_sim.runtime.trajectory_goal import JointTolerance, TrajectoryGoal, TrajectoryRequest
from manip_sim.simulation import Simulation
from manip_sim.simulation.robot_spawning import plan_with_robot, plan_without_robot

J1 = 'robot0_joint1'


class TrackedThread:
    """A thread that runs a simulation, and a tracker whose ends are collected."""

    def __init__(self, world, **arguments):
        self.simulation = Simulation(world)
        self.thread = SimulationThread(self.simulation, steps=5, **arguments)
        self.ended = SimpleQueue()
        self.tracker = GoalTracker(self.thread, self.simulation, self.ended.put)
        self.thread.start()

    def start(self, position=0.3, seconds=0.5, robot=None, joint=J1, **more):
        robot = robot or self.simulation.robot
        goal = TrajectoryGoal(robot, 'arm', TrajectoryRequest(
            [joint], [seconds], [[position]], **more), self.thread.progress.time_ns)
        self.tracker.start(goal)
        return goal

    def next_end(self):
        return self.ended.get(timeout=300.0)


@pytest.fixture
def tracked_thread():
    """Return a function that starts a thread, which is ended after the test."""
    started = []

    def start(world=None, **arguments):
        arguments = {'stepping': 'free', **arguments}
        started.append(TrackedThread(world or compose('Panda'), **arguments))
        return started[-1]
    yield start
    for running in started:
        running.thread.stop()
        assert running.thread.error is None


def test_goal_runs_to_its_end_and_is_forgotten(tracked_thread):
    running = tracked_thread()
    goal = running.start()
    assert running.next_end() is goal
    assert goal.outcome.ending is Ending.SUCCEEDED
    assert running.tracker.goals == ()


@pytest.mark.parametrize('end', ['cancel', 'abort_all'])
def test_a_gripper_goal_that_ends_at_once_says_where_the_fingers_are(end, tracked_thread):
    running = tracked_thread(paused=True)
    robot = running.simulation.robot
    goal = GripperGoal(robot, 'right/gripper', GripperRequest(0.021))
    # The observers are not called in between.
    running.thread.call(lambda: running.tracker.start(goal) or (
        running.tracker.cancel(goal) if end == 'cancel' else running.tracker.abort_all('test')))
    assert running.next_end() is goal
    finger = running.simulation.data.joint(goal.view.joint)
    assert goal.view.position == finger.qpos[0] > 0.01
    assert not goal.view.reached


def test_cancelled_goal_ends_at_once_also_while_paused_and_once_only(tracked_thread):
    running = tracked_thread(paused=True)
    goal = running.start()
    assert running.tracker.goals == (goal,)
    assert running.tracker.cancel(goal)
    assert running.next_end() is goal and goal.outcome.ending is Ending.CANCELED
    assert not running.tracker.cancel(goal)
    # Its command still waits for the next control period, which must leave it out.
    where = running.simulation.data.joint(J1).qpos[0]
    for _ in range(30):
        running.thread.step()
    assert running.simulation.data.joint(J1).qpos[0] == pytest.approx(where, abs=1e-9)
    assert goal.command.handle.status is Status.ABORTED


def test_goal_whose_command_still_waits_is_ended_by_a_reset(tracked_thread):
    running = tracked_thread(paused=True)
    goal = running.start()
    running.thread.reset()
    assert running.next_end() is goal
    assert (goal.outcome.ending, goal.outcome.reason) == (
        Ending.ABORTED, 'the simulation was reset')


def test_older_goal_is_told_before_the_newer_one_ends(tracked_thread):
    running = tracked_thread()
    older, newer = running.start(seconds=50.0), running.start()
    assert [running.next_end(), running.next_end()] == [older, newer]
    assert older.outcome.ending is Ending.ABORTED and newer.outcome.ending is Ending.SUCCEEDED


def test_all_goals_can_be_aborted_with_a_reason(tracked_thread):
    running = tracked_thread(paused=True)
    goals = [running.start(), GripperGoal(running.simulation.robot, 'right/gripper',
                                          GripperRequest(0.0))]
    running.tracker.start(goals[1])
    running.tracker.abort_all('the node is ending')
    assert [running.next_end(), running.next_end()] == goals
    assert {goal.outcome.reason for goal in goals} == {'the node is ending'}
    assert running.tracker.goals == ()


def test_goals_of_a_robot_are_aborted_before_it_is_deleted(tracked_thread):
    running = tracked_thread()
    robot = UR5e(idn='left')
    robot.set_base_xpos([0.0, 2.0, 0.0])
    running.thread.change_robots(plan_with_robot(running.simulation, robot))
    left = running.simulation.robots['robotleft']
    goal = running.start(seconds=50.0, robot=left, joint=left.joint_names[0])
    other = running.start(seconds=50.0, robot=running.simulation.robots['robot0'])
    reason = "robot 'left' was deleted"
    running.tracker.abort_all(reason, 'robotleft')
    running.thread.change_robots(plan_without_robot(running.simulation, 'robotleft'))
    assert running.next_end() is goal
    assert (goal.outcome.ending, goal.outcome.reason) == (Ending.ABORTED, reason)
    assert running.tracker.goals == (other,)
    with pytest.raises(UnknownNameError, match="unknown robot 'robotleft'"):
        running.thread.submit([goal.command], robot='robotleft')
    running.tracker.abort_all('done')


def test_cancel_after_the_end_of_the_simulation_is_rejected(tracked_thread):
    running = tracked_thread(paused=True)
    goal = running.start()
    running.thread.stop()
    assert not running.tracker.cancel(goal)


def test_lockstep_goes_on_until_a_goal_has_ended_though_its_trajectory_is_over(tracked_thread):
    running = tracked_thread(stepping='lockstep', lockstep_parts={'robot0': ['arm']})

    # A torque holds the joint away from its goal for a while after the trajectory.
    simulation = running.simulation

    def hold(_):
        simulation.data.qfrc_applied[0] = -20.0 if simulation.time_s < 1.0 else 0.0
    running.thread.observe(hold)
    goal = running.start(goal_tolerance=[JointTolerance(J1, 1e-3)])
    assert running.next_end() is goal and goal.outcome.ending is Ending.SUCCEEDED
    end_ns = simulation.time_ns
    assert end_ns > 1_000_000_000
    # Now it waits for commands again.
    with pytest.raises(Empty):
        running.ended.get(timeout=0.3)
    assert simulation.time_ns == end_ns == goal.view.time_ns


def test_lockstep_gives_the_same_end_in_every_run(tracked_thread):
    def end():
        running = tracked_thread(stepping='lockstep', lockstep_parts={'robot0': ['arm']})
        goal = running.start(position=0.7)
        running.next_end()
        return goal.view.time_ns, goal.view.position.tobytes()
    assert len({end() for _ in range(3)}) == 1


def test_goal_of_one_robot_does_not_answer_for_another(tracked_thread):
    beside = UR5e(idn=1)
    beside.set_base_xpos([0.0, 2.0, 0.0])
    running = tracked_thread(World([Panda(idn=0), beside]), stepping='lockstep',
                             lockstep_parts={'robot0': ['arm'], 'robot1': ['arm']})
    first, second = running.simulation.robots.values()
    goal = running.start(robot=first)
    assert running.tracker.busy_parts('robot0') == {'arm'}
    assert running.tracker.busy_parts('robot1') == frozenset()
    time.sleep(0.2)
    assert goal.outcome is None and goal.command.handle.status is Status.WAITING
    joint = second.joints.names[0]
    running.start(robot=second, joint=joint, position=0.1, seconds=5.0)
    assert running.next_end() is goal
    assert goal.outcome.ending is Ending.SUCCEEDED


def goal_of(kind, running, part):
    """Return a goal of a kind for a robot."""
    robot, now_ns = running.simulation.robot, running.thread.progress.time_ns
    if kind == 'gripper':
        return GripperGoal(robot, 'right/gripper', GripperRequest(0.01))
    indices = robot.joints.indices_of(part)
    names = [robot.joints.names[index] for index in indices]
    here = robot.controller_state(part).reference.position
    # One whose tolerance is never met still waits when its command is done.
    never = [JointTolerance(name, position=1e-12) for name in names] if kind == 'done' else []
    return TrajectoryGoal(robot, part, TrajectoryRequest(
        names, [0.03 if kind == 'done' else 1.0], [[value - 0.01 for value in here]],
        start_ns=now_ns + 300_000_000 if kind == 'deferred' else 0, goal_tolerance=never), now_ns)


@pytest.mark.full
@pytest.mark.parametrize('how', ['reset', 'restore'])
@pytest.mark.parametrize('kind', ['trajectory', 'deferred', 'done', 'gripper'])
@pytest.mark.parametrize('robot, part', [('Panda', 'arm'), ('PandaOmron', 'torso')])
def test_the_end_of_a_goal_changes_nothing_after_a_reset_or_a_restored_state(
        robot, part, kind, how, tracked_thread):
    digests = []
    # Without a goal, with one that is submitted only, and with one that has begun.
    for periods in (None, 0, 10):
        running = tracked_thread(compose(robot), paused=True)
        thread, own = running.thread, running.simulation.robot
        if part == 'arm':  # It moves, while PandaOmron rests.
            thread.submit([own.parse.action(part, [0.3] * 7)], robot=own.name)
        for _ in range(3):
            thread.step()
        thread.change('save')
        if periods is not None:
            goal = goal_of(kind, running, part)
            running.tracker.start(goal)
        for _ in range(periods or 0):
            thread.step()
        getattr(thread, how)()
        if periods is not None:
            assert running.next_end() is goal and goal.outcome.ending is Ending.ABORTED
        digests.append([thread.call(running.simulation.digest)])
        for _ in range(15):
            thread.step()
        digests[-1].append(thread.call(running.simulation.digest))
    assert digests[0] == digests[1] == digests[2]
