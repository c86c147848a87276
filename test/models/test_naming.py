# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of prefixes that the user gives, and of names that would be there twice."""

from catalogue import BASES, equipped, GRIPPERS, ROBOTS
import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import compose_robot
from manip_sim.models.arenas import EmptyArena, TableArena
from manip_sim.models.bases import MountModel
from manip_sim.models.grippers import create_gripper
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.robots import create_robot
from manip_sim.models.world import World

PLATE = '<body name="plate"><geom name="plate" size="0.1"/></body>'


def names_of(model):
    """Return all names of a compiled model but those of the world and the model itself."""
    return [name.decode() for name in model.names.split(b'\0')[1:] if name not in (b'', b'world')]


def prefixed(name, prefix, base='default', gripper='default'):
    """Return a robot whose parts all bear a prefix, mounted after it was given."""
    return compose_robot(name, gripper, base, prefix=prefix)


@pytest.fixture
def mount(mjcf):
    """Return a function that makes a mount from a worldbody and further sections."""
    class Mount(MountModel, registered=False):
        pass

    return lambda worldbody, sections='': Mount(mjcf(worldbody, sections, name='mount'))


@pytest.mark.parametrize('name', ROBOTS)
def test_a_prefix_takes_the_place_of_kinds_and_numbers_in_every_name(name):
    def public(raw):
        for arm in ('right', 'left'):
            raw = raw.replace(f'gripper0_{arm}_', f'left_gripper_{arm}_' if two else
                              'left_gripper_')
        for kind in ('mobilebase0_', 'fixed_mount0_', 'nullbase0_'):
            raw = raw.replace(kind, 'left_base_')
        return raw.replace('robot0_', 'left_')
    robot, plain = prefixed(name, 'left_'), equipped(name)
    two = len(robot.arms) == 2
    model = robot.compile()
    assert names_of(model) == [public(raw) for raw in names_of(plain.compile())]
    assert all(raw.startswith('left_') for raw in names_of(model))
    assert robot.all_joints == [public(joint) for joint in plain.all_joints]
    assert robot.eef_name == {arm: public(body) for arm, body in plain.eef_name.items()}
    assert robot.cameras == [public(camera) for camera in plain.cameras]


def test_names_of_a_prefix_are_those_that_the_documentation_tells():
    robot = prefixed('Panda', 'left_')
    assert robot.joints[0] == 'left_joint1'
    assert robot.grippers['right'].joints[0] == 'left_gripper_finger_joint1'
    assert robot.base.naming_prefix == 'left_base_'
    prefixes = {arm: gripper.naming_prefix for arm, gripper in
                prefixed('Baxter', 'b_').grippers.items()}
    assert prefixes == {'right': 'b_gripper_right_', 'left': 'b_gripper_left_'}


@pytest.mark.parametrize('name', ['PandaOmron', 'GR1'])
def test_the_xml_of_a_robot_with_a_prefix_can_be_read_again(name):
    robot = prefixed(name, 'left_')
    again = mujoco.MjModel.from_xml_string(robot.to_xml())
    assert names_of(again) == names_of(robot.compile())


@pytest.mark.parametrize('name', ['PandaOmron', 'GR1'])
def test_a_prefix_of_keywords_does_not_move_joints_to_another_subsystem(name):
    prefix = 'head_leg_mobile_torso_'
    robot, plain = prefixed(name, prefix), equipped(name)
    for part in ('arm', 'base', 'torso', 'head', 'legs'):
        assert len(robot.joints_of(part)) == len(plain.joints_of(part)), part
        assert all(joint.startswith(prefix) for joint in robot.joints_of(part))
        np.testing.assert_array_equal(
            robot.format_action(part, np.ones(len(robot.actuators_of(part)))),
            plain.format_action(part, np.ones(len(plain.actuators_of(part)))))


def test_a_prefix_may_be_given_and_taken_back_after_mounting():
    robot = equipped('PandaOmron')
    plain = names_of(robot.compile())
    robot.set_naming_prefix('left_')
    assert names_of(robot.compile()) == names_of(prefixed('PandaOmron', 'left_').compile())
    assert robot.torso_joints == ['left_base_joint_torso_height']
    assert 'left_right_hand' in robot.grippers
    assert 'robot0_right_hand' not in robot.grippers
    robot.set_naming_prefix('')
    assert names_of(robot.compile()) == plain


def test_grippers_are_mounted_by_the_public_name_of_the_end_effector():
    robot = create_robot('Baxter', prefix='b_')
    robot.add_gripper(create_gripper('RethinkGripper'), robot.eef_name['left'])
    assert robot.eef_name['left'] == 'b_left_hand'
    assert robot.grippers['b_left_hand'].naming_prefix == 'b_gripper_left_'
    with pytest.raises(ModelError, match=r"Baxter0 'robot0_right_hand': did you mean "
                                         r"'b_right_hand'"):
        robot.add_gripper(create_gripper('RethinkGripper'), 'robot0_right_hand')


