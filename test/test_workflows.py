# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Permissions of the workflows of CI, and pinned versions of the actions that they run."""

from pathlib import Path
import re
import subprocess

from packaging.requirements import Requirement
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / '.github' / 'workflows').glob('*.yml'))
WORKFLOWS = {file.name: yaml.safe_load(file.read_text()) for file in FILES}
JOBS = [(file, name, job) for file, found in WORKFLOWS.items()
        for name, job in found['jobs'].items()]


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.name)
def test_actions_are_pinned_by_hash_and_tell_their_version(file):
    used = re.findall(r'uses: *(.*)', file.read_text())
    assert used
    for action in used:
        assert re.fullmatch(r'[\w-]+/[\w-]+@[0-9a-f]{40}  # v\d+\.\d+\.\d+', action), action


@pytest.mark.parametrize(('file', 'name', 'job'), JOBS, ids=[job[1] for job in JOBS])
def test_a_job_has_the_least_rights_and_gives_no_token_to_its_steps(file, name, job):
    rights = job.get('permissions', WORKFLOWS[file].get('permissions'))
    assert rights == ({'contents': 'write'} if name == 'release' else {'contents': 'read'})
    assert 'token' not in str(job.get('env', {})) and 'token' not in str(
        WORKFLOWS[file].get('env', {}))
    for step in job['steps']:
        if step.get('uses', '').startswith('actions/checkout@'):
            assert step['with']['persist-credentials'] is False
        assert 'token' not in str(step.get('env', {})) or step['run'].startswith('gh release')


def test_a_job_that_may_write_runs_no_code_of_the_repository_or_of_packages():
    writers = [job for file, _, job in JOBS if 'write' in str(
        job.get('permissions', WORKFLOWS[file].get('permissions')))]
    assert len(writers) == 1
    for job in writers:
        for step in job['steps']:
            assert step.get('uses', '').startswith('actions/download-artifact@') or (
                step['run'].startswith('gh release create ') and '\n' not in step['run'])


def test_containers_are_the_image_of_the_dockerfile():
    image = re.search('^FROM (.*)$', (ROOT / 'Dockerfile').read_text(), re.MULTILINE)[1]
    found = [job['container'] for _, _, job in JOBS if 'container' in job]
    assert len(found) == 3 and set(found) == {image}


@pytest.mark.parametrize('function, free_names', [('wheel', 'mujoco'), ('kilted', 'ros-')])
def test_a_job_that_says_so_installs_what_is_locked(function, free_names, tmp_path):
    script = (ROOT / '.ci' / 'run').read_text().partition(f'\n{function}() {{\n')[2]
    condition = re.search(r'^  if \[ "\$\{LOCKED:-\}" = 1 \]; then.*?^  fi$', script,
                          re.MULTILINE | re.DOTALL)[0]
    done = subprocess.run(
        ['bash', '-euc', condition + '\necho "$PIP_CONSTRAINT"'], cwd=ROOT, check=True,
        capture_output=True, text=True, env={'LOCKED': '1', 'scratch': str(tmp_path),
                                             'PATH': '/usr/bin:/bin'})
    found = [Requirement(line) for line in Path(done.stdout.strip()).read_text().splitlines()]
    assert {'hypothesis', 'pytest', 'pytest-timeout', 'pytest-xdist', 'scipy', 'setuptools',
            'viser', 'numpy'} <= {one.name for one in found}
    # The lowest MuJoCo, and another ROS than that which is locked.
    assert not [one for one in found if one.name.startswith(free_names)]
    # All that it installs from then on is under these constraints, but for a NumPy of its own.
    free = re.findall(r'^.*pip install.*$', script.partition(condition)[2].partition(
        '\n}\n')[0], re.MULTILINE)
    assert free
    assert [line.split()[-1] for line in free if 'env -u PIP_CONSTRAINT' in line] == (
        ["'numpy==1.26.4'"] if function == 'wheel' else [])
    locked = [name for _, name, job in JOBS if job.get('env', {}).get('LOCKED') == '1']
    assert locked == ['wheels', 'build']
