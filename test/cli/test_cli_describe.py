# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim describe``: what it tells is what the physics and the node have."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from manip_sim.cli.describe import _servo_type, camera_rows
from manip_sim.interface.topics import PUBLISHED, SUBSCRIBED
from manip_sim.models import compose, load_robot
from manip_sim.models.robots import robot_names
from manip_sim.simulation import Simulation

DATASHEETS = json.loads(
    (Path(__file__).resolve().parents[1] / 'data' / 'datasheets.json').read_text())
PARTS_OF_PANDA = ['arm', 'right', 'right/gripper']


def by_name(rows):
    return {row['name']: row for row in rows}


def test_a_camera_has_a_resolution_where_its_file_says_one():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><camera name="own" resolution="320 240"/><camera name="line" '
        'resolution="320 1"/><camera name="none"/></worldbody></mujoco>')
    assert {row['name']: row['resolution'] for row in camera_rows(model)} == {
        'own': [320, 240], 'line': None, 'none': None}


def test_limits_of_the_panda_are_those_of_its_data_sheet(described):
    joints = by_name(described()['joints'])
    # Franka Emika, Panda: joint limits in position, velocity and torque.
    sheet = [(-2.8973, 2.8973, 2.175, 87), (-1.7628, 1.7628, 2.175, 87),
             (-2.8973, 2.8973, 2.175, 87), (-3.0718, -0.0698, 2.175, 87),
             (-2.8973, 2.8973, 2.61, 12), (-0.0175, 3.7525, 2.61, 12),
             (-2.8973, 2.8973, 2.61, 12)]
    for number, (low, high, velocity, effort) in enumerate(sheet, start=1):
        joint = joints[f'robot0_joint{number}']
        assert joint['position'] == pytest.approx([low, high], abs=1e-3)
        assert joint['velocity'] == pytest.approx(velocity)
        assert joint['effort'] == pytest.approx([-effort, effort])
        assert (joint['part'], joint['type'], joint['unit']) == ('arm', 'hinge', 'rad')
        assert joint['driven_by'] == [f'robot0_torq_j{number}'] and not joint['coupled']
    finger = joints['gripper0_right_finger_joint1']
    assert (finger['part'], finger['type'], finger['unit']) == ('right/gripper', 'slide', 'm')
    assert finger['position'] == [0.0, 0.04] and finger['effort'] == [-70.0, 70.0]


@pytest.mark.parametrize('robot', robot_names())
def test_masses_are_those_of_the_data_sheets_and_add_up(robot, described):
    found = described('--robot', robot)
    models = {model['kind']: model for model in found['models']}
    expected = DATASHEETS['robots'][robot]['mass_kg']
    assert models['robot']['mass_kg'] == pytest.approx(expected, rel=0.1)
    assert sum(model['mass_kg'] for model in found['models']) == pytest.approx(found['mass_kg'])
    frames = [frame['mass_kg'] for frame in found['frames'] if frame['kind'] == 'body']
    assert sum(frames) == pytest.approx(found['mass_kg'])


@pytest.mark.full
@pytest.mark.parametrize('robot', robot_names())
def test_every_robot_is_described_in_numbers_that_json_has(robot, described):
    found = described('--robot', robot)
    simulation = Simulation(compose(robot))
    assert [joint['name'] for joint in found['joints']] == list(simulation.robot.joint_names)
    assert [part['name'] for part in found['parts']] == list(simulation.robot.parts)
    starts = [joint['start'] for joint in found['joints']]
    assert starts == pytest.approx(simulation.robot.state().position)
    assert len(found['actuators']) == simulation.model.nu
    assert found['start_defects'] == []
    for joint in found['joints']:
        assert joint['driven_by'] or joint['coupled'], joint['name']


