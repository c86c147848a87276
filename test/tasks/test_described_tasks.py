# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tasks by YAML files: starts, success, rewards, and what is wrong with them on one line."""

import json
import math
from pathlib import Path

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
import yaml

pytest.importorskip('pydantic', minversion='2', reason='pydantic 2 is not installed')

from manip_sim.cli.main import main  # noqa: E402
from manip_sim.errors import ManipSimError, ModelError, UnknownNameError  # noqa: E402
from manip_sim.models.sources import set_model_path  # noqa: E402
from manip_sim.simulation import Simulation  # noqa: E402
from manip_sim.tasks import create_task, Episode, task_names  # noqa: E402
from manip_sim.tasks.placing import place  # noqa: E402

PLATE = """
instruction: Put the red cube onto the green disc, and let go of it.
horizon: 8.0
objects:
  - {name: cube, shape: box, size: [0.04, 0.04, 0.04], mass: 0.1, condim: 4}
goals:
  - {name: disc, radius: 0.05, flat: true}
start:
  cube: {position: {low: [-0.1, -0.1, 0.82], high: [0.1, 0.1, 0.82]}, yaw: {low: -3.1, high: 3.1}}
  disc: {position: {low: [-0.1, -0.1, 0.8], high: [0.1, 0.1, 0.8]}}
apart: 0.12
success:
  - {distance: [cube, disc], axes: xy, below: 0.03}
  - {contact: [cube, table]}
  - {contact: [cube, gripper], touch: false}
  - {speed: cube, below: 0.02}
reward:
  - {distance: [end_effector, cube], below: 0.02, weight: 2}
"""
DRAWER = {
    'instruction': 'Pull.', 'horizon': 4, 'arena': 'drawer', 'grasps': False,
    'start': {'drawer_slide': {'position': {'low': 0.01, 'high': 0.05}}},
    'success': [{'joint': 'drawer_slide', 'low': 0.1},
                {'position': 'handle', 'low': [-math.inf, -math.inf, 0.8]}], 'reward': 'sparse'}


@pytest.fixture(scope='module')
def file(tmp_path_factory):
    """Return a file that describes a task."""
    found = tmp_path_factory.mktemp('tasks') / 'plate.yaml'
    found.write_text(PLATE)
    return found


@pytest.fixture(scope='module')
def plate(file):
    """Return episodes of the task of the file."""
    task = create_task(file)
    return Episode(task, Simulation(task.world))


@pytest.fixture(scope='module')
def drawer():
    """Return episodes of a task with a joint."""
    task = create_task('drawer', description={'name': 'pull', **DRAWER})
    return Episode(task, Simulation(task.world))


def test_a_task_is_what_its_file_says(plate):
    assert (plate.task.name, plate.task.horizon_s) == ('plate', 8.0)
    assert plate.task.instruction == 'Put the red cube onto the green disc, and let go of it.'


@pytest.mark.full
def test_starts_are_drawn_evenly_within_the_ranges_and_apart(plate):
    found = []
    for seed in range(100):
        plate.reset(seed)
        cube, disc = plate.observation['object_pose'][0], plate.observation['goal']
        assert np.abs([*cube[:2], *disc[:2]]).max() <= 0.1 and disc[2] == 0.8
        assert math.dist(cube[:2], disc[:2]) >= 0.12
        found.append([*cube[:2], 2.0 * math.atan2(cube[5], cube[6])])
    x, y, yaw = np.transpose(found)
    yaw = (yaw + np.pi) % (2.0 * np.pi) - np.pi
    for values, half in ((x, 0.1), (y, 0.1), (yaw, 3.1)):
        assert np.abs(values).max() <= half
        assert np.histogram(values, 4, (-half, half))[0].min() >= 10
    plate.reset(7)
    digest = plate.digest
    plate.reset(8)
    assert plate.digest != digest
    plate.reset(7)
    assert plate.digest == digest


def test_all_conditions_must_hold(plate):
    plate.reset(1)
    simulation, disc = plate.simulation, plate.task.goal(plate.simulation)
    for off, holds in (([0.0, 0.0, 0.0199], True), ([0.02, 0.02, 0.0199], True),
                       ([0.03, 0.01, 0.0199], False), ([0.0, 0.0, 0.1], False)):
        place(simulation, 'cube', disc + off)
        assert plate.success == holds
        assert (plate.reward == 1.0) == holds and 0.0 <= plate.reward <= 1.0
    place(simulation, 'cube', disc + [0.0, 0.0, 0.0199])
    simulation.data.joint('cube_joint').qvel[0] = 0.03
    simulation.forward()
    assert not plate.success
    site = simulation.robot.end_effectors['right'].grip_site
    place(simulation, 'cube', simulation.data.site(site).xpos)
    assert not plate.success


