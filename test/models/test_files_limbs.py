# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Parts that no name of a joint tells: wheels, legs, planar bases, hands, lifts, arms by place."""

from __future__ import annotations

import math

from files_rig import write
import pytest

from manip_sim.models import compose, load_robot
from manip_sim.simulation import Simulation

SHAPE = '<geom size="0.02" mass="0.1"/>'


def chain(name, count, place='0 0 0', limits='-1 1', inside='', kind='hinge', body='{}',
          axis='0 1 0'):
    """Return bodies in a row, the first at a place, each with a joint."""
    text = inside
    for i in range(count, 0, -1):
        range_ = f'range="{limits}" limited="true"' if limits else 'limited="false"'
        text = (f'<body name="{body.format(f"{name}{i}_link")}" '
                f'pos="{place if i == 1 else "0 0 0.1"}"><joint name="{name}{i}" type="{kind}" '
                f'axis="{axis}" {range_}/>{SHAPE}{text}</body>')
    return text


def model(inside, root='trunk', free='', equality=''):
    """Return the MJCF of a root body that carries something."""
    return (f'<mujoco><compiler angle="radian"/><worldbody><body name="{root}" pos="0 0 1">{free}'
            f'{SHAPE}{inside}</body></worldbody><equality>{equality}</equality></mujoco>')


def parts_of(folder, inside, root='trunk', free=''):
    """Return the number of joints by part of what a root body carries, and what was inferred."""
    file = write(folder / 'robot.xml', model(inside, root, free))
    robot = load_robot(file)
    parts = Simulation(compose(load_robot(file))).robot.parts
    return {name: len(part.joints) for name, part in parts.items()
            if part.atomic == (name,) and part.joints}, robot.inferred


def around(count, radius=0.2, turn=0.0):
    """Return places on a circle."""
    angles = [turn + 2.0 * math.pi * i / count for i in range(count)]
    return [f'{radius * math.cos(a):.4f} {radius * math.sin(a):.4f} 0' for a in angles]


def test_wheels_are_the_hinges_without_limits_that_carry_nothing(tmp_path):
    wheels = ''.join(chain(f's{i}', 1, place, limits='', axis='1 0 0')
                     for i, place in enumerate(around(3)))
    arm = chain('j', 5, '0 0 0.1', inside=chain('k', 1, '0 0.02 0.1', body='moving_jaw'))
    parts, said = parts_of(tmp_path, wheels + arm)
    assert parts == {'base': 3, 'arm': 5, 'right/gripper': 1}
    assert [note for note in said if note.startswith('base is a guess: ') and
            'subsystems: {s01: other} in a YAML file' in note]


def test_bodies_tell_wheels_where_joints_have_numbers_only(tmp_path):
    wheels = ''.join(chain(f's{i}', 1, place, body=f'omni_wheel_{i}')
                     for i, place in enumerate(around(3)))
    parts, said = parts_of(tmp_path, wheels + chain('j', 4, '0 0 0.1'))
    assert parts == {'base': 3, 'arm': 4}
    assert not any('guess' in note for note in said)


@pytest.mark.parametrize('hinge', ['0 0 1', '0 1 0'])
def test_a_single_hinge_or_a_vertical_one_is_no_wheel(tmp_path, hinge):
    spinning = chain('s', 1, '0.2 0 0', limits='', axis=hinge)
    if hinge == '0 0 1':
        spinning += chain('t', 1, '-0.2 0 0', limits='', axis=hinge)
    parts, _ = parts_of(tmp_path, spinning + chain('j', 4, '0 0 0.1'))
    assert 'base' not in parts and parts['arm'] == 4


@pytest.mark.parametrize(('count', 'limits', 'turn'), [
    (6, '-1 1', 0.0), (8, '-1 1', 0.0), (6, '', 0.0), (4, '-1 1', math.pi / 4.0)])
@pytest.mark.parametrize('free', ['', '<freejoint/>'])
def test_alike_limbs_in_pairs_or_too_many_for_a_hand_are_legs(tmp_path, count, limits, turn, free):
    limbs = ''.join(chain(f'J{i}_', 3, place, limits) for i, place in
                    enumerate(around(count, turn=turn)))
    parts, said = parts_of(tmp_path, limbs, free=free)
    assert parts == {'legs': 3 * count}
    assert any(note.startswith('legs is a guess: ') for note in said)


