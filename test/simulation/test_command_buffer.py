# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of commands that wait for the next control period."""

import numpy as np

from manip_sim.simulation.commands import Goal, GripperAction, TrajectoryPoints
from manip_sim.simulation.staging import Staging


def goal(values, part='arm', mode='position'):
    """Return a goal for some actuators, from a dictionary of index and value."""
    return Goal(part, mode, np.array(list(values)), np.array(list(values.values())))


def trajectory(part='arm'):
    return TrajectoryPoints(part, np.array([0]), np.array([1.0]), np.array([[0.5]]))


def as_dictionary(command):
    return dict(zip(command.indices.tolist(), command.values.tolist()))


def test_commands_are_taken_once():
    staging = Staging()
    command = GripperAction('right/gripper', np.ones(1))
    staging.add(command)
    assert staging.take() == [command]
    assert staging.take() == []


def test_newer_goal_wins_joint_by_joint():
    staging = Staging()
    staging.add(goal({0: 1.0, 1: 2.0}))
    staging.add(goal({1: 3.0, 2: 4.0}))
    (merged,) = staging.take()
    assert as_dictionary(merged) == {0: 1.0, 1: 3.0, 2: 4.0}
    assert (merged.part, merged.mode) == ('arm', 'position')


def test_many_commands_do_not_pile_up():
    staging = Staging()
    for n in range(1000):
        staging.add(goal({0: float(n)}))
        staging.add(GripperAction('right/gripper', np.array([n / 1000.0])))
        staging.add(trajectory())
    commands = staging.take()
    assert len(commands) == 3
    assert as_dictionary(commands[0]) == {0: 999.0}
    assert commands[1].action[0] == 0.999


def test_goals_of_different_modes_are_not_mixed():
    staging = Staging()
    staging.add(goal({0: 1.0}))
    staging.add(goal({1: 2.0}, mode='velocity'))
    (kept,) = staging.take()
    assert (kept.mode, as_dictionary(kept)) == ('velocity', {1: 2.0})


def test_goals_of_different_parts_are_kept_apart_in_the_order_of_arrival():
    staging = Staging()
    staging.add(goal({0: 1.0}, part='torso'))
    staging.add(goal({0: 2.0}, part='arm'))
    staging.add(goal({0: 3.0}, part='torso'))
    assert [(c.part, as_dictionary(c)) for c in staging.take()] == [
        ('arm', {0: 2.0}), ('torso', {0: 3.0})]


def test_goal_after_a_trajectory_comes_after_it():
    staging = Staging()
    staging.add(goal({0: 1.0}))
    staging.add(trajectory())
    staging.add(goal({0: 2.0}))
    assert [type(c) for c in staging.take()] == [TrajectoryPoints, Goal]


def test_lockstep_is_complete_when_every_part_has_a_command():
    staging = Staging(['arm', 'right/gripper'])
    assert not staging.complete
    staging.add(goal({0: 1.0}))
    staging.add(goal({0: 1.0}, part='head'))
    assert not staging.complete
    staging.add(GripperAction('right/gripper', np.ones(1)))
    assert staging.complete
    staging.take()
    assert not staging.complete


def test_cleared_commands_are_gone():
    staging = Staging(['arm'])
    staging.add(goal({0: 1.0}))
    staging.clear()
    assert not staging.complete
    assert staging.take() == []


def test_merging_leaves_the_commands_that_were_given():
    staging, older, newer = Staging(), goal({0: 1.0, 1: 2.0}), goal({1: 3.0})
    staging.add(older)
    staging.add(newer)
    assert as_dictionary(older) == {0: 1.0, 1: 2.0}
    assert as_dictionary(newer) == {1: 3.0}
