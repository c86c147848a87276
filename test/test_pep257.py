# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Docstrings: pydocstyle with the rules that ament_pep257 leaves on, for the package."""

from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: What ament_pep257 ignores.
IGNORED = 'D100,D101,D102,D103,D104,D105,D106,D107,D203,D212,D404'


def test_docstrings_have_the_form_that_ament_asks_for():
    pytest.importorskip('pydocstyle', reason='pydocstyle is a tool of the extra test')
    result = subprocess.run(
        [sys.executable, '-m', 'pydocstyle', f'--ignore={IGNORED}', 'manip_sim', 'setup.py'],
        cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