def test_legs_by_their_kind_leave_the_arm_between_them(tmp_path):
    limbs = ''.join(chain(f'J{i}_', 3, place) for i, place in
                    enumerate(around(4, turn=math.pi / 4.0)))
    parts, _ = parts_of(tmp_path, limbs + chain('a', 6, '0 0 0.1'))
    assert parts == {'legs': 12, 'arm': 6}


def test_a_limb_with_the_name_of_a_leg_is_one_whatever_its_first_joint_is_called(tmp_path):
    limbs = ''.join(
        chain(f'c{i}_shoulder', 1, place, inside=chain(f'tibia{i}_', 2, '0 0 -0.1'))
        for i, place in enumerate(around(4)))
    assert parts_of(tmp_path, limbs)[0] == {'legs': 12}


@pytest.mark.parametrize('places', [
    ['0 0.04 0.1', '0 0 0.1', '0 -0.04 0.1', '0.03 0.06 0.02'], around(3, 0.04)])
def test_fingers_around_a_palm_or_beside_a_thumb_are_a_hand(tmp_path, places):
    fingers = ''.join(chain(f'J{i}_', 4, place) for i, place in enumerate(places))
    parts, said = parts_of(tmp_path, fingers)
    assert parts == {'right/gripper': 4 * len(places)}
    assert any('arms: none in a YAML file if it is no hand' in note for note in said)


@pytest.mark.parametrize('lengths', [(1, 1, 1, 6), (2, 2, 5)])
def test_unequal_limbs_are_no_fingers(tmp_path, lengths):
    limbs = ''.join(chain(f'J{i}_', count, place) for i, (count, place) in
                    enumerate(zip(lengths, around(len(lengths)))))
    parts, _ = parts_of(tmp_path, limbs)
    assert parts == {'arm': max(lengths), 'other': sum(lengths) - max(lengths)}


@pytest.mark.parametrize('axis', ['0 1 0', '0 -1 0'])
def test_two_slides_along_one_line_are_a_gripper_alone(tmp_path, axis):
    jaws = (chain('p', 1, '0 0.03 0.05', '-0.03 0.01', kind='slide')
            + chain('q', 1, '0 -0.03 0.05', '-0.03 0.01', kind='slide', axis=axis))
    parts, said = parts_of(tmp_path, jaws)
    assert parts == {'right/gripper': 2}
    assert any('right/gripper is a guess' in note for note in said)


def test_two_joints_in_different_directions_are_neither_a_gripper_nor_arms(tmp_path):
    ears = chain('p', 1, '0 0.03 0.05') + chain('q', 1, '0 -0.03 0.05', axis='1 0 0')
    assert parts_of(tmp_path, ears)[0] == {'other': 2}


def test_a_body_called_palm_carries_fingers_whatever_they_are(tmp_path):
    fingers = chain('p', 3, '0 0.03 0.05') + chain('q', 2, '0 -0.03 0.05')
    assert parts_of(tmp_path, fingers, root='palm_base')[0] == {'right/gripper': 5}


@pytest.mark.parametrize(('names', 'sides'), [
    (('right_', 'left_'), ('right', 'left')), (('a_', 'b_'), ('left', 'right'))])
@pytest.mark.parametrize('thumb', ['thumb', 'f'])
@pytest.mark.parametrize(('palm', 'apart'), [('palm', 0.06), ('rack', 0.3)])
def test_two_hands_by_their_names_or_out_of_reach_of_each_other_are_two_grippers(
        tmp_path, names, sides, thumb, palm, apart):
    hands = ''
    for name, y in zip(names, (-apart, apart) if names[0] == 'right_' else (apart, -apart)):
        fingers = ''.join(chain(f'{name}{finger}', 2, place) for finger, place in zip(
            (thumb, 'g', 'h'), around(3, 0.04)))
        hands += f'<body name="{name}{palm}" pos="0 {y} 0">{SHAPE}{fingers}</body>'
    robot = load_robot(write(tmp_path / 'robot.xml', model(hands)))
    assert robot.eef_name == {side: f'robot0_{name}{palm}' for name, side in zip(names, sides)}
    assert {side: len(hand.joints) for side, hand in robot.grippers.items()} == {
        'right': 6, 'left': 6}


