# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of hands from files: where they grasp, which way they close, what YAML says of them."""

import re

from files_rig import HAND, write
import mujoco
import numpy as np
import pytest

from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.models import compose, load_gripper, load_robot
from manip_sim.models.files import fingers
from manip_sim.models.files.fingers import control_range, digest_of_meshes
from manip_sim.models.robots import Panda
from manip_sim.simulation import Simulation


def described(tmp_path, yaml, hand=HAND):
    """Return a hand with a YAML file beside it."""
    file = write(tmp_path / 'hand.xml', hand)
    write(tmp_path / 'hand.yaml', yaml)
    return load_gripper(file)


def site_positions(model, names):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return [data.site(name).xpos.copy() for name in names]


def test_a_hand_gets_a_grasp_frame_between_its_fingertips(tmp_path):
    hand = load_gripper(write(tmp_path / 'hand.xml', HAND))
    model = hand.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pads = [data.geom(f'gripper0_{side}_pad').xpos for side in ('left', 'right')]
    np.testing.assert_allclose(data.site('gripper0_grip_site').xpos, np.mean(pads, axis=0),
                               atol=1e-9)
    # It is turned as the mount is, not as the root body of the file.
    np.testing.assert_allclose(hand.rotation_offset, [0.0, 0.0, 0.0, 1.0], atol=1e-9)
    assert hand.name == 'hand0'
    assert hand.important_sensors == {'force_ee': 'gripper0_force_ee',
                                      'torque_ee': 'gripper0_torque_ee'}


def test_a_link_without_shapes_that_is_named_as_the_grasp_is_the_grasp_frame(tmp_path):
    text = HAND.replace('<body name="left_tip"', '<body name="gripper_frame_link" '
                        'pos="0.01 0.02 0.03"/><body name="left_tip"')
    hand = load_gripper(write(tmp_path / 'hand.xml', text))
    assert "grasp frame: body 'gripper_frame_link'" in hand.inferred
    model = hand.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(
        data.site('gripper0_grip_site').xpos, data.body('gripper0_gripper_frame_link').xpos)


@pytest.mark.parametrize(('sites', 'found'), [
    (['tcp'], 'tcp'), (['gripper_mount', 'gripperframe'], 'gripperframe'),
    (['tcp', 'finger_grip', 'pinch_site'], 'pinch_site'),
    (['tcp', 'gripping', 'left_grasp2'], 'left_grasp2')], ids=str)
