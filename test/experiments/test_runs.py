# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Runs of many seeds: real processes, rows on the disk, resuming, shards, and bad input."""

import hashlib
import json
import os
from pathlib import Path
import pickle
import re
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import scipy

parquet = pytest.importorskip('pyarrow.parquet', reason='pyarrow is not installed')
pytest.importorskip('tqdm', reason='tqdm is not installed')

from manip_sim.cli.main import main  # noqa: E402
from manip_sim.errors import ManipSimError, ModelError  # noqa: E402
from manip_sim.experiments import (  # noqa: E402
    Experiment, parse_seeds, parse_shard, processes, wilson_interval, Worker)
from manip_sim.experiments.experiment import TIMES  # noqa: E402
from manip_sim.experiments.policies import inputs, load_policy, policy_content  # noqa: E402
from manip_sim.experiments.run_folder import spans  # noqa: E402
from manip_sim.tasks import Setting  # noqa: E402

POLICIES = Path(__file__).with_name('policies_under_test.py')


def run(out, *more, policy='Towards', seeds='0:6', task='reach', worlds='2'):
    name = policy if policy == 'expert' or ':' in policy else f'{POLICIES}:{policy}'
    return main(['run', task, '--policy', name, '--seeds', seeds, '--out', str(out), '--worlds',
                 worlds, *more])


def rows(out):
    """Return the rows of a run without wall times, which differ each time."""
    return parquet.read_table(out / 'episodes.parquet').drop_columns(list(TIMES)).to_pylist()


def summary(out):
    return json.loads((out / 'summary.json').read_text())


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Return the folder of a run of six seeds by a policy of this file."""
    out = tmp_path_factory.mktemp('run') / 'whole'
    assert run(out) == 0
    return out


@pytest.mark.full
def test_a_run_has_the_rows_of_episodes_that_are_run_by_hand(whole):
    worker = Worker(Experiment(Setting('reach'), f'{POLICIES}:Towards'))
    episode, policy = worker._episode, load_policy(f'{POLICIES}:Towards', worker._episode)
    for row in rows(whole):
        total = 0.0
        episode.reset(row['seed'])
        policy.reset(row['seed'])
        while not episode.over:
            episode.step(policy.act(episode.observation))
            total += episode.reward
        assert row == {'seed': row['seed'], 'success': episode.success, 'return': total,
                       'periods': episode.periods, 'digest': episode.digest, 'error': '',
                       'faults': ''}
    assert [row['seed'] for row in rows(whole)] == list(range(6))


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_the_rows_say_which_faults_of_a_plan_were_injected(whole, tmp_path, capsys):
    plan = tmp_path / 'faults.yaml'
    plan.write_text('faults:\n- {what: lost_commands, part: arm, from: [0.1, 0.5]}\n')
    assert run(tmp_path / 'out', '--faults', str(plan), seeds='0:2', worlds='1') == 0
    injected = [json.loads(row['faults']) for row in rows(tmp_path / 'out')]
    assert injected[0][0]['from'] != injected[1][0]['from']
    assert all(fault['lost'] > 0 for fault, in injected)
    assert [row['faults'] for row in rows(whole)] == [''] * 6
    plan.write_text('faults:\n- {what: limb, part: arm}\n')
    assert run(tmp_path / 'other', '--faults', str(plan)) == 1
    assert "did you mean 'limp'" in capsys.readouterr().err


@pytest.mark.full
def test_the_summary_says_how_often_and_how_sure(whole):
    found = summary(whole)
    successes = sum(row['success'] for row in rows(whole))
    assert (found['episodes'], found['complete'], found['successes']) == (6, True, successes)
    interval = scipy.stats.binomtest(successes, 6).proportion_ci(method='wilson')
    np.testing.assert_allclose(found['success_rate_95'], interval, atol=1e-6)
    assert found['task'] == 'reach' and found['seeds'] == '0:6'
    assert {'manip_sim', 'mujoco', 'numpy', 'python'} == set(found['versions'])


@pytest.mark.full
@pytest.mark.parametrize('successes, count', [(0, 1), (1, 1), (3, 10), (870, 1000), (200, 200)])
def test_the_interval_is_that_of_wilsons_score(successes, count):
    expected = scipy.stats.binomtest(successes, count).proportion_ci(method='wilson')
    np.testing.assert_allclose(wilson_interval(successes, count), expected, atol=1e-6)
    low, high = wilson_interval(successes, count)
    assert (low == 0.0) is (successes == 0) and (high == 1.0) is (successes == count)


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_shards_in_one_folder_and_in_several_make_the_same_rows(whole, tmp_path, capsys):
    for number in (1, 2):
        assert run(tmp_path / 'shared', '--shard', f'{number}/2', worlds='1') == 0
        assert run(tmp_path / f'apart{number}', '--shard', f'{number}/2', worlds='1') == 0
        assert summary(tmp_path / 'shared')['complete'] == (number == 2)
    assert rows(tmp_path / 'shared') == rows(whole)
    apart = [str(tmp_path / f'apart{number}') for number in (1, 2)]
    assert main(['merge', *apart, '--out', str(tmp_path / 'merged')]) == 0
    assert rows(tmp_path / 'merged') == rows(whole)
    assert 'episodes     6 of 6' in capsys.readouterr().out.split('Run')[-1]
    assert main(['merge', apart[0], apart[0], '--out', str(tmp_path / 'twice')]) == 1
    assert 'both have the seed 0: the same shard twice' in capsys.readouterr().err
    lost = tmp_path / 'apart3'
    assert main(['merge', apart[0], str(lost), '--out', str(tmp_path / 'less')]) == 1
    assert f'{lost} is not the folder of a run' in capsys.readouterr().err
    assert not lost.exists() and not (tmp_path / 'less').exists()


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_runs_of_other_policies_are_not_merged_and_leave_no_folder(whole, tmp_path, capsys):
    assert run(tmp_path / 'other', policy='WithoutSeed', worlds='1', seeds='0:1') == 0
    out = tmp_path / 'merged'
    assert main(['merge', str(whole), str(tmp_path / 'other'), '--out', str(out)]) == 1
    assert str(tmp_path / 'other') in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.full
def test_a_run_that_was_killed_goes_on_and_doubles_nothing(whole, tmp_path):
    out = tmp_path / 'killed'
    command = [sys.executable, '-m', 'manip_sim.cli', 'run', 'reach', '--policy',
               f'{POLICIES}:Towards', '--seeds', '0:6', '--out', str(out), '--worlds', '1']
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    file = out / 'rows-1-of-1.jsonl'
    while process.poll() is None and not (file.exists() and file.read_text().count('\n') >= 2):
        time.sleep(0.005)
    process.kill()
    process.communicate()
    done = file.read_text().count('\n')
    assert 2 <= done < 6
    # As a process that is killed while it writes leaves it.
    with file.open('a') as opened:
        opened.write('{"seed": 5, "succ')
    assert run(out) == 0
    assert rows(out) == rows(whole)
    assert file.read_text().count('\n') == 6
    assert run(out) == 0  # Nothing is left to do.
    assert rows(out) == rows(whole)


NEVER_ANSWERS = """
import time

