# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Order of delayed commands that arrive at one instant."""

import numpy as np
import pytest

from manip_sim.control.delayed_commands import DelayedCommands


@pytest.fixture
def commands(panda_sim):
    """Return commands, some for same joints or the same gripper, and which pairs are."""
    parse, names = panda_sim.robot.parse, panda_sim.robot.joint_names
    random = np.random.default_rng(7)
    joints = [sorted(random.choice(7, random.integers(1, 4), replace=False)) for _ in range(20)]
    made = [(*parse.joint_command([names[n] for n in some], np.full(len(some), 0.1)),)
            for some in joints]
    made += [(parse.action('right/gripper', [value]),) for value in (1.0, -1.0, 0.0)]
    overlaps = {(a, b): bool({*joints[a]} & {*joints[b]}) if max(a, b) < 20 else min(a, b) >= 20
                for a in range(23) for b in range(23)}
    return [command for command, in made], overlaps


def arrived(commands, order):
    delayed = DelayedCommands()
    for number in order:
        delayed.add(commands[number], 5)
    return [commands.index(command) for command in delayed.due(5)]


@pytest.mark.parametrize('seed', range(20))
def test_only_the_order_for_same_joints_and_grippers_matters(commands, seed):
    commands, overlaps = commands
    random = np.random.default_rng(seed)
    order = random.permutation(len(commands)).tolist()
    expected = arrived(commands, order)
    for a, b in overlaps:
        if a != b and overlaps[a, b]:
            assert (order.index(a) < order.index(b)) == (expected.index(a) < expected.index(b))
    for _ in range(200):
        place = random.integers(len(order) - 1)
        if not overlaps[order[place], order[place + 1]]:
            order[place], order[place + 1] = order[place + 1], order[place]
    assert arrived(commands, order) == expected


def test_a_later_command_that_is_due_earlier_does_not_overtake(commands):
    commands, _ = commands
    delayed = DelayedCommands()
    delayed.add(commands[0], 9)
    delayed.add(commands[1], 4)
    assert [*delayed.due(8)] == []
    assert len([*delayed.due(9)]) == 2
