# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Paired comparison of runs: statistics against scipy and by enumeration, tables, bad input."""

import functools
import json
import math
from pathlib import Path

import numpy as np
import pytest
import scipy

pytest.importorskip('pyarrow', reason='pyarrow is not installed')
pytest.importorskip('tqdm', reason='tqdm is not installed')

from manip_sim.cli.main import main  # noqa: E402
from manip_sim.errors import ModelError  # noqa: E402
from manip_sim.experiments import Experiment  # noqa: E402
from manip_sim.experiments.comparison import (  # noqa: E402
    compare, difference_interval, first_difference, mcnemar_p, Pairs, seeds_to_add)
from manip_sim.experiments.run_folder import read_rows, read_run, spans  # noqa: E402
from manip_sim.tasks import Setting  # noqa: E402
from manip_sim.tasks.fixtures import Reach  # noqa: E402

POLICIES = Path(__file__).with_name('policies_under_test.py')
#: One of the description of a run of reach.
ABOUT = {'task': 'reach', 'robot': 'Panda', 'gripper': 'default', 'action': 'osc_pose',
         'control_hz': 20.0, 'latency': {'command_s': 0.0, 'state_s': 0.0,
                                         'command_jitter_s': 0.0, 'state_jitter_s': 0.0},
         'cameras': [], 'image_size': None, 'composition': {}, 'policy': 'expert',
         'policy_content': None, 'versions': {'manip_sim': '1', 'mujoco': '4'},
         'period_s': 0.05}


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    """Let no line of a table be wrapped."""
    monkeypatch.setenv('COLUMNS', '1000')


def write_run(folder, outcomes, seeds=None, errors=(), **about):
    """Write the folder of a run with some outcomes by seed."""
    folder.mkdir()
    text = spans([*outcomes]) if seeds is None else seeds
    (folder / 'run.json').write_text(json.dumps({**ABOUT, 'seeds': text, **about}))
    (folder / 'rows-1-of-1.jsonl').write_text(''.join(json.dumps({
        'seed': seed, 'success': success, 'return': 1.0, 'periods': 7, 'digest': f'{success}',
        'error': 'boom' if seed in errors else ''}) + '\n' for seed, success in outcomes.items()))
    return folder


def outcomes(both, only_first, only_second, neither):
    """Return the outcomes by seed of two runs with so many pairs of each kind."""
    pairs = [(True, True)] * both + [(True, False)] * only_first + (
        [(False, True)] * only_second) + [(False, False)] * neither
    return ({seed: pair[i] for seed, pair in enumerate(pairs)} for i in range(2))


def two_runs(folder, *counts, **about):
    first, second = outcomes(*counts)
    return write_run(folder / 'first', first), write_run(folder / 'second', second, **about)


def compared(*words):
    return main(['compare', *map(str, words)])


# ---------------------------------------------------------------------- statistics


@pytest.mark.parametrize('pair', [(0, 0), (1, 0), (0, 9), (3, 4), (12, 2), (40, 60), (700, 800)])
def test_mcnemars_test_is_the_binomial_test_of_the_pairs_that_differ(pair):
    expected = scipy.stats.binomtest(min(pair), sum(pair)).pvalue if sum(pair) else 1.0
    assert mcnemar_p(*pair) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize('pair', [(0, 0), (1, 0), (0, 9), (4, 4), (3, 4), (12, 2), (700, 800)])
def test_the_mid_p_value_counts_half_of_what_is_as_unequal(pair):
    fewer, count = min(pair), sum(pair)
    one_sided = scipy.stats.binom.cdf(fewer - 1, count, 0.5) + (
        scipy.stats.binom.pmf(fewer, count, 0.5) / 2.0)
    assert mcnemar_p(*pair, mid=True) == pytest.approx(2.0 * one_sided, rel=1e-9)


