# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The tables of topics and services against those of the reference, and filled in."""

from dataclasses import dataclass
from pathlib import Path
import re

from manip_sim.interface.composition import declare_parts
from manip_sim.interface.parameter_spec import GivenParameters
from manip_sim.interface.topics import (
    BY_NAME, PUBLISHED, Scope, SERVICES, SUBSCRIBED, TOPICS, topics_of)

REFERENCE = Path(__file__).resolve().parents[1] / 'docs' / 'reference'
TABLES = '\n'.join((REFERENCE / page).read_text() for page in ('topics.md', 'services.md'))


@dataclass
class Part:
    atomic: tuple[str, ...] = ()
    joints: tuple[str, ...] = ('j',)
    actuators: tuple[str, ...] = ('a',)
    gripper: object = None


def rows_below(header):
    """Return name and type of the rows of the reference's table with a header."""
    table = TABLES.split(f'\n| {header} |')[1].split('\n\n')[0]
    return re.findall(r'^\| `([^`]+)` \| (\w+/\w+) \|', table, re.MULTILINE)


def test_topics_and_services_are_those_of_the_reference_in_its_order():
    for header, direction in (('published | type | content', PUBLISHED),
                              ('subscribed | type | meaning', SUBSCRIBED)):
        assert rows_below(header) == [
            (topic.name, topic.type) for topic in TOPICS if topic.direction == direction]
    assert rows_below('service | type | meaning') == [(s.name, s.type) for s in SERVICES]


def test_only_what_a_part_has_gives_topics():
    names = [topic.name for topic in topics_of(
        {'arm': Part(), 'legs': Part(actuators=()), 'left/gripper': Part(joints=(), gripper=1)},
        twist=False)]
    assert 'arm/command' in names and 'legs/joint_states' in names
    assert 'left/wrench' in names and 'left/gripper/command' in names
    assert not {'legs/command', 'left/gripper/joint_states', 'base/cmd_vel', 'left/command',
                'left/gripper/controller_state'} & set(names)
    assert not [name for name in names if '<' in name]


def test_parameters_of_parts_that_are_commanded_are_filled_in():
    parameters = GivenParameters({})
    declare_parts(parameters, [(Scope(), {
        'arm': Part(atomic=('arm',)), 'base': Part(atomic=('base',)),
        'legs': Part(actuators=()), 'right/gripper': Part(gripper=1)})])
    found = {name: spec.default for name, spec in parameters.specs.items()}
    modes = {name: value for name, value in found.items() if name.startswith('control_mode')}
    assert modes == {'control_mode.arm': 'position', 'control_mode.base': 'velocity'}
    assert found['command_timeout.base'] == 0.5 and found['command_timeout.arm'] == 0.0


def test_the_name_of_a_topic_says_of_what_it_is():
    for name, of in (('<part>/joint_command', 'left'), ('<arm>/gripper/command', 'left/gripper'),
                     ('objects/<name>/pose', 'cube'), ('<camera>/color/image_raw', 'front'),
                     ('<lidar>/scan', 'flat'), ('sensors/<sensor>/imu', 'hand')):
        row = BY_NAME[name]
        assert row.of_name(row.filled_in(of).name) == of
    for name in ('joint_command', '/joint_command', 'left/joint_commands', 'x/left/joint_comman'):
        assert BY_NAME['<part>/joint_command'].of_name(name) == ''
    # What stands before and after does not overlap.
    assert BY_NAME['objects/<name>/pose'].of_name('objects/pose') == ''