def test_frames_stand_where_forward_kinematics_puts_them(described):
    frames = by_name(described('--arena', 'table')['frames'])
    world = compose('Panda', arena='table')
    model = world.compile()
    data = mujoco.MjData(model)
    for joint, position in world.init_qpos().items():
        data.joint(joint).qpos = position
    mujoco.mj_kinematics(model, data)
    for name in ('robot0_link3', 'gripper0_right_eef', 'fixed_mount0_pedestal'):
        assert frames[name]['position_m'] == pytest.approx(data.body(name).xpos, abs=1e-9)
        w, x, y, z = data.body(name).xquat
        assert frames[name]['quat_xyzw'] == pytest.approx([x, y, z, w], abs=1e-9)
    site = frames['gripper0_right_grip_site']
    assert site['parent'] == 'gripper0_right_eef' and site['kind'] == 'site'
    assert site['position_m'] == pytest.approx(data.site('gripper0_right_grip_site').xpos)
    rotation = np.empty(9)
    x, y, z, w = site['quat_xyzw']
    mujoco.mju_quat2Mat(rotation, np.array([w, x, y, z]))
    assert rotation == pytest.approx(data.site('gripper0_right_grip_site').xmat, abs=1e-9)
    assert 'gripper0_right_ft_frame' in frames and 'table' not in frames


@pytest.mark.parametrize(('actuator', 'kind'), [
    ('<position joint="j" kp="10"/>', 'position servo'),
    ('<position joint="j" kp="10" kv="1"/>', 'position servo'),
    ('<velocity joint="j" kv="2"/>', 'velocity servo'),
    ('<motor joint="j"/>', 'motor'), ('<muscle joint="j"/>', 'other'),
    ('<general joint="j" biastype="affine"/>', 'other'),
    ('<general joint="j" gainprm="-9" biastype="affine" biasprm="0 -9 -1"/>', 'other'),
    ('<general joint="j" gaintype="affine" biastype="affine" biasprm="0 -1 0"/>', 'other'),
    ('<general joint="j" gaintype="affine"/>', 'other')])
def test_an_actuator_is_called_as_the_element_that_makes_it(actuator, kind):
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="j" range="-1 1" limited="true"/>'
        f'<geom size="1"/></body></worldbody><actuator>{actuator}</actuator></mujoco>')
    assert _servo_type(model, 0) == kind


def test_actuators_tell_what_they_are_in_the_files(described):
    actuators = by_name(described()['actuators'])
    elbow = actuators['robot0_torq_j4']
    assert (elbow['type'], elbow['drives'], elbow['target']) == (
        'position servo', 'joint', 'robot0_joint4')
    assert elbow['control'] == pytest.approx([-3.0718, -0.0698], abs=1e-3)
    assert elbow['force'] == [-87.0, 87.0]


@pytest.mark.parametrize(('actuator', 'kind', 'effort', 'velocity'), [
    ('<motor name="a" joint="joint1" ctrlrange="-30 30"/>', 'motor', [-30.0, 30.0], np.pi),
    ('<motor name="a" joint="joint1"/>', 'motor', None, np.pi),
    ('<velocity name="a" joint="joint1" kv="5" ctrlrange="-2 2"/>', 'velocity servo', None, 2.0),
    ('<position name="a" joint="joint1" kp="50" forcerange="-7 9"/>', 'position servo',
     [-7.0, 9.0], np.pi),
    ('<general name="a" joint="joint1" biastype="affine" biasprm="1 0 0"/>', 'other', None,
     np.pi)])
def test_limits_follow_from_the_kind_of_the_actuator(
        actuator, kind, effort, velocity, here, one_joint_arm, composing):
    composing('describe', one_joint_arm(actuator))
    found = json.loads(here('describe', '--json')[1])
    joint, = found['joints']
    assert found['actuators'][0]['type'] == kind
    assert joint['effort'] == (None if effort is None else pytest.approx(effort))
    assert joint['velocity'] == pytest.approx(velocity)


def test_passive_joints_of_a_linkage_are_told_as_coupled(described):
    joints = by_name(described('--robot', 'UR5e')['joints'])
    passive = joints['gripper0_right_left_inner_finger_joint']
    assert passive['driven_by'] == [] and passive['coupled']
    assert passive['effort'] is None


def test_a_tendon_drives_all_its_joints(fingers_sim):
    made = []
    fingers_sim('<position name="pull" tendon="t" kp="900" kv="9" ctrlrange="0 0.04"/>',
                '<tendon><fixed name="t"><joint joint="left" coef="1"/><joint joint="right" '
                'coef="1"/></fixed></tendon>', coupled=False, before=made.append)
    from manip_sim.cli.describe import actuator_rows
    from manip_sim.models.couplings import actuated_joints
    model = made[0].compile()
    row, = actuator_rows(model, {'gripper0_pull': 'right/gripper'})
    assert (row['drives'], row['target']) == ('tendon', 'gripper0_t')
    assert {model.joint(j).name for j in actuated_joints(model, 0)} == {
        'gripper0_left', 'gripper0_right'}


