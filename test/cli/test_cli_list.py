# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim list``."""

import json
from pathlib import Path
import re
import sys

import pytest

from manip_sim.models.arenas import arena_names
from manip_sim.models.bases import base_names
from manip_sim.models.grippers import gripper_names
from manip_sim.models.object_creation import create_object
from manip_sim.models.robots import robot_names
from manip_sim.resources import share_directory
from manip_sim.tasks import task_names

SOURCE = Path(__file__).resolve().parents[2]
NAMES = {'robots': robot_names, 'grippers': gripper_names, 'bases': base_names,
         'arenas': arena_names}


def rows_of(text, title):
    """Return the rows of one table of the output as dictionaries by the name of the column."""
    header, *rows = text.split(f'{title}\n')[1].split('\n\n')[0].splitlines()
    return [dict(zip(_cells(header), _cells(row))) for row in rows]


def _cells(line):
    return [cell.strip() for cell in line.split('  ') if cell.strip()]


@pytest.mark.parametrize('kind', NAMES)
def test_all_of_a_kind_are_listed_with_their_files(kind, here):
    code, text, errors = here('list', kind)
    rows = rows_of(text, kind.capitalize())
    assert (code, errors) == (0, '')
    assert [row['name'] for row in rows] == NAMES[kind]()
    for row in rows:
        assert row['from'] == 'manip_sim'
        assert (share_directory() / row['file']).is_file()
    assert text.rstrip().endswith(f'Files of manip_sim lie in {share_directory()}')


def test_robots_tell_their_arms_and_what_they_carry_by_default(here):
    rows = {row['name']: row for row in rows_of(here('list', 'robots')[1], 'Robots')}
    assert rows['GR1']['arms'] == '2' and rows['GR1']['joints'] == '32'
    assert rows['GR1']['default gripper'] == 'FourierRightHand, FourierLeftHand'
    assert rows['Panda']['default base'] == 'RethinkMount'


def test_everything_is_listed_unless_a_kind_is_asked_for(here):
    text = here('list')[1]
    for kind in (*NAMES, 'objects', 'tasks'):
        assert f'{kind.capitalize()}\n' in text
    assert 'Grippers' not in here('list', 'bases')[1]


def test_arenas_tell_their_parameters(here):
    rows = {row['name']: row for row in rows_of(here('list', 'arenas')[1], 'Arenas')}
    assert rows['table']['parameters and defaults'] == (
        'table_length=0.8, table_width=0.8, table_height=0.8, friction=1.0, cube=true')


def test_json_has_what_the_tables_have(here):
    code, text, errors = here('list', '--json')
    found = json.loads(text)
    assert (code, errors) == (0, '')
    assert list(found) == [*NAMES, 'shapes_of_objects', 'objects', 'tasks']
    for kind, names in NAMES.items():
        assert [row['name'] for row in found[kind]] == names()
    panda = next(row for row in found['robots'] if row['name'] == 'Panda')
    assert panda == {'name': 'Panda', 'arms': 1, 'joints': 7, 'default_gripper': ['PandaGripper'],
                     'default_base': 'RethinkMount', 'from': 'manip_sim',
                     'file': 'assets/robots/panda/panda.xml'}
    table = next(row for row in found['arenas'] if row['name'] == 'table')
    assert table['parameters_and_defaults']['table_height'] == 0.8
    assert found['objects'][0]['mass_kg'] == pytest.approx(0.1)


def test_shapes_of_objects_tell_what_their_size_is(here):
    rows = {row['name']: row['size m'] for row in
            rows_of(here('list', 'objects')[1], 'Shapes of objects')}
    assert list(rows) == ['box', 'sphere', 'cylinder', 'capsule', 'ellipsoid', 'mesh']
    assert rows['cylinder'] == '[radius, length]'
    # What it says is what an object takes.
    for shape, size in (('box', [1, 1, 1]), ('sphere', 1), ('cylinder', [1, 1]),
                        ('capsule', [1, 1]), ('ellipsoid', [1, 1, 1])):
        create_object({'name': 'o', 'shape': shape, 'size': size})


def test_objects_tell_their_arena_and_what_brings_them(here):
    row, = rows_of(here('list', 'objects')[1], 'Objects')
    assert (row['name'], row['mass kg'], row['arena']) == ('cube', '0.1', 'table')
    assert row['parameters'] == 'cube=true'


