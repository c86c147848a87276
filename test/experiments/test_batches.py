# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Policies that act in several episodes at once, with the rows of those that act in one."""

from dataclasses import replace
import json
from pathlib import Path

import pytest

from manip_sim.cli.main import main  # noqa: E402
from manip_sim.errors import ModelError
from manip_sim.experiments import Experiment, Worker
from manip_sim.tasks import Setting

POLICIES = Path(__file__).with_name('policies_under_test.py')
IN_TIME, LATE = Setting('reach'), Setting('reach', answer_time={'time': 0.13, 'jitter': 0.02})


def fields(row):
    """Return what is the same in each run: not the wall time."""
    return row.seed, row.success, row.returned, row.periods, row.digest, row.error


@pytest.mark.parametrize('setting', [IN_TIME, LATE], ids=['in time', 'late'])
def test_a_batch_has_the_rows_of_single_episodes(setting):
    alone = Worker(Experiment(setting, f'{POLICIES}:Towards'))
    together = Worker(Experiment(setting, f'{POLICIES}:Together', batch=3))
    for seeds in ([0, 1, 2], [7, 3], [4]):
        rows = sorted(together.run_at_once(seeds), key=lambda row: seeds.index(row.seed))
        assert [fields(row) for row in rows] == [fields(alone.run(seed)) for seed in seeds]
        assert all(row.success for row in rows)


@pytest.mark.usefixtures('forked')
def test_failures_are_in_the_rows_that_they_concern(tmp_path):
    words = ['run', 'reach', '--policy', f'{POLICIES}:TogetherSometimes', '--seeds', '0:12',
             '--batch', '3', '--out', str(tmp_path / 'out')]
    assert main(words) == 1
    import pyarrow.parquet
    table = pyarrow.parquet.read_table(tmp_path / 'out' / 'episodes.parquet').to_pylist()
    errors = {row['seed']: row['error'] for row in table}
    assert sorted(errors) == list(range(12))
    assert [seed for seed, error in errors.items() if not error] == [0, 1, 9, 11]
    assert 'must be finite' in errors[2]
    assert all('ZeroDivisionError: five' in errors[seed] for seed in (3, 4, 5))
    assert all('must return an array of the shape (3, 7)' in errors[seed] for seed in (6, 7, 8))
    # Others of its batch are run again without it.
    assert 'died 3 times, exit code 3' in errors[10]
    description = json.loads((tmp_path / 'out' / 'run.json').read_text())
    assert description['batch'] == 3
    assert Experiment.of(description) == replace(Experiment.of(description), batch=3)


@pytest.mark.parametrize('policy', ['expert', 'ros:/policy'])
def test_who_acts_in_one_episode_at_a_time_says_so(policy):
    with pytest.raises(ModelError, match=f"policy '{policy}' .* needs no --batch"):
        Worker(Experiment(IN_TIME, policy, batch=2))