@functools.cache
def tables_called_worse(count):
    """Return the numbers of pairs of each kind of runs whose second policy is called worse."""
    tables = [(b, c, count - b - c) for b in range(count + 1) for c in range(count + 1 - b)]
    return np.array([(b, c, same) for b, c, same in tables if Pairs(same, b, c, 0).is_worse(0.0)])


def share_called_worse(count, only_first, only_second):
    """Return the share of runs of so many seeds in which the second policy is called worse."""
    tables = tables_called_worse(count)
    shares = (only_first, only_second, 1.0 - only_first - only_second)
    return scipy.stats.multinomial(count, shares).pmf(tables).sum()


@pytest.mark.parametrize('count', [20, 40, 60])
def test_a_policy_as_good_is_called_worse_in_at_most_25_of_1000_cases(count):
    assert max(share_called_worse(count, share, share)
               for share in (0.02, 0.05, 0.1, 0.2, 0.3, 0.45)) <= 0.025


def test_a_policy_that_fails_with_a_tenth_of_the_seeds_more_is_called_worse_with_66():
    # With the exact test, it took 78.
    assert share_called_worse(66, 0.1, 0.0) > 0.8


def score(only_first, only_second, count, assumed):
    """Return the score statistic of a difference, with the likelihood maximized by scipy."""
    same = count - only_first - only_second

    def cost(first_only):
        second_only = first_only + assumed
        terms = ((only_first, first_only), (only_second, second_only),
                 (same, 1.0 - first_only - second_only))
        return -sum(k * math.log(max(p, 1e-300)) for k, p in terms if k)
    lowest, highest = max(0.0, -assumed), (1.0 - assumed) / 2.0
    share = scipy.optimize.minimize_scalar(
        cost, bounds=(lowest, highest), method='bounded', options={'xatol': 1e-12}).x
    variance = count * (2.0 * share + assumed * (1.0 - assumed))
    return (only_second - only_first - count * assumed) / math.sqrt(variance)


@pytest.mark.parametrize('only_first, only_second, count', [
    (3, 9, 40), (12, 2, 100), (0, 5, 20), (7, 7, 60), (1, 0, 3)])
def test_the_interval_of_a_difference_ends_where_the_score_test_rejects(
        only_first, only_second, count):
    low, high = difference_interval(only_first, only_second, count)
    assert score(only_first, only_second, count, low) == pytest.approx(1.959964, abs=1e-3)
    assert score(only_first, only_second, count, high) == pytest.approx(-1.959964, abs=1e-3)
    assert difference_interval(only_second, only_first, count) == pytest.approx((-high, -low))


def test_the_interval_of_a_difference_has_ends_that_are_known():
    z2 = 1.959964**2
    # Without a pair that differs, it is that of Wilson's score for 0 of n, on both sides.
    assert difference_interval(0, 0, 20) == pytest.approx((-z2 / (20 + z2), z2 / (20 + z2)))
    low, high = difference_interval(0, 20, 20)
    assert high == 1.0 and 0.6 < low < 1.0
    assert difference_interval(20, 0, 20) == pytest.approx((-1.0, -low))
    assert difference_interval(1, 0, 1) == pytest.approx((-1.0, difference_interval(1, 0, 1)[1]))


def test_the_interval_of_a_difference_contains_it_in_95_of_100_cases():
    count = 40
    cells = [(b, c) for b in range(count + 1) for c in range(count + 1 - b)]
    limits = np.array([difference_interval(b, c, count) for b, c in cells])
    tables = np.array([(b, c, count - b - c) for b, c in cells])
    covered = []
    for only_first, only_second in ((0.1, 0.1), (0.15, 0.05), (0.3, 0.1), (0.02, 0.12)):
        shares = (only_first, only_second, 1.0 - only_first - only_second)
        weight = scipy.stats.multinomial(count, shares).pmf(tables)
        truth = only_second - only_first
        covered.append(weight[(limits[:, 0] <= truth) & (truth <= limits[:, 1])].sum())
    assert min(covered) > 0.93 and max(covered) < 0.98


