# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Starts that cannot succeed: one line that says why, and exit code 1."""

import errno
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading

from forks import ends
import pytest
import rclpy
from rclpy.executors import InvalidHandle

from manip_sim.errors import ManipSimError
from manip_sim.ros import sim_node
from manip_sim.ros.declared_parameters import Parameters
from manip_sim.ros.executor import load_laws
from manip_sim.ros.process import for_other_nodes

QOS = 'qos_overrides./joint_states.publisher'
REJECTED = {
    f'-p {QOS}.reliability:=bogus': (
        f"parameter '{QOS}.reliability': unknown value 'bogus'", 'best_effort'),
    f'-p {QOS}.reliability:=1': (f"parameter '{QOS}.reliability': unknown value '1'",),
    f'-p {QOS}.history:=all': (f"parameter '{QOS}.history': unknown value 'all'", 'keep_all'),
    f'-p {QOS}.depth:=0': (f"parameter '{QOS}.depth' must be an integer from 1 to", "got '0'"),
    f'-p {QOS}.depth:=true': (f"parameter '{QOS}.depth' must be an integer from 1 to",),
    f'-p {QOS}.durability:=volatile': (
        f"unknown parameter '{QOS}.durability': did you mean '{QOS}.",),
    '-p qos_overrides./joint_stats.publisher.depth:=5': (
        f"unknown parameter 'qos_overrides./joint_stats.publisher.depth': "
        f"did you mean '{QOS}.depth'",),
    f'-r __ns:=/left -p {QOS}.depth:=5': (
        f"unknown parameter '{QOS}.depth': "
        "did you mean 'qos_overrides./left/joint_states.publisher.depth'",),
    '-p use_sim_time:=nonsense': ("parameter 'use_sim_time'", "'nonsense'", 'BOOL'),
    f'-r __node:={"a" * 300}': ('invalid node name', "should not exceed '255'"),
    '-p robot': ('bad ROS arguments', "'-p robot'"),
    '-p robot=Panda': ("'-p robot=Panda' must be -p NAME:=VALUE",),
    '-p robot: Panda': ("'-p robot:' must be -p NAME:=VALUE, without spaces",),
    'robot:=Panda': ("'robot:=Panda' must follow -p: -p robot:=Panda",),
    '__ns:=/left': ("'__ns:=/left' must follow -r: -r __ns:=/left",),
    '-p position:=[0,0.5,0]': ("'position:=[0,0.5,0]': write all numbers of a list with a",),
    '-r joint_command': ("'-r joint_command' must be -r OLD:=NEW",),
    '-r __ns:=left': ("'__ns:=left': a namespace begins with a slash: __ns:=/left",),
    '-r __node:=my-node': ("'__node:=my-node': the name of a node consists of letters,",),
    '--log-level nonsense -p robot:=Panda': ('bad ROS arguments', 'nonsense'),
    '--params-file nofile.yaml': ('bad ROS arguments', 'nofile.yaml'),
    '-p lockstep_parts:=[] -p stepping:=lockstep': (
        "parameter 'lockstep_parts': lockstep needs at least one part",)}


@pytest.fixture(scope='module')
def rejected():
    """Return how the starts that cannot succeed end, by their arguments."""
    return dict(zip(REJECTED, ends([['--ros-args', *words.split()] for words in REJECTED])))


@pytest.mark.full
@pytest.mark.parametrize('arguments', REJECTED)
def test_a_start_that_cannot_succeed_ends_with_one_line(arguments, rejected):
    code, output, errors = rejected[arguments]
    assert (code, output) == (1, '')
    assert len(errors.splitlines()) == 1, errors
    assert '/src/' not in errors
    for words in REJECTED[arguments]:
        assert words in errors


def test_a_node_that_cannot_be_built_is_destroyed_whatever_has_failed(serve, monkeypatch):
    built = []

    def fail(parameters, scope, parts):
        built.append(parameters._node)
        raise KeyError('left')
    monkeypatch.setattr(Parameters, 'couple', fail)
    with pytest.raises(KeyError):
        serve()
    with pytest.raises(InvalidHandle):
        built[0].get_name()


