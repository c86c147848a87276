# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which tests ``make test-fast`` chooses, and how it keeps to its time."""

import os
from pathlib import Path
import subprocess
import sys
import time

import fast
import pytest

TESTS = sorted((fast.ROOT / 'test').rglob('test_*.py'))


def first(count, *changed):
    """Return the names of the test files that are the nearest to changed files."""
    files = fast.nearest({name: [] for name in changed}, TESTS)
    return [test.name for test, _ in zip(files, range(count))]


@pytest.mark.parametrize(('changed', 'wanted'), [
    ('manip_sim/control/servos.py', 'test_servos.py'),
    ('manip_sim/control/setpoints.py', 'test_setpoints.py'),
    ('manip_sim/control/cartesian/pose_stream.py', 'test_pose_streams.py'),
    ('manip_sim/models/files/urdf.py', 'test_files_urdf.py'),
    ('manip_sim/models/world.py', 'test_world.py'),
    ('manip_sim/runtime/pacing.py', 'test_pacing.py'),
    ('manip_sim/ros/action_servers.py', 'test_goal_server.py'),
    ('manip_sim/ros/diagnostics.py', 'test_diagnostics.py'),
    ('manip_sim/viewer/page/panels.py', 'test_panels.py'),
    ('manip_sim/cli/tables.py', 'test_cli_tables.py'),
    ('manip_sim/cli/check.py', 'test_cli_check.py'),
    ('manip_sim/records/__init__.py', 'test_interrupted.py'),
    ('manip_sim/ros/process.py', 'test_process.py'),
    ('manip_sim/examples/hand_over.py', 'test_hand_over.py'),
    ('docs/reference/command.md', 'test_reference_pages.py'),
    ('test/cli/test_cli_main.py', 'test_cli_main.py')])
def test_the_tests_of_a_file_are_near_to_it(changed, wanted):
    assert wanted in first(6, changed)


def test_each_module_has_tests():
    modules = (fast.ROOT / 'manip_sim').rglob('*.py')
    assert not [module for module in modules if not first(1, str(module.relative_to(fast.ROOT)))]


def test_each_changed_file_has_its_turn():
    assert {'test_tables', 'test_pacing'} <= {
        name.removesuffix('.py').replace('cli_', '') for name in first(
            2, 'manip_sim/cli/tables.py', 'manip_sim/runtime/pacing.py')}


def test_lines_that_differ_and_new_files_are_found(tmp_path, monkeypatch):
    monkeypatch.setattr(fast, 'ROOT', tmp_path)
    (tmp_path / 'old.py').write_text('a = 1\nb = 2\nc = 3\n')
    for words in (['init', '-q'], ['add', '.'], [
            '-c', 'user.name=a', '-c', 'user.email=a@b.c', 'commit', '-q', '-m', 'first']):
        subprocess.run(['git', *words], cwd=tmp_path, check=True)
    assert fast.changed_lines('HEAD') == {}
    (tmp_path / 'old.py').write_text('a = 1\nb = 4\n')
    (tmp_path / 'new.py').write_text('')
    assert fast.changed_lines('HEAD') == {'new.py': [], 'old.py': [2]}


def run(folder, seconds, *arguments):
    """Return exit code and outcomes of tests in a folder, by name, in the order they run."""
    done = subprocess.run(
        [sys.executable, '-m', 'pytest', '-v', '-p', 'fast', '-p', 'no:cacheprovider',
         '--rootdir', str(folder), '-c', os.devnull, *arguments],
        cwd=folder, capture_output=True, text=True, timeout=120,
        env={**os.environ, 'TEST_FAST_END': str(time.time() + seconds),
             'PYTHONPATH': str(Path(fast.__file__).parent)})
    lines = [line.split()[:2] for line in done.stdout.splitlines() if '::' in line]
    return done.returncode, {name.partition('::')[2]: outcome for name, outcome in lines}


def test_one_case_of_each_test_comes_before_further_cases_and_none_after_the_time(tmp_path):
    for name in ('test_b.py', 'test_a.py'):
        (tmp_path / name).write_text(f"""import pytest
@pytest.mark.parametrize('n', [1, 2])
def test_{name[5]}_many(n): pass
def test_{name[5]}_single(): pass
""")
    code, outcomes = run(tmp_path, 100.0, 'test_b.py', 'test_a.py')
    assert code == 0 and list(outcomes.items()) == [
        (f'test_{file}_{test}', 'PASSED') for file in 'ba'
        for test in ('many[1]', 'single', 'many[2]')]
    code, outcomes = run(tmp_path, -1.0, 'test_b.py')
    assert set(outcomes.values()) == {'SKIPPED'}
    assert code == pytest.ExitCode.NO_TESTS_COLLECTED  # No success where nothing has run.
