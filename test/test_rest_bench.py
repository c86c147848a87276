# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What ``benchmark/rest.py`` measures is what the documentation says, robot by robot."""

from pathlib import Path
import re

import pytest

from manip_sim.models.robots import robot_names

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'how_to' / 'cartesian.md').read_text()


@pytest.fixture
def rest(monkeypatch):
    """Return the module of the script."""
    monkeypatch.syspath_prepend(str(ROOT / 'benchmark'))
    import rest
    return rest


@pytest.mark.parametrize(('robot', 'mode', 'targets'), [
    ('Jaco', 'position', [106, 131]), ('Panda', 'velocity', [89]), ('Baxter', 'effort', [31])])
def test_hands_that_once_kept_moving_on_their_place_come_to_rest(rest, robot, mode, targets):
    arrive_s, rest_s = rest.measure(robot, mode, targets)
    assert max(arrive_s) < 10.0
    assert max(rest_s) < rest.SOON_S


def test_the_page_says_that_every_arm_of_every_robot_rests_in_time():
    rows = re.findall(r'^\| (\w+) \| (\w+) \| (\d+) \| [\d., ]+ \| (\d+) \|', PAGE, re.MULTILINE)
    assert {(name, mode) for name, mode, *_ in rows} == {
        (name, mode) for name in robot_names() for mode in ('position', 'effort')}
    assert all(int(targets) == int(soon) > 100 for _, _, targets, soon in rows)
