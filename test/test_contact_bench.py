# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What ``benchmark/contact.py`` measures is what the documentation says, row by row."""

from pathlib import Path
import re
import sys

import pytest

from manip_sim.models.grippers import gripper_names

pytestmark = pytest.mark.full

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'explanation' / 'contact.md').read_text()
COLUMNS = ('name', 'light', 'touch', 'still', 'sliding', 'lost', 'friction', 'load', 'creep',
           'shake')
#: How far a row that is measured again may be from that of the page.
TOLERANCES = {'light': 0.3, 'touch': 0.3, 'still': 0.05, 'sliding': 0.05, 'lost': 1.0,
              'friction': 0.03}


@pytest.fixture
def contact(benchmark_module):
    """Return the module of the script."""
    return benchmark_module('contact')


def read(line):
    """Return a row of the table as numbers by column; what is not measured is left out."""
    cells = dict(zip(COLUMNS, line.strip('| \n').split(' | ')))
    return cells.pop('name').strip('`'), {
        column: float(cell.split()[0]) for column, cell in cells.items() if cell != '-'}


def check(figures):
    """Check a row against what is wanted of every gripper and robot."""
    assert figures['light'] < 3.0 * 5.0 and figures['touch'] < 3.0 * 10.0
    assert figures['still'] < 0.5 and figures['sliding'] < 0.5
    assert figures['lost'] < 5.0
    if 'load' in figures:
        assert figures['creep'] < 0.1
        assert figures['shake'] < 1.0


def test_the_script_measures_a_gripper_with_its_own_friction(contact, monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['contact.py', 'WipingGripper'])
    assert contact.main() == 0
    *header, line = capsys.readouterr().out.splitlines()
    name, figures = read(line)
    assert '\n'.join(header) == contact.HEADER and name == 'WipingGripper'
    # The table has 1.0; felt has its own.
    assert 0.34 < figures['friction'] < 0.401
    check(figures)
    said = dict(map(read, rows_below(contact.HEADER)))[name]
    assert said.keys() == figures.keys()
    for column, figure in figures.items():
        assert figure == pytest.approx(said[column], abs=TOLERANCES[column]), column


def test_an_unknown_gripper_is_told_which_there_are(contact, monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['contact.py', 'PandaGriper'])
    assert contact.main() == 1
    assert "did you mean 'PandaGripper'" in capsys.readouterr().err


def rows_below(header):
    """Return the lines of the table of the page that begins with a header."""
    return re.match(r'(?:\|.*\n)*', PAGE.split(header + '\n')[1]).group().splitlines()


def test_the_page_has_the_figures_of_every_gripper_and_robot(contact):
    rows = dict(map(read, rows_below(contact.HEADER)))
    assert set(rows) == {*gripper_names(), *contact.ROBOTS} - {  # These have no fingers.
        'NullGripper', 'VacuumGripper'}
    assert {name for name, figures in rows.items() if 'load' in figures} == set(contact.PAYLOADS)
    for figures in rows.values():
        check(figures)


@pytest.mark.parametrize('name', ['PandaGripper', 'Robotiq85Gripper', 'JacoThreeFingerGripper'])
def test_a_cube_of_most_of_the_payload_does_not_creep(contact, name):
    load_kg, creep, shaken = contact.hold(name, seconds=1.5)
    assert load_kg == pytest.approx(0.8 * contact.PAYLOADS[name][0])
    assert creep * 60e3 < 0.1
    assert shaken < 1e-3


def test_the_page_has_the_presses_over_topics(contact):
    rows = [[float(cell) for cell in line.strip('| ').split(' | ')[1:]]
            for line in rows_below(contact.TOPICS_HEADER)]
    assert [row[:2] for row in rows] == 2 * [
        [force, rate] for force in (5.0, 10.0, 20.0) for rate in (100.0, 500.0)]
    assert all(max(row[2:]) < 0.5 for row in rows)


# The 2F-85 has the most contact points for the least force, on the Panda.
@pytest.mark.parametrize('name', ['Robotiq85Gripper', 'Kinova3'])
def test_a_gripper_that_is_drawn_along_a_table_stays_on_it(contact, name):
    lost, where, _ = contact.drag(name, speeds=(0.05,), seconds=0.3)
    assert lost < 0.05, where


def test_only_the_gripper_counts_as_contact_with_the_table(contact):
    # A cube on the table would hide that the gripper hops.
    bench = contact.Bench('PandaGripper')
    bench.wait(0.1)
    assert bench.touch() == (0.0, 0.0)


@pytest.mark.parametrize('force_n, rate_hz', [(5.0, 100.0), (10.0, 500.0)])
def test_an_admittance_controller_holds_its_force_still_and_sliding(contact, force_n, rate_hz):
    still, sliding = contact.press(
        'Robotiq85Gripper', force_n, rate_hz, seconds=1.0, settle=0.5)
    assert still < 0.5 and sliding < 0.5


def test_a_touch_peaks_as_the_page_says_wherever_in_a_period_it_falls(contact):
    said = dict(map(read, rows_below(contact.HEADER)))['Robotiq85Gripper']
    assert contact.touch_down('Robotiq85Gripper', 5.0) == pytest.approx(
        said['light'], abs=TOLERANCES['light'])


def test_fingers_that_are_drawn_along_do_not_give(contact):
    # A thumb that slips while the gripper slides lets it sink, 1.7 N less for a second.
    assert contact.press('JacoThreeFingerGripper', 20.0)[1] < 0.5
