# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands that wait for the next control period, and which answers lock-step accepts."""

import numpy as np
import pytest

from manip_sim.control.commands import (
    BaseTwist, GripperAction, GripperSetpoint, JointSetpoint, JointTrajectory, Status,
    TrajectoryStop)
from manip_sim.control.trajectory import Trajectory
from manip_sim.errors import CommandError
from manip_sim.models.robots import Panda
from manip_sim.runtime.change_queue import CommandBuffer, PendingCommands

ROBOT = Panda()
RIGHT, BOTH = frozenset(['right']), frozenset(['right', 'left'])


def setpoint(values, parts=RIGHT, mode='position'):
    """Return goals for some joints, from a dictionary of index and value."""
    return JointSetpoint(robot=ROBOT, parts=parts, modes=(mode,) * len(values),
                         indices=np.array(list(values)), values=np.array(list(values.values())))


def trajectory(*indices, parts=RIGHT, start_ns=0):
    count = len(indices)
    return JointTrajectory(robot=ROBOT, parts=parts, indices=np.array(indices),
                           columns=np.arange(count), start_ns=start_ns,
                           trajectory=Trajectory(np.ones(1), np.zeros((1, count))))


def gripper_action(value=1.0, part='right/gripper'):
    return GripperAction(robot=ROBOT, parts=frozenset([part]), indices=np.array([0]),
                         action=np.array([value]))


def finger_setpoint(index):
    return GripperSetpoint(robot=ROBOT, parts=frozenset(['right/gripper']),
                           indices=np.array([index]), joints=(f'finger{index}',),
                           values=np.array([0.01]))


def as_dictionary(command):
    return dict(zip(command.indices.tolist(), command.values.tolist()))


def statuses(*commands):
    return [command.handle.status for command in commands]


def test_commands_are_taken_once():
    buffer, command = CommandBuffer(), gripper_action()
    buffer.add(command)
    assert buffer.take() == [command]
    assert buffer.take() == []
    assert statuses(command) == [Status.WAITING]


def test_newer_goal_wins_joint_by_joint():
    buffer, older, newer = CommandBuffer(), setpoint({0: 1.0, 1: 2.0}), setpoint({1: 3.0, 2: 4.0})
    buffer.add(older)
    buffer.add(newer)
    first, second = buffer.take()
    assert (as_dictionary(first), as_dictionary(second)) == ({0: 1.0}, {1: 3.0, 2: 4.0})
    assert statuses(older, newer) == [Status.WAITING] * 2
    assert first.handle is older.handle


def test_command_that_loses_all_of_its_joints_is_replaced():
    buffer, older = CommandBuffer(), setpoint({0: 1.0, 1: 2.0})
    buffer.add(older)
    buffer.add(setpoint({1: 3.0}))
    assert statuses(older) == [Status.WAITING]
    buffer.add(setpoint({0: 3.0}))
    assert statuses(older) == [Status.REPLACED]
    assert len(buffer.take()) == 2


def test_merging_leaves_the_commands_that_were_given():
    buffer, older, newer = CommandBuffer(), setpoint({0: 1.0, 1: 2.0}), setpoint({1: 3.0})
    buffer.add(older)
    buffer.add(newer)
    assert as_dictionary(older) == {0: 1.0, 1: 2.0}
    assert as_dictionary(newer) == {1: 3.0}


def test_many_commands_do_not_pile_up():
    buffer = CommandBuffer()
    for n in range(1000):
        buffer.add(setpoint({0: float(n)}))
        buffer.add(gripper_action(n / 1000.0))
        buffer.add(trajectory(1))
    goal, action, _ = buffer.take()
    assert as_dictionary(goal) == {0: 999.0}
    assert action.action[0] == 0.999


def test_modes_of_goals_stay_with_their_joints():
    buffer = CommandBuffer()
    buffer.add(JointSetpoint(robot=ROBOT, parts=RIGHT, indices=np.array([3, 5]),
                             values=np.array([1.0, 2.0]), modes=('velocity', 'effort')))
    buffer.add(setpoint({3: 0.0}))
    rest, _ = buffer.take()
    assert (rest.modes, as_dictionary(rest)) == (('effort',), {5: 2.0})


def test_commands_are_taken_in_the_order_of_their_arrival():
    buffer = CommandBuffer()
    commands = [setpoint({0: 1.0}), gripper_action(), trajectory(4, 5), setpoint({7: 1.0})]
    for command in commands:
        buffer.add(command)
    assert buffer.take() == commands


