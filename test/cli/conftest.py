# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The command as a process of its own, and in this one."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

from manip_sim.cli.main import main

SOURCE = Path(__file__).resolve().parents[2]


@pytest.fixture
def environment(tmp_path):
    """Return the variables for a process that finds this source tree and has no terminal."""
    variables = {**os.environ, 'PYTHONPATH': str(SOURCE)}
    variables.pop('COLUMNS', None)
    return variables


@pytest.fixture
def command(environment):
    """Return a function that runs ``manip_sim ARGUMENTS`` and returns the finished process."""
    def run(*arguments, **variables):
        return subprocess.run(
            [sys.executable, '-m', 'manip_sim.cli', *map(str, arguments)], text=True,
            capture_output=True, timeout=120, env={**environment, **variables})
    return run


@pytest.fixture
def here(capsys, monkeypatch):
    """Return a function that runs the command in this process: exit code, output, errors."""
    monkeypatch.delenv('COLUMNS', raising=False)

    def run(*arguments):
        capsys.readouterr()
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as ended:
            code = ended.code
        output, errors = capsys.readouterr()
        return code, output, errors
    return run


@pytest.fixture
def refused(here):
    """Return a function that runs the command and returns its one line of error."""
    def run(*arguments, code=1):
        found, output, errors = here(*arguments)
        assert (found, output) == (code, ''), errors
        assert errors.startswith('manip_sim: ') and errors.count('\n') == 1, errors
        return errors.removeprefix('manip_sim: ').rstrip('\n')
    return run
