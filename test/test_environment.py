# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Mistakes in the environment are one line that says what fits, before rclpy is imported."""

import os
import subprocess
import sys

from hypothesis import given, settings, strategies
import pytest

from manip_sim.errors import ManipSimError
from manip_sim.ros_environment import apt_names, check_ros_environment, missing_module

#: Run a program as if a module were not installed.
WITHOUT = """
import sys
sys.modules[sys.argv[1]] = None
sys.argv[1:] = []
from manip_sim.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize('value', ['0', '7', '101', '150', '232', ''])
def test_a_domain_that_has_ports_is_accepted(value, monkeypatch):
    monkeypatch.delenv('RMW_IMPLEMENTATION', raising=False)
    monkeypatch.setenv('ROS_DOMAIN_ID', value)
    check_ros_environment()


@pytest.mark.parametrize('value', ['233', '-1', 'abc', '7.0', ' 7', '0x10', '1' * 5000, '\u0667'])
def test_a_domain_without_ports_is_rejected_with_the_range(value, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', value)
    with pytest.raises(ManipSimError, match='a whole number from 0 to 232, got ') as caught:
        check_ros_environment()
    assert len(str(caught.value)) < 300
    assert 'below 102 or above 214' in str(caught.value)


@given(strategies.text(strategies.characters(exclude_characters='\0', exclude_categories=['Cs'])))
@settings(max_examples=100, derandomize=True, deadline=None)
def test_any_text_is_a_domain_or_one_line(text):
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv('RMW_IMPLEMENTATION', raising=False)
        patch.setenv('ROS_DOMAIN_ID', text)
        try:
            check_ros_environment()
        except ManipSimError as error:
            assert str(error).isprintable()
        else:
            assert text == '' or 0 <= int(text) <= 232


@pytest.mark.parametrize('strategy', ['', 'Permissive', 'Enforce'])
def test_security_without_a_keystore_is_rejected(strategy, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_SECURITY_STRATEGY', strategy)
    for keystore in ('', 'nowhere'):
        monkeypatch.setenv('ROS_SECURITY_KEYSTORE', keystore)
        with pytest.raises(ManipSimError, match='^ROS_SECURITY_ENABLE is true, and '
                           f"ROS_SECURITY_KEYSTORE is no folder, got '{keystore}': create one "):
            check_ros_environment()
    monkeypatch.setenv('ROS_SECURITY_KEYSTORE', str(tmp_path))
    check_ros_environment()
    monkeypatch.setenv('ROS_SECURITY_KEYSTORE', '')
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'false')
    check_ros_environment()


def index(folder, *names):
    folder = folder / 'share' / 'ament_index' / 'resource_index' / 'rmw_typesupport'
    folder.mkdir(parents=True)
    for name in names:
        (folder / name).touch()


def test_a_middleware_that_is_not_installed_is_rejected_with_those_that_are(
        tmp_path, monkeypatch):
    index(tmp_path / 'a', 'rmw_implementation', 'rmw_zenoh_cpp')
    index(tmp_path / 'b', 'rmw_fastrtps_cpp')
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'b'))
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}/a:{tmp_path}/nowhere')
    for name in ('rmw_zenoh_cpp', 'rmw_fastrtps_cpp', ''):
        monkeypatch.setenv('RMW_IMPLEMENTATION', name)
        check_ros_environment()
    monkeypatch.setenv('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp')
    with pytest.raises(ManipSimError, match="^RMW_IMPLEMENTATION is 'rmw_cyclonedds_cpp', which "
                       'is not installed; installed: rmw_fastrtps_cpp, rmw_zenoh_cpp$'):
        check_ros_environment()
    # Nothing is known where ROS has no index.
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    monkeypatch.delenv('AMENT_PREFIX_PATH')
    check_ros_environment()


@pytest.mark.parametrize('program', [
    'manip_sim', 'manip_sim.viewer', 'manip_sim.examples pick_cube',
    'manip_sim.examples hand_over'])
@pytest.mark.parametrize('variable, value', [
    ('ROS_DOMAIN_ID', '300'), ('RMW_IMPLEMENTATION', 'rmw_nonsense_cpp'),
    ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'localhost')])
def test_a_program_ends_with_one_line(program, variable, value, monkeypatch):
    pytest.importorskip('rclpy', reason='which middleware is installed is known to ROS')
    monkeypatch.setenv(variable, value)
    done = subprocess.run([sys.executable, '-m', *program.split()], capture_output=True,
                          text=True, timeout=60.0, check=False)
    assert (done.returncode, done.stdout) == (1, '')
    assert done.stderr.count('\n') == 1
    assert variable in done.stderr and value in done.stderr


@pytest.mark.parametrize('module, hint', [
    ('mujoco', 'pip install mujoco'), ('yaml', 'pip install pyyaml'), ('PIL', 'pillow'),
    ('viser', "pip install 'manip_sim[viewer]'"),
    ('websockets', "pip install 'manip_sim[viewer]'"), ('rclpy', 'source ROS 2 Jazzy'),
    ('sensor_msgs.msg', 'source ROS 2 Jazzy')])
def test_a_module_that_is_missing_is_named_with_what_installs_it(module, hint):
    line = missing_module(ModuleNotFoundError('', name=module))
    assert f"no module '{module.partition('.')[0]}'" in line and hint in line


@pytest.mark.full
def test_a_rclpy_that_cannot_be_used_is_named_with_its_folder(tmp_path):
    # As that of another ROS, whose modules for the C API are for another Python.
    (tmp_path / 'rclpy').mkdir()
    for text, reason in (
            ('import rclpy._rclpy_pybind11', "No module named 'rclpy._rclpy_pybind11'"),
            ('from rclpy import Node', "cannot import name 'Node'")):
        (tmp_path / 'rclpy/__init__.py').write_text(text)
        done = subprocess.run(
            [sys.executable, '-m', 'manip_sim'], capture_output=True, text=True, timeout=60.0,
            check=False, env={**os.environ, 'PYTHONPATH': str(tmp_path)})
        assert (done.returncode, done.stdout) == (1, '')
        assert done.stderr.startswith(
            f'sim_node: {tmp_path}/rclpy/__init__.py cannot be used: {reason}'), done.stderr
        assert done.stderr.endswith('in a new shell, source one ROS 2 only\n')
        assert done.stderr.count('\n') == 1


@pytest.mark.parametrize(('sourced', 'name'), [
    ('kilted', 'ros-kilted-tf2-msgs'), ('lyrical', 'ros-lyrical-tf2-msgs'),
    (None, 'ros-$ROS_DISTRO-tf2-msgs'), ('x; rm -r .', 'ros-$ROS_DISTRO-tf2-msgs')])
def test_packages_of_apt_are_those_of_the_ros_that_is_sourced(sourced, name, monkeypatch):
    monkeypatch.delenv('ROS_DISTRO', raising=False)
    if sourced:
        monkeypatch.setenv('ROS_DISTRO', sourced)
    assert apt_names('tf2_msgs') == name
    assert apt_names('tf2_msgs', 'xacro').split(' ros-')[-1].endswith('-xacro')


def test_a_package_from_pip_that_cannot_be_used_is_not_one_of_ros():
    line = missing_module(ImportError('libGL.so.1: cannot open\nmore', name='mujoco'))
    assert line == "module 'mujoco' cannot be used: libGL.so.1: cannot open"


def test_a_missing_module_of_the_package_is_an_error_of_the_package():
    with pytest.raises(ModuleNotFoundError):
        missing_module(ModuleNotFoundError('', name='manip_sim.ros.nothing'))


@pytest.mark.parametrize('code, error', [
    ('from manip_sim.experiments.policies import load_policy; load_policy("ros:/policy", None)',
     "policy 'ros:/policy': no module 'rclpy': source ROS 2 Jazzy or a later one, or install it "
     "from wheels with pip install 'manip_sim[jazzy]'"),
    ('from manip_sim.cli.main import main; main(["check", "--against", "/joint_states"])',
     "--against: no module 'rclpy': source ROS 2 Jazzy or a later one, or install it "
     "from wheels with pip install 'manip_sim[jazzy]'"),
    ('import manip_sim.env', "environments need gymnasium: pip install 'manip_sim[env]'")])
def test_what_uses_an_optional_package_names_what_installs_it(code, error):
    done = subprocess.run(
        [sys.executable, '-c', 'import sys\nfor name in ("rclpy", "gymnasium"):'
         f'\n    sys.modules[name] = None\n{code}'], capture_output=True, text=True, timeout=300.0)
    assert done.stderr.splitlines()[-1].endswith(error)


def test_without_mujoco_the_node_names_it_and_not_ros():
    done = subprocess.run([sys.executable, '-c', WITHOUT, 'mujoco'], capture_output=True,
                          text=True, timeout=60.0, check=False)
    assert (done.returncode, done.stdout) == (1, '')
    assert done.stderr == "sim_node: no module 'mujoco': install it with pip install mujoco\n"


#: Where no node has left files, the import of rclpy ends by SIGBUS.
FULL_OF_OTHERS = """
mount -t tmpfs -o size=1m tmpfs /dev/shm || exit 77
dd if=/dev/zero of=/dev/shm/full bs=4k 2> /dev/null
"$0" -m "$@"
"""
FULL = """
mount -t tmpfs -o size=8m tmpfs /dev/shm || exit 77
"$0" -c "import rclpy; rclpy.init(); node = rclpy.create_node('killed')
import os; os.kill(os.getpid(), 9)"
ls /dev/shm/fastrtps_????????????????
dd if=/dev/zero of=/dev/shm/full bs=4k 2> /dev/null
"$0" -m "$@"
"""


def run_without_room(script, program, transports='DEFAULT'):
    pytest.importorskip('rclpy', reason='needs ROS 2')
    done = subprocess.run(
        ['unshare', '--user', '--map-root-user', '--mount', 'sh', '-c', script,
         sys.executable, *program], capture_output=True, text=True, timeout=300.0,
        # With this range, rmw_fastrtps uses shared memory whatever the transports are.
        env={**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
             'FASTDDS_BUILTIN_TRANSPORTS': transports})
    if done.returncode == 77 or 'unshare' in done.stderr:
        pytest.skip('no mounts of its own here')
    return done


@pytest.mark.full
@pytest.mark.parametrize('transports', ['DEFAULT', 'UDPv4'])
@pytest.mark.parametrize('program', [['manip_sim'], ['manip_sim.cli', 'topic', 'list']])
def test_a_full_shared_memory_is_one_line_that_names_what_killed_nodes_have_left(
        program, transports):
    done = run_without_room(FULL, program, transports)
    left = done.stdout.split()[0].rpartition('/')[2]
    assert done.returncode == 1
    line = done.stderr.splitlines()[-1]
    name = 'manip_sim' if program[1:] else 'sim_node'
    assert line.startswith(f'{name}: /dev/shm has 0.0 MB left, and ROS needs 4 MB there: nodes '
                           'that were killed have left 0.')
    assert f'{left}*' in line and 'rm fastrtps_' in line


@pytest.mark.full
@pytest.mark.parametrize('program', [
    ['pytest', '-q', '-p', 'no:cacheprovider', 'test_of_mine.py'],
    ['manip_sim.cli', 'run', 'reach', '--policy', 'ros:/policy', '--seeds', '0', '--out', 'run'],
    ['manip_sim.env.ros']])
def test_a_full_shared_memory_ends_neither_tests_runs_nor_clients_without_a_word(
        program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'test_of_mine.py').write_text('def test_it(sim_node):\n    sim_node()\n')
    done = run_without_room(FULL_OF_OTHERS, program)
    assert done.returncode == 1
    assert '/dev/shm has 0.0 MB left, and ROS needs 4 MB there' in done.stdout + done.stderr