@pytest.mark.parametrize(('axes', 'part'), [
    ((('slide', '1 0 0'), ('slide', '0 1 0'), ('hinge', '0 0 1')), 'base'),
    ((('hinge', '0 0 1'), ('slide', '0 1 0'), ('slide', '1 0 0')), 'base'),
    ((('slide', '1 0 0'), ('slide', '0 0 1'), ('hinge', '0 1 0')), 'arm'),
    ((('slide', '1 0 0'), ('slide', '0 1 0'), ('slide', '0 0 1')), 'arm'),
    ((('slide', '1 0 0'), ('slide', '1 0 0'), ('hinge', '0 0 1')), 'arm')])
def test_two_slides_and_a_hinge_across_below_an_arm_are_a_base(tmp_path, axes, part):
    text = chain('arm', 4, '0 0 0.1')
    for i, (kind, axis) in reversed(list(enumerate(axes))):
        text = chain(f'm{i}_', 1, inside=text, kind=kind, axis=axis)
    parts, _ = parts_of(tmp_path, text)
    assert parts == ({'base': 3, 'arm': 4} if part == 'base' else {'arm': 7})


def test_the_root_of_a_planar_walker_is_its_base(tmp_path):
    root = ''.join(f'<joint name="{name}" type="{kind}" axis="{axis}"/>' for name, kind, axis in (
        ('along', 'slide', '1 0 0'), ('up', 'slide', '0 0 1'), ('lean', 'hinge', '0 1 0')))
    legs = ''.join(chain(f'thigh_{side}', 3, place) for side, place in (
        ('a', '0 0.1 0'), ('b', '0 -0.1 0')))
    assert parts_of(tmp_path, legs, free=root)[0] == {'base': 3, 'legs': 6}


def two_arms_on_a_lift(right_carries):
    """Return a lift with two bars that follow it; arms hang on the lift, or on the right bar."""
    arms = chain('l_j', 4, '0 0.2 0.3') + chain('r_j', 4, '0 -0.2 0.3')
    inside, beside = (arms, '') if right_carries else ('', arms)
    bars = (chain('left_bar', 1, '0 0.1 0', '0 0.5') + beside
            + chain('right_bar', 1, '0 -0.1 0', '0 0.5', inside=inside))
    return chain('tripod', 1, '0 0 0.1', '0 0.3', inside=bars, kind='slide', axis='0 0 1')


@pytest.mark.parametrize('right_carries', [False, True])
def test_joints_that_follow_one_are_of_its_part(tmp_path, right_carries):
    ties = ''.join(
        f'<joint joint1="{side}_bar1" joint2="tripod1"/>' for side in ('left', 'right'))
    text = model(two_arms_on_a_lift(right_carries), equality=ties)
    robot = load_robot(write(tmp_path / 'robot.xml', text))
    assert robot.torso_joints == [f'robot0_{name}1' for name in (
        'tripod', 'left_bar', 'right_bar')] and len(robot.arm_joints) == 8


def test_a_joint_with_a_word_of_legs_on_the_way_to_fingers_is_of_the_arm(tmp_path):
    fingers = chain('left_finger', 1, '0 0.02 0.1') + chain('right_finger', 1, '0 -0.02 0.1')
    text = chain('s_abduction', 1, inside=chain('j', 3, '0 0 0.1', inside=fingers))
    assert parts_of(tmp_path, text)[0] == {'arm': 4, 'right/gripper': 2}


def test_a_head_on_six_rods_is_no_hand(tmp_path):
    rods = ''.join(chain(f'rod{i}_', 2, place) for i, place in enumerate(around(6, 0.05)))
    text = chain('yaw', 1, '0 0 0.1', inside=rods, axis='0 0 1')
    ears = chain('right_antenna', 1, '0 -0.1 0.2') + chain('left_antenna', 1, '0 0.1 0.2')
    assert parts_of(tmp_path, text + ears)[0] == {'head': 2, 'other': 13}


def test_a_chain_beyond_one_of_six_rods_is_no_arm(tmp_path):
    rods = ''.join(chain(f'rod{i}_', 2, place, inside=chain('more', 3) if i == 5 else '')
                   for i, place in enumerate(around(6, 0.05)))
    parts, _ = parts_of(tmp_path, chain('yaw', 1, '0 0 0.1', inside=rods, axis='0 0 1'))
    assert parts == {'other': 16}


