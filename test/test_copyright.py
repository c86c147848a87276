# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every source file says whose it is and under which licence."""

import importlib.util
from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
# REUSE-IgnoreStart
HEADER = ('# Copyright 2026 The manip_sim developers\n'
          '# SPDX-License-Identifier: Apache-2.0\n')
# REUSE-IgnoreEnd


def test_every_python_file_begins_with_the_licence():
    folders = ('manip_sim', 'lerobot_env_manip_sim', 'lerobot_robot_manip_sim', 'test',
               'benchmark', 'hardware')
    files = [ROOT / 'setup.py', *(p for folder in folders for p in (ROOT / folder).rglob('*.py'))]
    assert len(files) > 20
    assert not [str(file) for file in files if not file.read_text().startswith(HEADER)]


def test_every_cpp_file_begins_with_the_licence():
    files = [*(ROOT / 'hardware').rglob('*.cpp'), *(ROOT / 'benchmark').rglob('*.cpp')]
    assert files
    assert not [str(file) for file in files
                if not file.read_text().startswith(HEADER.replace('#', '//'))]


@pytest.mark.full
@pytest.mark.skipif(importlib.util.find_spec('reuse') is None, reason='reuse is not installed')
def test_the_licence_of_every_file_can_be_read_by_reuse():
    done = subprocess.run([sys.executable, '-m', 'reuse', 'lint'], cwd=ROOT, capture_output=True,
                          text=True, timeout=100)
    assert done.returncode == 0, done.stdout
    # Tools that look for one licence, and those that follow REUSE, find the same.
    assert (ROOT / 'LICENSE').read_text() == (ROOT / 'LICENSES/Apache-2.0.txt').read_text()
