# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Who owns joints and grippers: the newest command, until it is withdrawn or replaced."""

import itertools

import numpy as np
import pytest

from manip_sim.control.commands import Ledger, Status
from manip_sim.models import compose
from manip_sim.runtime.change_queue import CommandBuffer
from manip_sim.simulation import Simulation
from manip_sim.worlds.worlds import SimulationPrototype

HAND = 'right/gripper'


def test_a_command_is_withdrawn_from_its_own_joints_and_once(panda_sim):
    parse, names = panda_sim.robot.parse, panda_sim.robot.joints.names
    (older,) = parse.joint_command(names[:3], position=[0.1, 0.2, 0.3])
    (newer,) = parse.joint_command(names[2:4], position=[0.1, 0.2])
    ledger = Ledger(len(names))
    for command in (older, newer):
        ledger.take(command)
        ledger.running.append(command)
    assert ledger.current_owner(older) is newer.handle and ledger.current_owner(newer) is None
    assert ledger.withdraw(older.handle, 'no more').tolist() == [0, 1]
    assert ledger.withdraw(older.handle, 'no more').tolist() == []
    assert ledger.running == [newer] and newer.handle.is_active
    assert (older.handle.status, older.handle.reason) == (Status.ABORTED, 'no more')
    assert ledger.current_owner(older).reason == 'no more'


def test_a_command_for_one_finger_takes_the_gripper_and_goes_on_when_the_older_one_is_withdrawn():
    simulation = Simulation(compose('Jaco'))
    robot, gripper = simulation.robot, simulation.robot.grippers[HAND]
    older = robot.parse.action(HAND, np.ones(gripper.dof))
    robot.apply(older)
    simulation.advance(50)
    finger = gripper.joints.names[0]
    low, high = gripper.joints.ranges((finger,))[0]
    goal = 0.5 * (low + high)
    (newer,) = robot.parse.joint_command([finger], position=[goal])
    assert 0 < len(newer.indices) < len(older.indices)
    robot.apply(newer)
    robot.withdraw(older, 'no more')
    assert (older.handle.status, newer.handle.status) == (Status.REPLACED, Status.RUNNING)
    for _ in range(300):
        simulation.advance(5)
    assert newer.handle.status is Status.DONE
    assert abs(float(simulation.data.joint(finger).qpos[0]) - goal) < 0.02 * (high - low)


def test_a_newer_action_replaces_that_of_a_gripper_without_actuators():
    robot = Simulation(compose('Panda', gripper='WipingGripper')).robot
    actions = [robot.parse.action(HAND, []) for _ in range(2)]
    robot.apply(*actions)
    assert [a.handle.status for a in actions] == [Status.REPLACED, Status.RUNNING]
    robot.reset()
    assert actions[1].handle.status is Status.ABORTED


def reach(simulation, by, ahead_s, seconds=0.5):
    """Return a trajectory of the first joint that starts later."""
    robot, now_ns = simulation.robot, simulation.time_ns
    here = robot.joints.measured(np.array([0]), simulation.data)[0][0]
    return robot.parse.trajectory('arm', robot.joints.names[:1], [seconds], [[here + by]],
                                  start_ns=now_ns + round(ahead_s * 1e9), now_ns=now_ns)


def positions(simulation, steps):
    """Advance step by step, and return the positions of the first joint."""
    found = []
    for _ in range(steps):
        simulation.advance(1)
        found.append(float(simulation.data.qpos[0]))
    return found


def test_each_trajectory_stamped_ahead_runs_until_the_start_of_the_next():
    alone, simulation = (Simulation(compose('UR5e')) for _ in range(2))
    alone.robot.apply(reach(alone, 0.3, 0.1))
    first, second = reach(simulation, 0.3, 0.1), reach(simulation, -0.2, 0.3)
    start = float(simulation.data.qpos[0])
    simulation.robot.apply(first, second)
    assert positions(simulation, 149) == positions(alone, 149)
    assert (first.handle.status, second.handle.status) == (Status.RUNNING, Status.RUNNING)
    simulation.advance(3)
    assert first.handle.status is Status.REPLACED
    simulation.advance(600)
    assert second.handle.status is Status.DONE
    assert simulation.data.qpos[0] == pytest.approx(start - 0.2, abs=2e-3)