def test_sensors_and_cameras_tell_where_they_are(described):
    found = described()
    force = by_name(found['sensors'])['gripper0_right_force_ee']
    assert force == {'name': 'gripper0_right_force_ee', 'type': 'force',
                     'of': 'gripper0_right_ft_frame', 'length': 3}
    camera = by_name(found['cameras'])['robot0_eye_in_hand']
    assert camera['body'] == 'robot0_right_hand' and camera['fovy_rad'] == pytest.approx(
        np.radians(75.0))


def test_sensors_of_a_hand_in_the_file_of_the_robot_are_listed_once(described, tmp_path):
    file = tmp_path / 'arm.xml'
    file.write_text("""<mujoco><worldbody><body name="base">
      <geom size="0.05"/>
      <body name="arm" pos="0 0 0.3"><joint name="lift" axis="0 1 0" range="-1 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.03"/>
        <body name="palm" pos="0 0 0.35"><joint name="roll" range="-1 1"/><geom size="0.04"/>
          <body name="jaw" pos="0 0.05 0.02"><joint name="jaw" axis="1 0 0" range="0 1"/>
            <geom type="box" size="0.01 0.01 0.05" pos="0 0 0.05"/></body>
          <body name="thumb" pos="0 -0.05 0.02"><joint name="thumb" axis="1 0 0" range="-1 0"/>
            <geom type="box" size="0.01 0.01 0.05" pos="0 0 0.05"/></body>
        </body></body></body></worldbody>
      <actuator><position joint="lift" kp="100"/><position joint="roll" kp="100"/>
        <position joint="jaw" kp="5"/><position joint="thumb" kp="5"/></actuator></mujoco>""")
    found = described('--robot', file, '--base', 'none')
    names = [row['name'] for row in found['sensors']]
    assert names.count('robot0_right_hand_force_ee') == 1
    assert len(names) == len(set(names))
    model = mujoco.MjModel.from_xml_path(str(file))
    hand = float(model.body('palm').subtreemass[0])
    arm = float(model.body('base').subtreemass[0]) - hand
    assert [(row['kind'], row['arm']) for row in found['models']] == [
        ('robot', None), ('gripper', 'right')]
    assert [row['mass_kg'] for row in found['models']] == pytest.approx([arm, hand])


def test_topics_and_parameters_are_those_of_the_parts(described):
    found = described('--robot', 'PandaOmron')
    topics = {(topic['name'], topic['direction']) for topic in found['topics']}
    assert {('base/cmd_vel', SUBSCRIBED), ('torso/joint_states', PUBLISHED),
            ('right/wrench', PUBLISHED), ('/clock', PUBLISHED)} <= topics
    assert ('base/cmd_vel', SUBSCRIBED) not in {
        (t['name'], t['direction']) for t in described()['topics']}
    assert {action['name'] for action in found['actions']} == {
        *(f'{part}/follow_joint_trajectory' for part in ('arm', 'right', 'base', 'torso')),
        'right/gripper/gripper_cmd', 'right/gripper/parallel_gripper_cmd'}
    parameters = by_name(found['parameters'])
    assert parameters['control_mode.base']['value'] == 'velocity'
    assert parameters['robot']['value'] == 'PandaOmron'
    assert parameters['robot']['default'] == 'Panda'
    assert {service['name'] for service in found['services']} >= {'~/reset', '~/step'}


def test_a_sensor_of_another_package_has_its_topics_with_the_others(package_on_path, described):
    package_on_path('manip_sim.sensors', 'height_sensors', """
from manip_sim.interface.offered_sensors import TopicSource
from manip_sim.interface.topics import PUBLISHED, Topic

class Height(TopicSource):
    topic = Topic('<arm>/height', 'std_msgs/Float64', PUBLISHED, 'of grip_site [m]')
    def write(self, message, simulation):
        message.data = 1.0
""", {'height': 'Height'})
    rows = {row['name']: row['meaning'] for row in described('--robot', 'Baxter')['topics']}
    assert rows['left/height'] == rows['right/height'] == 'of grip_site [m]'


