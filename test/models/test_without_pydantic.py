# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Ubuntu 24.04 has pydantic 1: what needs version 2 says so, and all else works."""

import subprocess
import sys

import pytest

WITH_ARENA = """
from manip_sim.models import compose
print(compose(arena='table', cube=True).compile().body('cube').mass[0])
"""
WITH_OBJECT = """
from manip_sim.models import create_object
create_object({'name': 'ball', 'shape': 'sphere', 'size': 0.1, 'mass': 1.0})
"""
WITH_FILE = """
from manip_sim.models import compose
compose('robot.xml')
"""


def run(tmp_path, script):
    """Run a script where pydantic is of version 1; return its exit code and last line."""
    (tmp_path / 'pydantic.py').write_text("VERSION = '1.10.14'\nclass BaseModel: pass\n")
    path = f'import sys\nsys.path.insert(0, {str(tmp_path)!r})\n'
    done = subprocess.run([sys.executable, '-c', path + script], capture_output=True, text=True,
                          check=False, timeout=60)
    return done.returncode, (done.stdout + done.stderr).splitlines()[-1]


@pytest.mark.full
def test_the_catalogue_works_without_it(tmp_path):
    assert run(tmp_path, WITH_ARENA) == (0, '0.1')


@pytest.mark.full
@pytest.mark.parametrize('script', [WITH_OBJECT, WITH_FILE])
def test_what_needs_it_says_so_in_one_line(tmp_path, script):
    code, line = run(tmp_path, script)
    assert code == 1
    assert line.startswith('manip_sim.errors.ModelError: models and objects from files and '
                           "descriptions need pydantic 2: pip install 'pydantic>=2'")
