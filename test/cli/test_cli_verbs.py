# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Verbs of the command that other packages add."""

from functools import partial
import re

import numpy as np
import pytest

from manip_sim.cli.main import main
from manip_sim.models import compose_robot, create_arena, World
from manip_sim.simulation import Simulation

BEGIN = """
from manip_sim.cli.offered_verbs import Verb
from manip_sim.errors import ModelError
class Fine(Verb):
    summary = 'do nothing'
    def run(self, options): return 'done', 0
"""
#: By the verb: its class, and what is printed of it when it is run.
BROKEN = {
    'raises': ('def run(self, options): 1 / 0', 'ZeroDivisionError: division by zero'),
    'rejects': ("def run(self, options): raise ModelError('no arm')", 'no arm'),
    'textless': ('def run(self, options): return None', 'must return a text and an exit code'),
    'optionless': ('def add_arguments(self, parser): parser.add_argument(1)\n'
                   '    def run(self, options): pass', 'TypeError'),
    'unmade': ('', 'must be a class that derives from Verb'),
    'needy': ('def run(self, options): pass\n    def __init__(self, more): pass', 'TypeError'),
}


@pytest.fixture
def package(package_on_path):
    """Return a function that puts a package with verbs, by name, on the path."""
    return partial(package_on_path, 'manip_sim.commands')


@pytest.mark.full
def test_an_installed_verb_is_listed_and_runs_with_the_options_of_a_composition(
        install_example, command, environment):
    path = f'{install_example("reach_command")}:{environment["PYTHONPATH"]}'
    listed = command('--help', PYTHONPATH=path)
    assert re.search(r'^ +reach +print the box that the end effectors reach$', listed.stdout,
                     re.MULTILINE)
    done = command('reach', '--robot', 'UR5e', '--samples', 200, PYTHONPATH=path)
    assert (done.returncode, done.stderr) == (0, '')
    site, box = done.stdout.split(':')
    low, high = np.array(re.findall(r'-?\d+\.\d*', box), dtype=float).reshape(2, 3)
    simulation = Simulation(World([compose_robot('UR5e')], create_arena('empty')))
    start = simulation.data.site(site).xpos
    assert (low < start).all() and (start < high).all()
    # Of an arm whose reach is 0.85 m, with a gripper.
    assert (high - low < 2.4).all() and (high - low > 1.0).all()
    wrong = command('reach', '--robot', 'Nothing', PYTHONPATH=path)
    assert wrong.returncode == 1 and (
        wrong.stderr.startswith("manip_sim: parameter 'robot': unknown value 'Nothing'"))
    unknown = command('reach', '--more', PYTHONPATH=path)
    assert unknown.returncode == 2 and unknown.stderr == (
        'manip_sim: unrecognized arguments: --more; see manip_sim reach --help\n')


def test_a_verb_that_fails_is_an_error_of_one_line_that_names_its_package(package, capsys):
    package('their_verbs', BEGIN + '\n'.join(
        f"class {verb.title()}(Verb):\n    summary = 'fail'\n    {code}\n"
        for verb, (code, _) in BROKEN.items()), {verb: verb.title() for verb in BROKEN})
    package('their_import', 'import does_not_exist', {'lost': 'Lost'})
    for verb, (_, what) in {**BROKEN, 'lost': ('', 'does_not_exist')}.items():
        assert main([verb]) == 1
        printed = capsys.readouterr()
        assert printed.out == '' and printed.err.count('\n') == 1 and what in printed.err
        if verb != 'rejects':  # What a verb says itself needs no more.
            assert f"'{verb}' of the package their_" in printed.err and ' 1.2 ' in printed.err


def test_a_verb_that_cannot_be_used_hides_no_other_and_replaces_no_command(
        package, capsys, caplog):
    package('more_verbs', BEGIN, {'fine': 'Fine', 'list': 'Fine', 'BAD': 'Fine'})
    package('more_imports', 'import does_not_exist', {'lost': 'Lost'})
    with pytest.raises(SystemExit, match='0'):
        main(['--help'])
    assert re.search('^ +fine +do nothing$', capsys.readouterr().out, re.MULTILINE)
    warnings = [record.getMessage() for record in caplog.records]
    assert len(warnings) == 3
    for verb, what in (('list', 'has a command of that name'), ('BAD', 'lower-case'),
                       ('lost', 'does_not_exist')):
        (line,) = [line for line in warnings if f"'{verb}' of the package" in line]
        assert what in line
    assert main(['fine']) == 0 and capsys.readouterr().out == 'done\n'
    caplog.clear()
    assert main(['list', 'arenas']) == 0 and 'empty' in capsys.readouterr().out
    assert not caplog.records
