# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What an error says about the names that there are."""

import re

import pytest

import manip_sim
from manip_sim.errors import describe_choices

PANDA = [*(f'robot0_joint{n}' for n in range(1, 8)),
         'gripper0_right_finger_joint1', 'gripper0_right_finger_joint2']
LEFT = [name.replace('robot0_', 'left_').replace('gripper0_right_', 'left_gripper_')
        for name in PANDA]
PARAMETERS = ['robot', 'base', 'publish_rate', 'control_mode.arm', 'control_mode.base',
              'command_timeout.arm', 'command_timeout.base']


def suggested(message):
    """Return the names that a message suggests, the nearest first."""
    hint = re.match(r'did you mean (.*?)\? available: ', message)
    return re.findall(r"'([^']*)'", hint.group(1)) if hint else []


@pytest.mark.parametrize(('asked', 'available', 'first'), [
    ('joint1', PANDA, 'robot0_joint1'), ('joint1', LEFT, 'left_joint1'),
    ('joint2', LEFT, 'left_joint2'), ('JOINT1', PANDA, 'robot0_joint1'),
    ('finger_joint2', LEFT, 'left_gripper_finger_joint2'),
    ('robot0_joint3', LEFT, 'left_joint3'), ('panda_joint3', PANDA, 'robot0_joint3'),
    ('arm.control_mode', PARAMETERS, 'control_mode.arm'),
    ('base.command_timeout', PARAMETERS, 'command_timeout.base'),
    ('arm.control_mod', PARAMETERS, 'control_mode.arm'),
    ('pblish_rate', PARAMETERS, 'publish_rate'), ('robott', PARAMETERS, 'robot'),
    ('joint_state', ['/arm/controller_state', '/joint_states'], '/joint_states')])
def test_the_name_that_was_meant_comes_first(asked, available, first):
    assert suggested(describe_choices(asked, available))[0] == first


def test_siblings_of_the_name_that_was_meant_are_not_suggested():
    assert suggested(describe_choices('joint1', PANDA)) == [
        'robot0_joint1', 'gripper0_right_finger_joint1']
    assert suggested(describe_choices('arm.control_mode', PARAMETERS)) == ['control_mode.arm']


def test_names_that_look_alike_are_suggested_where_no_word_is_right():
    assert suggested(describe_choices('torq', ['position', 'torque', 'torques'])) == [
        'torque', 'torques']
    assert suggested(describe_choices('elbow', PANDA)) == []


@pytest.mark.parametrize('asked', ['joint1', 'elbow', 'link', 'joint' * 1000])
@pytest.mark.parametrize('count', [1, 40, 1000])
@pytest.mark.parametrize('length', [5, 60])
def test_a_message_stays_short_and_counts_what_it_leaves_out(asked, count, length):
    available = [f'{"a" * length}_joint{n}' for n in range(count)]
    message = describe_choices(asked, available)
    assert len(message) <= 240
    listed = message.split('available: ')[1].split(', ')
    last = re.fullmatch(r'\.\.\. and (\d+) more', listed[-1])
    shown = listed[:-1] if last else listed
    assert shown == available[:len(shown)] and len(shown) >= 1
    assert len(shown) + (int(last.group(1)) if last else 0) == count


def test_long_names_leave_room_for_one_suggestion_only():
    available = [f'{letter * 70}_joint1' for letter in 'abc']
    message = describe_choices('joint1', available)
    assert suggested(message) == available[:1]
    assert len(message) <= 240


def test_a_short_list_is_told_as_a_whole():
    assert describe_choices('xyzzy', ['arm', 'base']) == 'available: arm, base'
    assert describe_choices('xyzzy', []) == 'available: none'


@pytest.mark.parametrize('available', [[], ['']])
def test_a_message_says_that_there_is_nothing_to_choose_from(available):
    assert describe_choices('home', available) == 'available: none'


@pytest.mark.parametrize('name, where', [
    ('compose', 'manip_sim.models'), ('Simulation', 'manip_sim.simulation'),
    ('Worlds', 'manip_sim.worlds')])
def test_a_name_of_a_folder_that_is_asked_of_the_package_is_told_with_its_folder(name, where):
    with pytest.raises(AttributeError, match=f'it is {where}.{name}$'):
        getattr(manip_sim, name)
    assert not hasattr(manip_sim, 'composer')
