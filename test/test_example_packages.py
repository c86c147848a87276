# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The example packages of ``test/data``: they are short, and the guides show them."""

from pathlib import Path

import pytest

pytestmark = pytest.mark.full

ROOT = Path(__file__).resolve().parents[1]
GUIDES = {'end_effector_imu': 'how_to/add_sensor.md', 'touched_bodies': 'how_to/add_sensor.md',
          'go_home': 'how_to/add_feature.md', 'nudge': 'how_to/add_feature.md',
          'reach_command': 'how_to/add_verb.md', 'spring_mode': 'how_to/add_control_mode.md',
          'friction_compensation': 'tutorials/own_law.md'}


@pytest.mark.parametrize('name', GUIDES)
def test_an_example_package_is_short_and_its_guide_shows_its_files(name):
    files = [path.read_text() for path in (ROOT / 'test/data' / name).iterdir() if path.is_file()]
    assert len(files) == 2 and sum(len(text.splitlines()) for text in files) <= 60
    guide = (ROOT / 'docs' / GUIDES[name]).read_text()
    shown = [f'{name}.py'] + ['pyproject.toml'] * (
        name not in ('touched_bodies', 'nudge'))  # As those of the first example.
    for file in shown:
        text = (ROOT / 'test/data' / name / file).read_text()
        assert text.partition('\n\n')[2] in guide  # After the licence.


def test_every_example_package_has_a_guide():
    assert set(GUIDES) == {path.parent.name for path in (ROOT / 'test/data').glob('*/*.toml')}