class Policy:
    def reset(self, seed):
        print('reset', flush=True)

    def act(self, observation):
        time.sleep(1000.0)
"""


@pytest.mark.full
def test_processes_of_a_run_that_was_killed_end_although_a_policy_has_not_answered(tmp_path):
    (tmp_path / 'policy.py').write_text(NEVER_ANSWERS)
    with subprocess.Popen(
            [sys.executable, '-m', 'manip_sim.cli', 'run', 'reach', '--policy',
             'policy.py:Policy', '--seeds', '0:2', '--out', 'run', '--worlds', '1'],
            cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert b'reset' in process.stdout.readline()
        process.kill()
        # The pipe ends with the last process that has it.
        assert process.communicate(timeout=100.0) == (b'', None)


@pytest.mark.full
def test_an_interrupted_run_says_that_it_goes_on(tmp_path):
    out = tmp_path / 'interrupted'
    process = subprocess.Popen(
        [sys.executable, '-m', 'manip_sim.cli', 'run', 'reach', '--policy',
         f'{POLICIES}:Towards', '--seeds', '0:600', '--out', str(out), '--worlds', '1'],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    file = out / 'rows-1-of-1.jsonl'
    while process.poll() is None and not (file.exists() and file.read_text()):
        time.sleep(0.005)
    os.killpg(process.pid, signal.SIGINT)
    text, errors = process.communicate()
    assert process.returncode == 130, errors
    assert 'interrupted; run the same command again to continue' in text
    assert 'Traceback' not in errors
    assert summary(out)['complete'] is False and summary(out)['episodes'] >= 1


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_a_policy_that_fails_costs_its_episode(tmp_path, capsys):
    assert run(tmp_path / 'fails', policy='Sometimes') == 1
    found = rows(tmp_path / 'fails')
    assert [bool(row['error']) for row in found] == [False, True, True, True, False, False]
    assert [row['error'] for row in found[1:4]] == [
        'act() of the policy: ZeroDivisionError: one', found[2]['error'],
        'an action must have 7 numbers, got 5']
    assert 'finite' in found[2]['error']
    assert not any(row['success'] for row in found[1:4])
    assert '1 x act() of the policy: ZeroDivisionError: one' in capsys.readouterr().out


@pytest.mark.full
@pytest.mark.usefixtures('forked')
@pytest.mark.parametrize('policy, error', [
    ('Interrupts', 'act() of the policy: KeyboardInterrupt: '),
    ('Exits', 'act() of the policy: SystemExit: 0'),
    ('Speechless', 'act() of the policy: Error: it has no text'),
    ('Lies', 'act() of the policy: RuntimeError: not an array'),
    ('InterruptsAtReset', 'reset() of the policy: KeyboardInterrupt: ')])
def test_whatever_a_policy_raises_costs_one_episode_only(whole, tmp_path, capfd, policy, error):
    assert run(tmp_path / 'raises', policy=policy, seeds='1:4', worlds='1') == 1
    found = rows(tmp_path / 'raises')
    assert found[1]['error'] == error
    assert [found[0], found[2]] == [rows(whole)[1], rows(whole)[3]]
    assert 'Traceback' not in capfd.readouterr().err


@pytest.mark.full
@pytest.mark.usefixtures('forked')
@pytest.mark.parametrize('policy', [
    'Hangs', 'HangsWhateverIsRaised', 'HangsInTheSecondProcess', 'HangsAfterStoppingItself',
    'HangsWithoutAlarms', 'HangsWithATimerOfItsOwn'])
def test_a_policy_that_hangs_is_ended(tmp_path, policy):
    assert run(tmp_path / 'hangs', '--policy-limit', '2', policy=policy, seeds='2:3') == 1
    assert [row['error'] for row in rows(tmp_path / 'hangs')] == [
        'the policy took longer than 2 s']


@pytest.mark.full
def test_a_process_that_cannot_begin_says_why():
    for setting, message in ((Setting('pick_cub'), 'unknown task'),
                             (Setting('reach', robot='Pandaa'), 'unknown robot')):
        with pytest.raises(ManipSimError, match=message):
            list(processes.run_in_processes(Experiment(setting, 'expert'), [0], 1))


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_a_process_that_dies_is_noticed_though_a_copy_of_it_lives(tmp_path):
    assert run(tmp_path / 'copies', policy='DiesBesideACopy', seeds='1:4', worlds='1') == 1
    assert [row['error'] for row in rows(tmp_path / 'copies')] == [
        '', 'its process died 3 times, exit code -9', '']


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_a_copy_that_a_policy_forks_gives_no_second_row(whole, tmp_path):
    assert run(tmp_path / 'forks', policy='Forks', seeds='1:4', worlds='1') == 0
    assert rows(tmp_path / 'forks') == rows(whole)[1:4]


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_a_policy_that_changes_the_folder_moves_no_file(whole, tmp_path, monkeypatch):
    pytest.importorskip('mcap', reason='mcap is not installed')
    for name in ('here', 'there'):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / 'here')
    monkeypatch.setenv('MANIP_SIM_TEST_MARK', str(tmp_path / 'there'))
    Path('moving.py').write_text(POLICIES.read_text())
    assert run(Path('moved'), '--record', policy='moving.py:Moves', seeds='1:4', worlds='1') == 0
    assert rows(tmp_path / 'here' / 'moved') == rows(whole)[1:4]
    assert len([*(tmp_path / 'here' / 'moved' / 'records').iterdir()]) == 3
    assert not [*(tmp_path / 'there').iterdir()]


@pytest.mark.full
def test_the_file_of_a_policy_replaces_no_module(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('random.py').write_text(POLICIES.read_text())
    Path('json.py').write_text('raise ValueError("broken")')
    modules = {name: sys.modules[name] for name in ('random', 'json')}
    for file in modules:
        main(['run', 'reach', '--policy', f'{file}.py:Towards', '--seeds', '0:1', '--out', file])
    assert 'broken' in capsys.readouterr().err
    assert {name: sys.modules[name] for name in modules} == modules
    assert 'policy_json' not in sys.modules


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_a_policy_that_writes_into_its_observation_changes_no_row(whole, tmp_path):
    assert run(tmp_path / 'writes', policy='Writes', seeds='0:3', worlds='1') == 0
    assert rows(tmp_path / 'writes') == rows(whole)[:3]


@pytest.mark.full
def test_a_process_that_dies_loses_nothing(whole, tmp_path, monkeypatch):
    mark = tmp_path / 'mark'
    mark.touch()
    monkeypatch.setenv('MANIP_SIM_TEST_MARK', str(mark))
    assert run(tmp_path / 'dies', policy='Deadly') == 0
    assert not mark.exists()
    assert rows(tmp_path / 'dies') == rows(whole)


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_a_seed_whose_process_always_dies_is_a_row_with_that_error(tmp_path):
    assert run(tmp_path / 'dies', policy='AlwaysDeadly', seeds='1:4') == 1
    assert [row['error'] for row in rows(tmp_path / 'dies')] == [
        '', 'its process died 3 times, exit code -9', '']


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_memory_that_earlier_episodes_keep_costs_no_seed(whole, tmp_path):
    assert run(tmp_path / 'leaks', policy='Leaks', worlds='1') == 0
    assert rows(tmp_path / 'leaks') == rows(whole)


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_a_seed_that_never_has_memory_is_a_row_with_that_error(tmp_path):
    assert run(tmp_path / 'none', policy='NeverHasMemory', seeds='2:3', worlds='1') == 1
    assert rows(tmp_path / 'none')[0]['error'] == 'its process ran out of memory 3 times'


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_a_process_whose_memory_grows_beyond_its_share_is_replaced(monkeypatch):
    monkeypatch.setattr(processes, '_MEMORY_SHARE', 0.0)
    pool = processes.WorkerPool(Experiment(Setting('reach'), f'{POLICIES}:Towards'), 1)
    (worker,) = pool._workers
    try:
        first = worker._process.pid
        list(pool.run([0]))
        assert worker._process.pid == first  # Twice of what it had is allowed.
        worker._first_bytes = 1
        list(pool.run([1]))
        assert worker._process.pid != first
    finally:
        pool.close()


def towards_file(path, factor):
    path.write_text('import numpy as np\nimport helper\n\n\ndef act(observation):\n'
                    '    way = observation["goal"] - observation["eef_pose"][0, :3]\n'
                    f'    return np.array([*np.clip({factor} * way / 0.05, -1, 1), 0, 0, 0, 0])\n')
    return f'{path}:act'


@pytest.fixture
def policy_files(tmp_path, monkeypatch):
    """Return the name of a policy in a file that imports another one, and names its weights."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    (tmp_path / 'helper.py').write_text("WEIGHTS = 'weights.bin'\n")
    (tmp_path / 'weights.bin').write_bytes(b'1')
    yield towards_file(tmp_path / 'policy.py', 0.0)
    sys.modules.pop('helper', None)