def test_an_arm_among_many_things_that_move_by_themselves_is_one(tmp_path):
    things = ''.join(f'<body name="{name}{i}" pos="1 {i} 0"><joint name="{name}{i}" type="{kind}" '
                     f'axis="1 0 0"/>{SHAPE}</body>' for name, kind, count in (
                         ('drawer', 'slide', 4), ('knob', 'hinge', 3)) for i in range(count))
    text = model(chain('j', 4, '0 0 0.1')).replace('</worldbody>', f'{things}</worldbody>')
    robot = load_robot(write(tmp_path / 'scene.xml', text))
    assert len(robot.arm_joints) == 4 and len(robot.other_joints) == 7


def test_what_moves_on_a_head_or_a_wheel_is_of_it(tmp_path):
    ears = (chain('a', 1, '0 -0.1 0.1') + chain('b', 1, '0 0.1 0.1', axis='1 0 0')
            + chain('laser', 1, '0 0 0.1', limits=''))
    rollers = ''.join(chain(f'r{i}_', 1, place) for i, place in enumerate(around(3, 0.05)))
    text = (chain('neck', 2, '0 0 0.2', inside=ears) + chain('wheel', 1, '0 0.2 0', inside=rollers)
            + chain('j', 4, '0.2 0 0', inside=chain('camera', 1, '0 0.1 0.1')))
    assert parts_of(tmp_path, text)[0] == {
        'head': 5, 'other': 1, 'base': 4, 'arm': 4}


def test_what_moves_beside_an_arm_on_a_base_is_no_part_of_the_base(tmp_path):
    text = chain('j', 4, '0 0 0.1') + chain('laser', 1, '0.2 0 0')
    for i, (kind, axis) in enumerate((('hinge', '0 0 1'), ('slide', '0 1 0'), ('slide', '1 0 0'))):
        text = chain(f'mobile{i}_', 1, inside=text, kind=kind, axis=axis)
    assert parts_of(tmp_path, text)[0] == {'base': 3, 'arm': 4, 'other': 1}


def test_the_rods_of_a_parallelogram_are_of_the_arm_that_they_follow(tmp_path):
    rods = chain('p', 3, '0.05 0 0.1')
    text = chain('yaw', 1, inside=chain('j', 3, '0 0 0.1') + rods, axis='0 0 1')
    ties = ''.join(f'<joint joint1="p{i}" joint2="j1"/>' for i in (1, 2, 3))
    robot = load_robot(write(tmp_path / 'robot.xml', model(text, equality=ties)))
    assert len(robot.arm_joints) == 7 and robot.eef_name == {'right': 'robot0_j3_link'}


def test_the_carriage_of_a_lift_is_no_finger(tmp_path):
    fingers = chain('left', 1, '0 0.02 -0.1', body='left_finger', kind='slide', limits='0 0.02')
    fingers += chain('right', 1, '0 -0.02 -0.1', body='right_finger', kind='slide',
                     limits='0 0.02', axis='0 -1 0')
    lift = chain('lift', 1, inside=fingers, body='carriage', kind='slide', axis='0 0 1')
    parts, _ = parts_of(tmp_path, lift)
    assert parts == {'arm': 1, 'right/gripper': 2}


@pytest.mark.parametrize(('limits', 'expected'), [
    ('limited="false"', {'base': 3, 'arm': 6}), ('range="-300 300" limited="true"',
                                                 {'base': 3, 'arm': 6}),
    ('range="-0.4 0.4" limited="true"', {'arm': 9})])
def test_a_root_that_slides_without_limits_is_a_base_and_a_gantry_is_none(
        tmp_path, limits, expected):
    slides = ''.join(f'<joint name="root{i}" type="slide" axis="{axis}" {limits}/>'
                     for i, axis in enumerate(('1 0 0', '0 1 0', '0 0 1')))
    parts, said = parts_of(tmp_path, chain('j', 6, '0 0 0.1'), free=slides)
    assert parts == expected
    assert any(note.startswith('base is a guess: ') for note in said) == ('base' in expected)