@pytest.mark.full
@pytest.mark.parametrize('every_s, ahead_s', [(0.02, 0.05), (0.02, 0.01), (0.004, 0.1),
                                              (0.1, 0.35)])
def test_goals_sent_faster_than_they_lead_move_the_arm_to_the_last_one(every_s, ahead_s):
    simulation = Simulation(compose('UR5e'))
    start, steps = float(simulation.data.qpos[0]), round(every_s / simulation.timestep_s)
    for number in range(round(1.0 / every_s)):
        goal = start + 0.2 * np.sin(number * every_s)
        command = simulation.robot.parse.trajectory(
            'arm', simulation.robot.joints.names[:1], [0.3], [[goal]],
            start_ns=simulation.time_ns + round(ahead_s * 1e9), now_ns=simulation.time_ns)
        simulation.robot.apply(command)
        simulation.advance(steps)
    # It has followed for a part of the second already.
    assert simulation.data.qpos[0] > start + 0.02
    simulation.advance(round((ahead_s + 0.6) / simulation.timestep_s))
    assert abs(simulation.data.qpos[0] - goal) < 2e-3
    assert command.handle.status is Status.DONE


def test_a_newer_trajectory_replaces_those_that_start_after_it_also_in_one_period():
    for at_once in (False, True):
        simulation = Simulation(compose('UR5e'))
        later, sooner = reach(simulation, 0.3, 0.3), reach(simulation, -0.2, 0.1)
        last = reach(simulation, 0.1, 0.2)
        commands = later, sooner, last
        if at_once:
            buffer = CommandBuffer()
            for command in commands:
                buffer.add(command)
            commands = buffer.take()
        simulation.robot.apply(*commands)
        assert later.handle.status is Status.REPLACED
        simulation.advance(80)
        assert sooner.handle.status is Status.RUNNING
        simulation.advance(25)
        assert sooner.handle.status is Status.REPLACED
        assert last.handle.status is Status.RUNNING


@pytest.mark.full
def test_trajectories_that_wait_are_limited():
    simulation = Simulation(compose('UR5e'))
    commands = [reach(simulation, 0.1, 10.0 + number) for number in range(1001)]
    simulation.robot.apply(*commands)
    assert (commands[-1].handle.status, commands[-1].handle.reason) == (
        Status.ABORTED, '1000 trajectories wait for their starts already')
    assert commands[-2].handle.is_active


@pytest.mark.full
@pytest.mark.parametrize('latency_s', [0.0, 0.03])
def test_the_order_of_arrival_within_an_instant_makes_no_difference(latency_s):
    digests, two_arms = set(), SimulationPrototype(Simulation(compose('Baxter')))
    for order in [*itertools.permutations(range(4))][::3]:
        simulation = two_arms.copy()
        robot = simulation.robot
        robot.sensing.set('latency.command', latency_s)
        for number in range(3):
            pose = robot.true_state().end_effectors['left'].pose
            moved = np.add(pose.position, 0.01 * number)
            commands = (
                robot.parse.action('right/gripper', np.ones(1)),
                robot.parse.action('right', np.full(7, 0.1 * number)),
                # Of two commands for one gripper, the later one counts.
                robot.parse.action('right/gripper' if number == 1 else 'left/gripper', [-1.0]),
                robot.parse_cartesian.pose('left', moved, pose.quat_xyzw))
            for index in sorted(order) if number == 1 else order:
                robot.apply(commands[index])
            digests.add((number, 'before', simulation.digest()))
            simulation.advance(10)
            digests.add((number, 'after', simulation.digest()))
    assert len(digests) == 6