# ---------------------------------------------------------------------- tables and exit codes


def test_the_table_has_the_numbers_of_the_pairs(tmp_path, capsys):
    first, second = two_runs(
        tmp_path, 60, 25, 5, 10, policy='other.pt', policy_content='abcdefgh9')
    assert compared(first, second) == 0
    lines = capsys.readouterr().out.splitlines()
    assert '85 of 100  85.0 %  76.7 to 90.7 %' in lines[2]
    assert 'other.pt (abcdefgh)' in lines[3] and '65 of 100  65.0 %' in lines[3]
    (found,) = [line for line in lines if '-20.0 %' in line]
    assert found.split()[-7:] == ['%', '60', '25', '5', '10', '0.000325', '0.000192']
    assert '30 seeds with different success' in lines
    assert '70 of 100 episodes are equal to the last bit in all runs' in lines
    assert [line.split() for line in lines if line.split()[:1] == ['60']] == [
        ['60', 'success', 'no', 'success']]


def test_the_comparison_as_json(tmp_path, capsys):
    first, second = two_runs(tmp_path, 60, 25, 5, 10)
    assert compared(first, second, '--json', '--threshold', '0.05') == 1
    found = json.loads(capsys.readouterr().out)
    assert found['seeds'] == '0:100' and found['worse'] == [str(second)]
    against = found['runs'][1].pop('against_first')
    assert against['difference'] == -0.2 and against['mcnemar_p'] == pytest.approx(0.000325, 0.01)
    assert against['mcnemar_mid_p'] == mcnemar_p(25, 5, mid=True)
    assert against['difference_95'] == [*difference_interval(25, 5, 100)]
    assert found['differing_seeds'] == [*range(60, 90)]


@pytest.mark.parametrize('counts, threshold, code, text', [
    ((60, 25, 5, 10), '0', 1, 'second: worse by more than 0 %'),
    ((60, 25, 5, 10), '0.05', 1, 'second: worse by more than 5 %'),
    ((60, 25, 5, 10), '0.2', 0, 'these seeds do not tell whether it is worse by more than 20 %'),
    ((60, 25, 5, 10), '0.4', 0, 'second: not worse by more than 40 %'),
    # The score interval is -90.3 to -1.6 %, the mid-p-value 0.063.
    ((2, 4, 0, 0), '0', 0, 'these seeds do not tell whether it is worse by more than 0 %'),
    ((60, 5, 25, 10), '0', 0, 'second: not worse by more than 0 %')])
def test_the_exit_code_is_1_past_the_threshold(tmp_path, capsys, counts, threshold, code, text):
    assert compared(*two_runs(tmp_path, *counts), '--threshold', threshold) == code
    assert text in capsys.readouterr().out


def test_each_of_several_runs_is_compared_with_the_first(tmp_path, capsys):
    first, second = two_runs(tmp_path, 60, 25, 5, 10)
    third = write_run(tmp_path / 'third', dict.fromkeys(range(100), True))
    assert compared(first, second, third, '--threshold', '0.01') == 1
    text = capsys.readouterr().out
    assert f'{second}: worse' in text and f'{third}: not worse' in text
    assert compared(second, first, third, '--threshold', '0.01') == 0


# ---------------------------------------------------------------------- runs that do not fit


@pytest.mark.parametrize('about, text', [
    ({'task': 'push_cube'}, "its task is 'push_cube', not 'reach'"),
    ({'robot': 'UR5e'}, "its robot is 'UR5e', not 'Panda'"),
    ({'control_hz': 10.0}, 'its control_hz is 10.0, not 20.0'),
    ({'noise': {'noise.joint_position': 0.1}}, "its noise is {'noise.joint_position': 0.1}, not "
                                               'None'),
    ({'composition': {'randomization': {}}}, "its composition is {'randomization': {}}, not {}")])
