# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim check``: compositions and files, and what it says to write."""

from pathlib import Path

import pytest

from test_cli_list import NAMES

from manip_sim.cli.check import differences
from manip_sim.models import compose

LINK = """<body name="root"><geom size="0.05"/><body name="link" pos="0.3 0 0">
    <joint name="a" axis="0 1 0" range="-2 2"/><geom size="0.05" mass="1"/>{}</body></body>"""
SERVO = '<actuator><position name="s" joint="a" kp="900" kv="20" forcerange="-50 50"/></actuator>'


@pytest.mark.full
@pytest.mark.parametrize(('robot', 'arena'), [  # All pairs are checked in test_start_defects.py.
    *((robot, 'table') for robot in NAMES['robots']()),
    *(('Panda', arena) for arena in NAMES['arenas']() if arena != 'table')])
def test_nothing_is_wrong_with_a_robot_of_the_catalogue(robot, arena, here):
    code, text, errors = here('check', '--robot', robot, '--arena', arena)
    assert (code, errors) == (0, '')
    assert text == f'{robot}0 in arena {arena}: nothing is wrong with the start\n'


def test_each_defect_of_a_composition_comes_with_what_mends_it(here):
    code, text, errors = here('check', '--gripper', 'FourierRightHand')
    lines = text.splitlines()
    assert (code, errors) == (1, '')
    assert lines[0] == 'Panda0 in arena empty: 20 defects'
    assert lines[1].startswith("- geom 'gripper0_right_R_middle_proximal_link_col' of body")
    assert '47.4 mm inside' in lines[1]
    assert lines[2].startswith('  fix: start in another pose')
    assert len(lines) == 1 + 2 * 20 + 1
    assert lines[-1] == ('Names in the files lack the prefixes robot0_, fixed_mount0_, '
                         'gripper0_right_.')


def test_a_robot_without_names_is_checked_too(here, mjcf):
    file = mjcf('<geom type="plane" size="1 1 0.1"/><body><geom size="0.01"/>'
                '<body pos="0 0.5 0.04"><joint name="a" axis="0 1 0" range="-2 2"/>'
                '<geom size="0.05" mass="1"/></body></body>', SERVO)
    code, text, errors = here('check', file)
    assert (code, errors) == (1, '')
    assert '10.0 mm inside' in text


def test_lowered_gains_are_a_note_and_no_defect(here, mjcf):
    file = mjcf(LINK.format(''), SERVO.replace('kv="20"', 'kv="2000"'))
    code, text, errors = here('check', '--robot', file, '--base', 'none', '--position', '0', '0',
                              '1')
    assert (code, errors) == (0, '')
    lines = text.splitlines()
    assert lines[0].endswith('nothing is wrong with the start')
    assert lines[1].startswith("note: servo of joint 'robot0_a': damping 2000 to ")
    assert lines[1].endswith('not stable at its force limit with a timestep of 2 ms')


def test_a_robot_that_stands_in_the_table_is_told_to_move(here):
    code, text, _ = here('check', '--arena', 'table', '--base', 'none', '--position', '0', '0',
                         '0.4')
    assert code == 1
    assert "geom 'table_collision' of body 'table'" in text
    assert "fix: place the robot elsewhere (its position, or base_xpos_offset), or move 'table'" \
        in text


def test_missing_meshes_are_defects_unless_a_line_accepts_them(here, tmp_path, monkeypatch):
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    monkeypatch.delenv('ROS_PACKAGE_PATH', raising=False)
    file = Path(__file__).resolve().parents[1] / 'data/files/no_meshes.urdf'
    code, text, _ = here('check', '--robot', file, '--position', '0', '0', '0.5')
    assert code == 1
    assert text.count('left out: 1 ') == 2
    assert "source the workspace that has 'elsewhere'" in text
    assert 'accept it by meshes: none' in text
    accepted = tmp_path / 'arm.yaml'
    accepted.write_text(f'model: {file}\nmeshes: none\n')
    _, text, _ = here('check', '--robot', accepted, '--position', '0', '0', '0.5')
    assert 'left out' not in text


