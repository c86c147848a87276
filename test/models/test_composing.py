# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the one place that composes robot, gripper, base and arena."""

import inspect
from pathlib import Path

import numpy as np
import pytest

from manip_sim.errors import KindError, ManipSimError, ModelError, UnknownNameError
from manip_sim.models import compose, compose_robot, World
from manip_sim.models.arenas import create_arena, TableArena
from manip_sim.models.bases import create_base, NullMount
from manip_sim.models.grippers import create_gripper, PandaGripper
from manip_sim.models.robots import Baxter, create_robot, Panda


def test_default_is_what_the_robot_says():
    robot = compose_robot('Baxter', idn=3)
    assert type(robot.base).__name__ == robot.default_base
    assert {arm: type(g).__name__ for arm, g in robot.grippers.items()} == robot.default_gripper
    assert robot.grippers['left'].naming_prefix == 'gripper3_left_'


@pytest.mark.parametrize(('what', 'value'), [
    ('default_gripper', 'PandaGripper'), ('default_gripper', None), ('base_xpos_offset', None)])
def test_what_a_class_declares_in_place_of_a_mapping_is_told(one_joint_arm, what, value):
    arm = one_joint_arm()
    setattr(type(arm), what, value)
    with pytest.raises(ModelError, match=rf'^{what} of Arm0 must be a mapping, such as \{{.*\}}, '
                                         rf'got {value!r}$'):
        compose(arm).compile()


_KINDS = [None, True, 5, -1.5, float('nan'), 1j, 'x', b'x', [], [1], ['a'], [None], (1, 2), {},
          {'a': 1}, {1: 2}, {'right': 5}, [{'name': 5}], object(), Panda, Path('missing'),
          np.zeros(2), range(2), {1}, np.zeros(0), np.array(5), np.array('x'), np.float32('nan'),
          'a\0b', '\ud800', Path('a\0b'), 10**30, 10**300, 10**400, [[]], {('a',): 1}]


@pytest.mark.parametrize(('make', 'keyword'), [
    *((compose, keyword) for keyword in inspect.signature(compose).parameters),
    *((World, keyword) for keyword in inspect.signature(World).parameters)])
def test_a_value_of_any_kind_is_taken_or_rejected_with_an_error_of_the_package(make, keyword):
    needed = {'robots': [compose_robot('SO101')]} if make is World else {'robot': 'SO101'}
    rejected = 0
    for value in _KINDS:
        try:
            make(**{**needed, keyword: value}).compile()
        except ManipSimError as error:
            rejected += 1
            assert '\n' not in str(error)
    assert rejected


@pytest.mark.parametrize('create', [create_robot, create_gripper, create_base, create_arena])
def test_a_part_of_any_kind_is_created_or_rejected_with_an_error_of_the_package(create):
    name = {create_robot: 'SO101', create_gripper: 'PandaGripper', create_base: 'NullMount',
            create_arena: 'table'}[create]
    keywords = ['name', *({'idn', 'prefix', 'table_height'} & {
        *inspect.signature(create).parameters, *(['table_height'] * (create is create_arena))})]
    for keyword in keywords:
        rejected = 0
        for value in _KINDS:
            try:
                create(**{'name': name, keyword: value})
            except ManipSimError:
                rejected += 1
        assert rejected, keyword


@pytest.mark.parametrize('flag', [np.True_, np.False_])
def test_numbers_of_numpy_are_taken_where_those_of_python_are(flag):
    world = compose('SO101', idn=np.int64(3), gravity_compensation=flag,
                    timestep_s=np.float32(0.0078125), seed=np.uint8(7))
    assert world.gravity_compensation is bool(flag)
    assert world.compile().opt.timestep == 0.0078125
    assert world.robots[0].naming_prefix == 'robot3_'