@pytest.mark.full
@pytest.mark.parametrize('content, line', [
    ('/**:\n\tros__parameters:\n', r", line 2: found character '\t' that cannot start any token"),
    ('robot: Panda\n', ": parameters must be below the name of the node and 'ros__parameters'"),
    ('manip_sim:\n  robot: Panda\n', ': parameters must be below the name of the node and ')])
def test_a_parameters_file_that_ros_cannot_read_is_explained(content, line, tmp_path):
    file = tmp_path / 'parameters.yaml'
    file.write_text(content)
    ((code, output, errors),) = ends([['--ros-args', '--params-file', str(file)]])
    assert (code, output, errors.count('\n')) == (1, '', 1)
    assert errors.startswith(f"sim_node: bad ROS arguments: '{file}'{line}"), errors


@pytest.mark.full
def test_a_home_that_cannot_be_written_is_named(process, monkeypatch):
    monkeypatch.setenv('HOME', '/proc/nobody')
    monkeypatch.delenv('ROS_LOG_DIR', raising=False)
    monkeypatch.delenv('ROS_HOME', raising=False)
    node = process()
    _, errors = node.communicate(timeout=300.0)
    assert node.returncode == 1
    assert len(errors.splitlines()) == 1, errors
    assert '/proc/nobody' in errors
    assert 'set ROS_LOG_DIR' in errors
    assert 'arguments' not in errors


@pytest.mark.full
@pytest.mark.parametrize(('program', 'folder'), [
    (['manip_sim'], '/proc/self'), (['manip_sim'], '/dev/null/log'),
    (['manip_sim.viewer', '--port', '0'], '/proc/self'),
    (['manip_sim.cli', 'record', 'new.mcap'], '/dev/null/log'),
    (['manip_sim.cli', 'topic', 'list'], '/proc/self'),
    (['manip_sim.examples', 'pick_cube'], '/dev/null/log')])
def test_a_log_folder_that_cannot_be_written_is_one_line(program, folder, tmp_path):
    done = subprocess.run(
        [sys.executable, '-m', *program], cwd=tmp_path, capture_output=True, text=True,
        timeout=300.0, check=False, env={**os.environ, 'ROS_LOG_DIR': folder})
    assert (done.returncode, done.stdout, done.stderr.count('\n')) == (1, '', 1), done.stderr
    assert folder in done.stderr and 'set ROS_LOG_DIR to a folder' in done.stderr


@pytest.mark.full
@pytest.mark.parametrize('log', [None, '~/log'])
@pytest.mark.parametrize('program', [
    ['manip_sim'], ['manip_sim.viewer', '--port', '0'], ['manip_sim.cli', 'topic', 'list']])
def test_an_environment_without_a_home_is_one_line(program, log, tmp_path):
    kept = {name: value for name, value in os.environ.items()
            if name not in ('HOME', 'ROS_HOME', 'ROS_LOG_DIR')}
    done = subprocess.run(
        [sys.executable, '-m', *program], cwd=tmp_path, capture_output=True, text=True,
        timeout=300.0, check=False, env={**kept, **({'ROS_LOG_DIR': log} if log else {})})
    assert (done.returncode, done.stdout, done.stderr.count('\n')) == (1, '', 1), done.stderr
    assert 'HOME is not set: set it, or ROS_LOG_DIR to a folder' in done.stderr


def test_compiled_laws_that_cannot_be_kept_are_one_line(monkeypatch):
    def fail():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr('manip_sim.control.law.loading.load_laws', fail)
    with pytest.raises(ManipSimError, match='cannot keep compiled control laws in .*: No space '
                       'left on device; set XDG_CACHE_HOME to another folder'):
        load_laws()


def test_a_start_does_not_import_what_only_files_of_users_tasks_or_commands_need():
    script = ("import sys; import manip_sim.ros.process; print(sorted({'numba', 'pydantic', "
              "'manip_sim.models.files', 'manip_sim.tasks'} & sys.modules.keys()))")
    assert subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          timeout=300.0, check=True).stdout == '[]\n'


