# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joint inertia is found from published states, as ``benchmark/identification.py`` does it."""

from pathlib import Path
import re

import numpy as np
import pytest

from manip_sim.models.robots import robot_names

pytestmark = pytest.mark.full

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'explanation' / 'control.md').read_text()


@pytest.fixture
def identification(benchmark_module):
    """Return the module of the script."""
    return benchmark_module('identification')


@pytest.mark.parametrize('name, mode', [
    ('Panda', 'effort'), ('UR5e', 'position'), ('Kinova3', 'velocity')])
def test_inertia_from_states_at_long_steps_is_that_of_the_model(identification, name, mode):
    assert np.abs(identification.errors(name, mode, 0.005)).max() < 0.02


def test_the_page_has_the_inertia_of_every_robot_within_two_percent():
    rows = re.findall(r'^\| (\w+)' + r' \| ([\d.]+)' * 6 + r' \|$', PAGE, re.M)
    assert [name for name, *_ in rows] == list(robot_names())
    assert all(float(error) < 2.0 for _, *errors in rows for error in errors)
