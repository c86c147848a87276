# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Install with colcon and pip, find programs as ``ros2 run`` does, and talk to the node."""

import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys

from manip_sim.testing.domains import reserve_domain
import pytest

pytestmark = pytest.mark.full

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = ['sim_node', 'sim_view', 'manip_sim', 'pick_cube', 'hand_over']
PARTS = ['package.xml', 'pyproject.toml', 'setup.py', 'setup.cfg', 'README.md', 'resource',
         'manip_sim', 'assets', 'config', 'hardware']
FIND = ('from ament_index_python import get_package_prefix; '
        "print(get_package_prefix('manip_sim'))")
TALK = """
import rclpy
from sensor_msgs.msg import JointState

rclpy.init()
node = rclpy.create_node('client')
states = []
node.create_subscription(JointState, 'joint_states', states.append, 1)
for _ in range(200):
    rclpy.spin_once(node, timeout_sec=0.1)
    if states:
        break
print(states[0].name[0])
"""


@pytest.fixture(scope='module')
def install(tmp_path_factory):
    """Build a copy of the package and return the environment that sourcing it would give."""
    pytest.importorskip('rclpy', reason='the installed node needs ROS 2')
    pytest.importorskip('colcon_core', reason='colcon is a tool of the extra test')
    workspace = tmp_path_factory.mktemp('workspace')
    copy_sources(workspace / 'src' / 'manip_sim')
    colcon = [str(Path(sys.executable).parent / 'colcon')]
    if not Path(colcon[0]).exists():
        colcon = [shutil.which('colcon')]
    built = subprocess.run([*colcon, 'build', '--event-handlers', 'console_direct+'],
                           cwd=workspace, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return sourced(workspace / 'install' / 'manip_sim')


def copy_sources(folder):
    folder.mkdir(parents=True)
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
        copy(ROOT / part, folder / part)


def sourced(prefix):
    """Return an environment in which ROS finds what is installed under a prefix."""
    site = next(prefix.glob('lib/python3*/site-packages'))
    index = os.environ.get('AMENT_PREFIX_PATH', '')
    return dict(os.environ, AMENT_PREFIX_PATH=f'{prefix}:{index}',
                PYTHONPATH=f'{site}:{os.environ.get("PYTHONPATH", "")}')


def pip_install(folder, *options):
    """Install the package with pip under the prefix ``folder/prefix``."""
    pytest.importorskip('ament_index_python', reason='ros2 run looks in the index of ROS 2')
    copy_sources(folder / 'sources')
    done = subprocess.run(
        [sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps', '--no-compile',
         '--no-build-isolation', '--ignore-installed', '--prefix', str(folder / 'prefix'),
         *options, str(folder / 'sources')], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / 'prefix'


def executable(name, environment):
    prefix = subprocess.run([sys.executable, '-c', FIND], env=environment, capture_output=True,
                            text=True, check=True, cwd='/').stdout.strip()
    found = Path(prefix) / 'lib' / 'manip_sim' / name
    assert os.access(found, os.X_OK), found
    return str(found)


def test_the_node_runs_from_the_place_that_ros2_run_looks_at(install):
    domain, lock = reserve_domain()
    environment = dict(install, ROS_DOMAIN_ID=str(domain),
                       ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    node = subprocess.Popen([executable('sim_node', environment)], env=environment, cwd='/',
                            stderr=subprocess.PIPE, text=True)
    try:
        client = subprocess.run([sys.executable, '-c', TALK], env=environment, cwd='/',
                                capture_output=True, text=True, timeout=60, check=False)
        # The middleware may write lines of its own before.
        assert client.stdout.split()[-1:] == ['robot0_joint1'], client.stderr
    finally:
        node.send_signal(signal.SIGINT)
        errors = node.communicate(timeout=300.0)[1]
        os.close(lock)
    assert node.returncode == 0, errors


def test_the_examples_and_the_command_are_installed_beside_it(install):
    executable('pick_cube', install)
    executable('hand_over', install)
    done = subprocess.run([executable('manip_sim', install), 'list', 'robots'], env=install,
                          capture_output=True, text=True, check=True, cwd='/')
    prefix = Path(install['AMENT_PREFIX_PATH'].split(':')[0])
    assert f'Files of manip_sim lie in {prefix}/share/manip_sim' in done.stdout


def test_ros2_run_finds_each_program_of_a_wheel_once(tmp_path):
    environment = sourced(pip_install(tmp_path))
    for name in PROGRAMS:
        executable(name, environment)
    done = subprocess.run([executable('sim_node', environment), 'a b'], env=environment,
                          capture_output=True, text=True, check=False, cwd='/')
    assert done.returncode == 2
    assert "unknown argument 'a b'" in done.stderr


def test_ros2_run_finds_the_programs_of_an_editable_installation(tmp_path):
    prefix = pip_install(tmp_path, '--editable')
    assert os.access(prefix / 'lib' / 'manip_sim' / 'sim_node', os.X_OK)
    assert (prefix / 'share/ament_index/resource_index/packages/manip_sim').exists()


def test_colcon_installs_each_program_once_and_as_itself(install):
    prefix = Path(install['AMENT_PREFIX_PATH'].split(':')[0])
    found = [path for path in prefix.rglob('*')
             if path.name in PROGRAMS and path.is_file() and os.access(path, os.X_OK)]
    assert sorted(path.name for path in found) == sorted(PROGRAMS)
    for path in found:
        assert 'python' in path.read_text().splitlines()[0], path


def test_assets_and_configuration_are_installed(install):
    share = Path(install['AMENT_PREFIX_PATH'].split(':')[0]) / 'share' / 'manip_sim'
    for folder in ('assets', 'config'):
        wanted = {p.relative_to(ROOT) for p in (ROOT / folder).rglob('*') if p.is_file()}
        installed = {p.relative_to(share) for p in (share / folder).rglob('*') if p.is_file()}
        assert wanted == installed