def test_a_root_of_six_joints_without_a_free_one_leaves_arms_and_legs_apart(tmp_path):
    root = ''.join(f'<joint name="root_t{axis}" type="slide" axis="{axis_of}" range="-500 500" '
                   f'limited="true"/><joint name="root_r{axis}" axis="{axis_of}" range="-1.5 1.5" '
                   'limited="true"/>' for axis, axis_of in zip('xyz', (
                       '1 0 0', '0 1 0', '0 0 1')))
    limbs = ''.join(chain(f'{side}_arm_', 4, f'0 {y} 0.3') + chain(
        f'{side}_knee_', 3, f'0 {y} -0.1') for side, y in (('left', 0.2), ('right', -0.2)))
    parts, _ = parts_of(tmp_path, limbs, free=root)
    assert parts == {'base': 6, 'right': 4, 'left': 4, 'legs': 6}


@pytest.mark.parametrize(('name', 'expected'), [
    ('thruster', {'other': 3}), ('gimbal', {'other': 3}), ('unit', {'right/gripper': 3})])
def test_rotors_of_a_flying_robot_are_no_fingers(tmp_path, name, expected):
    limbs = ''.join(chain(f'{name}{i}_', 1, place) for i, place in enumerate(around(3)))
    parts, _ = parts_of(tmp_path, limbs)
    assert parts == expected


def test_the_abduction_of_a_single_arm_is_the_arms(tmp_path):
    fingers = ''.join(chain(f'{side}c', 1, f'0 {y} 0.1') for side, y in (('r', -.02), ('l', .02)))
    arm = chain('s_abduction', 1, inside=chain('s_flexion', 1, inside=chain('roll', 2)))
    arm = arm.replace('</body>' * 4, fingers + '</body>' * 4)
    assert parts_of(tmp_path, arm)[0] == {'arm': 4, 'right/gripper': 2}


def test_a_leg_alone_stays_one(tmp_path):
    leg = chain('hip', 1, inside=chain('knee', 1, inside=chain('ankle', 1)))
    assert parts_of(tmp_path, leg)[0] == {'legs': 3}


def corners(names, joints, size=0.2, limits='-1 1'):
    """Return four limbs at the corners of a square, with the same joints each."""
    text = ''
    for name, (x, y) in zip(names, ((1, 1), (1, -1), (-1, 1), (-1, -1))):
        limb = ''
        for joint in reversed(joints):
            limb = chain(f'{name}_{joint}', 1, f'{size * x} {size * y} 0'
                         if joint == joints[0] else '0 0 -0.1', limits, limb)
        text += limb
    return text


SIDES = ('front_left', 'front_right', 'rear_left', 'rear_right')


def test_four_limbs_alike_with_shoulders_and_hands_are_legs(tmp_path):
    parts, said = parts_of(tmp_path, corners(SIDES, ('base_to_shoulder', 'shoulder_to_arm',
                                                     'arm_to_hand')))
    assert parts == {'legs': 12}
    assert any(note.startswith('legs is a guess: ') for note in said)


def test_four_limbs_alike_with_elbows_and_feet_are_legs(tmp_path):
    parts, _ = parts_of(tmp_path, corners(SIDES, ('shoulder', 'elbow', 'foot')))
    assert parts == {'legs': 12}


def test_four_limbs_with_elbows_are_no_legs(tmp_path):
    parts, _ = parts_of(tmp_path, corners(SIDES, ('shoulder', 'elbow', 'wrist')))
    assert 'legs' not in parts and 'right/gripper' not in parts


def test_legs_whose_links_have_their_frames_in_one_place_stand_where_their_masses_are(tmp_path):
    limbs = ''.join(chain(f'J{i}_', 3).replace(
        SHAPE, f'<geom size="0.02" mass="0.1" pos="{0.2 * x} {0.2 * y} 0"/>')
        for i, (x, y) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))))
    assert parts_of(tmp_path, limbs)[0] == {'legs': 12}


@pytest.mark.parametrize(('turns', 'part'), [(2.3, 'right/gripper'), (2.5, 'other')])
def test_limbs_that_turn_by_more_than_three_quarters_of_a_turn_are_no_fingers(
        tmp_path, turns, part):
    limbs = ''.join(chain(f'J{i}_', 3, place, limits=f'-{turns} {turns}')
                    for i, place in enumerate(around(3, 0.04)))
    assert parts_of(tmp_path, limbs)[0] == {part: 9}