def test_the_reward_rises_as_the_end_effector_comes_nearer(plate):
    plate.reset(1)
    end_effector, disc = plate.observation['eef_pose'][0, :3], plate.observation['goal']
    found = []
    for angle in np.linspace(0.0, 3.0, 5):  # Always as far from the disc.
        cube = disc + [0.15 * np.cos(angle), 0.15 * np.sin(angle), 0.0199]
        place(plate.simulation, 'cube', cube)
        found.append((math.dist(end_effector, cube), plate.reward))
    far, rewards = np.transpose(sorted(found))
    assert (np.diff(far) > 0.0).all() and (np.diff(rewards) < 0.0).all() and rewards[0] < 1.0


def test_conditions_on_joints_and_boxes(drawer):
    opened = []
    for seed in range(20):
        drawer.reset(seed)
        opened.append(drawer.simulation.data.joint('drawer_slide').qpos[0])
        assert not drawer.success and drawer.reward == 0.0
    assert 0.01 <= min(opened) < 0.02 and 0.04 < max(opened) <= 0.05
    drawer.simulation.data.joint('drawer_slide').qpos[0] = 0.11
    drawer.simulation.forward()
    assert drawer.success and drawer.reward == 1.0


@pytest.mark.full
def test_an_object_that_is_held_counts_as_in_the_tasks_by_classes():
    lifted = {'name': 'lift', 'instruction': 'Lift.', 'horizon': 6,
              'objects': [{'name': 'cube', 'shape': 'box', 'size': [0.04] * 3, 'mass': 0.1,
                           'condim': 4}],
              'start': {'cube': {'position': {'low': [-0.05, -0.05, 0.82],
                                              'high': [0.05, 0.05, 0.82]}}},
              'success': [{'held': 'cube'}, {'position': 'cube', 'low': [-1, -1, 0.92]}]}
    task, like = create_task('lift', description=lifted), create_task('pick_cube')
    episode = Episode(task, Simulation(task.world))
    assert episode.run(like.expert(episode.simulation), 2)
    assert episode.simulation.data.body('cube').xpos[2] > 0.92 and episode.periods > 10


@pytest.mark.full
def test_a_task_of_a_file_runs_from_the_command_line_and_is_repeated_without_the_file(
        file, tmp_path, capsys):
    pytest.importorskip('pyarrow', reason='pyarrow is not installed')
    pytest.importorskip('tqdm', reason='tqdm is not installed')
    pytest.importorskip('mcap', reason='mcap is not installed')
    own = tmp_path / 'soon.yaml'
    own.write_text(PLATE.replace('horizon: 8.0', 'horizon: 0.5'))
    policy = Path(__file__).parents[1] / 'experiments' / 'policies_under_test.py'
    command = ['run', str(own), '--policy', f'{policy}:towards', '--seeds', '0:2', '--out',
               str(tmp_path / 'out'), '--worlds', '1', '--record']
    assert main(command) == 0
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert (summary['episodes'], summary['successes']) == (2, 0)
    own.write_text(PLATE)
    assert main(command) == 1  # It is another run.
    own.unlink()
    capsys.readouterr()
    assert main(['replay', str(tmp_path / 'out' / 'records'), '--verify']) == 0


def test_gymnasium_takes_a_file(file):
    gymnasium = pytest.importorskip('gymnasium', reason='gymnasium is not installed')
    import manip_sim.env  # noqa: F401
    environment = gymnasium.make('manip_sim/Task-v0', task=str(file), robot='UR5e')
    observation, info = environment.reset(seed=3)
    assert observation['goal'].shape == (3,) and not info['success']


def test_a_node_takes_a_file(file):
    from manip_sim.interface.composition import compose_world
    from manip_sim.interface.given_parameters import GivenParameters
    composition = compose_world(GivenParameters({'task': str(file)}))
    assert composition.task.name == 'plate'


def test_a_file_in_a_folder_of_the_user_is_a_task_by_its_name(tmp_path, capsys):
    (tmp_path / 'tasks').mkdir()
    (tmp_path / 'tasks' / 'plate.yaml').write_text(PLATE)
    (tmp_path / 'tasks' / 'broken.yaml').write_text('horizon: 1')
    set_model_path([tmp_path])
    try:
        assert {'plate', 'reach'} <= set(task_names())
        assert create_task('plate', 'UR5e').name == 'plate'
        assert main(['list', 'tasks', '--json']) == 1
        listed = {row['name']: row for row in json.loads(capsys.readouterr().out)['tasks']}
        assert listed['plate']['horizon_s'] == 8.0
        assert listed['plate']['from'] == f'file {tmp_path / "tasks" / "plate.yaml"}'
        assert "needs 'instruction'" in listed['broken']['error']
    finally:
        set_model_path([])


def changed(**values):
    return {'name': 'plate', **yaml.safe_load(PLATE), **values}


