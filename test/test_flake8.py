# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Style: flake8 with ament's line length and quotes, and ruff with the project's rules."""

from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
CHECKED = ['manip_sim', 'test', 'benchmark', 'setup.py']


def run(module, *arguments):
    pytest.importorskip(module, reason=f'{module} is a tool of the extra test')
    result = subprocess.run([sys.executable, '-m', module, *arguments, *CHECKED], cwd=ROOT,
                            capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_flake8_finds_nothing():
    run('flake8', '--max-line-length=99')


def test_ruff_finds_nothing():
    run('ruff', 'check')
