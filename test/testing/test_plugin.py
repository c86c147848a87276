# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The plugin of pytest as a user has it: in a folder of tests of their own."""

import importlib.util
import subprocess
import sys

import numpy as np
from pages import blocks, DOCS
from PIL import Image
import pytest

from manip_sim.models.archive import load_archive

pytestmark = pytest.mark.full

needs_ros = pytest.mark.skipif(importlib.util.find_spec('rclpy') is None,
                               reason='the fixture sim_node needs ROS 2')


def pytest_in(folder, *arguments):
    return subprocess.run([sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider',
                           *arguments], cwd=folder, capture_output=True, text=True, timeout=500)


#: Tests of the page on testing, by file.
PAGE = {block.file: block.text
        for block in blocks(DOCS / 'how_to' / 'test_your_controller.md') if block.tested_by}


FAILS = """
from sensor_msgs.msg import JointState


def test_that_fails(sim_node):
    sim = sim_node(robot='UR5e', arena='table', gripper='none')
    sim.publish('joint_command', JointState(name=['robot0_wrist_3_joint'], position=[1.0]))
    sim.run_for(0.2)
    assert False
"""


FAILS_AT_ITS_END = """
import threading

simulations = []


def test_that_fails_at_its_end(sim_node):
    simulations.extend([sim_node(), sim_node()])
    thread = threading.Thread(target=lambda: {}['no such key'])
    thread.start()
    thread.join()


def test_that_both_have_ended():
    assert len(simulations) == 2 and not any(sim.node.context.ok() for sim in simulations)
    assert threading.excepthook.__module__ != 'manip_sim.testing.controllers'
"""


FAILING = {'test_of_mine.py': FAILS, 'test_its_end.py': FAILS_AT_ITS_END}


@pytest.fixture(scope='module')
def ran(tmp_path_factory):
    """Run the tests of the page on testing, and some that fail; return the folder and the end."""
    folder = tmp_path_factory.mktemp('tests')
    for name, text in {**PAGE, **FAILING}.items():
        (folder / name).write_text(text)
    return folder, pytest_in(folder, '-rA', '--sim-node-failures', 'left')


@needs_ros
def test_the_tests_of_the_page_on_testing_pass(ran):
    _, done = ran
    assert set(PAGE) == {'test_reach.py', 'test_follower.py', 'test_admittance.py',
                         'test_pick.py'}
    for name in PAGE:
        assert f'\nPASSED {name}::' in done.stdout, done.stdout


@needs_ros
def test_all_simulations_of_a_test_end_although_the_controller_of_one_has_failed(ran):
    _, done = ran
    assert "KeyError: 'no such key'" in done.stdout
    for line in ('ERROR test_its_end.py::test_that_fails_at_its_end',
                 'PASSED test_its_end.py::test_that_both_have_ended',
                 '1 failed, 6 passed, 1 error'):
        assert line in done.stdout, done.stdout


@needs_ros
def test_a_failed_test_leaves_states_model_and_picture(ran, renderer):
    tests, done = ran
    assert done.returncode == 1
    folder = tests / 'left' / 'test_of_mine.py_test_that_fails'
    assert f'the last instant: {folder}/picture.png' in done.stdout
    assert ': /manip_sim, /test_of_a_controller\n' in done.stdout
    with np.load(folder / 'states.npz') as states:
        assert states['joint_states/position'].shape == (21, 6)
        assert states['joint_states/time_s'][-1] == pytest.approx(0.21)
    assert load_archive((folder / 'model.mjz').read_bytes()).nq == 13  # With the free cube.
    with Image.open(folder / 'picture.png') as picture:
        assert len(np.unique(np.asarray(picture.convert('RGB')).reshape(-1, 3), axis=0)) > 1000


def test_the_plugin_imports_neither_ros_nor_mujoco():
    script = ('import sys; import manip_sim.testing.plugin; '
              'print(*{"rclpy", "mujoco", "numpy"}.intersection(sys.modules))')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          check=True)
    assert not done.stdout.strip()


def test_without_ros_the_fixture_skips_a_test(tmp_path):
    (tmp_path / 'rclpy.py').write_text('raise ModuleNotFoundError("no ROS here")')
    (tmp_path / 'test_of_mine.py').write_text('def test_it(sim_node):\n    sim_node()\n')
    done = pytest_in(tmp_path, '-rs')
    assert done.returncode == 0
    assert 'the fixture sim_node needs ROS 2' in done.stdout
