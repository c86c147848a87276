# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The types that users see: the Python examples of the documentation pass ``mypy --strict``."""

import os
from pathlib import Path
import re
import subprocess
import sys
from typing import get_type_hints

import mujoco
import pytest

from manip_sim.models import World
from manip_sim.models.robots import Panda

ROOT = Path(__file__).resolve().parents[1]
BLOCKS = [block for block in re.findall(r'```python\n(.*?)```', (
    ROOT / 'docs' / 'how_to' / 'python.md').read_text(), re.DOTALL)]
WRONG = """
from manip_sim.models.robots import Panda, Pandda
from manip_sim.models.grippers import PandaGripper
Panda().add_gripper('PandaGripper')
PandaGripper().add_base(None)
"""


@pytest.fixture(scope='module')
def cache(tmp_path_factory):
    """Return a folder where mypy keeps what it knows of our modules from one test to the next."""
    return tmp_path_factory.mktemp('mypy')


@pytest.fixture
def check(tmp_path, cache):
    """Return a function that checks code as a user does, without the settings of this project."""
    pytest.importorskip('mypy', reason='mypy is not installed')

    def run(code):
        file = tmp_path / 'example.py'
        file.write_text(code)
        done = subprocess.run(
            [sys.executable, '-m', 'mypy', '--strict', '--config-file=',
             '--follow-imports=silent', f'--cache-dir={cache}', str(file)],
            capture_output=True, text=True, cwd=tmp_path, timeout=110,
            env={**os.environ, 'MYPYPATH': str(ROOT)})
        assert not done.stderr
        return done.stdout
    return run


def test_the_python_examples_of_the_documentation_are_well_typed(check):
    assert BLOCKS
    for block in BLOCKS:
        assert check(block) == 'Success: no issues found in 1 source file\n'


def test_a_wrong_name_or_argument_is_found(check):
    found = check(WRONG)
    assert 'has no attribute "Pandda"' in found
    assert 'Argument 1 to "add_gripper"' in found
    assert '"PandaGripper" has no attribute "add_base"' in found


@pytest.mark.parametrize(('function', 'argument', 'kind'), [
    (World.compile, 'return', mujoco.MjModel), (World.compose, 'return', mujoco.MjSpec),
    (Panda.compile, 'return', mujoco.MjModel), (Panda.attach_to, 'spec', mujoco.MjSpec),
    (Panda.attach_to, 'frame', mujoco.MjsFrame), (Panda.spec.fget, 'return', mujoco.MjSpec)])
def test_annotations_name_the_types_of_mujoco(function, argument, kind):
    assert get_type_hints(function)[argument] is kind