def test_runs_of_other_episodes_are_rejected_unless_asked(tmp_path, capsys, about, text):
    first, second = two_runs(tmp_path, 3, 1, 1, 1, **about)
    assert compared(first, second) == 2
    error = capsys.readouterr().err
    assert text in error and error.count('\n') == 1
    (name,) = about
    assert f'--across {name} compares them all the same' in error
    assert compared(first, second, '--across', name) == 0


def test_another_version_is_noted(tmp_path, capsys):
    assert compared(*two_runs(tmp_path, 3, 1, 1, 1, versions={'manip_sim': '2', 'mujoco': '4'})
                    ) == 0
    assert 'second: manip_sim is 2, not 1' in capsys.readouterr().out


def test_only_common_seeds_are_compared(tmp_path, capsys):
    first = write_run(tmp_path / 'first', dict.fromkeys(range(10), True))
    second = write_run(tmp_path / 'second', dict.fromkeys(range(6, 20), False))
    assert compared(first, second) == 0
    text = capsys.readouterr().out
    assert '0 of 4' in text and '4 of 4' in text
    assert f"{first}: 6 seeds left out, which another run does not have: '0:6'" in text
    assert f'{second}: 10 seeds left out' in text
    third = write_run(tmp_path / 'third', dict.fromkeys(range(30, 32), False))
    assert compared(first, third) == 2
    assert 'no seed in common: ' in capsys.readouterr().err


def test_an_unfinished_run_and_errors_are_noted(tmp_path, capsys):
    first = write_run(tmp_path / 'first', dict.fromkeys(range(10), True))
    second = write_run(tmp_path / 'second', {0: True, 1: False}, seeds='0:10', errors=[1])
    assert compared(first, second) == 0
    text = capsys.readouterr().out
    assert 'second is not finished: it has 2 of 10 episodes' in text
    assert 'second: 1 episode without success because of an error' in text
    empty = write_run(tmp_path / 'empty', {}, seeds='0:10')
    assert compared(first, empty) == 2
    assert "empty has 'none'" in capsys.readouterr().err


@pytest.mark.parametrize('words, text', [
    (['{0}'], 'give at least two runs'), ([], 'the following arguments are required'),
    (['{0}', '{0}'], 'is there twice'), (['{0}', '{0}/../first'], 'is there twice'),
    (['{0}', 'nowhere'], 'nowhere is not the folder of a run: it has no run.json'),
    (['{0}', '{1}', '--until', '0'], '--until must be above 0'),
    (['{0}', '{1}', '--until', 'nan'], 'must be a finite number'),
    (['{0}', '{1}', '--until', '2'], '--until is a share of episodes from 0 to 1, got 2'),
    (['{0}', '{1}', '--threshold', '-1'], '--threshold is a share of episodes from 0 to 1'),
    (['{0}', '{1}', '--most', '9'], '--most is for --until'),
    (['{0}', '{1}', '--across', 'robbot'], "no run has the option 'robbot': did you mean 'robot'"),
    (['{0}', '{1}', '--video', '{0}/run.json'], 'run.json')])
def test_wrong_use_is_exit_code_2_and_one_line(tmp_path, capsys, words, text):
    folders = two_runs(tmp_path, 3, 1, 1, 1)
    try:
        code = compared(*(word.format(*folders) for word in words))
    except SystemExit as ended:
        code = ended.code
    error = capsys.readouterr().err
    assert code == 2 and text in error and error.count('\n') == 1


@pytest.mark.parametrize('file, content, text', [
    ('run.json', '{', 'run.json does not belong to a run'),
    ('run.json', '[]', 'run.json does not belong to a run'),
    ('run.json', '{"seeds": "0:3"}', 'it needs the seeds and the length of a control period'),
    ('run.json', '{"seeds": 3, "period_s": 0.05}', 'it needs the seeds'),
    ('run.json', '{"seeds": "x", "period_s": 0.05}', "seeds 'x'"),
    ('run.json', '{"seeds": "0:6", "period_s": 0.05}', "its action is None, not 'osc_pose'"),
    ('rows-1-of-1.jsonl', 'null\n', 'rows-1-of-1.jsonl: line 1 is not a row'),
    ('rows-1-of-1.jsonl', '{"seed": 1}\n', 'line 1 is not a row'),
    ('rows-1-of-1.jsonl', '{"seed": "1", "success": 1, "return": 0.0, "periods": 1, "digest": "", '
     '"error": ""}\n', 'line 1 is not a row'),
    ('rows-1-of-1.jsonl', b'\xff\xfe\n', 'rows-1-of-1.jsonl'),
    ('rows-2-of-2.jsonl', None, 'two shards have the seed 0')])
