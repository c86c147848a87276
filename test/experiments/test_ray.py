# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Runs on Ray: the rows are those of processes, also if a node is killed on the way."""

from pathlib import Path
import time

import pytest

ray = pytest.importorskip('ray', reason='Ray is not installed; it is the extra ray')
pytest.importorskip('pyarrow', reason='pyarrow is not installed')

from ray.cluster_utils import Cluster  # noqa: E402

from manip_sim.errors import ManipSimError  # noqa: E402
from manip_sim.experiments import Experiment  # noqa: E402
from manip_sim.experiments.processes import run_on_ray  # noqa: E402
from manip_sim.experiments.processes import run_in_processes  # noqa: E402
from manip_sim.tasks import Setting  # noqa: E402

pytestmark = [pytest.mark.filterwarnings('ignore')]  # Of Ray, which leaves sockets and files open.
EXPERIMENT = Experiment(
    Setting('reach'), f'{Path(__file__).with_name("policies_under_test.py")}:Towards')


@pytest.fixture
def cluster():
    """Return a cluster of two nodes with one processor each, which this process is part of."""
    found = Cluster(initialize_head=True, head_node_args={'num_cpus': 1})
    found.second = found.add_node(num_cpus=1)
    ray.init(address=found.address, log_to_driver=False)
    yield found
    ray.shutdown()
    found.shutdown()


def living_nodes():
    return len([node for node in ray.nodes() if node['Alive']])


def test_a_node_that_is_killed_loses_and_doubles_nothing(cluster):
    seeds, rows = list(range(160)), []
    for row in run_on_ray(EXPERIMENT, seeds, None, None):
        rows.append(row)
        if len(rows) == 8:
            assert living_nodes() == 2
            cluster.remove_node(cluster.second, allow_graceful=False)
            left_at_kill = len(seeds) - len(rows)
    # Ray learns of it by missing heartbeats, seconds later.
    end = time.monotonic() + 60.0
    while living_nodes() != 1:
        assert time.monotonic() < end
        time.sleep(0.1)
    assert left_at_kill == 152
    assert sorted(row.seed for row in rows) == seeds
    expected = run_in_processes(EXPERIMENT, seeds, 2)
    assert sorted(rows, key=lambda row: row.seed) == sorted(expected, key=lambda row: row.seed)


def test_a_task_that_cannot_be_used_is_said(cluster):
    with pytest.raises(ManipSimError, match='unknown task'):
        list(run_on_ray(Experiment(Setting('pick_cub'), 'expert'), [0], None, None))


@pytest.mark.parametrize('address', ['127.0.0.1:9', 'ray://127.0.0.1:9', '127.0.0.1:99999'])
def test_a_cluster_that_is_not_there_is_said_at_once(address):
    with pytest.raises(ManipSimError, match='no Ray cluster answers at '):
        list(run_on_ray(EXPERIMENT, [0], address, None))


def test_a_policy_that_ends_its_process_or_hangs_costs_its_own_seed_on_ray_too(cluster):
    for policy, limit_s in (('AlwaysDeadly', None), ('Hangs', 2.0)):
        experiment = Experiment(Setting('reach'), EXPERIMENT.policy.replace('Towards', policy),
                                limit_s=limit_s)
        rows = sorted(run_on_ray(experiment, range(4), None, None), key=lambda row: row.seed)
        assert [bool(row.error) for row in rows] == [False, False, True, False]
        assert rows == sorted(
            run_in_processes(experiment, range(4), 1), key=lambda row: row.seed)
