# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A ROS node in a process of its own as the policy of a run."""

import os
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed')
parquet = pytest.importorskip('pyarrow.parquet', reason='pyarrow is not installed')
pytest.importorskip('tqdm', reason='tqdm is not installed')
pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, strategies as st  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from manip_sim.cli.main import main  # noqa: E402
from manip_sim.errors import ManipSimError, ModelError  # noqa: E402
from manip_sim.experiments import Experiment, Worker  # noqa: E402
from manip_sim.experiments.experiment import TIMES  # noqa: E402
from manip_sim.experiments.ros_policy import RosPolicy  # noqa: E402
from manip_sim.simulation import Simulation  # noqa: E402
from manip_sim.tasks import create_task, Episode, Setting  # noqa: E402
from manip_sim.testing.domains import reserve_domain  # noqa: E402
from pages import blocks, DOCS  # noqa: E402

NODE = Path(__file__).with_name('node_under_test.py')
IN_PROCESS = Path(__file__).with_name('policies_under_test.py')


@pytest.fixture
def node(monkeypatch):
    """Return how to start the node in a domain of its own; it is ended afterwards."""
    domain, lock = reserve_domain()
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    started = []

    def start(kind='stamped', dies_after=-1, file=NODE):
        started.append(subprocess.Popen(
            [sys.executable, str(file), kind, str(dies_after)], env=os.environ))
        return started[-1]
    yield start
    for process in started:
        process.kill()
        process.wait()
    os.close(lock)


def run(out, policy, *more, seeds='0:3'):
    code = main(['run', 'reach', '--policy', policy, '--seeds', seeds, '--out', str(out), *more])
    table = parquet.read_table(out / 'episodes.parquet')
    return code, table.drop_columns(list(TIMES)).to_pylist()


def rows_of(policy, limit_s=10.0, seeds=range(3)):
    """Return the rows of a policy, run in this process."""
    worker = Worker(Experiment(Setting('reach'), policy, None, limit_s))
    return [worker.run(seed) for seed in seeds]


@pytest.mark.full
def test_the_node_of_the_guide_gives_the_rows_of_the_same_policy_in_process(node, tmp_path):
    (block,) = [block for block in blocks(DOCS / 'how_to' / 'experiments.md')
                if block.file == 'towards.py']
    (tmp_path / 'towards.py').write_text(block.text)
    node(file=tmp_path / 'towards.py')
    code, rows = run(tmp_path / 'node', 'ros:/policy')
    assert code == 0 and all(row['success'] for row in rows)
    like = rows_of(f'{IN_PROCESS}:Towards')
    assert [row['digest'] for row in rows] == [row.digest for row in like]
    assert [row['periods'] for row in rows] == [row.periods for row in like]


@pytest.mark.full
def test_an_action_may_have_names_in_any_order(node):
    node('names')
    assert rows_of('ros:/policy') == rows_of(f'{IN_PROCESS}:Towards')


@pytest.mark.full
def test_a_node_that_is_killed_costs_its_episodes_and_not_the_run(node, tmp_path, capsys):
    killed = node(dies_after=15)
    code, rows = run(tmp_path / 'out', 'ros:/policy', '--policy-limit', '4', seeds='0:2')
    assert code == 1 and killed.poll() is not None
    assert rows[0]['success'] and not rows[0]['error'] and not rows[-1]['success']
    assert '/policy/action' in rows[-1]['error'] and 'for 4 s' in rows[-1]['error']
    assert 'failed' in capsys.readouterr().out


@pytest.mark.full
@pytest.mark.parametrize('kind, message', [
    ('nan', 'finite'), ('unknown', "unknown name in an action 'elbow'"),
    ('unstamped', 'the last action has the stamp 0 ns, and that of the observation is')])
def test_an_answer_that_cannot_be_used_costs_the_episode(node, kind, message):
    node(kind)
    (row,) = rows_of('ros:/policy', 5.0, range(1))
    assert not row.success and message in row.error and '\n' not in row.error


def test_without_a_node_each_episode_fails_with_a_reason(node):
    assert [row.error for row in rows_of('ros:/policy', 0.2, range(2))] == [
        'act() of the policy: ManipSimError: no node publishes /policy/action: nothing for 0.2 s'
    ] * 2


def test_what_cannot_be_used_is_said_before_anything_is_written(tmp_path, capsys):
    for more in (['--worlds', '2'], ['--engine', 'ray']):
        assert main(['run', 'reach', '--policy', 'ros:/policy', '--seeds', '0:1', '--out',
                     str(tmp_path / 'x'), *more]) == 1
        assert 'a ROS node acts in one episode at a time' in capsys.readouterr().err
    for name in ('ros:', 'ros:policy', 'ros:/1', 'ros:/a//b'):
        with pytest.raises(ModelError, match='must be such as ros:/policy') as raised:
            Worker(Experiment(Setting('reach'), name))
        assert '\n' not in str(raised.value)
    assert not (tmp_path / 'x').exists()


@pytest.fixture(scope='module')
def episode():
    task = create_task('reach', 'Panda')
    made = Episode(task, Simulation(task.world))
    made.reset(0)
    return made


@pytest.mark.full
@given(data=st.data(), stamps=st.lists(st.integers(-1, 2), max_size=3))
def test_any_answer_is_an_action_or_an_error_on_one_line(episode, data, stamps):
    names = episode.actions.names
    name = st.sampled_from(names) | st.text(max_size=3)
    answer = JointState(
        name=data.draw(st.lists(name, max_size=9) | st.permutations(names) | st.just([])),
        position=data.draw(st.lists(st.floats(), min_size=6, max_size=8) | st.lists(
            st.floats(-1.0, 1.0), min_size=len(names), max_size=len(names)) | st.just([])))
    policy = object.__new__(RosPolicy)
    policy._episode, policy._stamp_ns, policy._answer = episode, 10**9, None
    for sec in stamps:
        answer.header.stamp.sec = sec
        policy._receive(answer)
    # Of what came, only the answer to this observation counts.
    assert (policy._answer is answer) == (1 in stamps)
    try:
        numbers = policy._numbers(answer)
        if len(answer.name):
            assert dict(zip(names, numbers.tolist())) == pytest.approx(
                dict(zip(answer.name, answer.position)), nan_ok=True)
        episode.step(numbers)
    except ManipSimError as error:
        assert '\n' not in str(error) and len(str(error)) < 1000
    else:
        assert len(numbers) == len(names) and np.isfinite(numbers).all()
