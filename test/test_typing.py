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
BLOCKS = [block for block in re.findall(
    # Without what needs a program that is not there.
    r'(?<! -->\n)```python\n(.*?)```', (ROOT / 'docs' / 'how_to' / 'python.md').read_text(),
    re.DOTALL)]
WRONG = """
from manip_sim.models.robots import Panda, Pandda
from manip_sim.models.grippers import PandaGripper
Panda().add_gripper('PandaGripper')
PandaGripper().add_base(None)
"""


@pytest.fixture(scope='module')
def found(tmp_path_factory):
    """Return what mypy finds in the examples and in wrong code, without our settings."""
    pytest.importorskip('mypy', reason='mypy is not installed')
    folder = tmp_path_factory.mktemp('typing')
    for number, block in enumerate(BLOCKS):
        (folder / f'example{number}.py').write_text(block)
    (folder / 'wrong.py').write_text(WRONG)
    done = subprocess.run(
        [sys.executable, '-m', 'mypy', '--strict', '--config-file=', '--follow-imports=silent',
         *sorted(file.name for file in folder.iterdir())],
        capture_output=True, text=True, cwd=folder, timeout=110,
        env={**os.environ, 'MYPYPATH': str(ROOT)})
    assert not done.stderr
    return done.stdout.splitlines()


@pytest.mark.full
def test_the_python_examples_of_the_documentation_are_well_typed(found):
    assert BLOCKS
    assert found[-1].endswith(f'(checked {len(BLOCKS) + 1} source files)')
    assert [line for line in found[:-1] if not line.startswith('wrong.py:')] == []


@pytest.mark.full
def test_a_wrong_name_or_argument_is_found(found):
    for what in ('has no attribute "Pandda"', 'Argument 1 to "add_gripper"',
                 '"PandaGripper" has no attribute "add_base"'):
        assert any(line.startswith('wrong.py:') and what in line for line in found), what


@pytest.mark.parametrize(('function', 'argument', 'kind'), [
    (World.compile, 'return', mujoco.MjModel), (World.compose, 'return', mujoco.MjSpec),
    (Panda.compile, 'return', mujoco.MjModel), (Panda.attach_to, 'spec', mujoco.MjSpec),
    (Panda.attach_to, 'frame', mujoco.MjsFrame), (Panda.spec.fget, 'return', mujoco.MjSpec)])
def test_annotations_name_the_types_of_mujoco(function, argument, kind):
    assert get_type_hints(function)[argument] is kind
