# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of what a YAML file says of a robot, a base or an arena, and of what it may not say."""

import re

import mujoco
import numpy as np
import pytest

from files_rig import ARM, ARM_WITH_HAND, HAND, TWO_ARMS, write

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import (
    compose, compose_robot, load_arena, load_base, load_gripper, load_robot)
from manip_sim.models.bases import MobileBaseModel, MountModel


def described(tmp_path, yaml, model=ARM):
    """Return a robot with a YAML file beside it."""
    file = write(tmp_path / 'arm.xml', model)
    write(tmp_path / 'arm.yaml', yaml)
    return load_robot(file)


def test_yaml_says_where_the_arm_ends_and_what_is_there_by_default(tmp_path):
    robot = described(tmp_path, """
arms:
  right:
    mount: {at: link3, position: [0, 0, 0.3], orientation: [1, 0, 0, 1]}
    gripper: PandaGripper
    controller: default_panda
base: RethinkMount
controllers: {torso: slow}
""")
    assert robot.default_gripper == {'right': 'PandaGripper'}
    assert robot.default_base == 'RethinkMount'
    assert robot.default_controller_config == {'right': 'default_panda', 'torso': 'slow'}
    hand = robot.compile().body('robot0_right_hand')
    np.testing.assert_allclose(hand.pos, [0.0, 0.0, 0.3])
    np.testing.assert_allclose(hand.quat, [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    whole = compose_robot(robot)
    assert [type(part).__name__ for part in whole.models] == ['RethinkMount', 'PandaGripper']


@pytest.mark.parametrize(('start', 'note'), [
    ('', ['start pose: zero']),
    ('start: {bend: 0.5}', ["start pose of joints that 'start' does not name: zero"]),
    ('start: {turn: 0.1, lift: 0.2, bend: 0.5}', [])])
def test_a_start_that_is_declared_is_not_said_to_be_inferred(tmp_path, start, note):
    without_keyframe = ARM[:ARM.index('<keyframe>')] + '</mujoco>'
    robot = described(tmp_path, start, without_keyframe)
    assert [said for said in robot.inferred if said.startswith('start pose')] == note


@pytest.mark.parametrize(('yaml', 'text'), [
    ('arms: {right: {gripper: small_hand}}', 'the default gripper of arm0: unknown gripper'),
    ('base: small_table', "the default base of arm0: unknown base 'small_table'")])
def test_an_unknown_part_of_a_yaml_is_said_to_be_of_the_robot_and_where_own_parts_are_found(
        tmp_path, yaml, text):
    robot = described(tmp_path, yaml)
    with pytest.raises(ModelError, match=text + '.*found in the folders of MANIP_SIM_PATH'):
        compose_robot(robot)


def test_a_body_that_is_the_mount_needs_no_new_one(tmp_path):
    robot = described(tmp_path, 'arms: {right: {mount: link2}}')
    assert robot.eef_name == {'right': 'robot0_link2'}


def test_a_mount_at_a_site_is_moved_in_the_frame_of_the_site(tmp_path):
    robot = described(tmp_path, 'arms: {right: {mount: {at: attachment_site, '
                                'position: [0.1, 0, 0]}}}')
    model = robot.compile()
    site, hand = model.site('robot0_attachment_site'), model.body('robot0_right_hand')
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.array([0.1, 0.0, 0.0]), site.quat)
    np.testing.assert_allclose(hand.pos, site.pos + turned, atol=1e-12)
    np.testing.assert_allclose(hand.quat, site.quat, atol=1e-12)


def test_yaml_says_start_subsystems_limits_and_place(tmp_path):
    robot = described(tmp_path, """
start: {bend: 0.5}
subsystems: {turn: torso}
velocity_limits: {lift: 1.25}
foot: [0, 0, -0.5]
placement: {table: [-1, 0.1, 0]}
""")
    np.testing.assert_allclose(robot.init_qpos, [0.1, 0.2, 0.5])
    assert robot.torso_joints == ['robot0_turn']
    model = robot.compile()
    assert model.jnt_user[model.joint('robot0_lift').id, 0] == 1.25
    np.testing.assert_allclose(robot.foot_offset, [0.0, 0.0, -0.5])
    world = compose(robot, arena='table')
    np.testing.assert_allclose(world.compile().body('robot0_base').pos, [-1.0, 0.1, 0.5])


def test_yaml_names_a_keyframe(tmp_path):
    text = ARM.replace('<keyframe>', '<keyframe><key name="far" qpos="1 1 1"/>')
    np.testing.assert_allclose(described(tmp_path, 'start: far', text).init_qpos, [1.0, 1.0, 1.0])


def test_yaml_says_of_an_own_hand_where_it_is_or_that_there_is_none(tmp_path):
    robot = described(tmp_path, 'arms: {right: {mount: palm, hand: none}}', ARM_WITH_HAND)
    assert not robot.grippers
    assert robot.joints[-1] == 'robot0_right_finger'
    robot = described(tmp_path, """
arms:
  right:
    hand: {body: palm, closing: {pull: [0, 255]}, grasp_point: {at: palm, position: [0, 0, 0.5]}}
""", ARM_WITH_HAND)
    hand = robot.grippers['right']
    np.testing.assert_allclose(hand.format_action([1.0]), [1.0])
    model = robot.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    grip = data.site(hand.important_sites['grip_site']).xpos
    np.testing.assert_allclose(grip - data.body('robot0_palm').xpos, [0.0, 0.0, 0.5], atol=1e-9)


def test_a_gripper_of_the_yaml_is_mounted_in_place_of_an_own_hand(tmp_path):
    robot = described(tmp_path, 'arms: {right: {gripper: RethinkGripper}}', ARM_WITH_HAND)
    assert robot.own_hands == ('right',)
    assert [gripper.name for gripper in compose_robot(robot).grippers.values()] == [
        'RethinkGripper0_right']
    robot = described(tmp_path, '', ARM_WITH_HAND)
    assert compose_robot(robot).own_hands == ('right',)


def test_yaml_tells_two_arms_apart(tmp_path):
    text = TWO_ARMS.replace('left/', 'one/').replace('right/', 'two/')
    robot = described(tmp_path, 'arms: {left: {mount: one/lower, hand: none}, '
                                'right: {mount: two/lower, hand: none}}', text)
    assert robot.eef_name == {'right': 'robot0_two/lower', 'left': 'robot0_one/lower'}


@pytest.mark.parametrize(('first', 'second'), [('left', 'right'), ('right', 'left')])
def test_what_yaml_says_of_one_arm_is_not_for_the_other(tmp_path, first, second):
    robot = described(tmp_path, f"""
arms:
  {first}: {{mount: {{at: {first}/lower, position: [0, 0, 0.3]}}, hand: none}}
  {second}: {{mount: {second}/lower, hand: none}}
""", TWO_ARMS)
    assert robot.eef_name == {first: f'robot0_{first}_hand', second: f'robot0_{second}/lower'}


def test_the_yaml_may_be_given_instead_of_the_model(tmp_path):
    write(tmp_path / 'models' / 'any.xml', ARM)
    file = write(tmp_path / 'mine.yaml', 'model: models/any.xml\nstart: {turn: -0.5}')
    robot = load_robot(file)
    assert robot.name == 'any0'
    assert robot.init_qpos[0] == -0.5


def test_the_yaml_of_a_folder_counts_for_the_model_it_names(tmp_path):
    model = write(tmp_path / 'arm' / 'model.xml', ARM)
    write(tmp_path / 'arm' / 'robot.yaml', 'start: {turn: -0.5}')
    for path in (tmp_path / 'arm', tmp_path / 'arm' / 'robot.yaml', model):
        assert load_robot(path).init_qpos[0] == -0.5
    other = write(tmp_path / 'arm' / 'other.xml', ARM)
    write(tmp_path / 'arm' / 'robot.yaml', 'model: model.xml\nstart: {turn: -0.5}')
    assert load_robot(other).init_qpos[0] == 0.1


def test_grippers_of_a_yaml_may_be_files_beside_it(tmp_path):
    write(tmp_path / 'hands' / 'hand.xml', HAND)
    robot = described(tmp_path, 'arms: {right: {gripper: hands/hand.xml}}')
    assert robot.default_gripper == {'right': str(tmp_path / 'hands' / 'hand.xml')}
    assert compose_robot(robot).grippers['right'].name == 'hand0_right'


@pytest.mark.parametrize('text', [HAND, re.sub(
    '<geom[^>]*/>', '<inertial pos="0 0 0.01" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>', HAND)],
    ids=['shapes', 'no shapes'])
def test_a_hand_alone_is_fixed_five_centimetres_above_the_floor(tmp_path, text):
    model = compose(str(write(tmp_path / 'hand.xml', text))).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lowest = min([data.geom_xpos[geom, 2] - model.geom_rbound[geom]
                  for geom in range(model.ngeom) if model.geom_bodyid[geom]],
                 default=data.body('robot0_palm').xpos[2])
    assert 0.05 - 1e-3 < lowest < 0.08


@pytest.mark.parametrize(('yaml', 'message'), [
    ('strat: home', "unknown key of .*arm.yaml 'strat': did you mean 'start'?"),
    ('arms: {right: {mout: link3}}', "unknown key of .*arm.yaml, arms.right 'mout': did you mean "
                                     "'mount'?"),
    ('arms: {right: {mount: {att: link3}}}', "arms.right.mount 'att': did you mean 'at'?"),
    ('arms: {right: {hand: {bdy: link3}}}', "arms.right.hand 'bdy': did you mean 'body'?"),
    ('arms: {right: {mount: lnk3}}', "unknown body or site in 'arms.right.mount' of .*arm.yaml "
                                     "'lnk3': did you mean 'link3'"),
    ('arms: {right: {hand: plm}}', "unknown body in 'arms.right.hand' of .*arm.yaml 'plm'"),
    ('arms: {left: {gripper: none}}', "unknown arm in 'arms' of .*arm.yaml 'left'"),
    ('subsystems: {trn: torso}', "unknown joint in 'subsystems' of .*arm.yaml 'trn': did you mean "
                                 "'turn'"),
    ('velocity_limits: {trn: 1}', "unknown joint in 'velocity_limits' of .*arm.yaml 'trn'"),
    ('start: {trn: 1}', "unknown joint in 'start' of .*arm.yaml 'trn': did you mean 'turn'"),
    ('start: hom', "unknown keyframe of .*arm.xml 'hom': did you mean 'home'")])
def test_an_unknown_key_or_name_is_told_with_file_key_and_nearest(tmp_path, yaml, message):
    with pytest.raises(UnknownNameError, match=message) as raised:
        described(tmp_path, yaml)
    assert '\n' not in str(raised.value)


@pytest.mark.parametrize(('yaml', 'message'), [
    ('start: 3', "'start' of .*arm.yaml: input should be .*, got '3'"),
    ('start: {turn: x}', "'start.turn' of .*arm.yaml: input should be a valid number, got 'x'"),
    ('start: {turn: .nan}', "'start.turn' of .*arm.yaml: input should be a finite number"),
    ('start: {turn: 2}', "'start' of joint 'turn' in .*arm.yaml must be within -1.5 to 1.5, got"),
    ('foot: [1, 2]', "'foot' of .*arm.yaml: list should have at least 3 items"),
    ('foot: [1, 2, true]', "'foot.2' of .*arm.yaml: input should be a valid number, got 'True'"),
    ('velocity_limits: {turn: 0}', "'velocity_limits.turn' of .*: input should be greater than 0"),
    ('subsystems: {turn: arms}', "'subsystems.turn' of .*arm.yaml: input should be 'arm', 'base'"),
    ('arms: {middle: {}}', "'arms.middle' of .*arm.yaml: input should be 'right' or 'left'"),
    ('arms: {right: {mount: {at: link3, orientation: [0, 0, 0, 0]}}}', 'must not be zero'),
    ('arms: {right: {mount: {position: [0, 0, 1]}}}', "'arms.right.mount' of .* must say 'at'"),
    ('arms: {left: {mount: link3}}', "the only arm is called 'right', but 'arms' of .* 'left'"),
    ('- a', r"arm.yaml must hold keys and values, got \['a'\]"),
    ('arms: &x [1]\nstart: *x', 'is invalid or unsafe YAML: anchors and aliases are not read'),
    ('base: a\nbase: b', "is invalid or unsafe YAML: 'base' appears twice, again in line 2"),
    ('!!python/object/apply:os.system ["false"]', 'arm.yaml is invalid or unsafe YAML: '
                                                  'tags are not read, found one in line 1'),
    ('{', 'arm.yaml is invalid or unsafe YAML'),
    ('[' * 3000, 'arm.yaml is invalid or unsafe YAML: it is nested too deeply'),
    ('model: other.xml', "'model' of .*arm.yaml: no such file: .*other.xml"),
    (f'model: {"a/" * 2000}o.xml', "'model' of .*arm.yaml: no such file: ")])
def test_yaml_that_cannot_be_used_is_told_in_one_line(tmp_path, yaml, message):
    with pytest.raises(ModelError, match=message) as raised:
        described(tmp_path, yaml)
    assert '\n' not in str(raised.value)
    assert len(str(raised.value)) < 500


def test_a_yaml_file_that_is_too_long_is_not_read(tmp_path):
    with pytest.raises(ModelError, match='arm.yaml is larger than 1000000 bytes'):
        described(tmp_path, '#' * 1_000_001)


def test_a_file_that_is_missing_or_nothing_we_know_is_told(tmp_path):
    with pytest.raises(ModelError, match='no such file: .*none.xml'):
        load_robot(tmp_path / 'none.xml')
    with pytest.raises(ModelError, match='robot.txt is neither a model .* nor a description'):
        load_robot(write(tmp_path / 'robot.txt', ''))
    with pytest.raises(ModelError, match="any.yaml must say which 'model' it describes"):
        load_robot(write(tmp_path / 'any.yaml', 'base: none'))
    write(tmp_path / 'one' / 'arm.xml', ARM)
    for name in ('any.yaml', 'zebra.yaml'):
        with pytest.raises(ModelError, match=f"{name} must say which 'model' it describes"):
            load_robot(write(tmp_path / 'one' / name, 'base: none'))
    write(tmp_path / 'two' / 'a.xml', ARM)
    write(tmp_path / 'two' / 'b.xml', ARM)
    with pytest.raises(ModelError, match='two has neither robot.yaml nor two.xml nor one model '
                                         'alone, but a.xml, b.xml'):
        load_robot(tmp_path / 'two')


def test_the_scene_of_a_folder_is_not_its_model(tmp_path):
    write(tmp_path / 'acme_arm' / 'arm.xml', ARM)
    write(tmp_path / 'acme_arm' / 'scene.xml',
          '<mujoco><include file="arm.xml"/><worldbody><light pos="0 0 2"/></worldbody></mujoco>')
    assert load_robot(tmp_path / 'acme_arm').file == tmp_path / 'acme_arm' / 'arm.xml'
    (tmp_path / 'acme_arm' / 'arm.xml').rename(tmp_path / 'arm.xml')
    scene = write(tmp_path / 'acme_arm' / 'scene.xml', ARM)
    assert load_robot(tmp_path / 'acme_arm').file == scene


@pytest.mark.parametrize(('path', 'message'), [
    ('/' + 'a' * 5000, 'cannot read /aaa.*: File name too long'),
    ('~nobody_of_that_name/x.xml', 'cannot read ~nobody_of_that_name/x.xml: .*home'),
    ('a\nb.xml', r'no such file: a\\nb.xml')])
def test_a_path_that_cannot_be_looked_at_is_told_in_one_line(path, message):
    with pytest.raises(ModelError, match=message) as raised:
        load_robot(path)
    assert '\n' not in str(raised.value) and len(str(raised.value)) < 300


def test_a_yaml_file_that_cannot_be_decoded_is_told(tmp_path):
    file = write(tmp_path / 'arm.xml', ARM)
    (tmp_path / 'arm.yaml').write_bytes(b'base: \xff\xfe')
    with pytest.raises(ModelError, match='arm.yaml is invalid or unsafe YAML'):
        load_robot(file)


MOUNT = """<mujoco><worldbody><body name="stand">
  <geom type="cylinder" size="0.1 0.2" pos="0 0 0.2"/></body></worldbody></mujoco>"""
CART = """<mujoco><worldbody><body name="chassis">
  <joint name="mobile_x" type="slide" axis="1 0 0"/>
  <geom type="box" size="0.2 0.2 0.1" pos="0 0 0.1"/><body name="deck" pos="0 0 0.2"/></body>
  </worldbody><actuator><velocity joint="mobile_x" kv="1000"/></actuator></mujoco>"""


def test_a_mount_of_a_file_carries_the_robot_on_its_highest_point(tmp_path):
    base = load_base(write(tmp_path / 'stand.xml', MOUNT))
    assert isinstance(base, MountModel)
    model = compose(write(tmp_path / 'arm.xml', ARM), 'none', base).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.body('fixed_mount0_stand').xpos[2] == pytest.approx(0.0)
    # The file's root is 20 mm above what the arm stands on.
    assert data.body('robot0_base').xpos[2] == pytest.approx(0.42)
    write(tmp_path / 'stand.yaml', 'top: [0, 0, 0.3]')
    np.testing.assert_allclose(load_base(tmp_path / 'stand.xml').top_offset, [0.0, 0.0, 0.3])


def test_a_mount_whose_root_is_above_its_floor_carries_the_robot_on_its_highest_point(tmp_path):
    text = MOUNT.replace('name="stand"', 'name="stand" pos="0 0 0.1"')
    base = load_base(write(tmp_path / 'stand.xml', text.replace('0 0 0.2"', '0 0 0.1"')))
    np.testing.assert_allclose(base.top_offset, [0.0, 0.0, 0.3])


@pytest.mark.parametrize('height', [0.25, 0.6])
def test_a_mount_that_is_not_on_a_floor_carries_the_robot_at_its_origin(tmp_path, height):
    base = load_base(write(tmp_path / 'stand.xml', MOUNT.replace('0 0 0.2"', f'0 0 {height}"')))
    np.testing.assert_array_equal(base.top_offset, [0.0, 0.0, 0.0])
    assert not any('stands on' in sentence for sentence in base.inferred)


def test_a_base_with_one_end_carries_the_robot_there(tmp_path):
    cart = CART.replace('<body name="deck" pos="0 0 0.2"/>', '<body name="lift" pos="0 0 0.2">'
                        '<joint name="rise" type="slide"/><geom size="0.1"/></body>')
    base = load_base(write(tmp_path / 'cart.xml', cart.replace(
        '</actuator>', '<position joint="rise" kp="100"/></actuator>')))
    assert base.inferred[-1] == "the robot stands on body 'lift'"


def test_a_base_with_joints_carries_the_robot_on_the_body_that_is_said(tmp_path):
    write(tmp_path / 'cart.yaml', 'support: deck')
    base = load_base(write(tmp_path / 'cart.xml', CART))
    assert isinstance(base, MobileBaseModel)
    robot = compose_robot(write(tmp_path / 'arm.xml', ARM), 'none', base)
    assert robot.base_joints == ['mobilebase0_mobile_x']
    model = robot.compile()
    assert model.body(model.body('robot0_link1').parentid[0]).name == 'robot0_manipulator_mount'
    mount = model.body('robot0_manipulator_mount')
    assert model.body(mount.parentid[0]).name == 'mobilebase0_deck'
    write(tmp_path / 'plain.yaml', 'support: deck')
    plain = load_base(write(tmp_path / 'plain.xml', CART.replace('mobile_x', 'joint_x')))
    assert compose_robot('Panda', 'none', plain).base_joints == ['mobilebase0_joint_x']
    write(tmp_path / 'cart.yaml', 'support: dek')
    with pytest.raises(UnknownNameError, match="unknown body in 'support' of .*cart.yaml 'dek': "
                                               "did you mean 'deck'"):
        load_base(tmp_path / 'cart.xml')


def test_an_arena_of_a_file_is_a_world_to_stand_in(tmp_path):
    file = write(tmp_path / 'hall.xml', """
<mujoco><worldbody><geom name="floor" type="plane" size="5 5 0.1"/>
  <body name="block" pos="1 0 0.1"><freejoint/><geom size="0.05"/></body></worldbody>
  <keyframe><key qpos="1 0 0.3 1 0 0 0"/></keyframe></mujoco>""")
    write(tmp_path / 'hall.yaml', 'robot_position: [0.5, 0, 0]')
    arena = load_arena(file)
    assert arena.arena_name == 'hall' and arena.inferred == [
        'left out: 1 keyframe without a name']
    model = compose(write(tmp_path / 'arm.xml', ARM), arena=arena).compile()
    np.testing.assert_allclose(model.body('robot0_base').pos, [0.5, 0.0, 0.02])
    assert model.body('block').pos[0] == 1.0


def test_robots_stand_in_the_middle_of_an_arena_that_does_not_say_where(tmp_path):
    hall = '<mujoco><worldbody><geom type="plane" size="5 5 0.1"/></worldbody></mujoco>'
    arena = load_arena(write(tmp_path / 'hall.xml', hall))
    robot = load_robot(write(tmp_path / 'arm.xml', ARM))
    np.testing.assert_array_equal(arena.robot_position(robot), [0.0, 0.0, 0.0])


def test_files_of_other_packages_are_robots_hands_and_worlds_by_path(tmp_path):
    arm = write(tmp_path / 'arm.xml', ARM)
    hand = write(tmp_path / 'hand.xml', HAND)
    world = compose(str(arm), str(hand), str(write(tmp_path / 'stand.xml', MOUNT)), idn=3)
    robot = world.robots[0]
    assert robot.naming_prefix == 'robot3_'
    assert robot.grippers['right'].naming_prefix == 'gripper3_right_'
    assert robot.base.naming_prefix == 'fixed_mount3_'
    assert isinstance(load_gripper(hand), type(robot.grippers['right']))
