# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Arms that cannot go on come to rest.

Those whose targets are out of reach, as ``benchmark/rest.py`` and its page say, and those that
press on something, as ``benchmark/resting.py`` measures.
"""

from pathlib import Path
import re

import pytest

from manip_sim.models.robots import robot_names

pytestmark = pytest.mark.full

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'how_to' / 'cartesian.md').read_text()


@pytest.fixture
def rest(benchmark_module):
    """Return the module of the script."""
    return benchmark_module('rest')


@pytest.mark.parametrize(('robot', 'mode', 'targets'), [
    ('Jaco', 'position', [11, 106, 131]), ('GR1', 'position', [95]),
    ('Panda', 'velocity', [89]), ('Baxter', 'effort', [31])])
def test_arms_that_once_kept_moving_on_their_place_come_to_rest(rest, robot, mode, targets):
    arrive_s, rest_s = rest.measure(robot, mode, targets)
    assert max(arrive_s) < 10.0
    assert max(rest_s) < rest.SOON_S


def test_the_page_says_that_arms_rest_in_time():
    rows = re.findall(r'^\| (\w+) \| (\w+) \| (\d+) \| [\d., ]+ \| (\d+) \|', PAGE, re.M)
    assert {name for name, *_ in rows} <= set(robot_names()) and len(rows) >= 5
    assert all(int(soon) >= 0.98 * int(targets) for _, _, targets, soon in rows)


@pytest.mark.parametrize(('robot', 'mode', 'timestep_s', 'arena', 'motions', 'seed'), [
    ('IIWA', 'velocity', 0.005, 'table', [0, 1, 2], 1),
    ('IIWA', 'position', 0.005, 'table', [0], 1),
    ('Sawyer', 'position', 0.005, 'empty', [0, 12, 13, 14], 1),
    ('UR5e', 'velocity', 0.001, 'empty', [0, 1, 2], 1),
    ('UR5e', 'position', 0.002, 'empty', [42], 21),
    ('SO101', 'velocity', 0.002, 'empty', [6, 7, 8], 1),
    ('GR1', 'velocity', 0.005, 'table', [12], 3),
    ('FR3', 'velocity', 0.002, 'table', [21, 22], 3),
    ('GR1', 'position', 0.005, 'table', [3, 4, 5], 1),
    ('Panda', 'position', 0.002, 'table', [3, 4, 5], 21),
    ('Tiago', 'velocity', 0.005, 'table', [45], 7),
    ('Baxter', 'position', 0.005, 'empty', [12], 51),
    ('XArm7', 'position', 0.005, 'empty', [6, 7, 8], 81),
    ('IIWA', 'position', 0.005, 'empty', [18, 19, 20], 41),
    ('PandaOmron', 'position', 0.005, 'table', [0, 1, 2], 51)])
def test_arms_that_press_on_something_come_to_rest(
        benchmark_module, robot, mode, timestep_s, arena, motions, seed):
    outcomes = benchmark_module('resting').measure(robot, mode, timestep_s, motions, arena, seed)
    assert outcomes
    assert [outcome for outcome in outcomes if not outcome.rests] == []


def test_an_arm_that_a_controller_presses_with_its_hand_on_the_pedestal_comes_to_rest(
        benchmark_module):
    # MuJoCo finds one or two points between two boxes that tilt on each other, by turns.
    outcomes = benchmark_module('resting').measure('FR3', 'effort', 0.001, [0, 1], seed=1)
    assert outcomes and all(outcome.rests for outcome in outcomes)


def test_a_motion_that_slides_on_is_given_time_to_arrive(benchmark_module):
    resting = benchmark_module('resting')
    outcomes = resting.measure('Panda', 'position', 0.005, [0, 1, 2], 'table', seed=41)
    late = [outcome for outcome in outcomes if not outcome.rests]
    assert [outcome.motion for outcome in late] == [2] and 0.0 < late[0].later_s < resting.LATER_S