def test_damaged_files_are_told_in_one_line(tmp_path, capsys, file, content, text):
    first, second = two_runs(tmp_path, 3, 1, 1, 1)
    if content is None:
        content = (second / 'rows-1-of-1.jsonl').read_bytes()
    (second / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    assert compared(first, second) == 2
    error = capsys.readouterr().err
    assert text in error and error.count('\n') == 1


def test_a_row_that_is_cut_off_counts_as_missing(tmp_path, capsys):
    first, second = two_runs(tmp_path, 3, 1, 1, 1)
    file = second / 'rows-1-of-1.jsonl'
    file.write_text(file.read_text()[:-5])
    assert compared(first, second) == 0
    assert 'second is not finished: it has 5 of 6 episodes' in capsys.readouterr().out


def test_a_policy_that_has_changed_since_is_noted(tmp_path, capsys):
    policy = tmp_path / 'policy.py'
    policy.write_text('A = 1\n')
    first, second = two_runs(tmp_path, 3, 1, 1, 1, policy=f'{policy}:act', policy_content='other')
    assert compared(first, second) == 0
    assert 'policy.py:act has changed since' in capsys.readouterr().out
    policy.unlink()  # It may be on another machine.
    assert compared(first, second) == 0
    assert 'has changed' not in capsys.readouterr().out


# ---------------------------------------------------------------------- more seeds


def test_seeds_that_one_run_lacks_come_first_and_then_as_many_as_are_needed(tmp_path):
    first = read_run(write_run(tmp_path / 'first', dict.fromkeys(range(40), True)))
    second = read_run(write_run(tmp_path / 'second', dict.fromkeys(range(20), True)))
    assert seeds_to_add(compare([first, second]), 0.1, 1000) == [*range(40)]
    third = read_run(write_run(tmp_path / 'third', {
        seed: seed % 4 > 0 for seed in range(40)}))
    found = compare([first, third])
    # The width falls with the root of the number.
    assert len(seeds_to_add(found, 0.24, 1000)) == pytest.approx(
        40 * (found.width / 0.24)**2, abs=2)
    assert len(seeds_to_add(found, 0.001, 1000)) == 81  # No more than as many again.
    assert len(seeds_to_add(found, 0.001, 50)) == 50
    assert seeds_to_add(found, 0.001, 10) == [*range(40)]


@pytest.mark.parametrize('setting', [
    Setting('reach'),
    Setting('pick_cube', 'UR5e', 'Robotiq85Gripper', 'joint_position', 25.0,
            {'command': 0.04, 'state': 0.02, 'state_jitter': 0.01}, ('agentview', {
                'name': 'top', 'position': [0, 0, 2], 'look_at': [0, 0, 0.8]}), (64, 48),
            {'randomization': {'parameters': {'latency.image': {'uniform': [0.0, 0.03]}}}},
            {'noise.joint_position': 0.001})])
def test_the_description_of_a_run_makes_the_same_run(setting):
    described = Experiment(setting, 'expert').description
    stored = json.loads(json.dumps(described))
    again = Experiment.of(stored).description
    assert json.loads(json.dumps(again)) == stored
    for key in ('task', 'latency', 'cameras', 'image_size', 'policy'):
        with pytest.raises(ModelError, match='the description of a run cannot be used'):
            Experiment.of({name: value for name, value in stored.items() if name != key})


def run(out, policy, seeds, *more):
    return main(['run', 'reach', '--policy', f'{POLICIES}:{policy}', '--seeds', seeds, '--out',
                 str(out), *more])


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_seeds_are_added_until_the_interval_is_narrow(tmp_path, capsys):
    first, second, whole = (tmp_path / name for name in ('first', 'second', 'whole'))
    assert run(first, 'Towards', '0:3') == run(second, 'StopsInTheThirdPeriod', '0:2') == 0
    assert run(whole, 'StopsInTheThirdPeriod', '0:8') == 0
    capsys.readouterr()
    assert compared(first, second, '--until', '0.75', '--threshold', '0.1') == 1
    found = compare([read_run(first), read_run(second)])
    assert found.width <= 0.75 and len(found.seeds) == 7
    assert found.runs[1].rows == dict([*read_run(whole).rows.items()][:len(found.seeds)])
    with (whole / 'rows-1-of-1.jsonl').open() as file:
        assert set(found.runs[1].rows) <= set(read_rows(file))
    before = len(found.seeds)
    assert compared(first, second, '--until', '0.01', '--most', str(before)) == 0
    assert len(read_run(first).rows) == before


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_no_seeds_are_added_with_a_policy_that_has_changed(tmp_path, capsys):
    policy = tmp_path / 'policy.py'
    policy.write_text(POLICIES.read_text())
    for name in ('first', 'second'):
        assert main(['run', 'reach', '--policy', f'{policy}:Towards', '--seeds', '0:1', '--out',
                     str(tmp_path / name)]) == 0
    policy.write_text(POLICIES.read_text() + '\n')
    assert compared(tmp_path / 'first', tmp_path / 'second', '--until', '0.9') == 2
    assert 'as it was before its files changed' in capsys.readouterr().err


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_records_tell_where_states_first_differ_and_make_a_video(tmp_path, capsys, monkeypatch):
    av = pytest.importorskip('av', reason='av is not installed')
    pytest.importorskip('mcap', reason='mcap is not installed')
    monkeypatch.setattr(Reach, 'horizon_s', 1.0)
    first, second = tmp_path / 'first', tmp_path / 'second'
    assert run(first, 'Towards', '1:3', '--record') == 0
    assert run(second, 'StopsInTheThirdPeriod', '1:3', '--record') == 0
    runs = [read_run(path) for path in (first, second)]
    # The third action is the first that differs.
    assert [first_difference(*runs, seed) for seed in (1, 2)] == [3, 3]
    assert first_difference(runs[0], runs[0], 1) is None
    capsys.readouterr()
    video = tmp_path / 'video'
    assert compared(first, second) == 0
    assert capsys.readouterr().out.count('from period 3 on (0.15 s)') == 2
    # Without the record of a seed, or with one that is damaged, the rest is told.
    (second / 'records' / '2.mcap').write_bytes(b'no record')
    assert compared(first, second, '--video', video, '--threshold', '0.01') == 0
    text = capsys.readouterr().out
    assert 'no video of seed 2: ' in text
    assert f'{video / "1.mp4"}: first: success, second: no success' in text
    with av.open(str(video / '1.mp4')) as file:
        images = [frame.to_ndarray(format='rgb24') for frame in file.decode(video=0)]
    assert len(images) == runs[1].rows[1].periods + 1  # The longer one.
    left, right = (np.array(images, dtype=float)[:, 40:, half, :] for half in (
        slice(0, 400), slice(400, 800)))
    differ = np.abs(left - right).mean(axis=(1, 2, 3))
    assert differ[0] < 1.0 and differ[-1] > 3.0
    assert compared(first, second, '--camera', 'frontvieu', '--video', video) == 2
    assert "unknown camera 'frontvieu': did you mean 'frontview'" in capsys.readouterr().err
    (second / 'records' / '1.mcap').unlink()
    assert compared(first, second, '--video', video) == 0
    assert 'no video of seed 1: there is no' in capsys.readouterr().out