@pytest.mark.parametrize(('keywords', 'message'), [
    ({'robot': 5}, 'robot must be a name, a file or a RobotModel, got 5'),
    ({'gripper': {'right': 5}}, 'gripper must be a name, a file, a gripper, None or a mapping of '
                                'these by arm, got 5'),
    ({'base': ['x']}, r"base must be a name, a file, a base or None, got \['x'\]"),
    ({'arena': 5}, 'arena must be a name, a file or an Arena, got 5'),
    ({'cameras': 5}, 'cameras must be a list, got 5'),
    ({'objects': 'cube'}, "objects must be a list, got 'cube'"),
    ({'randomization': [1]}, r'randomization must be a mapping or a YAML file, got \[1\]'),
    ({'timestep_s': '0.002'}, "a timestep must be a number, got '0.002'"),
    ({'idn': None}, 'idn must be a number or a word, got None')])
def test_an_error_about_a_kind_says_what_it_should_be(keywords, message):
    with pytest.raises(KindError, match=f'^{message}$'):
        compose(**keywords)


@pytest.mark.parametrize('nothing', ['none', None])
def test_nothing_is_mounted_where_nothing_is_wanted(nothing):
    robot = compose_robot('Panda', nothing, nothing)
    assert robot.models == []


def test_grippers_may_differ_by_arm():
    robot = compose_robot('Baxter', {'right': 'PandaGripper', 'left': 'none'})
    assert list(robot.grippers) == ['right']
    assert isinstance(robot.grippers['right'], PandaGripper)


def test_an_arm_that_is_not_named_has_its_own_gripper():
    body = Baxter().eef_name['left']
    robot = compose_robot('Baxter', {body: 'PandaGripper'})
    assert {arm: type(g).__name__ for arm, g in robot.grippers.items()} == {
        'right': 'RethinkGripper', 'left': 'PandaGripper'}


@pytest.mark.parametrize('text', ['{right: none, left: PandaGripper}',
                                  ' {"left": PandaGripper,\n "right": none}'])
def test_a_text_tells_grippers_by_arm(text):
    robot = compose_robot('Baxter', text)
    assert {arm: type(g).__name__ for arm, g in robot.grippers.items()} == {'left': 'PandaGripper'}


@pytest.mark.parametrize(('text', 'what'), [
    ('{right: none, left: 3}', "the gripper of arm 'left' must be a name or a file, got 3"),
    ('{right: null}', "the gripper of arm 'right' must be a name or a file, got None"),
    ('{right: a, right: b}', "'right' appears twice"),
    ('{right: !!python/name:os.system }', 'gripper is invalid or unsafe YAML'),
    ('{right: PandaGripper', 'gripper is invalid or unsafe YAML'),
    ('{right: PandaGriper}', "unknown gripper 'PandaGriper': did you mean 'PandaGripper'"),
    ('{middle: PandaGripper}', "unknown arm of Baxter0 'middle': .*available: right, left")])
def test_a_text_of_grippers_by_arm_is_read_strictly(text, what):
    with pytest.raises(ModelError, match=what):
        compose_robot('Baxter', text)


def test_an_unknown_arm_is_told():
    with pytest.raises(UnknownNameError, match="unknown arm of Panda0 'left'"):
        compose_robot('Panda', {'left': 'PandaGripper'})


def test_objects_are_used_as_they_are():
    robot, gripper, base = Panda(), PandaGripper(), NullMount()
    world = compose(robot, gripper, base, TableArena(table_height_m=0.5))
    assert world.robots == [robot]
    assert robot.grippers['right'] is gripper
    assert robot.base is base
    assert world.compile().body('table').pos[2] < 0.5


def test_one_gripper_for_two_arms_is_copied():
    robot = compose_robot(Baxter(), PandaGripper())
    assert list(robot.grippers) == ['right', 'left']


def test_place_and_prefix_are_given_to_the_robot():
    world = compose(Panda(), prefix='left_', position=(1.0, 2.0, 0.0),
                    orientation=(0.0, 0.0, np.pi / 2.0))
    model = world.compile()
    body = model.body('left_base')
    np.testing.assert_allclose(body.pos[:2], [1.0, 2.0])
    np.testing.assert_allclose(body.quat, [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], atol=1e-9)


def test_parameters_of_the_arena_go_with_its_name():
    assert compose(arena='table', cube=True).compile().body('cube').mass[0] == pytest.approx(0.1)
    with pytest.raises(ModelError, match='parameters are for an arena that is given by name'):
        compose(arena=TableArena(), cube=True)