@pytest.mark.full
@pytest.mark.usefixtures('forked')
def test_a_policy_that_has_changed_is_not_reported_with_its_old_rows(
        policy_files, tmp_path, capsys):
    out = tmp_path / 'out'
    assert run(out, policy=policy_files, worlds='1') == 0
    before = summary(out)['successes']
    assert run(out, policy=policy_files, worlds='1') == 0  # Nothing has changed.
    towards_file(tmp_path / 'policy.py', 1.0)
    capsys.readouterr()
    assert run(out, policy=policy_files, worlds='1') == 1
    assert ('as it was before its files changed: choose another folder, or replace the rows with '
            '--again') in capsys.readouterr().err
    assert summary(out)['successes'] == before
    assert run(out, '--again', policy=policy_files, worlds='1') == 0
    assert summary(out)['successes'] > before


@pytest.mark.parametrize('file, content', [
    ('helper.py', "WEIGHTS = 'weights.bin'\n\n"), ('weights.bin', '2')])
def test_what_a_policy_imports_and_names_is_a_part_of_it(policy_files, tmp_path, file, content):
    before = policy_content(policy_files)
    (tmp_path / 'unrelated.py').write_text('')
    assert policy_content(policy_files) == before
    (tmp_path / file).write_text(content)
    assert policy_content(policy_files) != before