def test_columns_of_a_trajectory_stay_with_their_joints():
    buffer = CommandBuffer()
    buffer.add(trajectory(4, 5, 6))
    buffer.add(setpoint({5: 0.0}))
    rest, _ = buffer.take()
    assert (list(rest.indices), list(rest.columns)) == ([4, 6], [0, 2])


def test_goals_that_wait_go_before_a_trajectory_that_starts_later():
    buffer, goal, earlier = CommandBuffer(), setpoint({0: 1.0}), trajectory(0, start_ns=10**9)
    buffer.add(goal)
    buffer.add(earlier)
    later = trajectory(0, start_ns=2 * 10**9)
    buffer.add(later)
    sooner = trajectory(0, start_ns=15 * 10**8)
    buffer.add(sooner)
    # Each runs until the next one starts; what starts after a newer one is replaced.
    assert buffer.take() == [goal, earlier, sooner]
    assert statuses(goal, earlier, later) == [Status.WAITING, Status.WAITING, Status.REPLACED]


@pytest.mark.parametrize('newer', [setpoint({0: 2.0}), trajectory(0), BaseTwist(
    robot=ROBOT, parts=RIGHT, indices=np.array([0]), twist=np.zeros(3), joints=np.arange(3),
    columns=np.array([0]))])
def test_command_that_begins_at_once_replaces_those_of_every_kind(newer):
    for older in (setpoint({0: 1.0}), trajectory(0), trajectory(0, start_ns=10**9)):
        buffer = CommandBuffer()
        buffer.add(older)
        buffer.add(newer)
        (kept,) = buffer.take()
        assert kept.handle is newer.handle
        assert statuses(older) == [Status.REPLACED]


def test_stop_ends_trajectories_that_wait_and_leaves_goals():
    buffer, goal, motion, later = (CommandBuffer(), setpoint({0: 1.0}), trajectory(1),
                                   trajectory(2, start_ns=10**9))
    stop = TrajectoryStop(robot=ROBOT, parts=RIGHT, indices=np.array([0, 1, 2]))
    for command in (goal, motion, later, stop):
        buffer.add(command)
    assert buffer.take() == [goal, stop]
    assert statuses(goal, motion, later) == [Status.WAITING, Status.ABORTED, Status.ABORTED]
    assert motion.handle.reason == 'ended by an empty trajectory'


def test_indices_of_grippers_are_not_those_of_joints():
    buffer = CommandBuffer()
    commands = [setpoint({0: 1.0}), gripper_action(part='right/gripper'),
                gripper_action(part='left/gripper')]
    for command in [*commands, *commands[:1]]:
        buffer.add(command)
    assert len(buffer.take()) == 3
    for command in commands[1:] + commands[:1]:
        buffer.add(command)
    assert len(buffer.take()) == 3


def test_fingers_of_a_gripper_are_commanded_one_by_one():
    buffer, action = CommandBuffer(), gripper_action()
    buffer.add(action)
    buffer.add(finger_setpoint(0))
    buffer.add(finger_setpoint(1))
    assert [command.joints for command in buffer.take()] == [('finger0',), ('finger1',)]
    assert statuses(action) == [Status.REPLACED]


def test_lockstep_is_ready_when_every_part_has_a_command():
    buffer = CommandBuffer(['right', 'right/gripper'])
    assert buffer.missing()
    buffer.add(setpoint({0: 1.0}))
    buffer.add(setpoint({20: 1.0}, parts=frozenset(['head'])))
    assert buffer.missing() == {'right/gripper'}
    buffer.add(gripper_action())
    assert not buffer.missing()
    buffer.take()
    assert buffer.missing()


def test_lockstep_of_two_arms_waits_for_both():
    buffer = CommandBuffer(['right', 'left'])
    buffer.add(setpoint({0: 1.0}))
    assert buffer.missing()
    buffer.add(setpoint({7: 1.0}, parts=frozenset(['left'])))
    assert not buffer.missing()
    buffer.take()
    buffer.add(setpoint({0: 1.0, 7: 1.0}, parts=BOTH))
    assert not buffer.missing()


def test_part_that_follows_a_trajectory_needs_no_command_in_lockstep():
    buffer = CommandBuffer(['right', 'left'])
    buffer.add(setpoint({0: 1.0}))
    assert buffer.missing(['right'])
    assert not buffer.missing(['left'])


def test_without_lockstep_parts_nothing_is_missing():
    assert not CommandBuffer().missing()