@pytest.mark.parametrize(('wrist', 'fingers', 'expected'), [
    ('joint_claw', ('right_gripper', 'left_gripper'), {'arm': 4, 'right/gripper': 2}),
    ('claw_finger', ('right_gripper', 'left_gripper'), {'arm': 3, 'right/gripper': 3}),
    ('joint_claw', ('gripper',), {'arm': 3, 'right/gripper': 2})])
def test_a_joint_with_a_grippers_name_that_turns_both_fingers_is_of_the_arm(
        tmp_path, wrist, fingers, expected):
    jaws = ''.join(chain(name, 1, f'0 {y} 0.1', kind='slide', limits='0 0.02')
                   for name, y in zip(fingers, (-0.02, 0.02)))
    arm = chain('j', 3, '0 0 0.1', inside='')
    end = chain(wrist, 1, '0 0 0.1', inside=jaws, axis='0 0 1')
    parts, _ = parts_of(tmp_path, arm.replace('</body>' * 3, end + '</body>' * 3))
    assert parts == expected


def test_a_joint_with_a_hands_name_that_turns_fingers_without_names_is_of_the_arm(tmp_path):
    fingers = ''.join(chain(f'd{i}_', 2, place) for i, place in enumerate(
        ('0 -0.03 0.1', '0 0 0.1', '0 0.03 0.1')))
    end = chain('hand_turn', 1, '0 0 0.1', inside=fingers, axis='0 0 1')
    parts, _ = parts_of(tmp_path, chain('j', 4, '0 0 0.1').replace(
        '</body>' * 4, end + '</body>' * 4))
    assert parts == {'arm': 5, 'right/gripper': 6}


def test_a_chain_with_the_name_of_a_hand_beside_two_arms_is_no_hand(tmp_path):
    upper = ''.join(chain(f'{side}_arm', 4, f'0 {y} 0.2')
                    for side, y in (('left', 0.15), ('right', -0.15)))
    upper += chain('hand', 2, '0 0 0.3')
    parts, _ = parts_of(tmp_path, chain('body', 2, '0 0 0.1').replace(
        '</body>' * 2, upper + '</body>' * 2))
    assert parts == {'torso': 2, 'right': 4, 'left': 4, 'other': 2}


def test_a_camera_with_a_word_of_arms_beside_fingers_leaves_them_a_hand(tmp_path):
    beside = chain('wrist_camera_', 2, '0.05 0 0.05') + ''.join(
        chain(f'{side}_finger', 1, f'0 {y} 0.1') for side, y in (('l', 0.02), ('r', -0.02)))
    parts, _ = parts_of(tmp_path, chain('j', 4, '0 0 0.1').replace(
        '</body>' * 4, beside + '</body>' * 4))
    assert parts == {'arm': 4, 'right/gripper': 4}


def cell(lengths, places=('0 0.4 0', '0 -0.4 0')):
    """Return the MJCF of arms that stand on roots of their own."""
    roots = ''.join(f'<body name="stand{i}" pos="{place}">{SHAPE}{chain(f"m{i}_", length)}</body>'
                    for i, (length, place) in enumerate(zip(lengths, places)))
    return f'<mujoco><compiler angle="radian"/><worldbody>{roots}</worldbody></mujoco>'


@pytest.mark.parametrize('lengths', [(7, 6), (6, 6)])
def test_two_arms_of_a_cell_are_told_apart_by_their_places_whatever_their_lengths(
        tmp_path, lengths):
    robot = load_robot(write(tmp_path / 'cell.xml', cell(lengths)))
    parts = Simulation(compose(robot)).robot.parts
    assert (len(parts['left'].joints), len(parts['right'].joints)) == lengths
    assert any('left is the one that stands further left' in note
               and 'in a YAML file changes it' in note for note in robot.inferred)


@pytest.mark.parametrize('legs', [2, 0])
def test_a_pelvis_that_carries_no_arm_is_a_torso_if_there_are_legs(tmp_path, legs):
    sides = (('left', 0.1), ('right', -0.1))[:legs]
    limbs = chain('pelvis_', 2, '0 0 0.1') + ''.join(
        chain(f'{side}_knee', 3, f'0 {y} 0') for side, y in sides)
    assert parts_of(tmp_path, limbs)[0] == ({'torso': 2, 'legs': 6} if legs else {'arm': 2})
