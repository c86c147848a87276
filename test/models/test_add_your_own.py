# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The steps of ``docs/how_to/add_your_own.md``, followed to the letter in a package copy."""

import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

import pytest

from manip_sim.resources import share_directory

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / 'docs' / 'how_to' / 'add_your_own.md'
FILE = re.compile(r'^`([^`\n]+)`:\n\n(?:<!-- [^>]* -->\n)?```\w+\n(.*?)```$',
                  re.DOTALL | re.MULTILINE)
SCRIPT = re.compile(r'^```python\n(from .*?)```$', re.DOTALL | re.MULTILINE)


@pytest.fixture(scope='module')
def package(tmp_path_factory):
    """Copy the package with its model tests, and add the files of the document."""
    copy = tmp_path_factory.mktemp('package')
    # Together with what Python and pytest have compiled, so that no process does it again.
    not_needed = shutil.ignore_patterns('ros')
    shutil.copytree(ROOT / 'manip_sim', copy / 'manip_sim', ignore=not_needed)
    shutil.copytree(share_directory() / 'assets', copy / 'assets')
    shutil.copytree(ROOT / 'test' / 'models', copy / 'test' / 'models', ignore=not_needed)
    shutil.copytree(ROOT / 'test' / 'data', copy / 'test' / 'data')
    # Without these, properties would be tried with other examples each time.
    for file in set((ROOT / 'test').glob('*.py')) - set((ROOT / 'test').glob('test_*.py')):
        shutil.copy(file, copy / 'test')
    for file in ('package.xml', 'pyproject.toml'):
        shutil.copy(ROOT / file, copy / file)
    for name, text in FILE.findall(DOCUMENT.read_text()):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_text(text)
    return copy


def run(package, *arguments):
    """Run Python in the copy, scripts with its own models; return the finished process."""
    path = os.pathsep.join([str(package), os.environ.get('PYTHONPATH', '')])
    models = str(package / 'my_models') if arguments[0] == '-c' else ''
    return subprocess.run(
        [sys.executable, *map(str, arguments)], cwd=package, text=True, capture_output=True,
        env={**os.environ, 'MANIP_SIM_PATH': models, 'PYTHONPATH': path},
        timeout=100, check=False)


def test_the_document_gives_a_model_a_readme_and_a_class_for_each_part():
    files = sorted(name for name, _ in FILE.findall(DOCUMENT.read_text()))
    assert files == [
        'assets/grippers/tiny_gripper/README.md', 'assets/grippers/tiny_gripper/part.yaml',
        'assets/grippers/tiny_gripper/tiny_gripper.xml',
        'assets/robots/tiny_arm/README.md', 'assets/robots/tiny_arm/tiny_arm.xml',
        'manip_sim/models/grippers/tiny_gripper.py', 'manip_sim/models/robots/tiny_arm.py',
        'my_models/grippers/small_hand.xml', 'my_models/grippers/small_hand.yaml',
        'my_models/robots/small_arm/robot.yaml', 'my_models/robots/small_arm/small_arm.xml']


@pytest.mark.full
def test_the_new_parts_are_found_and_mounted(package):
    done = run(package, '-c', """if True:
        from manip_sim.models.grippers import create_gripper, gripper_names
        from manip_sim.models.robots import create_robot, robot_names
        assert 'TinyArm' in robot_names() and 'TinyGripper' in gripper_names()
        robot = create_robot('TinyArm')
        robot.add_gripper(create_gripper(robot.default_gripper['right']))
        model = robot.compile()
        assert (model.nq, model.nu) == (5, 5)
        print(robot.arm_joints, robot.grippers['right'].actuators)
        """)
    assert done.returncode == 0, done.stderr
    assert 'robot0_elbow' in done.stdout and 'gripper0_left_finger' in done.stdout


@pytest.mark.full
def test_the_command_finds_nothing_wrong_with_the_new_arm(package):
    done = run(package, '-m', 'manip_sim.cli', 'check', '--robot', 'TinyArm')
    assert (done.returncode, done.stderr) == (0, '')
    assert done.stdout == 'TinyArm0 in arena empty: nothing is wrong with the start\n'


@pytest.mark.full
def test_the_scripts_of_the_document_run(package):
    scripts = SCRIPT.findall(DOCUMENT.read_text())
    assert scripts
    for script in scripts:
        done = run(package, '-c', script)
        assert done.returncode == 0, done.stderr


@pytest.mark.full
def test_the_catalogue_tests_take_the_new_parts_and_pass(package):
    files = [file for file in sorted((package / 'test' / 'models').glob('test_*.py'))
             if re.search('ROBOTS|GRIPPERS|_names', file.read_text())]
    done = run(package, '-m', 'pytest', '-q', '-p', 'no:cacheprovider',
               '--hypothesis-profile=fast', *files,
               '-k', 'TinyArm or TinyGripper or tiny_arm or tiny_gripper')
    assert done.returncode == 0, done.stdout
    # Poses, contacts, masses, stability, every base, actions, grasps: nothing is left out.
    passed = int(re.search(r'(\d+) passed', done.stdout).group(1))
    assert passed >= 40, done.stdout


@pytest.mark.full
def test_what_the_yaml_files_say_is_so(package):
    done = run(package, '-c', """if True:
        from manip_sim.models import compose
        from manip_sim.models.grippers import gripper_names
        from manip_sim.models.robots import robot_names
        assert 'small_arm' in robot_names() and 'small_hand' in gripper_names()
        robot = compose('small_arm', arena='table').robots[0]
        assert robot.eef_name == {'right': 'robot0_right_hand'}
        assert robot.init_qpos.tolist() == [0.0, 0.3, 1.8]
        assert type(robot.base).__name__ == 'RethinkMount'
        hand = robot.grippers['right']
        assert hand.format_action([1.0]).tolist() == [-1.0]
        assert not [s for s in hand.inferred if s.startswith(('closing', 'grasp'))]
        model = robot.compile()
        assert model.jnt_user[:3, 0].tolist() == [2.0, 2.0, 3.0]
        """)
    assert done.returncode == 0, done.stderr


def test_the_package_itself_knows_nothing_of_the_example():
    from manip_sim.models.robots import robot_names
    assert 'TinyArm' not in robot_names()