@pytest.mark.parametrize('values, message', [
    ({'sucess': []}, "unknown key 'sucess': did you mean 'success'"),
    ({'horizon': 0}, "'horizon' must be above 0, got 0"),
    ({'horizon': 'long'}, "'horizon' must be a number, got 'long'"),
    ({'instruction': ''}, "'instruction' must be one line of text"),
    ({'arena': 'tabel'}, "unknown arena 'tabel': did you mean 'table'"),
    ({'arena': {'name': 'table', 'frction': 1.0}}, "'frction': did you mean 'friction'"),
    ({'arena': {'friction': 1.0}}, "'arena' needs 'name'"),
    ({'gripper': 'Robotiq'}, "unknown gripper 'Robotiq': did you mean"),
    ({'objects': [{'name': 'cube', 'shape': 'bxo', 'size': 1}]}, "1: object 'cube': 'shape'"),
    ({'objects': [3]}, 'object 1 must be keys and values, got 3'),
    ({'goals': [{'name': 'disc', 'radus': 1}]}, "goal 1: unknown key 'radus'"),
    ({'goals': [{'name': 'disc'}, {'name': 'disc'}]}, "goal 'disc': there is a body of this"),
    ({'goals': [{'name': 'cube'}]}, 'cube'),
    ({'start': {'cub': {'position': [0, 0, 1]}}}, "'cub': did you mean 'cube'"),
    ({'start': {'cube': {'position': 1}}}, "start of 'cube': position must be x, y, z"),
    ({'start': {'cube': {'position': {'low': [0, 0, 1], 'high': [0, 0, 0]}}}},
     "'low' must not be above 'high'"),
    ({'start': {'cube': {}}}, "start of 'cube': needs 'position'"),
    ({'start': {'cube': {'position': [0, 0, 1e5]}}}, "start of 'cube': position: 'low'"),
    ({'start': {'cube': {'position': [0, 0, 1], 'yaw': {'low': -1e308, 'high': 1e308}}}},
     "start of 'cube': yaw: 'low' must be at least -10000, got -1e+308"),
    ({'start': {'robot0_joint1': {'position': 100}}},
     'position must be from -2.8973 to 2.8973, the range of the joint, got 100 to 100'),
    ({'reward': [{'speed': 'cube', 'below': 1, 'weight': 1e308}]}, "'weight' must be at most"),
    ({'apart': 5.0}, 'none of 1000 starts has all things apart by 5 m'),
    ({'success': []}, "'success' must have at least 1 of them"),
    ({'success': [{'distnce': ['cube', 'disc'], 'below': 1}]}, "did you mean 'distance'"),
    ({'success': [{'distance': ['cube', 'dsc'], 'below': 1}]}, "'dsc': did you mean 'disc'"),
    ({'success': [{'distance': ['cube', 'disc']}]}, "success 1: needs 'below'"),
    ({'success': [{'distance': ['cube', 'disc'], 'below': math.nan}]}, "'below' must be"),
    ({'success': [{'contact': ['cube', 'cube']}]}, "'contact' must be of two bodies"),
    ({'success': [{'held': 'cube', 'speed': 'cube'}]}, 'must be one kind of condition'),
    ({'success': [{'joint': 'robot0_joint', 'low': 0}]}, "'robot0_joint': did you mean"),
    ({'success': [{'joint': 'cube_joint', 'low': 0}]}, "unknown joint of one axis 'cube_joint'"),
    ({'reward': 'much'}, "'reward'"),
    ({'reward': [{'speed': 'cube', 'below': 1, 'weight': -1}]}, "'weight' must be above 0"),
])
def test_what_is_wrong_is_one_line(values, message):
    with pytest.raises(ModelError) as raised:
        task = create_task('plate', description=changed(**values))
        Episode(task, Simulation(task.world)).reset(0)
    assert message in str(raised.value) and '\n' not in str(raised.value)


KEYS = st.sampled_from([*yaml.safe_load(PLATE), 'low', 'high', 'distance', 'contact', 'weight',
                        'position', 'yaw', 'name', 'below', 'axes', 'radius', 'x'])
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4) | KEYS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=8)


def spoilt(data, value):
    """Return a description of which one part is replaced by something else."""
    if isinstance(value, (dict, list)) and value and data.draw(st.integers(0, 3)):
        keys = sorted(value) if isinstance(value, dict) else list(range(len(value)))
        key, copy = data.draw(st.sampled_from(keys)), value.copy()
        copy[key] = spoilt(data, value[key])
        return copy
    return data.draw(ANYTHING)


@pytest.mark.full
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_no_description_raises_anything_but_one_line(data):
    values = spoilt(data, changed())
    if not isinstance(values, dict):
        return
    try:
        task = create_task('plate', description={'name': 'plate', **values})
        episode = Episode(task, Simulation(task.world))
        episode.reset(0)
        episode.step(np.zeros(episode.actions.size))
        assert math.isfinite(episode.reward)
    except ManipSimError as error:
        assert '\n' not in str(error) and len(str(error)) < 1000


def test_a_robot_that_cannot_and_a_missing_file_are_said(tmp_path, plate):
    with pytest.raises(ModelError, match='plate needs 1 arm with grippers that grasp'):
        create_task('plate', 'Panda', 'none', description=changed())
    with pytest.raises(ModelError, match='no such YAML file: .*none.yaml'):
        create_task(tmp_path / 'none.yaml')
    with pytest.raises(UnknownNameError, match="unknown task 'plat'"):
        create_task('plat')
    with pytest.raises(ModelError, match='has no expert: give a policy'):
        plate.task.expert(plate.simulation)
