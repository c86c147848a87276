# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots, grippers, bases and arenas of other packages, found through their entry points."""

import itertools
import logging
import os
import subprocess
import sys

import numpy as np
from pages import blocks, PAGES
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import arenas, bases, compose, grippers, robots
from manip_sim.models.robots import Panda
from manip_sim.simulation import Simulation

MODULE = """
from manip_sim.models.arenas import TableArena
from manip_sim.models.bases import RethinkMount
from manip_sim.models.grippers import PandaGripper
from manip_sim.models.robots import UR5e

class {0}Arm(UR5e): pass
class {0}Hand(PandaGripper): pass
class {0}Stand(RethinkMount): pass
class {0}Bench(TableArena): arena_name = '{0}_bench'
"""
_numbers = itertools.count()


@pytest.fixture
def package(tmp_path, monkeypatch):
    """
    Return a function that makes a package with entry points and puts it on ``sys.path``.

    It returns the package's name, which is that of its module too.
    """
    def make(code, points, name=None, damaged=''):
        # A module is imported once in a process, so each has a name of its own.
        name = name or f'other{next(_numbers)}'
        (tmp_path / f'{name}.py').write_text(code)
        info = tmp_path / f'{name}-1.2.dist-info'
        info.mkdir()
        (info / 'METADATA').write_text(f'Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n')
        lines = itertools.chain.from_iterable(
            (f'[manip_sim.{kind}s]', *(f'{key} = {value.format(name)}'
                                       for key, value in entries.items()))
            for kind, entries in points.items())
        (info / 'entry_points.txt').write_text('\n'.join([*lines, damaged]))
        return name

    # Made on the path at once, because what is found there is kept as long as the path.
    monkeypatch.syspath_prepend(str(tmp_path))
    return make


@pytest.fixture
def warnings_of(caplog):
    """Return a function that gives the texts of warnings of the model layer so far."""
    caplog.set_level(logging.WARNING, logger='manip_sim.models')
    return lambda: [record.getMessage() for record in caplog.records
                    if record.name == 'manip_sim.models']


def test_classes_of_another_package_are_listed_and_created_as_our_own(package, warnings_of):
    package(MODULE.format('Far'), {
        'robot': {'FarArm': '{}:FarArm'}, 'gripper': {'FarHand': '{}:FarHand'},
        'base': {'FarStand': '{}:FarStand'}, 'arena': {'Far_bench': '{}:FarBench'}})
    assert 'FarArm' in robots.robot_names()
    assert 'FarHand' in grippers.gripper_names()
    assert 'FarStand' in bases.base_names()
    assert 'Far_bench' in arenas.arena_names()
    robot = robots.create_robot('FarArm', idn=3)
    assert robot.name == 'FarArm3'
    robot.add_base(bases.create_base('FarStand'))
    robot.add_gripper(grippers.create_gripper('FarHand'))
    assert robot.compile().nu == 8
    assert arenas.create_arena('Far_bench', table_length_m=1.0).table_length_m == 1.0
    assert robots.FarArm is type(robot)
    assert warnings_of() == []


def test_a_class_may_have_another_name_than_its_entry_point(package):
    package('from manip_sim.models.robots import UR5e as _Mine', {'robot': {'ur_5': '{}:_Mine'}})
    assert type(robots.create_robot('ur_5')) is robots.UR5e
    assert 'ur_5' in robots.robot_names()


def test_a_package_is_imported_when_its_class_is_asked_for_and_not_before(package):
    name = package(MODULE.format('Late'), {'robot': {'LateArm': '{}:LateArm'}})
    robots.create_robot('Panda')
    assert name not in sys.modules
    robots.create_robot('LateArm')
    assert name in sys.modules


@pytest.mark.full
@pytest.mark.parametrize(('code', 'why'), [
    ('import no_such_module_at_all', r"ModuleNotFoundError: No module named "
                                     r"'no_such_module_at_all'"),
    ('raise RuntimeError("two\\nlines")', 'RuntimeError: two lines'),
    ('import sys; sys.exit(3)', 'SystemExit: 3'),
    ('', r"AttributeError: module 'other\d+' has no attribute 'Broken'")])
def test_an_entry_point_that_cannot_be_imported_is_told_and_hides_no_other(
        package, code, why):
    package(code, {'robot': {'Broken': '{}:Broken'}})
    package(MODULE.format('Whole'), {'robot': {'WholeArm': '{}:WholeArm'}})
    message = (r"^robot 'Broken' of the package other\d+ 1\.2 \(other\d+:Broken\) cannot be "
               rf'imported: {why}$')
    for _ in range(2):
        with pytest.raises(ModelError, match=message):
            robots.create_robot('Broken')
    names = robots.robot_names()
    assert 'WholeArm' in names and 'Panda' in names
    assert 'Broken' not in names


def test_a_list_of_names_warns_once_of_what_cannot_be_imported(package, warnings_of):
    package('1 / 0', {'gripper': {'Broken': '{}:Broken'}})
    for _ in range(3):
        assert 'Broken' not in grippers.gripper_names()
    (warning,) = warnings_of()
    assert warning.endswith('cannot be imported: ZeroDivisionError: division by zero')