@pytest.mark.parametrize('line', [
    "W = HERE / 'nets' / 'old' / 'gain.json'", "W = os.path.join(HERE, 'nets', 'old/gain.json')",
    "W = Path('nets') / 'old' / 'gain.json'"])
def test_a_file_that_a_policy_names_by_its_folders_is_a_part_of_it(tmp_path, line):
    (tmp_path / 'policy.py').write_text(line)
    weights = tmp_path / 'nets' / 'old' / 'gain.json'
    weights.parent.mkdir(parents=True)
    contents = set()
    for text in ('1', '2'):
        weights.write_text(text)
        contents.add(policy_content(f'{tmp_path / "policy.py"}:act'))
    assert len(contents) == 2


@pytest.mark.full
@pytest.mark.usefixtures('forked')
@pytest.mark.parametrize('line', [
    "W = (HERE / 'nets' / f'{KIND}.pt').read_text()", "W = HERE / 'nets' / f'{KIND}.pt'",
    "W = [file.read_text() for file in (HERE / 'nets').iterdir()]",
    "W = np.fromfile('nets/{}.pt'.format(KIND), np.uint8)",
    "with open(HERE / json.loads((HERE / 'names.json').read_text())['file']) as file: file.read()",
    "W = importlib.import_module(KIND + '_gain')"])
def test_a_file_that_a_policy_computes_the_name_of_is_a_part_of_it(
        tmp_path, monkeypatch, capsys, line):
    policy = tmp_path / 'policy.py'
    policy.write_text(
        'import importlib\nimport json\nfrom pathlib import Path\nimport numpy as np\n\n'
        f"HERE, KIND = Path(__file__).parent, 'best'\n{line}\n\n\n"
        'def act(observation):\n    open("log.txt", "a").write("more")\n    return np.zeros(7)\n')
    (tmp_path / 'names.json').write_text('{"file": "nets/best.pt"}')
    read = tmp_path / ('best_gain.py' if 'import_module' in line else 'nets/best.pt')
    read.parent.mkdir(exist_ok=True)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)

    def again():
        sys.modules.pop('best_gain', None)
        return run(Path('out'), policy=f'{policy}:act', seeds='0:1', worlds='1')
    read.write_text('A = 1')
    assert again() == 0
    assert (tmp_path / 'log.txt').is_file()
    assert again() == 0  # What it writes is no part of it.
    read.write_text('A = 20')
    assert again() == 1
    assert 'as it was before its files changed' in capsys.readouterr().err
    described = json.loads((tmp_path / 'out' / 'run.json').read_text())

    def content():  # As `manip_sim compare` has it, which does not load the policy.
        return policy_content(described['policy'], described['policy_files'])
    assert content() != described['policy_content']
    read.write_text('A = 1')
    assert content() == described['policy_content']


def test_the_file_of_a_policy_imports_those_beside_it(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, 'path', sys.path.copy())
    (tmp_path / 'gains_beside.py').write_text('GAIN = 2.0\n')
    (tmp_path / 'json.py').write_text('raise ValueError\n')
    (tmp_path / 'policy.py').write_text(
        'import json\nfrom gains_beside import GAIN\n\n\ndef act(observation):\n'
        '    return [GAIN] * 7\n')
    policy = load_policy(f'{tmp_path / "policy.py"}:act', None)
    assert policy.act({}) == [2.0] * 7
    del sys.modules['gains_beside']


def test_an_experiment_is_described_once_also_for_its_workers(policy_files, tmp_path):
    experiment = Experiment(Setting('reach'), policy_files)
    described = experiment.description
    (tmp_path / 'weights.bin').write_text('2')
    assert pickle.loads(pickle.dumps(experiment)).description == described  # noqa: S301
    assert Experiment(Setting('reach'), policy_files).description != described


