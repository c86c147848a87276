# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The command as a process of its own, and in this one."""

import json
import os
from pathlib import Path
import subprocess
import sys

import pytest

from manip_sim.cli.main import main
from manip_sim.interface.composition import Composition, declare_node
from manip_sim.interface.parameter_spec import GivenParameters
from manip_sim.interface.topics import Scope
from manip_sim.models.world import World

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
            capture_output=True, timeout=300, env={**environment, **variables})
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
def described(here):
    """Return a function that returns what ``describe --json`` tells."""
    def describe(*arguments):
        code, text, errors = here('describe', '--json', *arguments)
        assert (code, errors) == (0, '')
        return json.loads(text)
    return describe


@pytest.fixture
def rejected(here):
    """Return a function that runs the command and returns its one line of error."""
    def run(*arguments, code=1):
        found, output, errors = here(*arguments)
        assert (found, output) == (code, ''), errors
        assert errors.startswith('manip_sim: ') and errors.count('\n') == 1, errors
        return errors.removeprefix('manip_sim: ').rstrip('\n')
    return run


@pytest.fixture
def composing(monkeypatch):
    """Return a function that lets a command have a world of one robot, whatever is asked for."""
    def compose(command, robot):
        from manip_sim.cli.composing_options import Composed
        parameters = GivenParameters({})
        declare_node(parameters)
        composed = Composed(Composition([Scope()], World([robot]), 5), parameters)
        monkeypatch.setattr(f'manip_sim.cli.{command}.compose_from', lambda options: composed)
    return compose


@pytest.fixture
def parameters_file(tmp_path):
    """Return a function that writes a file of parameters of the node and returns its path."""
    def write(parameters, node='/**'):
        file = tmp_path / 'parameters.yaml'
        lines = ''.join(f'    {line}\n' for line in parameters.strip().splitlines())
        file.write_text(f'{node}:\n  ros__parameters:\n{lines}')
        return file
    return write
