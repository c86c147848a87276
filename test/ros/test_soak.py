# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The scripts of ``make soak``, in amounts of seconds."""

from pathlib import Path
import subprocess
import sys

import pytest

SOAK = Path(__file__).parent.parent / 'soak' / 'soak.py'


@pytest.mark.full
def test_the_soak_scripts_run_and_lose_nothing():
    done = subprocess.run(
        [sys.executable, str(SOAK), '--only', 'malformed', 'floods', 'stops', 'starts',
         'time', 'requests', 'viewer', 'spawns', 'actions', 'changes', '--messages', '200',
         '--flood', '0.1', '--stops', '2', '--starts', '4', '--hours', '0.003',
         '--requests', '100', '--viewer', '100', '--spawns', '50', '--goals', '150',
         '--changes', '60'],
        capture_output=True, text=True, timeout=300.0)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line for line in done.stdout.splitlines() if line.startswith('|')]
    assert len(rows) == 2 + 13
    assert done.stdout.splitlines()[-1] == '0 lost'