def test_modules_packages_and_networks_have_a_content_and_experts_and_nodes_have_none(
        policy_files, tmp_path):
    package = tmp_path / 'my_policies'
    package.mkdir()
    (package / '__init__.py').write_text('')
    (package / 'act.py').write_text('from . import net\nimport numpy\n')
    (package / 'net.py').write_text('A = 1\n')
    (tmp_path / 'net.onnx').write_bytes(b'1')
    names = ['my_policies.act:act', 'policy:act', str(tmp_path / 'net.onnx')]
    before = [policy_content(name) for name in names]
    assert len({*before, policy_content('nothing:there')}) == 4
    (package / 'net.py').write_text('A = 2\n')
    (tmp_path / 'net.onnx.data').write_bytes(b'2')
    towards_file(tmp_path / 'policy.py', 2.0)
    assert not set(before) & {policy_content(name) for name in names}
    assert policy_content('expert') is policy_content('ros:/policy') is None


@pytest.mark.parametrize('line, file', [
    (f"TEXT = '{'文' * 120}'", None),  # Longer than the name of a file may be.
    ("TEXT = '/proc/self/stat'", None), ("TEXT = '/dev/zero'", None), ("TEXT = '.'", None),
    ('import installed', 'env/lib/python3.11/site-packages/installed.py'),
    ('import installed', 'env/lib/python3/dist-packages/installed/__init__.py')])
def test_texts_that_name_no_file_of_the_policy_and_installed_packages_are_no_part_of_it(
        tmp_path, monkeypatch, line, file):
    policy = tmp_path / 'policy.py'
    policy.write_text(line)
    if file:
        (tmp_path / file).parent.mkdir(parents=True)
        (tmp_path / file).write_text('')
        monkeypatch.syspath_prepend(tmp_path / file.rpartition('/installed')[0])
    alone = hashlib.sha256(hashlib.sha256(policy.read_bytes()).digest()).hexdigest()
    assert policy_content(f'{policy}:act') == alone


def test_the_content_of_a_policy_is_the_same_in_other_folders(tmp_path, monkeypatch):
    contents = set()
    for own, other in (('a', 'b'), ('c', 'a')):
        for folder in (own, other):
            (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / own / 'policy.py').write_text("WEIGHTS = 'weights.bin'")
        (tmp_path / other / 'weights.bin').write_text('1')
        monkeypatch.chdir(tmp_path / other)
        contents.add(policy_content(f'{tmp_path / own / "policy.py"}:act'))
    assert len(contents) == 1


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_seeds_are_added_to_a_run_and_runs_of_other_seeds_are_merged(whole, tmp_path, capsys):
    out = tmp_path / 'grows'
    assert run(out, seeds='0:3', worlds='1') == 0
    assert run(out, seeds='0:6', worlds='1') == 0
    assert rows(out) == rows(whole) and summary(out)['seeds'] == '0:6'
    assert run(out, seeds='0:4') == 1
    assert 'has the seeds 0:6: name all of them' in capsys.readouterr().err
    for name, seeds in (('a', '4:6'), ('b', '0:4')):
        assert run(tmp_path / name, seeds=seeds, worlds='1') == 0
    merged = tmp_path / 'merged'
    assert main(['merge', str(tmp_path / 'b'), str(tmp_path / 'a'), '--out', str(merged)]) == 0
    assert rows(merged) == rows(whole) and summary(merged)['complete']


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_shards_keep_their_seeds_when_seeds_are_added(whole, tmp_path):
    out = tmp_path / 'shards'
    for seeds in ('0:3', '0:6'):
        for number in (1, 2):
            assert run(out, '--shard', f'{number}/2', seeds=seeds, worlds='1') == 0
    assert rows(out) == rows(whole)


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_rows_with_an_error_can_be_run_again(whole, tmp_path, monkeypatch):
    out, mark = tmp_path / 'errors', tmp_path / 'mark'
    mark.touch()
    monkeypatch.setenv('MANIP_SIM_TEST_MARK', str(mark))
    assert run(out, policy='FailsWhileMarked', worlds='1') == 1
    assert rows(out)[2]['error']
    mark.unlink()
    assert run(out, policy='FailsWhileMarked', worlds='1') == 1  # The row stays.
    assert run(out, '--retry-errors', policy='FailsWhileMarked', worlds='1') == 0
    assert rows(out) == rows(whole)


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
@pytest.mark.parametrize('policy', ['WithoutSeed', 'towards'])
def test_a_policy_may_be_a_function_or_need_no_seed(whole, tmp_path, policy):
    assert run(tmp_path / 'other', policy=policy, seeds='0:2', worlds='1') == 0
    assert rows(tmp_path / 'other') == rows(whole)[:2]


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_a_run_again_leaves_no_rows_or_records_of_the_run_before_and_other_files(tmp_path):
    out = tmp_path / 'out'
    assert run(out, '--record', seeds='0:2', worlds='1') == 0
    (out / 'notes.txt').touch()
    assert run(out, '--again', '--record', policy='expert', seeds='1:2', worlds='1') == 0
    assert [row['seed'] for row in rows(out)] == [1] and (out / 'notes.txt').exists()
    assert [file.name for file in (out / 'records').iterdir()] == ['1.mcap']


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_a_run_can_record_its_episodes(tmp_path):
    pytest.importorskip('mcap', reason='mcap is not installed')
    assert run(tmp_path / 'recorded', '--record', seeds='3:5', worlds='1') == 0
    assert sorted(file.name for file in (tmp_path / 'recorded' / 'records').iterdir()) == [
        '3.mcap', '4.mcap']


