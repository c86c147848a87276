# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The container file, as far as it can be checked without building it; CI builds it."""

import json
from pathlib import Path
import re
import shlex
import subprocess

from packaging.requirements import Requirement
import pytest

ROOT = Path(__file__).resolve().parents[1]
LINES = [line for line in (ROOT / 'Dockerfile').read_text().splitlines()
         if not line.startswith('#')]
INSTRUCTIONS = [tuple(line.split(' ', 1))
                for line in '\n'.join(LINES).replace('\\\n', ' ').splitlines() if line]
KEYWORDS = {'FROM', 'ENV', 'WORKDIR', 'COPY', 'RUN', 'USER', 'ENTRYPOINT', 'CMD'}


def arguments(keyword):
    return [rest for word, rest in INSTRUCTIONS if word == keyword]


def words_after(*begin):
    """Return the names that a command of the image installs, without its options."""
    for run in arguments('RUN'):
        for command in run.split('&&'):
            words = shlex.split(command)
            if words[:len(begin)] == list(begin):
                return [word for word in words[len(begin):] if not word.startswith('--')]
    raise AssertionError(begin)


def test_its_instructions_are_known_and_it_begins_with_ros():
    assert {word for word, _ in INSTRUCTIONS} == KEYWORDS
    word, image = INSTRUCTIONS[0]
    assert word == 'FROM' and re.fullmatch('ros:jazzy@sha256:[0-9a-f]{64}', image)


def test_what_it_runs_has_the_rights_of_a_user_that_it_makes():
    (user,) = arguments('USER')
    assert user != 'root' and any(f'useradd --create-home {user}' in run
                                  for run in arguments('RUN'))
    words = [word for word, _ in INSTRUCTIONS]
    as_root = words[:words.index('USER')].count('RUN')
    as_user = arguments('RUN')[as_root:]
    assert [run for run in as_user if 'install ' in run or 'useradd' in run] == []
    assert words.index('USER') < words.index('ENTRYPOINT') < words.index('CMD')


def test_pip_installs_the_versions_of_the_requirements_but_for_numpy(tmp_path):
    (tmp_path / 'src').mkdir()
    (tmp_path / 'src' / 'manip_sim').symlink_to(ROOT)
    (environment,) = arguments('ENV')
    assert 'PIP_CONSTRAINT=/ws/locked.txt' in environment and arguments('WORKDIR')[0] == '/ws'
    subprocess.run(['sh', '-ec', arguments('RUN')[0]], cwd=tmp_path, check=True)
    found = [Requirement(line) for line in (tmp_path / 'locked.txt').read_text().splitlines()]
    locked = [Requirement(line.partition(' \\')[0]) for line in (
        ROOT / 'requirements' / 'run.txt').read_text().splitlines() if line[:1].isalpha()]
    for one in locked:
        one.extras.clear()  # Constraints of pip have none.
    assert [str(one) for one in found] == [
        *(str(one) for one in locked if one.name != 'numpy'), 'numpy==1.26.4']
    assert {'mujoco', 'viser', 'trimesh'} <= {one.name for one in found}


@pytest.mark.parametrize('run', arguments('RUN'), ids=lambda run: run.split()[0])
def test_its_commands_are_valid_shell_that_ends_with_the_first_error(run):
    subprocess.run(['sh', '-n', '-c', run], check=True)
    assert ';' not in run and '||' not in run


def test_beside_what_package_xml_names_it_installs_what_documentation_and_setup_py_name():
    opengl = (ROOT / 'docs' / 'how_to' / 'cameras.md').read_text()
    for package in words_after('apt-get', 'install'):
        assert package == 'python3-pip' or f'`{package}`' in opengl, package
    setup = (ROOT / 'setup.py').read_text()
    for requirement in words_after('python3', '-m', 'pip', 'install'):
        name = re.split('[<>]', requirement)[0]
        assert requirement == 'numpy<2' or f"'{requirement}'" in setup, name


def test_its_entry_point_sources_the_workspace_and_runs_a_command_with_its_arguments(tmp_path):
    (tmp_path / 'setup.bash').write_text('export SOURCED=yes\n')
    entry, = (json.loads(text.replace('/ws/install', str(tmp_path)))
              for text in arguments('ENTRYPOINT'))
    done = subprocess.run([*entry, 'sh', '-c', 'echo "$SOURCED" "$1"', '-', 'a  b'], text=True,
                          capture_output=True, check=True)
    assert done.stdout == 'yes a  b\n'
    command, = map(json.loads, arguments('CMD'))
    assert command == ['ros2', 'run', 'manip_sim', 'sim_node']
    assert "'sim_node': " in (ROOT / 'setup.py').read_text()


def test_it_copies_nothing_that_git_ignores():
    def names(file):
        return {line.strip('/').removeprefix('**/')
                for line in (ROOT / file).read_text().splitlines() if not line.startswith('#')}
    assert names('.gitignore') - names('.dockerignore') == {'*.pyc'}
