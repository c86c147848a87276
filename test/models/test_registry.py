# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of finding robots, grippers, bases and arenas by name; parametrised over all there are."""

import re

import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import arenas, bases, grippers, robots
from manip_sim.models.arenas import TableArena
from manip_sim.models.files import FileMobileBase, FileMount
from manip_sim.models.files.file_gripper import BuiltInGripper, FileGripper
from manip_sim.models.files.file_robot import FileManipulator, FileRobot
from manip_sim.models.registry import Registry
from manip_sim.models.robots import Panda

CATALOGUES = {
    'robot': (robots.robot_names, robots.create_robot, robots),
    'gripper': (grippers.gripper_names, grippers.create_gripper, grippers),
    'base': (bases.base_names, bases.create_base, bases)}
ALL = [(kind, name) for kind, (names, _, _) in CATALOGUES.items() for name in names()]


@pytest.mark.parametrize(('kind', 'name'), ALL)
def test_every_name_creates_a_model_of_that_class(kind, name):
    _, create, module = CATALOGUES[kind]
    model = create(name, idn=4)
    assert type(model) is getattr(module, name)
    assert model.name == f'{name}4'
    assert '4_' in model.naming_prefix


@pytest.mark.parametrize(('kind', 'name'), ALL)
def test_a_model_without_a_number_has_number_zero(kind, name):
    _, create, module = CATALOGUES[kind]
    model, numbered = getattr(module, name)(), create(name, idn=0)
    assert model.name == numbered.name == f'{name}0'
    assert model.naming_prefix == numbered.naming_prefix
    assert create(name).name == f'{name}0'


@pytest.mark.parametrize(('kind', 'name', 'nearest'), [
    ('robot', 'panda', "'Panda'"), ('robot', 'Ur5', "'UR5e'"),
    ('gripper', 'PandaGriper', "'PandaGripper'"), ('base', 'RethinkMont', "'RethinkMount'")])
def test_unknown_name_tells_the_nearest_and_all(kind, name, nearest):
    names, create, _ = CATALOGUES[kind]
    with pytest.raises(UnknownNameError) as error:
        create(name)
    message = str(error.value)
    assert message.startswith(f"unknown {kind} '{name}': did you mean ")
    assert nearest in message
    listed, more = re.search(r'available: (.*?)(?:, \.\.\. and (\d+) more)?$', message).groups()
    shown = listed.split(', ')
    assert shown == names()[:len(shown)]
    assert int(more or 0) == len(names()) - len(shown)
    assert error.value.available == names()
    assert isinstance(error.value, KeyError)
    assert isinstance(error.value, ValueError)


def test_name_far_from_all_gives_no_hint():
    with pytest.raises(UnknownNameError, match=r"^unknown robot 'xyzzy': available: "):
        robots.create_robot('xyzzy')


def test_abstract_classes_and_variants_are_not_offered():
    assert {'ManipulatorModel', 'RobotModel', 'CatalogueRobot'}.isdisjoint(robots.robot_names())
    assert {'GripperModel', 'CatalogueGripper'}.isdisjoint(grippers.gripper_names())
    assert {'MountModel', 'MobileBaseModel', 'RobotBaseModel'}.isdisjoint(bases.base_names())


@pytest.mark.parametrize(('kind', 'cls'), [
    ('robot', FileRobot), ('robot', FileManipulator), ('gripper', FileGripper),
    ('gripper', BuiltInGripper), ('base', FileMount), ('base', FileMobileBase)])
def test_classes_that_models_from_files_are_made_of_have_no_name_in_a_catalogue(kind, cls):
    _, create, _ = CATALOGUES[kind]
    with pytest.raises(UnknownNameError, match=f"^unknown {kind} '{cls.__name__}': "):
        create(cls.__name__)


@pytest.mark.parametrize('module', [robots, grippers, bases])
def test_missing_attribute_of_a_catalogue_is_an_attribute_error(module):
    with pytest.raises(AttributeError, match=rf"^module '{module.__name__}' has no attribute "
                                             r"'Nothing'$"):
        module.Nothing  # noqa: B018


def test_class_that_a_user_defines_can_be_created_by_name(robot_class):
    class MyRobot(robot_class):
        def __init__(self, idn=0):
            self.idn = idn

    assert 'MyRobot' in robots.robot_names()
    assert robots.create_robot('MyRobot', idn=2).idn == 2


def test_only_what_its_name_suffices_for_is_listed(robot_class, arm_class, gripper_class):
    class _Hidden(Panda):
        pass

    class ByFile(Panda):
        def __init__(self, fname, idn=0):
            super().__init__(idn)

    class WithoutNumber(Panda):
        def __init__(self):
            super().__init__()

    class WithChoice(Panda):
        def __init__(self, idn=0, tool='none'):
            super().__init__(idn)

    names = robots.robot_names()
    assert {'_Hidden', 'ByFile', 'WithoutNumber', 'Robot', 'Arm'}.isdisjoint(names)
    assert 'WithChoice' in names
    assert 'MyGripper' not in grippers.gripper_names()


def test_class_that_needs_more_than_a_name_says_what(arm_class):
    with pytest.raises(ModelError, match=r"^robot 'Arm' cannot be created by its name: its "
                                         r'constructor must take idn, and have defaults for all '
                                         r"else \(missing a required argument: 'fname'\)$"):
        robots.create_robot('Arm')
    with pytest.raises(AttributeError, match=r"^module 'manip_sim.models.robots' has no 'Arm': "):
        robots.Arm  # noqa: B018


@pytest.mark.parametrize('module', [robots, grippers, bases])
def test_every_shipped_class_is_an_export_with_its_own_type(module):
    (names,) = (function for name, function in vars(module).items() if name.endswith('_names'))
    shipped = {name for name in names()
               if getattr(module, name).__module__.startswith('manip_sim.')}
    assert shipped <= set(module.__all__) & set(vars(module))


def test_later_class_of_a_name_replaces_the_earlier_one():
    registry = Registry('thing', object, takes=())
    first, second = type('Thing', (), {}), type('Thing', (), {})
    registry.register(first)
    registry.register(second)
    assert registry.names() == ['Thing']
    assert registry.get('Thing') is second


def test_empty_registry_says_so():
    with pytest.raises(UnknownNameError, match=r"^unknown thing 'a': available: none$"):
        Registry('thing', object).get('a')


@pytest.mark.parametrize('name', arenas.arena_names())
def test_every_arena_is_created_by_its_name(name):
    arena = arenas.create_arena(name)
    assert arena.arena_name == name
    assert arena.compile().ngeom > 0


def test_unknown_arena_tells_the_nearest():
    with pytest.raises(UnknownNameError, match=r"^unknown arena 'tabel': did you mean 'table'\? "
                                               r'available: .*empty, .*table'):
        arenas.create_arena('tabel')


def test_parameters_of_an_arena_are_passed_on():
    assert arenas.create_arena('table', table_length_m=1.1).table_length_m == 1.1


def test_unknown_parameter_of_an_arena_tells_the_nearest():
    with pytest.raises(UnknownNameError, match=r"^unknown parameter of the arena table "
                                               r"'table_heigth_m': did you mean 'table_height'"):
        arenas.create_arena('table', table_heigth_m=1.1)


def test_arena_that_inherits_its_name_replaces_none():
    class LongTable(TableArena):
        pass

    class Bench(TableArena):
        arena_name = 'bench'

        def __init__(self, length_m):
            super().__init__(length_m)

    assert type(arenas.create_arena('table')) is TableArena
    assert {'LongTable', 'bench'}.isdisjoint(arenas.arena_names())