def test_a_file_without_defects_is_told_so(here, mjcf):
    file = mjcf(LINK.format(''), SERVO)
    assert here('check', file) == (0, f'{file}: nothing is wrong with the start\n', '')


def test_a_file_is_checked_at_its_keyframe_home_else_at_the_first(here, mjcf):
    def key(name, value):
        return f'<key name="{name}" qpos="{value}" ctrl="{value}"/>'

    keys = f'<keyframe>{key("far", 2.5)}{key("home", 1.0)}</keyframe>'
    assert here('check', mjcf(LINK.format(''), SERVO + keys))[0] == 0
    code, text, _ = here('check', mjcf(LINK.format(''), SERVO + keys.replace('home', 'near')))
    assert code == 1 and "joint 'a' starts at 2.5 rad, 0.5 outside its range of -2 to 2" in text


def test_defects_of_a_file_name_what_to_write(here, mjcf):
    inner = '<body name="tip" pos="0.3 0 0"><joint name="b"/><geom size="0.01"/></body>'
    two = SERVO.replace('</actuator>', '<velocity name="v" joint="a"/></actuator>')
    code, text, _ = here('check', mjcf(LINK.format(inner), two))
    assert code == 1
    assert text.splitlines()[0].endswith(': 2 defects')
    assert "joint 'a' is driven by 2 actuators, 's', 'v'" in text
    assert '<motor joint="b" ctrlrange="-LIMIT LIMIT"/>' in text
    assert 'In the files' not in text


def test_objects_and_furniture_of_a_file_are_no_robots(here, mjcf):
    balls = ''.join(f'<body pos="{x} 3 1"><freejoint/><geom size="0.1"/></body>' for x in (0, 0.1))
    assert here('check', mjcf(balls + LINK.format(''), SERVO))[0] == 0


def test_a_walking_robot_is_one_though_its_root_is_free(here, mjcf):
    walking = LINK.format('').replace('<geom', '<freejoint/><geom', 1)
    code, text, _ = here('check', mjcf(walking))
    assert code == 1 and "joint 'a' has no actuator" in text


def test_several_robots_of_a_file_are_all_checked(here, mjcf):
    other = LINK.replace('"root"', '"two"').replace('"link"', '"link2"').replace('"a"', '"c"')
    code, text, _ = here('check', mjcf(LINK.format('') + other.format('').replace(
        '<body name="two">', '<body name="two" pos="0 2 0">'), SERVO))
    assert code == 1 and "joint 'c' has no actuator" in text


def test_what_cannot_be_controlled_is_a_defect_beside_the_others(
        here, one_joint_arm, composing):
    two = '<motor name="m" joint="joint1"/><motor name="n" joint="joint1"/>'
    composing('check', one_joint_arm(two))
    code, text, errors = here('check')
    assert (code, errors) == (1, '')
    assert 'this cannot be simulated: joint ' in text
    assert "joint 'robot0_joint1' is driven by 2 actuators, 'robot0_m', 'robot0_n'" in text


def test_what_cannot_be_controlled_is_checked_where_its_couplings_put_it(
        here, one_joint_arm, composing):
    two = '<motor name="m" joint="joint1"/><motor name="n" joint="joint1"/>'
    tied = """<body name="base"><geom size="0.05"/><body name="link1" pos="0 0 1">
        <joint name="joint1" axis="0 1 0" range="-2 2"/><geom size="0.02"/>
        <body name="crank"><joint name="tied" range="0.4 1"/><geom size="0.01"/></body>
        <body name="right_hand" pos="0.5 0 0"/></body></body>"""
    equality = '<equality><joint joint1="tied" polycoef="0.6"/></equality>'
    composing('check', one_joint_arm(two, tied, equality))
    _, text, _ = here('check')
    assert 'this cannot be simulated: joint ' in text and 'outside its range' not in text


@pytest.mark.parametrize(('content', 'what'), [
    (None, 'no such MJCF file'), ('<mujoco><worldbody>', 'is not well-formed XML'),
    ('<mujoco><worldbody><geom size="-1"/></worldbody></mujoco>', 'does not compile'),
    ('<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>',
     'has no body with joints, so no robot to check')])