def test_cameras_that_are_chosen_have_topics_and_parameters(described):
    found = described('--cameras', 'birdview',
                      '--cameras', '{name: front, position: [2, 0, 1], width: 320, depth: false}')
    assert 'front' in by_name(found['cameras'])
    topics = by_name(found['topics'])
    assert topics['birdview/depth/image_raw']['type'] == 'sensor_msgs/Image'
    assert topics['front/color/image_raw']['direction'] == PUBLISHED
    assert 'front/depth/image_raw' not in topics
    parameters = by_name(found['parameters'])
    assert parameters['camera.front.width']['value'] == 320
    assert parameters['camera.birdview.width']['value'] == 640
    assert not any(name.startswith(('birdview', '<camera>')) for name in by_name(
        described()['topics']))


def test_a_camera_that_is_not_there_is_told(here):
    code, _, errors = here('describe', '--cameras', 'birdvew')
    assert code == 1
    assert "unknown camera 'birdvew': did you mean 'birdview'" in errors


def test_a_hand_on_each_arm_is_told_with_its_arm(described):
    found = described('--robot', 'Baxter')
    assert [(m['class'], m['arm']) for m in found['models'] if m['kind'] == 'gripper'] == [
        ('RethinkGripper', 'right'), ('RethinkGripper', 'left')]
    arm = by_name(found['parts'])['arm']
    assert arm['consists_of'] == ['right', 'left'] and len(arm['joints']) == 14


def test_tables_hold_what_the_description_has(here):
    code, text, errors = here('describe', '--arena', 'table', '--arena-param', 'cube=true')
    assert (code, errors) == (0, '')
    for title in ('Models', 'Parts', 'Joints', 'Actuators', 'Sensors', 'Frames', 'Cameras',
                  'Objects', 'Topics', 'Services', 'Actions', 'Parameters'):
        assert f'\n{title}' in text
    assert text.startswith('Panda0 in arena table, ')
    row = next(line for line in text.splitlines() if line.startswith('  robot0_joint4'))
    assert row.split() == ['robot0_joint4', 'arm', '-2.618', '-3.072', 'to', '-0.0698', 'rad',
                           '2.175', '-87', 'to', '87', 'robot0_torq_j4']
    topic = next(line for line in text.splitlines() if line.startswith('  arm/joint_command'))
    assert topic.split()[1:3] == ['sensor_msgs/JointState', 'subscribes']
    for part in PARTS_OF_PANDA:
        assert f'\n  {part} ' in text


def test_tables_keep_to_the_width_of_the_terminal(here, monkeypatch):
    monkeypatch.setenv('COLUMNS', '100')
    lines = here('describe', '--robot', 'GR1')[1].splitlines()
    assert max(map(len, lines)) <= 100 and len(lines) > 200


def test_a_start_with_defects_is_pointed_out(here):
    text = here('describe', '--robot', 'UR5e', '--gripper', 'FourierRightHand')[1]
    assert "The start has 17 defects, see 'manip_sim check'" in text


def test_what_was_inferred_of_files_is_listed(here, tmp_path):
    file = tmp_path / 'arm.xml'
    file.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="foot"><geom size="0.1"/>'
        '<body name="arm" pos="0 0 0.2"><joint name="elbow" range="0.4 0.8"/><geom size="0.1"/>'
        '<site name="flange"/></body></body></worldbody>'
        '<actuator><motor name="elbow" joint="elbow"/></actuator></mujoco>')
    _, text, _ = here('describe', '--robot', str(file))
    for sentence in load_robot(file).inferred:
        assert f'  arm0   {sentence}' in text
    assert 'middle of the range for elbow' in text
    assert 'Inferred' not in here('describe', '--robot', 'Panda')[1]


def test_what_was_inferred_of_a_file_is_printed_as_the_yaml_that_is_read(here, rejected, tmp_path):
    file = Path(__file__).resolve().parents[1] / 'data/files/keyframes.xml'
    code, text, errors = here('describe', '--robot', file, '--yaml')
    assert (code, errors) == (0, '')
    assert text.startswith('# Save this as keyframes.yaml beside keyframes.xml')
    assert "right arm ends at site 'attachment_site'" in text
    (tmp_path / 'keyframes.xml').write_text(file.read_text())
    (tmp_path / 'keyframes.yaml').write_text(text)
    robot = load_robot(tmp_path / 'keyframes.xml')
    assert robot.described == load_robot(file).described == yaml.safe_load(text)
    assert 'is for one robot from a file' in rejected('describe', '--yaml')