@pytest.mark.full
@pytest.mark.parametrize('policy', ['Towards', 'expert'])
def test_recorded_images_are_those_of_the_states_beside_them(renderer, policy, tmp_path):
    pytest.importorskip('mcap_ros2', reason='needs the extra records')
    from manip_sim.records.converting import Frames
    from manip_sim.records.recorded import Record
    name = policy if policy == 'expert' else f'{POLICIES}:{policy}'
    setting = Setting('reach', cameras=('agentview',), image_size=(64, 48))
    row = Worker(Experiment(setting, name, tmp_path)).run(3)
    assert row == Worker(Experiment(Setting('reach'), name)).run(3)
    (recorded,) = Record(tmp_path / '3.mcap').episodes()
    assert row.digest == recorded.result['digest']
    found, episode = list(Frames(recorded).images('agentview')), setting.create_episode()
    episode.reset(3)
    for action, image in zip(recorded.actions, found):
        seen = episode.observation['image/agentview'].astype(int)
        assert np.abs(seen - image).mean() < 4.0  # It is a JPEG.
        episode.step(action)
    assert np.abs(found[0].astype(int) - found[-1]).max() > 50  # The robot has moved.
    episode.observer.pictures.close()


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_latency_is_a_part_of_the_run(whole, tmp_path):
    assert run(tmp_path / 'late', '--latency', '0.2', worlds='1', seeds='0:2') == 0
    assert [row['digest'] for row in rows(tmp_path / 'late')] != [
        row['digest'] for row in rows(whole)[:2]]
    assert summary(tmp_path / 'late')['latency'] == {
        'command_s': 0.2, 'state_s': 0.0, 'command_jitter_s': 0.0, 'state_jitter_s': 0.0}


@pytest.mark.full
@pytest.mark.parametrize('more, text', [
    ({'task': 'pick_cub'}, "unknown task 'pick_cub': did you mean 'pick_cube'"),
    ({'more': ['--robot', 'Pandda']}, "unknown robot 'Pandda': did you mean 'Panda'"),
    ({'task': 'pick_cube', 'more': ['--gripper', 'none']}, 'pick_cube needs 1 arm with grippers'),
    ({'more': ['--robot', 'GR1']}, 'reach: GR1 cannot do it, its hands do not reach the middle'),
    ({'more': ['--action', 'osc']}, "unknown action 'osc': did you mean 'osc_pose'"),
    ({'policy': 'WithoutAct'}, 'it has no act'),
    ({'policy': 'NeedsArguments'}, 'cannot be created without arguments: TypeError'),
    ({'policy': 'ExitsAtOnce'}, 'cannot be created without arguments: SystemExit: 0'),
    ({'policy': 'WithAReset'}, ': RuntimeError: no reset'),
    ({'policy': 'NUMBER'}, 'must be a class or a function, got int'),
    ({'policy': 'Toward'}, "did you mean 'Towards'"),
    ({'policy': 'no_such_module:Policy'}, 'cannot import'),
    ({'policy': 'nothing:'}, "must be 'expert', MODULE:CLASS"),
    ({'policy': 'there.onnx:'}, "must be 'expert'"),
    ({'seeds': '5:5'}, "'5:5' has no seed"), ({'seeds': '-1'}, "'-1' must be like 7, 0:1000"),
    ({'seeds': '0:3,2'}, 'a seed appears twice'), ({'seeds': '0:9:0'}, 'has no seed'),
    ({'seeds': '0:99999999999'}, 'more than 10000000 seeds'), ({'seeds': ''}, 'must be like 7'),
    ({'more': ['--shard', '5/4']}, 'must be from 1/4 to 4/4'),
    ({'more': ['--shard', '0/4']}, 'must be from 1/4 to 4/4'),
    ({'more': ['--shard', 'two']}, 'must be like 1/4'),
    ({'more': ['--latency', '-1']}, 'latency of a command must be from 0 to 10 s'),
    ({'more': ['--noise', 'frank']}, "unknown noise 'frank': did you mean 'franka'"),
    ({'more': ['--noise', 'noise.joint_positon:=0.1']}, "did you mean 'noise.joint_position'"),
    ({'more': ['--noise', 'noise.joint_position:=-1']}, 'must be a number from 0 to 1'),
    ({'more': ['--noise', 'noise.joint_position:=nan']}, 'must be a number from 0 to 1'),
    ({'more': ['--noise', 'noise.joint_position:=much']}, "'much' is not a number"),
    ({'more': ['--address', 'auto']}, '--address is for --engine ray')])