def test_a_file_that_cannot_be_checked_is_one_line(content, what, rejected, tmp_path):
    file = tmp_path / 'broken.xml'
    if content is not None:
        file.write_text(content)
    assert what in rejected('check', file)


def test_a_urdf_is_told_what_to_write_in_urdf_and_each_prefix_once(here, tmp_path):
    solid = ('<inertial><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" '
             'iyz="0"/></inertial><collision><geometry><box size="0.2 0.2 0.2"/></geometry>'
             '</collision>')
    links = ''.join(f'<link name="{name}">{solid}</link>' for name in (
        'base', 'upper', 'palm', 'thumb', 'finger'))
    links = links.replace('<link name="finger"><inertial><mass value="2"/><inertia ixx="0.1"',
                          '<link name="finger"><inertial><mass value="0.02"/><inertia ixx="0.2"')
    joints = ''.join(
        f'<joint name="{child}_joint" type="revolute"><parent link="{parent}"/><child '
        f'link="{child}"/><origin xyz="0.5 {y} 0"/><axis xyz="0 1 0"/><limit lower="0" upper="1" '
        f'effort="{effort}" velocity="1"/></joint>' for parent, child, y, effort in (
            ('base', 'upper', 0, 3), ('upper', 'palm', 0, 90), ('palm', 'thumb', 0.3, 40),
            ('palm', 'finger', -0.3, 40)))
    file = tmp_path / 'arm.urdf'
    file.write_text(f'<robot name="r">{links}{joints}</robot>')
    code, text, errors = here('check', '--robot', str(file), '--base', 'none', '--position', '0',
                              '0', '2')
    assert (code, errors) == (1, '')
    assert 'or write a higher limit, such as <limit effort="' in text
    assert "init_qpos, or 'start' in the YAML file" in text
    assert "- link 'robot0_finger' has a moment of inertia of 0.2 kg m^2" in text
    assert 'write moments of some 0.00024 kg m^2, as <inertia ixx="0.00024"' in text
    for word in ('actuatorfrcrange', 'keyframe', 'geom', 'body', 'diaginertia'):
        assert word not in text
    assert text.count('robot0_,') + text.count('robot0_.') == 1
    assert 'has no actuator' not in here('check', str(file))[1]


START = dict(zip([f'robot0_joint{n}' for n in range(1, 8)], [0.1, 0.2, 0.3, -2.0, 0.5, 2.0, 0.7]))


@pytest.mark.parametrize(('states', 'texts', 'remarks'), [
    (START, [], []),
    (dict(reversed(START.items())), [], ["/js has 'robot0_joint7' before 'robot0_joint6', this "]),
    ({**START, 'robot0_joint4': 2.0, 'robot0_joint6': -2.0},
     ["/js: 'robot0_joint4' is at 2, beyond its range from -3.072 to -0.0698; 'robot0_joint6' is "
      'beyond its own too', "'robot0_joint4' is beyond its own too"], []),
    ({**START, 'robot0_joint1': 200.0}, ["'robot0_joint1' is at 200, beyond its range"], []),
    ({name.replace('robot0', 'fr3'): value for name, value in START.items()},
     ["/js has joints that this robot does not have: 'fr3_joint1', ",
      "/js lacks joints of this robot: 'robot0_joint1', "], [])])
def test_states_of_another_source_are_compared_with_a_robot(states, texts, remarks):
    world = compose('Panda', gripper=None)
    defects, notes = differences(world, '/js', [*states], [*states.values()])
    assert len(defects) == len(texts) and len(notes) == len(remarks)
    for sentence, text in zip([*[defect.text for defect in defects], *notes], [*texts, *remarks]):
        assert text in sentence


def test_states_with_a_joint_twice_or_without_positions_are_told():
    world, names = compose('Panda', gripper=None), [*START, 'robot0_joint1']
    defects, _ = differences(world, '/js', names, [*START.values()])
    assert [defect.text for defect in defects] == [
        "/js names joints twice: 'robot0_joint1'", '/js has 8 names and 7 positions']


def test_a_file_is_not_compared_with_states(here, mjcf):
    assert here('check', mjcf(LINK), '--against', 'joint_states')[0] == 2