def test_cleared_commands_are_aborted_with_the_reason():
    buffer, command = CommandBuffer(['right']), setpoint({0: 1.0})
    buffer.add(command)
    buffer.clear('the simulation was reset')
    assert buffer.missing()
    assert buffer.take() == []
    assert (command.handle.status, command.handle.reason) == (
        Status.ABORTED, 'the simulation was reset')


def test_goals_that_replace_others_unused_tell_of_how_many_messages_they_stand_for():
    buffer = CommandBuffer()
    for value in (0.1, 0.2, 0.2, 0.3):
        buffer.add(setpoint({0: value, 1: 0.5}))
    (command,) = buffer.take()
    # A copy of a message is none.
    assert command.messages == 3
    np.testing.assert_allclose(command.values, [0.3, 0.5])


def test_poses_that_replace_others_unused_tell_of_how_many_messages_they_stand_for(panda_sim):
    buffer = CommandBuffer()
    for height in (0.5, 0.6, 0.6, 0.7):
        buffer.add(panda_sim.robot.parse_cartesian.pose(
            'right', [0.4, 0.0, height], [1.0, 0.0, 0.0, 0.0]))
    (command,) = buffer.take()
    assert command.messages == 3
    np.testing.assert_allclose(command.position, [0.4, 0.0, 0.7])


def test_goals_count_messages_for_the_joints_that_they_name():
    buffer = CommandBuffer()
    for value in ({0: 0.1, 1: 0.5}, {0: 0.2}, {1: 0.4}):
        buffer.add(setpoint(value))
    assert [command.messages for command in buffer.take()] == [1, 2]


SHOWN_NS, NEXT_NS = 3_600_020_000_000, 3_600_030_000_000


@pytest.fixture
def pending(panda_sim):
    return PendingCommands(panda_sim, {'robot0': ['arm']})


@pytest.fixture
def answer(panda_sim, pending):
    """Return a function that answers the state of a stamp with a command."""
    def give(stamp_ns):
        command = panda_sim.robot.parse.action('arm', [0.1] * 7)
        (handle,) = pending.add([command], stamp_ns, None)
        return handle
    return give


def shown(pending):
    pending.may_answer(SHOWN_NS)


def used(pending):
    shown(pending)
    pending.take()


def cleared(pending):
    shown(pending)
    pending.clear('the simulation was reset')


@pytest.mark.parametrize('before', [lambda pending: None, used, cleared],
                         ids=['at the start', 'used', 'cleared'])
def test_nothing_can_be_answered_until_the_next_state_is_shown(pending, answer, before):
    before(pending)
    for stamp_ns in (SHOWN_NS, NEXT_NS):
        with pytest.raises(CommandError, match='all commands for that state have come already$'):
            answer(stamp_ns)
    assert pending.missing == {'robot0': ['arm']}
    assert pending.take() == []
    pending.may_answer(NEXT_NS)
    answer(NEXT_NS)
    assert pending.complete


def test_only_the_state_that_was_shown_last_can_be_answered(pending, answer):
    shown(pending)
    for stamp_ns in (SHOWN_NS - 1, NEXT_NS):
        with pytest.raises(CommandError, match=(
                f'^lockstep: the command answers the state of 3600.{stamp_ns % 10**9:09d} s, the '
                'present state is that of 3600.020000000 s$')):
            answer(stamp_ns)
    assert not pending.complete
    # A command without a stamp answers whatever is shown.
    assert answer(0).status is Status.WAITING and pending.complete


def test_a_reset_aborts_what_waits(pending, answer):
    shown(pending)
    handle = answer(SHOWN_NS)
    pending.clear('the simulation was reset')
    assert (handle.status, handle.reason) == (Status.ABORTED, 'the simulation was reset')
    assert not pending.complete


@pytest.mark.parametrize(('lockstep_parts', 'sent_ns'), [(None, 123_456_789), ({}, 0)])
def test_a_stamp_tells_when_a_command_was_sent_outside_lock_step_only(panda_sim, lockstep_parts,
                                                                      sent_ns):
    pending = PendingCommands(panda_sim, lockstep_parts)
    stamp_ns = 123_456_789 if lockstep_parts is None else panda_sim.time_ns
    command = panda_sim.robot.parse.action('arm', [0.1] * 7)
    (handle,) = pending.add([command], stamp_ns, None)
    ((_, taken),) = pending.take()
    assert taken.sent_ns == sent_ns
    assert taken.handle is handle is command.handle