def test_what_cannot_be_used_is_said_in_one_line(tmp_path, capsys, more, text):
    arguments = {**more}
    extra = arguments.pop('more', [])
    assert run(tmp_path / 'none', *extra, **arguments) == 1
    error = capsys.readouterr().err
    assert text in error and error.count('\n') == 1
    assert not (tmp_path / 'none').exists()


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_noise_of_a_run_is_that_of_an_environment_with_the_profile(whole, tmp_path):
    out = tmp_path / 'noisy'
    assert run(out, '--noise', 'ur', '--noise', 'noise.joint_position:=0.01', '--latency', '0.1',
               seeds='0:3') == 0
    found = summary(out)
    # The latency of a state is that of the profile, that of a command was given.
    assert found['latency'] == {'command_s': 0.1, 'state_s': 0.002, 'command_jitter_s': 0.0005,
                                'state_jitter_s': 0.0005}
    assert found['noise']['noise.joint_position'] == 0.01
    assert found['noise']['noise.wrench_force'] == 1.2 and 'latency.state' not in found['noise']
    late = {key.removesuffix('_s'): value for key, value in found['latency'].items()}
    worker = Worker(Experiment(
        Setting('reach', latency=late, noise=found['noise']), f'{POLICIES}:Towards'))
    assert [worker.run(seed).digest for seed in range(3)] == [row['digest'] for row in rows(out)]
    assert {row['digest'] for row in rows(out)}.isdisjoint(row['digest'] for row in rows(whole))


@pytest.mark.full
def test_a_folder_of_something_else_is_rejected(whole, tmp_path, capsys):
    before = {file: file.read_bytes() for file in whole.iterdir()}
    assert run(whole, '--latency', '0.1') == 1
    assert re.search('is the folder of another run: its latency is .*: choose another folder$',
                     capsys.readouterr().err, re.MULTILINE)
    assert run(whole, seeds='0:5') == 1
    assert 'has the seeds 0:6: name all of them' in capsys.readouterr().err
    assert run(whole, '--shard', '1/2') == 1
    assert 'has shards of 1, not of 2' in capsys.readouterr().err
    assert {file: file.read_bytes() for file in whole.iterdir()} == before
    (tmp_path / 'thesis.tex').touch()
    assert run(tmp_path) == 1
    assert 'is not the folder of a run, but has thesis.tex' in capsys.readouterr().err
    assert main(['merge', str(tmp_path), '--out', str(tmp_path / 'x')]) == 1
    assert 'it has no run.json' in capsys.readouterr().err


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_a_shard_that_runs_already_is_rejected(tmp_path, capsys):
    import fcntl
    assert run(tmp_path / 'twice', seeds='0:1', worlds='1') == 0
    with (tmp_path / 'twice' / 'rows-1-of-1.jsonl').open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert run(tmp_path / 'twice', seeds='0:1', worlds='1') == 1
    assert 'shard 1/1 of' in capsys.readouterr().err


def test_seeds_and_shards_are_read_as_they_are_written():
    assert parse_seeds('0:3, 7,10:20:5') == [0, 1, 2, 7, 10, 15]
    assert spans(parse_seeds('0:3,7,10:12')) == '0:3,7,10:12'
    assert parse_shard('2/4') == (2, 4)
    with pytest.raises(ModelError, match="'1:a' must be like"):
        parse_seeds('1:a')


def test_a_flat_observation_has_the_order_of_gymnasium():
    gymnasium = pytest.importorskip('gymnasium', reason='gymnasium is not installed')
    from manip_sim.env import TaskEnv
    env = TaskEnv('pick_cube')
    observation, _ = env.reset(seed=1)
    flattened, _ = gymnasium.wrappers.FlattenObservation(env).reset(seed=1)
    batch = {key: value[None] for key, value in observation.items()}
    np.testing.assert_array_equal(
        inputs(batch, ['x'], None)['x'], flattened[None].astype(np.float32))
    env.close()


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_rows_of_randomized_runs_are_those_of_shards_and_of_episodes_by_hand(tmp_path, capsys):
    file = tmp_path / 'drawn.yaml'
    file.write_text('bodies: {"robot0_link*": {mass: {scale: {uniform: [0.8, 1.2]}}}}\n'
                    'parameters: {latency.command: {uniform: [0.0, 0.1]}}\n')
    more = ['--randomization', str(file)]
    assert run(tmp_path / 'whole', *more, seeds='0:4') == 0
    assert run(tmp_path / 'parts', *more, '--shard', '2/2', seeds='0:4', worlds='1') == 0
    assert run(tmp_path / 'parts', *more, '--shard', '1/2', seeds='0:4', worlds='1') == 0
    assert rows(tmp_path / 'parts') == rows(tmp_path / 'whole')
    episode = Setting('reach', composition={'randomization': file}).create_episode()
    policy = load_policy(f'{POLICIES}:Towards', episode)
    for row in rows(tmp_path / 'whole'):
        assert episode.run(policy, row['seed']) == row['success']
        assert episode.digest == row['digest']
    # Another content of the file is another run.
    file.write_text('bodies: {"robot0_link*": {mass: {scale: {uniform: [0.9, 1.1]}}}}\n')
    assert run(tmp_path / 'whole', *more, seeds='0:4') == 1
    assert 'is the folder of another run' in capsys.readouterr().err
    file.write_text('bodies:\n  robot0_linc1: {mass: {uniform: [1, 2]}}\n')
    assert run(tmp_path / 'other', *more, seeds='0:4') == 1
    assert "line 2: no body matches 'robot0_linc1': did you mean" in capsys.readouterr().err


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_a_sweep_over_latencies_is_one_command_that_repeats_to_the_last_bit(
        whole, tmp_path, capsys):
    for name in ('one', 'two'):
        assert run(tmp_path / name, '--state-latency', '0,0.4', seeds='0:2', worlds='1') == 0
        lines = capsys.readouterr().out.splitlines()
        assert any('latency of a state' in line for line in lines)
        told = {line.split()[0]: line for line in lines if ' of 2 ' in line}
        assert list(told) == ['0', '0.4']
        for late, line in told.items():
            summary = json.loads((tmp_path / name / f'latency_{late}/summary.json').read_text())
            time_s = summary['median_time_of_success_s']
            assert (' - ' if time_s is None else f' {time_s:.2f} s ') in line
        assert (tmp_path / name / 'success.svg').read_text().count('<circle') == 2
    late = [rows(tmp_path / 'one' / f'latency_{late}') for late in ('0', '0.4')]
    assert late == [rows(tmp_path / 'two' / f'latency_{late}') for late in ('0', '0.4')]
    assert late[0] == rows(whole)[:2] and late[1] != late[0]