def test_tasks_tell_what_is_to_be_done(here):
    rows = json.loads(here('list', 'tasks', '--json')[1])['tasks']
    arms = {row['name']: row['arms'] for row in rows if 'arms' in row}
    assert arms['hand_over'] == 2 and arms['pick_cube'] == arms['reach'] == 1
    assert [row['name'] for row in rows] == task_names()
    assert {'name': 'pick_cube', 'instruction': 'Pick up the red cube.', 'arms': 1,
            'horizon_s': 6.0, 'not_for': ['GR1', 'SO101'], 'expert_fails': [],
            'from': 'manip_sim'} in rows


def test_a_robot_of_the_users_own_file_tells_its_folder(here, one_joint_arm, tmp_path):
    class OwnArm(type(one_joint_arm())):
        def __init__(self, idn=0):
            super().__init__(tmp_path / 'model.xml', idn)

    OwnArm.__module__ = 'manip_sim.models.loaded'
    row = next(r for r in rows_of(here('list', 'robots')[1], 'Robots') if r['name'] == 'OwnArm')
    assert (row['from'], row['file']) == (f'folder {tmp_path}', 'model.xml')


def test_a_robot_without_arms_has_none_in_the_list(here, robot_class, one_joint_arm, tmp_path):
    one_joint_arm()

    class Crane(robot_class):
        def __init__(self, idn=0):
            super().__init__(tmp_path / 'model.xml', idn)
    row = next(row for row in json.loads(here('list', 'robots', '--json')[1])['robots']
               if row['name'] == 'Crane')
    assert (row['arms'], row['joints'], row['default_gripper']) == (0, 1, [])


@pytest.mark.full
def test_a_robot_of_another_package_tells_its_package_or_entry_point(
        here, one_joint_arm, tmp_path, monkeypatch):
    class Foreign(type(one_joint_arm())):
        def __init__(self, idn=0):
            super().__init__(tmp_path / 'model.xml', idn)

    Foreign.__module__ = 'their_robots.arms'

    def source():
        rows = rows_of(here('list', 'robots')[1], 'Robots')
        return next(row['from'] for row in rows if row['name'] == 'Foreign')

    assert source() == 'package their_robots'
    metadata = tmp_path / 'site' / 'their_robots-1.0.dist-info'
    metadata.mkdir(parents=True)
    (metadata / 'METADATA').write_text('Metadata-Version: 2.1\nName: their-robots\nVersion: 1.0\n')
    (metadata / 'entry_points.txt').write_text(
        '[manip_sim.robots]\nforeign = their_robots.arms:Foreign\n')
    monkeypatch.setattr(sys, 'path', [str(metadata.parent), *sys.path])
    assert source() == 'entry point foreign of their-robots'


def test_a_part_that_cannot_be_created_does_not_hide_the_others(here, one_joint_arm, tmp_path):
    class Broken(type(one_joint_arm())):
        def __init__(self, idn=0):
            super().__init__(tmp_path / 'lost.xml', idn)

    class Stringy(type(one_joint_arm())):
        default_gripper = 'PandaGripper'

        def __init__(self, idn=0):
            super().__init__(one_joint_arm().file, idn)

    code, text, _ = here('list', 'robots')
    assert code == 1
    line = next(line for line in text.splitlines() if 'Stringy' in line)
    assert 'cannot be created: KindError: default_gripper of Stringy0 must be a mapping' in line
    line = next(line for line in text.splitlines() if 'Broken' in line)
    assert f'cannot be created: ModelError: no such MJCF file: {tmp_path}/lost.xml' in line
    assert 'Panda ' in text


def test_tasks_say_with_which_robots_their_experts_fail_as_the_page_of_experts(here):
    page = (SOURCE / 'docs' / 'reference' / 'experts.md').read_text()
    rows = re.findall(r'^\| `(\w+)` \| (\w+) \| (\d+) of (\d+) ', page, re.MULTILINE)
    failing = {(task, f'{robot}: {successes} of {count}') for task, robot, successes, count in rows
               if int(successes) < 0.9 * int(count)}
    tasks = json.loads(here('list', 'tasks', '--json')[1])['tasks']
    listed = {(task['name'], text) for task in tasks for text in task.get('expert_fails', ())}
    assert listed == failing != set()
