# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The file beside a policy: names, order, units and rates; wall times of answers."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

parquet = pytest.importorskip('pyarrow.parquet', reason='pyarrow is not installed')
pytest.importorskip('tqdm', reason='tqdm is not installed')

from manip_sim.cli.main import main  # noqa: E402
from manip_sim.errors import ModelError  # noqa: E402
from manip_sim.experiments import Experiment, Worker  # noqa: E402
from manip_sim.experiments.policies import (  # noqa: E402
    check_interface, inputs, load_policy, read_interface)
from manip_sim.tasks import interface_of, Setting  # noqa: E402

POLICIES = Path(__file__).with_name('policies_under_test.py')


@pytest.fixture(scope='module')
def episode():
    return Setting('reach').create_episode()


@pytest.fixture(scope='module')
def interface(episode):
    return interface_of(episode)


def test_the_interface_names_each_number_in_its_order_and_unit(episode, interface):
    assert json.loads(json.dumps(interface)) == interface
    observation, model = episode.observation, episode.simulation.model
    assert list(interface['observation']) == list(observation)
    for key, described in interface['observation'].items():
        assert tuple(described['shape']) == observation[key].shape
        assert len(described.get('names', ())) in (0, observation[key].shape[0])
        assert len(described.get('units', ())) in (0, observation[key].shape[-1])
    assert interface['control_hz'] == 20.0
    # By MuJoCo: the addresses of the joints in qpos.
    names = interface['observation']['joint_position']['names']
    positions = [episode.simulation.data.qpos[model.joint(name).qposadr[0]] for name in names]
    np.testing.assert_allclose(observation['joint_position'], positions)
    units = interface['observation']['joint_position']['units']
    slides = [int(model.joint(name).type[0]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
              for name in names]
    assert units == ['m' if slide else 'rad' for slide in slides] and {*slides} == {True, False}
    assert interface['action']['units'] == [*['0.05 m'] * 3, *['0.5 rad'] * 3, 'half stroke']


@pytest.mark.full
@pytest.mark.parametrize('action, unit', [
    ('joint_position', 'rad'), ('joint_velocity', 'rad/s'), ('joint_effort', 'N m')])
def test_actions_of_joints_have_the_units_of_their_mode(action, unit):
    found = interface_of(Setting('reach', action=action, control_hz=25.0).create_episode())
    assert found['control_hz'] == 25.0
    assert found['action']['units'] == [*[unit] * 7, 'half stroke']
    assert len(found['action']['names']) == len(found['action']['bounds']) == 8


def changed(interface, *path, value):
    """Return an interface with another value at a place."""
    found = json.loads(json.dumps(interface))
    part = found
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    return found


def swapped(names):
    return [names[1], names[0], *names[2:]]


@pytest.mark.parametrize('change, text', [
    (lambda own: changed(own, 'control_hz', value=50.0), 'control_hz: it needs 50.0, this is 20'),
    (lambda own: changed(own, 'action', 'kind', value='joint_position'),
     "kind of actions: it needs 'joint_position', this is 'osc_pose'"),
    (lambda own: changed(own, 'action', 'units', 0, value='m'),
     "units of actions, number 0: it needs 'm', this is '0.05 m'"),
    (lambda own: changed(own, 'action', 'names', value=[]), 'names of actions: it needs []'),
    (lambda own: changed(own, 'observation', 'joint_position', 'names', value=swapped(
        own['observation']['joint_position']['names'])),
     "names of joint_position, number 0: it needs 'robot0_joint2', this is 'robot0_joint1'"),
    (lambda own: changed(own, 'observation', 'eef_pose', 'columns', value=[
        'x', 'y', 'z', 'qw', 'qx', 'qy', 'qz']),
     "columns of eef_pose, number 3: it needs 'qw', this is 'qx'"),
    (lambda own: changed(own, 'observation', 'joint_velocity', 'units', 2, value='deg/s'),
     "units of joint_velocity, number 2: it needs 'deg/s', this is 'rad/s'"),
    (lambda own: changed(own, 'observation', 'goal', 'shape', value=[3, 1]),
     'shape of goal: it needs [3, 1], this is [3]'),
    (lambda own: changed(own, 'observation', 'image/agentview', value={}),
     "observation 'image/agentview': it needs 'there', this is 'not there'")])
def test_another_rate_order_or_unit_is_rejected_with_the_difference(interface, change, text):
    check_interface(interface, interface, 'here')
    with pytest.raises(ModelError) as raised:
        check_interface(change(interface), interface, 'policy.interface.json')
    assert str(raised.value).startswith('policy.interface.json: the policy was made for other')
    assert text in str(raised.value)


def test_what_a_file_leaves_out_may_be_anything(interface):
    for expected in ({}, {'control_hz': 20}, {'action': {'kind': 'osc_pose'}},
                     {'observation': {'goal': {}}}):
        check_interface(expected, interface, 'here')


@pytest.mark.parametrize('content, text', [
    ('{', 'cannot be read'), ('[]', 'an interface must be an object'),
    ('{"format": 2}', 'has the format 2, not 1'),
    ('{"control_rate": 2}', "unknown key 'control_rate'"),
    ('{"action": 3}', 'action must be an object'),
    ('{"action": {"unit": []}}', "unknown key 'unit': did you mean 'units'"),
    ('{"observation": []}', 'observation must be an object, by key'),
    ('{"observation": {"goal": []}}', 'observation must be an object'),
    ('[' * 100000, 'cannot be read')])
def test_a_file_that_is_no_interface_is_told_in_one_line(tmp_path, content, text):
    file = tmp_path / 'policy.py.interface.json'
    file.write_text(content)
    with pytest.raises(ModelError) as raised:
        read_interface(file)
    assert text in str(raised.value) and str(file) in str(raised.value)
    assert '\n' not in str(raised.value)


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_a_run_is_rejected_by_the_file_beside_its_policy_and_takes_that_of_a_run(
        tmp_path, capsys, episode):
    policy = tmp_path / 'policy.py'
    policy.write_text(POLICIES.read_text())
    words = ['run', 'reach', '--policy', f'{policy}:Towards', '--seeds', '0:1', '--worlds', '1']
    assert main([*words, '--out', str(tmp_path / 'first')]) == 0
    beside = tmp_path / 'policy.py.interface.json'
    beside.write_bytes((tmp_path / 'first' / 'interface.json').read_bytes())
    assert main([*words, '--out', str(tmp_path / 'second')]) == 0
    capsys.readouterr()
    assert main([*words, '--control-hz', '50', '--out', str(tmp_path / 'third')]) == 1
    error = capsys.readouterr().err
    assert f'{beside}: the policy was made for other episodes: control_hz: it needs 20.0' in error
    assert error.count('\n') == 1 and not (tmp_path / 'third').exists()
    beside.write_text('{')
    with pytest.raises(ModelError, match='cannot be read'):
        load_policy(f'{policy}:Towards', episode)


def test_a_network_gets_the_observations_that_its_file_lists():
    observation = {'b': np.ones((1, 2)), 'a': np.zeros((1, 3)), 'image/top': np.ones((1, 2, 2, 3))}
    assert inputs(observation, ['x'], None)['x'].tolist() == [[0.0] * 3 + [1.0] * 2]
    assert inputs(observation, ['x'], ['b'])['x'].tolist() == [[1.0, 1.0]]


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_wall_times_of_answers_are_in_rows_summaries_and_records(tmp_path, capsys):
    pytest.importorskip('mcap', reason='mcap is not installed')
    from manip_sim.records.recorded import Record
    out = tmp_path / 'run'
    assert main(['run', 'reach', '--policy', f'{POLICIES}:Thinks', '--seeds', '0:1', '--worlds',
                 '1', '--out', str(out), '--record']) == 0
    (row,) = parquet.read_table(out / 'episodes.parquet').to_pylist()
    assert 0.01 < row['answer_mean_s'] < row['answer_max_s'] < row['wall_time_s']
    assert row['answer_max_s'] >= 0.04
    assert row['wall_time_s'] >= row['periods'] * 0.01 + 0.03
    found = json.loads((out / 'summary.json').read_text())
    assert found['answer_time_s'] == {'mean': row['answer_mean_s'], 'max': row['answer_max_s']}
    (recorded,) = Record(out / 'records' / '0.mcap').episodes()
    times = [message.data for message in recorded.decoded(
        '/episode/answer_time', 'std_msgs/Float64')]
    # A machine with other work makes any of them longer.
    assert len(times) == row['periods'] and max(times) == row['answer_max_s']
    assert times[1] >= 0.04 and min(times) >= 0.01
    assert np.mean(times) == pytest.approx(row['answer_mean_s'])
    assert ' of wall time' in capsys.readouterr().out


def test_rows_are_equal_whatever_their_wall_times():
    worker = Worker(Experiment(Setting('reach'), f'{POLICIES}:Towards'))
    first, second = worker.run(0), worker.run(0)
    assert first == second and first.wall_time_s != second.wall_time_s