def test_a_site_that_is_named_as_the_grasp_is_the_grasp_frame(tmp_path, sites, found):
    places = {name: [0.01, 0.02, 0.03 + 0.01 * n] for n, name in enumerate(sites)}
    text = HAND.replace('<body name="left_tip"', ''.join(
        f'<site name="{name}" pos="{x} {y} {z}" euler="0 0 0.4"/>'
        for name, (x, y, z) in places.items()) + '<body name="left_tip"')
    hand = load_gripper(write(tmp_path / 'hand.xml', text))
    assert f"grasp frame: site '{found}'" in hand.inferred
    model = hand.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    palm, grip = data.body('gripper0_palm'), data.site('gripper0_grip_site')
    turn = palm.xmat.reshape(3, 3)
    np.testing.assert_allclose(grip.xpos, palm.xpos + turn @ places[found], atol=1e-9)
    about_z = [[np.cos(0.4), -np.sin(0.4), 0.0], [np.sin(0.4), np.cos(0.4), 0.0], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(grip.xmat.reshape(3, 3), turn @ about_z, atol=1e-9)


def test_a_grasp_frame_is_told_where_nobody_declared_it(tmp_path):
    hand = load_gripper(write(tmp_path / 'hand.xml', HAND))
    (told,) = [said for said in hand.inferred if 'grasp frame' in said]
    place = re.fullmatch(r"grasp frame: the middle of the fingertips, (.*) m in 'palm'", told)
    np.testing.assert_allclose([float(number) for number in place[1].split()], [0.0, 0.0, 0.05])
    hand = described(tmp_path, 'grasp_point: {at: palm, position: [0, 0, 0.2]}')
    assert not any('grasp frame' in said for said in hand.inferred)


def test_closing_is_where_the_fingertips_meet(tmp_path):
    hand = load_gripper(write(tmp_path / 'hand.xml', HAND))
    assert hand.dof == 1
    np.testing.assert_allclose(hand.format_action([1.0]), [-1.0])
    np.testing.assert_allclose(hand.format_action([0.0]), [0.0])
    assert 'closing: pull from 255 to 0' in hand.inferred


def test_a_hand_that_was_loaded_before_is_not_tried_again_and_another_is(tmp_path, monkeypatch):
    file = write(tmp_path / 'hand.xml', HAND)
    closing = load_gripper(file).closing
    steps = []
    monkeypatch.setattr(mujoco, 'mj_step', lambda *given: steps.append(given))
    assert load_gripper(file).closing == closing and not steps
    load_gripper(write(file, HAND.replace('axis="0 1 0"', 'axis="0 2 1"')))
    assert steps


def test_the_other_servos_hold_where_they_start_while_one_is_tried(tmp_path):
    # The second finger starts 0.05 m to the left of the first one, and 0.05 m to its right if its
    # control were 0.
    hand = load_gripper(write(tmp_path / 'hand.xml', """
<mujoco><compiler autolimits="true"/><worldbody><body name="palm">
  <geom name="palm" type="box" size="0.03 0.04 0.01" mass="0.2"/>
  <body name="first_tip" pos="0 0 0.05"><joint name="first" type="slide" axis="0 1 0"
    range="-0.03 0.03"/><geom size="0.005" mass="0.02"/></body>
  <body name="second_tip" pos="0 0.05 0.05"><joint name="second" type="slide" axis="0 1 0"
    range="-0.1 0.01"/><geom size="0.005" mass="0.02"/></body>
  </body></worldbody>
  <actuator><position name="first" joint="first" kp="500" ctrlrange="-0.03 0.03"/>
    <position name="second" joint="second" kp="500" ctrlrange="-0.1 0.01"/></actuator>
  <keyframe><key name="home" qpos="0 -0.1"/></keyframe></mujoco>"""))
    assert any('first from 0.03 to -0.03' in said for said in hand.inferred)


@pytest.mark.parametrize('pose', ['quat="0 1 0 1"', 'euler="1.5708 0 0"', 'quat="0 1 0 0"', ''])
def test_the_fingers_point_away_from_the_arm_however_the_file_lays_the_hand(tmp_path, pose):
    hand = load_gripper(write(tmp_path / 'hand.xml', HAND.replace('quat="0 1 0 1"', pose)))
    (grip,) = site_positions(hand.compile(), ['gripper0_grip_site'])
    np.testing.assert_allclose(grip, [0.0, 0.0, 0.05], atol=1e-6)
    turned = 'mount: turned so that the fingers point along z' in hand.inferred
    assert turned == bool(pose)


FREE = '<freejoint/><geom name="palm"'
FLOATING = """<robot name="r"><link name="world"/>{links}
<joint name="free" type="{kind}"><parent link="{parent}"/><child link="palm"/>
  <origin xyz="0 0 0.4"/></joint>
{fingers}</robot>"""


@pytest.mark.parametrize('how', ['mjcf', 'urdf'])
def test_a_hand_whose_file_lets_it_float_is_carried_by_the_arm(tmp_path, how):
    if how == 'mjcf':
        assert HAND.count('<geom name="palm"') == 1
        files = [write(tmp_path / 'hand.xml', HAND), write(tmp_path / 'free.xml', HAND.replace(
            '<geom name="palm"', FREE))]
    else:
        links = ''.join(
            f'<link name="{name}"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" '
            'izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            for name in ('palm', 'left', 'right'))
        fingers = ''.join(
            f'<joint name="{name}_joint" type="prismatic"><parent link="palm"/><child '
            f'link="{name}"/><origin xyz="{x} 0 0.1"/><axis xyz="1 0 0"/><limit lower="0" '
            'upper="0.03" effort="20" velocity="1"/></joint>'
            for name, x in (('left', 0.03), ('right', -0.06)))
        files = [write(tmp_path / f'{kind}.urdf', FLOATING.format(
            links=links, fingers=fingers, kind=kind, parent='world'))
            for kind in ('fixed', 'floating')]
    hands = [load_gripper(file) for file in files]
    assert ('left out, as the arm carries the hand: the free joint of its root'
            in hands[1].inferred)
    worlds = [compose('UR5e', gripper=str(file)).compile() for file in files]
    assert worlds[0].nv == worlds[1].nv == 6 + hands[0].compile().nv
    (grip,) = site_positions(hands[1].compile(), ['gripper0_grip_site'])
    assert 0.04 < np.linalg.norm(grip) < 0.11


def test_fingers_that_reach_nowhere_tell_no_direction(tmp_path):
    text = HAND.replace('pos="0 0 0.05"', 'pos="0 0 0.01"')
    hand = load_gripper(write(tmp_path / 'hand.xml', text))
    assert not any('mount: turned' in said for said in hand.inferred)


@pytest.mark.parametrize('collides', ['', 'contype="0"', 'conaffinity="0"'])
@pytest.mark.parametrize('pose', ['', 'quat="0 1 0 1"', 'pos="0 0 0.3" quat="0 1 0 0"'])
def test_a_palm_far_behind_its_frame_is_put_in_front_of_the_mount(collides, pose, tmp_path):
    text = HAND.replace('size="0.03 0.04 0.01"',
                        f'size="0.03 0.04 0.045" pos="0 0 -0.045" {collides}')
    hand = load_gripper(write(tmp_path / 'hand.xml', text.replace('quat="0 1 0 1"', pose)))
    model = hand.compile()
    np.testing.assert_allclose(model.body('gripper0_palm').pos, [0.0, 0.0, 0.09], atol=1e-9)
    assert 'mount: 0.090 m along z, so that the palm is in front of it' in hand.inferred


@pytest.mark.parametrize('wrong', [[1.0, 0.0], [np.nan]])
def test_an_action_that_does_not_fit_is_rejected(tmp_path, wrong):
    hand = load_gripper(write(tmp_path / 'hand.xml', HAND))
    with pytest.raises(CommandError, match='an action of FileGripper must'):
        hand.format_action(wrong)


def test_a_finger_that_bends_closes_towards_the_palm(tmp_path):
    fingers = ''.join(f"""<body name="f{i}" pos="0 {0.03 * i} 0.05">
      <joint name="bend{i}" axis="0 {sign} 0" range="{low} {high}" armature="0.01" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.06" size="0.008" mass="0.02"/></body>"""
                      for i, (sign, low, high) in enumerate([(1, -0.1, 1.5), (-1, -1.5, 0.1),
                                                             (1, -0.1, 1.5)]))
    hand = load_gripper(write(tmp_path / 'hand.xml', f"""
<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="palm">
  <geom type="box" size="0.02 0.05 0.04" mass="0.3"/>{fingers}</body></worldbody><actuator>
  {''.join(f'<position joint="bend{i}" kp="5" inheritrange="1"/>' for i in range(3))}
</actuator></mujoco>"""))
    np.testing.assert_allclose(hand.format_action([1.0, 1.0, 1.0]), [1.0, -1.0, 1.0])
    np.testing.assert_allclose(hand.format_action([-1.0, 0.0, 0.5]), [-1.0, 0.0, 0.5])


def test_an_actuator_that_moves_nothing_closes_at_its_upper_end_as_a_guess(tmp_path):
    idle = '<general name="idle" joint="left_finger" gainprm="0" ctrlrange="0 1"/>'
    hand = load_gripper(write(tmp_path / 'hand.xml', HAND.replace(
        '</actuator>', f'{idle}</actuator>')))
    assert any('idle from 0 to 1 (a guess)' in sentence for sentence in hand.inferred)


def test_a_control_range_is_no_longer_than_what_the_joint_can_reach(tmp_path):
    text = HAND.replace('name="pull" tendon="split" ctrlrange="0 255"',
                        'name="pull" joint="left_finger" ctrlrange="-1 1"')
    text = text.replace('gainprm="1.5"', 'gainprm="12750"')
    hand = load_gripper(write(tmp_path / 'hand.xml', text))
    np.testing.assert_allclose(hand.compile().actuator('gripper0_pull').ctrlrange, [0.0, 0.03])
    np.testing.assert_allclose(hand.format_action([1.0]), [-1.0])


def test_a_control_range_that_ends_a_little_beyond_the_joint_presses(tmp_path):
    text = HAND.replace('name="pull" tendon="split" ctrlrange="0 255"',
                        'name="pull" joint="left_finger" ctrlrange="-0.001 0.031"')
    text = text.replace('gainprm="1.5"', 'gainprm="12750"')
    model = load_gripper(write(tmp_path / 'hand.xml', text)).compile()
    np.testing.assert_allclose(model.actuator('gripper0_pull').ctrlrange, [-0.001, 0.031])


@pytest.mark.parametrize(('actuator', 'expected'), [
    # Half a range beyond the joint's is no more than pressing.
    ('<position joint="j" kp="4" ctrlrange="-0.5 1.5"/>', (-0.5, 1.5)),
    ('<position joint="j" kp="4" ctrlrange="-0.51 0.5"/>', (0.0, 0.5)),
    ('<position joint="j" kp="4" ctrlrange="0.5 1.51"/>', (0.5, 1.0)),
    ('<position joint="j" kp="4" ctrlrange="-9 9"/>', (0.0, 1.0)),
    ('<position joint="j" kp="4" ctrlrange="1 9"/>', None),
    ('<position joint="j" kp="0.5"/>', (0.0, 1.0)),
    ('<position joint="j" kp="4" gear="-2"/>', (-2.0, 0.0)),
    ('<general joint="j" gainprm="4" biastype="affine" biasprm="1 -8 0" gear="2"/>',
     (-0.25, 3.75)),
    ('<position joint="endless" kp="4"/>', None),
    ('<position joint="endless" kp="4" ctrlrange="-9 9"/>', (-9.0, 9.0)),
    ('<position joint="j" kp="4" kv="1" ctrlrange="-1 3"/>', (0.0, 1.0)),
    # A motor, a damper and what pushes away from its target are no servos.
    ('<motor joint="j" ctrlrange="-9 9"/>', (-9.0, 9.0)),
    ('<damper joint="j" kv="1" ctrlrange="0 9"/>', (0.0, 9.0)),
    ('<general joint="j" gainprm="4" biastype="affine" biasprm="0 0.5 0"/>', None),
    ('<general joint="j" gainprm="-0.5" biastype="affine" biasprm="0 -4 0"/>', None),
    ('<general joint="j" gaintype="affine" gainprm="4" biastype="affine" biasprm="0 -4"/>', None),
    ('<general joint="j" gainprm="4" forcerange="-8 2"/>', (-2.0, 0.5)),
    ('<general joint="j" gainprm="0.5" forcerange="-8 2"/>', (-16.0, 4.0)),
    ('<general joint="j" gainprm="0" forcerange="-8 2"/>', None),
    ('<general joint="j" gainprm="-4" forcerange="-8 2"/>', None),
    ('<general joint="j" gainprm="4"/>', None),
    ('<position joint="endless" kp="4" forcerange="-8 2"/>', None)])
def test_the_control_range_is_what_limits_an_actuator_first(actuator, expected):
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco><compiler angle="radian"/><worldbody>
  <body><geom size="1"/><joint name="endless"/>
    <body><geom size="1"/><joint name="j" range="0 1"/></body></body></worldbody>
  <actuator><motor joint="endless"/>{actuator}</actuator></mujoco>""")
    assert control_range(model, 1) == (None if expected is None else pytest.approx(expected))


def test_an_actuator_without_any_limit_is_told(tmp_path):
    text = HAND.replace('ctrlrange="0 255" forcerange="-50 50"', '')
    hand = load_gripper(write(tmp_path / 'hand.xml', text))
    assert "actuator 'pull' has no limits: actions are its control" in hand.inferred
    np.testing.assert_allclose(hand.compile().actuator('gripper0_pull').ctrlrange, [-1.0, 1.0])


def test_a_keyframe_is_the_start_of_a_hand(tmp_path):
    text = HAND.replace('</mujoco>', '<keyframe><key name="open" qpos="0.03 0.03" ctrl="255"/>'
                                     '<key name="x" qpos="0 0" ctrl="0"/></keyframe></mujoco>')
    hand = load_gripper(write(tmp_path / 'hand.xml', text))
    np.testing.assert_allclose(hand.init_qpos, [0.03, 0.03])


def test_yaml_says_the_mount_the_grasp_point_the_closing_and_the_start(tmp_path):
    hand = described(tmp_path, """
mount: {position: [0, 0, 0.1], orientation: [0, 0, 1.5707963267948966]}
grasp_point: {at: palm, position: [0, 0, 0.2]}
closing: {pull: [200, 10]}
start: {left_finger: 0.02, right_finger: 0.02}
fingers: {left_fingerpad: [left_pad], right_fingerpad: [right_pad]}
""")
    np.testing.assert_allclose(hand.format_action([1.0]), [2 * 10 / 255 - 1])
    np.testing.assert_allclose(hand.format_action([-1.0]), [2 * 200 / 255 - 1])
    np.testing.assert_allclose(hand.init_qpos, [0.02, 0.02])
    assert hand.important_geoms['left_fingerpad'] == ['gripper0_left_pad']
    model = hand.compile()
    np.testing.assert_allclose(model.body('gripper0_palm').pos, [0.0, 0.0, 0.1])
    np.testing.assert_allclose(model.body('gripper0_palm').quat,
                               [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], atol=1e-9)
    (grip,) = site_positions(model, [hand.important_sites['grip_site']])
    np.testing.assert_allclose(grip, [0.0, 0.0, 0.3], atol=1e-9)


def test_one_number_may_close_all_actuators_together(tmp_path):
    two = HAND.replace('</actuator>', '<position name="also" joint="left_finger" kp="1" '
                                      'ctrlrange="0 0.03"/></actuator>')
    hand = described(tmp_path, 'action: together\nclosing: {pull: [255, 0], also: [0.03, 0]}', two)
    assert hand.dof == 1
    np.testing.assert_allclose(hand.format_action([1.0]), [-1.0, -1.0])
    assert 'closing' not in ' '.join(hand.inferred)


def test_a_grasp_point_of_the_yaml_replaces_the_one_of_the_file(tmp_path):
    text = HAND.replace('<body name="left_tip"',
                        '<body name="eef"><site name="grip_site"/></body><body name="left_tip"')
    assert load_gripper(write(tmp_path / 'hand.xml', text)).important_sites['grip_site'] == (
        'gripper0_grip_site')
    hand = described(tmp_path, 'grasp_point: {at: palm, position: [0.1, 0, 0]}', text)
    palm = hand.compile().body('gripper0_palm')
    (grip,) = site_positions(hand.compile(), [hand.important_sites['grip_site']])
    rotated = np.empty(3)
    mujoco.mju_rotVecQuat(rotated, np.array([0.1, 0.0, 0.0]), palm.quat)
    np.testing.assert_allclose(grip, palm.pos + rotated, atol=1e-9)


@pytest.mark.parametrize(('yaml', 'message'), [
    ('closing: {pul: [0, 1]}', "unknown actuator in 'closing' of .*hand.yaml 'pul': did you mean "
                               "'pull'"),
    ('grasp_point: {at: plam}', "unknown body or site in 'grasp_point' of .*hand.yaml 'plam': did "
                                "you mean 'palm'"),
    ('start: {left_fingr: 0}', "unknown joint in 'start' of .*hand.yaml 'left_fingr': did you mean"
                               " 'left_finger'"),
    ('start: hom', "unknown keyframe of .*hand.xml 'hom'"),
    ('fingers: {left_finger: [pad]}', "unknown geom of hand0 in .*hand.xml 'pad'")])
def test_an_unknown_name_in_the_yaml_is_told_with_file_key_and_nearest(tmp_path, yaml, message):
    with pytest.raises(UnknownNameError, match=message):
        described(tmp_path, yaml)


@pytest.mark.parametrize(('yaml', 'message'), [
    ('closing: {pull: [0, 300]}', "'closing' of actuator 'pull' in .*hand.yaml must be within its "
                                  r'control range of 0 to 255, got \[0, 300\]'),
    ('start: {left_finger: 0.5}', "'start' of joint 'left_finger' in .*hand.yaml must be within 0 "
                                  'to 0.03, got 0.5')])
def test_a_value_outside_a_range_is_told(tmp_path, yaml, message):
    with pytest.raises(ModelError, match=message):
        described(tmp_path, yaml)


def test_a_hand_of_a_file_is_mounted_like_ours(tmp_path):
    robot = Panda()
    robot.add_gripper(load_gripper(write(tmp_path / 'hand.xml', HAND)))
    model = robot.compile()
    assert model.body('gripper0_palm').parentid[0] == model.body('robot0_right_hand').id
    assert model.nu == 8


#: A pawl lets a finger pass that closes towards a thumb, and holds it there.
LATCHED = """<mujoco><compiler angle="radian"/><worldbody><body name="palm" pos="0 0 0.3">
  <geom type="box" size="0.05 0.02 0.01" mass="1"/>
  <geom type="box" size="0.005 0.02 0.05" pos="-0.05 0 0.06" mass="0.1"/>
  <body name="finger" pos="0.05 0 0.01"><joint name="finger" axis="0 -1 0" range="0 1.4"
    limited="true" armature="0.001" damping="0.05"/>
    <geom type="capsule" size="0.005" fromto="0 0 0 0 0 0.08" mass="0.05"/></body>
  <body name="pawl" pos="0 0 {height}"><joint name="pawl" axis="0 1 0" range="0 1.5"
    limited="true" stiffness="0.02" armature="1e-5" damping="0.0005"/>
    <geom type="capsule" size="0.003" fromto="0 0 0 0 0 -0.06" mass="0.005"/></body>
  </body></worldbody><actuator>{actuator}</actuator></mujoco>"""
SERVO = ('<position name="finger" joint="finger" kp="2" kv="0.1" ctrlrange="0 1.4" '
         'forcerange="-1 1"/>')


@pytest.mark.parametrize(('height', 'closed'), [(0.12, 0.7), (0.2, 1.4)])
def test_a_hand_that_locks_itself_closes_only_as_far_as_it_opens_again(tmp_path, height, closed):
    text = LATCHED.format(height=height, actuator=SERVO)
    robot = load_robot(write(tmp_path / 'hand.xml', text))
    assert robot.grippers['right'].closing == {'finger': pytest.approx([0.0, closed])}
    assert (closed == 0.7) == any(note.startswith(
        "right hand: closing of 'finger': other than the ends of its range, from which it does "
        'not open again') for note in robot.inferred)
    simulation = Simulation(compose(robot))
    places = []
    for action in (-1.0, 1.0, -1.0):
        simulation.robot.apply(simulation.robot.parse.action('right/gripper', [action]))
        simulation.advance(1500)
        places.append(float(simulation.robot.state().position[0]))
    assert places == pytest.approx([0.0, closed, 0.0], abs=0.02)


def test_a_closing_that_a_file_declares_is_not_tried(tmp_path):
    file = write(tmp_path / 'hand.xml', LATCHED.format(height=0.12, actuator=SERVO))
    write(tmp_path / 'hand.yaml', 'arms: {right: {hand: {closing: {finger: [0, 1.4]}}}}\n')
    assert load_robot(file).grippers['right'].closing == {'finger': [0.0, 1.4]}


def test_the_tips_of_fingers_in_a_robots_file_are_where_their_visual_shapes_are(tmp_path):
    def finger(side, y):
        return (f'<body name="{side}_finger" pos="0 {y} 0"><joint name="{side}_finger" '
                f'type="slide" axis="0 {-50 * y:g} 0" range="0 0.02"/><geom size="0.005"/>'
                '<geom size="0.004" pos="0 0 0.09" contype="0" conaffinity="0" mass="0"/></body>')

    text = f"""<mujoco><compiler autolimits="true"/><worldbody>
      <body name="base"><geom size="0.05"/>
      <body name="l1" pos="0 0 0.2"><joint name="turn" axis="0 0 1" range="-1 1"/>
      <geom size="0.03"/><body name="l2" pos="0 0 0.2"><joint name="lift" axis="0 1 0"
      range="-1 1"/><geom size="0.03"/>{finger('left', 0.02)}{finger('right', -0.02)}
      </body></body></body></worldbody></mujoco>"""
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    point = robot.described['arms']['right']['hand']['grasp_point']['position']
    np.testing.assert_allclose(point, [0.0, 0.0, 0.09], atol=1e-6)


def test_meshes_of_one_file_in_other_places_have_other_digests():
    def digest(place):
        spec = mujoco.MjSpec()
        mesh = spec.add_mesh(name='tip', refpos=place)
        mesh.uservert = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1]
        return digest_of_meshes(spec)
    assert digest([0, 0, 0]) == digest([0, 0, 0]) != digest([0, 0, 0.1])


@pytest.fixture
def gripping_arm(tmp_path):
    """Return an arm of two joints, the second of which carries two fingers with servos."""
    fingers = ''.join(
        f'<body name="{side}_finger" pos="0 {y} 0"><joint name="{side}_finger" type="slide" '
        f'axis="0 {-50 * y:g} 0" range="0 0.02"/><geom size="0.005" pos="0 0 0.06"/></body>'
        for side, y in (('left', 0.02), ('right', -0.02)))
    return load_robot(write(tmp_path / 'arm.xml', f"""<mujoco><compiler autolimits="true"/>
      <worldbody><body name="base"><geom size="0.05"/>
      <body name="l1" pos="0 0 0.2"><joint name="turn" axis="0 0 1" range="-1 1"/>
      <geom size="0.03"/><body name="palm" pos="0 0 0.2"><joint name="lift" axis="0 1 0"
      range="-1 1"/><geom size="0.03"/>{fingers}</body></body></body></worldbody></mujoco>"""))


def test_a_hand_of_a_robot_closes_within_a_range_that_was_edited(gripping_arm):
    hand = gripping_arm.grippers['right']
    assert hand.closing == {'left_finger': [0.0, 0.02], 'right_finger': [0.0, 0.02]}
    gripping_arm.spec.actuator('left_finger').ctrlrange = [0.0, 0.01]
    gripping_arm.refresh()
    assert hand.closing == {'left_finger': [0.0, 0.01], 'right_finger': [0.0, 0.02]}


@pytest.fixture
def tried(monkeypatch):
    """Return a function that loads a robot and returns the model in which its hand is tried."""
    models = []
    monkeypatch.setattr(fingers, '_known', {})
    trial = fingers.Fingers._trial_model
    monkeypatch.setattr(fingers.Fingers, '_trial_model', lambda hand: (
        models.append(trial(hand)), models[-1])[1])
    return lambda file: (load_robot(file), models[-1])[1]


def test_what_carries_a_hand_keeps_the_mass_of_its_mesh_in_trials(gripping_arm, tried):
    corners = ' '.join(f'{x} {y} {z}' for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1))
    text = gripping_arm.file.read_text().replace(
        '<worldbody>', f'<asset><mesh name="box" vertex="{corners}"/></asset><worldbody>').replace(
        '<geom size="0.03"/><body name="left', '<geom type="mesh" mesh="box"/><body name="hand">'
        '<geom size="0.02"/><body name="left')
    text = text.replace('</body></body></body></worldbody>', '</body>' * 4 + '</worldbody>')
    model = tried(write(gripping_arm.file.with_name('heavy.xml'), text))
    assert model.body('palm').mass[0] == pytest.approx(1.0)


def test_only_the_hand_and_its_carrier_move_in_trials(gripping_arm, tried):
    model = tried(gripping_arm.file)
    assert [model.joint(joint).name for joint in range(model.njnt)] == [
        'lift', 'left_finger', 'right_finger']
    touching = np.flatnonzero(model.geom_contype)
    assert {model.body(body).name for body in model.geom_bodyid[touching]} == {
        'palm', 'left_finger', 'right_finger'}