@pytest.mark.parametrize('more, text', [
    (['--latency', '0,0'], 'the latencies must differ'),
    (['--latency', '0,1', '--state-latency', '0,1'], 'only one of --latency, --state-latency and'),
    (['--latency', '0,1', '--answer-time', '0,1'], 'only one of --latency, --state-latency and'),
    (['--answer-time', '0,measured,0'], 'the latencies must differ'),
    (['--answer-time', '0,soon'], "--answer-time must be seconds or 'measured', got 'soon'"),
    (['--answer-time', '-1'], "answer_time must be 'measured' or from 0 to 10 s, got -1"),
    (['--answer-time', 'nan'], 'from 0 to 10 s, got nan'),
    (['--answer-time', 'measured', '--answer-time-jitter', '0.1'], 'has no jitter'),
    (['--chunk-hz', '40'], 'chunk_hz must be that of a whole number of timesteps'),
    (['--latency', '0,-1'], 'latency of a command must be from 0 to 10 s')])
def test_latencies_that_make_no_sense_are_rejected(more, text, tmp_path, capsys):
    assert run(tmp_path / 'out', *more, seeds='0:1', worlds='1') == 1
    assert text in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
def test_a_sweep_over_answer_times_is_one_command_whose_records_repeat(whole, tmp_path, capsys):
    pytest.importorskip('mcap', reason='mcap is not installed')
    out = tmp_path / 'think'
    more = ['--answer-time', '0,0.12', '--record']
    assert run(out, *more, seeds='0:2', worlds='1') == 0
    text = capsys.readouterr().out
    assert 'answer time' in text and '\n  0.12 s' in text
    assert rows(out / 'answer_time_0') == rows(whole)[:2]
    late = rows(out / 'answer_time_0.12')
    worker = Worker(Experiment(Setting('reach', answer_time=0.12), f'{POLICIES}:Towards'))
    assert [worker.run(seed).digest for seed in range(2)] == [row['digest'] for row in late]
    assert late != rows(whole)[:2]
    assert summary(out / 'answer_time_0.12')['answer_time'] == {
        'mean_s': 0.12, 'jitter_s': 0.0, 'measured': False, 'chunk_hz': None, 'ask_ahead': 0}
    assert main(['replay', '--verify', str(out)]) == 0
    assert '4 of 4 equal' in capsys.readouterr().out
    # Without an action of each period it is no data set.
    assert main(['convert', str(out / 'answer_time_0.12'), '--to', 'hdf5',
                 str(tmp_path / 'set.hdf5')]) == 1
    assert 'control periods' in capsys.readouterr().err


@pytest.mark.full
@pytest.mark.usefixtures('in_this_process')
@pytest.mark.parametrize('more', [
    [], ['--answer-time', '0.1', '--answer-time-jitter', '0.05', '--ask-ahead', '2'],
    ['--chunk-hz', '10'], ['--answer-time', 'measured']])
def test_a_policy_that_returns_chunks_is_repeated_to_the_last_bit(tmp_path, capsys, more):
    pytest.importorskip('mcap', reason='mcap is not installed')
    out = tmp_path / 'chunks'
    assert run(out, *more, '--record', policy='Chunks', seeds='0:2', worlds='1') == 0
    assert all(row['success'] for row in rows(out))
    assert main(['replay', '--verify', str(out)]) == 0
    assert '2 of 2 equal' in capsys.readouterr().out


@pytest.mark.parametrize('address, count, ray_address, expected', [
    (None, None, None, 3), (None, 5, None, 5), (None, None, '10.0.0.1:6379', None),
    (None, 5, '10.0.0.1:6379', None), ('auto', 5, None, None)])
def test_ray_is_given_the_processors_only_of_a_cluster_that_it_starts(
        address, count, ray_address, expected, monkeypatch):
    given = []

    def init(**keywords):
        given.append(keywords['num_cpus'])
        raise RuntimeError('no cluster')

    monkeypatch.setitem(sys.modules, 'ray', SimpleNamespace(
        init=init, is_initialized=lambda: False))
    monkeypatch.setattr(processes, 'processors', lambda: 3)
    monkeypatch.delenv('RAY_ADDRESS', raising=False)
    if ray_address is not None:
        monkeypatch.setenv('RAY_ADDRESS', ray_address)
    with pytest.raises(ManipSimError, match='Ray: no cluster'):
        list(processes.run_on_ray(Experiment(Setting('reach'), 'expert'), [0], address, count))
    assert given == [expected]