def test_two_robots_of_different_prefix_share_a_world():
    world = World([prefixed('Panda', 'left_'), prefixed('Panda', 'right_'), equipped('Panda')])
    model = world.compile()
    assert model.nq == 27
    assert set(world.init_qpos()) == {model.joint(i).name for i in range(27)}


@pytest.mark.parametrize('prefix', [
    'left/', '/left_', ' ', 'left arm_', 'left\n', '1_', '_left', 'links-', 'ł_', 'a' * 65, "'"])
def test_a_prefix_that_names_cannot_begin_with_is_rejected(prefix):
    with pytest.raises(ModelError, match=r'^prefix .* cannot begin the names of joints and '
                                         r'frames: it needs a letter, then at most 63 ') as error:
        create_robot('Panda', prefix=prefix)
    assert '\n' not in str(error.value)
    assert create_robot('Panda', prefix='a' * 64).joints[0] == 'a' * 64 + 'joint1'


def test_a_class_with_a_prefix_of_its_own_cannot_bear_another(mjcf):
    class Stubborn(MujocoXMLModel):
        naming_prefix = 'mine_'

    with pytest.raises(ModelError, match=r"^Stubborn0 cannot have the prefix 'left_': its class "
                                         r"says that it is 'mine_'$"):
        Stubborn(mjcf(PLATE)).set_naming_prefix('left_')
    with pytest.raises(ModelError, match=r"its class says that it is ''$"):
        EmptyArena().set_naming_prefix('left_')


@pytest.mark.parametrize(('kind', 'link', 'sections', 'of_mount'), [
    ('body', '<body name="base_plate"/>', '', ''),
    ('geom', '<geom name="base_plate" size="0.1"/>', '', ''),
    ('site', '<site name="base_mark"/>', '', '<site name="mark"/>'),
    ('default class', '<geom class="base_steel" size="0.1"/>',
     '<default><default class="base_steel"/></default>', 'steel')])
def test_a_name_of_the_robot_that_a_part_would_bring_again_is_rejected(
        robot_class, mjcf, mount, kind, link, sections, of_mount):
    robot = robot_class(mjcf(f'<body name="base"><geom size="0.1"/>{link}</body>', sections))
    steel = of_mount == 'steel'
    geom = '<geom class="steel" size="0.1"/>' if steel else of_mount
    robot.add_base(mount(
        PLATE.replace('</body>', f'{geom}</body>'),
        '<default><default class="steel"/></default>' if steel else ''))
    robot.compile()  # Without a prefix the names are different.
    robot.set_naming_prefix('left_')
    name = {'site': 'left_base_mark', 'default class': 'left_base_steel'}.get(
        kind, 'left_base_plate')
    with pytest.raises(ModelError, match=rf"^{kind} '{name}' already exists, Mount0 cannot "
                                         r'bring another: change the idn or prefix of Mount0, or '
                                         r'the name in its file$'):
        robot.compile()


def test_a_name_of_the_arena_or_the_world_cannot_be_taken(robot_class, mjcf):
    for prefix, rest, arena, message in (
            ('ta', 'ble', TableArena(), "'table' of TableArena0 already exists, from a robot: "
                                        'change the idn or prefix of the robot$'),
            ('wor', 'ld', EmptyArena(), "'world' already exists, Robot0")):
        robot = robot_class(mjcf(f'<body name="{rest}"><geom size="0.1"/></body>'))
        robot.set_naming_prefix(prefix)
        with pytest.raises(ModelError, match=f'^body {message}'):
            World([robot], arena).compile()


@pytest.mark.parametrize('root', ['base', 'manipulator_mount'])
def test_a_robot_with_the_name_that_a_mobile_base_needs_is_rejected(
        robot_class, mjcf, mobile_base, root):
    inner = '<body name="manipulator_mount"/>' if root == 'base' else ''
    robot = robot_class(mjcf(f'<body name="{root}"><geom size="0.1"/>{inner}</body>'))
    robot.add_base(mobile_base)
    with pytest.raises(ModelError, match=r"^Robot0 cannot stand on a mobile base: it has a body "
                                         r"'manipulator_mount' of its own$"):
        robot.compile()


@pytest.mark.full
@pytest.mark.parametrize('name', ROBOTS)
def test_no_part_of_the_catalogue_takes_a_name_of_a_robot_that_has_a_prefix(name):
    for base in BASES:
        prefixed(name, 'p_', base).compose()
    for gripper in GRIPPERS:
        prefixed(name, 'p_', gripper=gripper).compose()