def test_a_node_imports_the_c_code_of_messages_without_the_generator_of_their_python_code():
    ended = subprocess.run(
        [sys.executable, '-X', 'importtime', '-m', 'manip_sim', '--ros-args', '-p',
         'robot:=Pander'],
        capture_output=True, text=True, timeout=300.0, check=False)
    assert "'Pander'" in ended.stderr
    imported = {line.rpartition('|')[2].strip() for line in ended.stderr.splitlines()}
    assert 'rosidl_generator_py.import_type_support_impl' in imported
    assert 'lark' not in imported


@pytest.mark.parametrize('stepping', ['realtime', 'free', 'lockstep'])
def test_laws_that_are_kept_are_loaded_before_the_first_command(serve, monkeypatch, stepping):
    monkeypatch.setattr(sim_node, 'all_are_kept', lambda: True)
    loaded = threading.Event()
    monkeypatch.setattr('manip_sim.ros.sim_node.load_laws', loaded.set)
    node = serve(stepping=stepping)
    assert loaded.wait(300.0)
    assert node.declared.value('stepping') == stepping


def first_joint_and_warnings(process, client, *arguments):
    node = process('--ros-args', *arguments)
    joint = client.state().name[0]
    node.send_signal(signal.SIGINT)
    _, errors = node.communicate(timeout=300.0)
    assert node.returncode == 0
    # That other processes slow the machine is no matter of the arguments.
    return joint, [line for line in errors.splitlines()
                   if '[WARN]' in line and 'too slow' not in line]


@pytest.mark.full
def test_an_empty_list_of_lockstep_parts_is_a_list(process, client):
    _, warnings = first_joint_and_warnings(process, client, '-p', 'lockstep_parts:=[]')
    assert not warnings


def file_for(key, folder):
    file = folder / 'parameters.yaml'
    file.write_text(f'"{key}":\n  ros__parameters:\n    idn: 7\n')
    return file


@pytest.mark.full
@pytest.mark.parametrize('key, effect', [
    ('sim_node', False), ('/ns/manip_sim', False), ('/*/*', False),
    ('manip_sim', True), ('/manip_sim', True), ('/**', True), ('/**/manip_sim', True),
    ('/*', True)])
def test_a_parameters_file_is_for_the_nodes_that_rcl_gives_it_to(key, effect, domain, tmp_path):
    arguments = ['--ros-args', '--params-file', str(file_for(key, tmp_path))]
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node('manip_sim', context=context, cli_args=arguments,
                             automatically_declare_parameters_from_overrides=True)
    given = node.has_parameter('idn')
    node.destroy_node()
    context.shutdown()
    assert (given, not list(for_other_nodes(arguments, '/manip_sim'))) == (effect, effect)


@pytest.mark.full
@pytest.mark.parametrize('key, effect', [('/ns/manip_sim', False), ('/*', True)])
def test_a_parameters_file_for_other_nodes_is_told(key, effect, process, client, tmp_path):
    file = file_for(key, tmp_path)
    joint, warnings = first_joint_and_warnings(process, client, '--params-file', str(file))
    assert joint == ('robot7_joint1' if effect else 'robot0_joint1')
    if effect:
        assert not warnings
    else:
        assert len(warnings) == 1
        assert 'has no effect' in warnings[0]
        assert 'this node is /manip_sim' in warnings[0]


@pytest.mark.full
def test_a_parameter_for_another_node_is_told(process, client):
    _, warnings = first_joint_and_warnings(process, client, '-p', 'sim_node:robot:=GR1')
    assert len(warnings) == 1
    assert "is for 'sim_node'" in warnings[0]


@pytest.mark.parametrize(('length', 'whole'), [(200, True), (201, False)])
def test_a_long_name_of_a_parameters_file_for_other_nodes_is_shortened(length, whole, tmp_path):
    file = str(tmp_path / 'x')
    file += 'x' * (length - len(file))
    Path(file).write_text('other:\n  ros__parameters: {rate: 1}\n')
    warning, = for_other_nodes(['--params-file', file], '/manip_sim')
    assert (f"'{file}' has" in warning, f"'{file[:200]}'" in warning) == (whole, True)