@pytest.mark.full
@pytest.mark.parametrize(('code', 'why'), [
    ('Thing = 7', 'must be a class that derives from RobotModel, got 7$'),
    ('from manip_sim.models.grippers import PandaGripper as Thing',
     'must be a class that derives from RobotModel, got <class .*Panda'),
    ('from manip_sim.models.robots import ManipulatorModel as Thing',
     'cannot be created by its name: its constructor must take idn'),
    ('from manip_sim.models.robots import Panda\n'
     'class Thing(Panda):\n def __init__(self): pass',
     r"cannot be created by its name: its constructor must take idn.*'idn'\)$")])
def test_an_entry_point_that_is_no_class_to_create_is_told(package, code, why):
    package(code, {'robot': {'Thing': '{}:Thing'}})
    with pytest.raises(ModelError, match=f"^robot 'Thing' of the package .*{why}"):
        robots.create_robot('Thing')
    assert 'Thing' not in robots.robot_names()


def test_another_package_cannot_replace_what_is_there(package, warnings_of):
    package('from manip_sim.models.robots import UR5e\nclass Panda(UR5e): pass',
            {'robot': {'Panda': '{}:Panda'}})
    assert 'Panda' in robots.robot_names()
    assert type(robots.create_robot('Panda')) is Panda
    first, second = warnings_of()
    assert "defines a robot 'Panda', which is already registered and is kept" in first
    assert second.endswith('is ignored: that name is registered already')


def test_a_class_that_was_imported_before_is_no_conflict(package, warnings_of):
    name = package(MODULE.format('Early'), {'robot': {'EarlyArm': '{}:EarlyArm'}})
    __import__(name)
    assert 'EarlyArm' in robots.robot_names()
    assert warnings_of() == []


def test_a_module_may_ask_for_names_while_it_is_imported(package):
    package('from manip_sim.models.robots import *\nNAMES = robot_names()\n'
            'class Asking(Panda): pass', {'robot': {'Asking': '{}:Asking'}})
    assert 'Asking' in robots.robot_names()
    assert type(robots.create_robot('Asking')).__name__ == 'Asking'


@pytest.mark.full
@pytest.mark.parametrize('more', [[], ['']], ids=['path', 'working directory too'])
def test_a_damaged_package_is_told_and_hides_no_other(
        package, warnings_of, monkeypatch, tmp_path, more):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'path', [*more, *(entry for entry in sys.path if entry)])
    package('', {'robot': {'Lost': '{}:Lost'}}, damaged='no equals sign')
    package(MODULE.format('Near'), {'robot': {'NearArm': '{}:NearArm'}})
    assert 'NearArm' in robots.robot_names()
    (warning,) = warnings_of()
    assert warning.startswith('cannot read the entry points of ')
    with pytest.raises(UnknownNameError):
        robots.create_robot('Lost')


@pytest.mark.full
def test_another_process_finds_them_without_a_script(package, tmp_path):
    package(MODULE.format('Child'), {'robot': {'ChildArm': '{}:ChildArm'}})
    paths = [str(tmp_path), *filter(None, [os.environ.get('PYTHONPATH')])]
    done = subprocess.run(
        [sys.executable, '-c', 'from manip_sim.models import compose; '
                               'print(compose("ChildArm", "none").robots[0].name)'],
        capture_output=True, text=True, timeout=60,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(paths)})
    assert (done.stdout, done.stderr) == ('ChildArm0\n', '')


SHED = '<mujoco><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>'


@pytest.mark.full
def test_a_gripper_and_an_arena_of_the_page_are_found_beside_their_files(package, tmp_path):
    page = {block.file or block.text: block.text for page in PAGES if page.stem == 'add_your_own'
            for block in blocks(page)}
    (code,) = [text for text in page.values() if 'class Shed' in text]
    (tmp_path / 'tiny_gripper.xml').write_text(
        page['assets/grippers/tiny_gripper/tiny_gripper.xml'])
    (tmp_path / 'shed.xml').write_text(SHED)
    package(code, {'gripper': {'TinyGripper': '{}:TinyGripper'}, 'arena': {'shed': '{}:Shed'}})
    simulation = Simulation(compose('Panda', 'TinyGripper', arena='shed'))
    robot, closed = simulation.robot, []
    for closing in (1.0, -1.0):
        robot.apply(robot.parse.action('right/gripper', [closing]))
        simulation.advance(500)
        closed.append(robot.state().position[-2:])
    np.testing.assert_allclose(closed, [[0.0, 0.0], [0.035, -0.035]], atol=1e-3)
    assert robot.robot_model.grippers['right'].important_geoms['left_fingerpad'] == [
        'gripper0_right_left_pad_collision']


@pytest.mark.parametrize(('kind', 'base'), [
    ('robot', 'UR5e'), ('gripper', 'PandaGripper'), ('base', 'RethinkMount'),
    ('arena', 'TableArena')])
def test_a_constructor_of_another_package_that_raises_is_told(package, kind, base):
    module = package(f"""
from manip_sim.models.{kind}s import {base}

class Broken{base}({base}):
    def __init__(self, idn=0):
        raise OSError('two', 'words')
""" + ("    arena_name = 'broken_arena'" if kind == 'arena' else ''), {
        kind: {'broken_arena' if kind == 'arena' else f'Broken{base}': '{}:Broken' + base}})
    name = 'broken_arena' if kind == 'arena' else f'Broken{base}'
    with pytest.raises(ModelError, match=(
            rf"^{kind} '{name}' of the package {module} 1.2 \(.*\) cannot be created: "
            r'OSError: \[Errno two\] words')):
        compose(**{kind: name})
