# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What ``make`` sets for the programs that it starts, and does with an environment."""

import os
from pathlib import Path
import shutil
import subprocess

import pytest

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
MAKEFILE = Path(__file__).parent.parent / 'Makefile'


@pytest.mark.skipif(shutil.which('make') is None, reason='needs make')
@pytest.mark.parametrize('given, seen', [(None, 'LOCALHOST'), ('SUBNET', 'SUBNET')])
def test_make_keeps_ros_within_this_machine_unless_told_otherwise(given, seen, tmp_path):
    # A Makefile of a line that includes ours tells what a recipe would see.
    probe = tmp_path / 'Makefile'
    probe.write_text(f'include {MAKEFILE}\nprobe:\n\t@echo "range=$${RANGE}"\n')
    environment = {k: v for k, v in os.environ.items() if k not in (RANGE, 'MAKEFLAGS')}
    if given is not None:
        environment[RANGE] = given
    done = subprocess.run(['make', '-f', str(probe), 'probe'], capture_output=True, text=True,
                          env=environment, timeout=60.0)
    assert f'range={seen}' in done.stdout, done.stderr


def dry_run(*words, distribution=None):
    """Return what make would do without or with a distribution of ROS sourced."""
    environment = {k: v for k, v in os.environ.items() if k not in ('ROS_DISTRO', 'MAKEFLAGS')}
    if distribution:
        environment['ROS_DISTRO'] = distribution
    return subprocess.run(
        ['make', '--dry-run', '--always-make', *words], capture_output=True, text=True,
        env=environment, cwd=MAKEFILE.parent, timeout=60.0)


@pytest.mark.skipif(shutil.which('make') is None, reason='needs make')
@pytest.mark.parametrize('marker, wheels, cleared', [
    ('pyvenv.cfg', 'jazzy', False), ('.ready-wheels', 'jazzy', False),
    ('.ready-sourced', 'jazzy', True), ('.ready-kilted', 'jazzy', True),
    ('.ready-kilted', 'kilted', False), ('.ready-wheels', 'kilted', True)])
def test_make_keeps_what_is_installed_unless_ros_comes_from_elsewhere(
        marker, wheels, cleared, tmp_path):
    (tmp_path / marker).touch()
    done = dry_run(f'VENV={tmp_path}', f'WHEELS={wheels}', 'run')
    (line,) = [line for line in done.stdout.splitlines() if ' -m venv ' in line]
    assert ('--clear' in line) == cleared, line


@pytest.mark.skipif(shutil.which('make') is None, reason='needs make')
@pytest.mark.parametrize('distribution', [None, 'humble', 'jazzy', 'kilted', 'lyrical'])
@pytest.mark.parametrize('wheels', ['jazzy', 'kilted'])
def test_make_uses_the_ros_that_is_sourced_and_else_wheels(distribution, wheels, tmp_path):
    made = dry_run(
        f'VENV={tmp_path}', f'WHEELS={wheels}', 'lint', distribution=distribution).stdout
    is_sourced = distribution in ('jazzy', 'kilted', 'lyrical')
    assert ('--system-site-packages' in made) == is_sourced
    assert (f"'.[{wheels},viewer]'" in made) != is_sourced
    assert (f'[docs,{wheels}-test,' in made) != is_sourced
    # There are wheels of MuJoCo, numba and ROS for it.
    assert '3.10 to 3.14' in made


@pytest.mark.skipif(shutil.which('make') is None, reason='needs make')
@pytest.mark.parametrize('words, error', [
    (['WHEELS=humble'], "WHEELS is jazzy or kilted, got 'humble'"),
    (['WHEELS=kilted', 'LOCKED=1'],
     'LOCKED=1 is for ROS 2 Jazzy from wheels, not for kilted')])
def test_make_says_which_wheels_there_are(words, error):
    done = dry_run(*words, 'run')
    assert done.returncode == 2 and error in done.stderr


@pytest.mark.skipif(shutil.which('make') is None, reason='needs make')
@pytest.mark.parametrize('target, ready, installs', [
    ('run', True, True), ('pick', True, False), ('view', True, False), ('view', False, True)])
def test_what_runs_beside_a_node_does_not_change_its_environment(
        target, ready, installs, tmp_path):
    if ready:  # Older than setup.py.
        (tmp_path / '.ready-wheels').touch()
        os.utime(tmp_path / '.ready-wheels', (0, 0))
    environment = {k: v for k, v in os.environ.items() if k not in ('ROS_DISTRO', 'MAKEFLAGS')}
    done = subprocess.run(
        ['make', '--dry-run', f'VENV={tmp_path}', target], capture_output=True, text=True,
        env=environment, cwd=MAKEFILE.parent, timeout=60.0, check=True)
    assert ('pip install' in done.stdout) == installs, done.stdout
