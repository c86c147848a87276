# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim topic``, ``param`` and ``service`` against a node, with the words of ``ros2``."""

from contextlib import nullcontext
import importlib
import os
import re
import signal
import subprocess
import sys
import threading
from unittest.mock import Mock

from geometry_msgs.msg import PoseStamped, PoseWithCovariance
from harness import Client
import pytest
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.duration import Duration
from rclpy.qos import (
    qos_profile_sensor_data, QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy)
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Byte, Float32, Float64MultiArray, String, UInt8
from std_srvs.srv import SetBool
import yaml

from manip_sim.cli import ros_commands
from manip_sim.cli.main import main
from manip_sim.cli.ros_commands import _message, _plain
from manip_sim.errors import MessageError

DONE = [
    ('topic list', r'^/arm/command\n(/\w.*\n)*/joint_states\n(/\w.*\n)*$'),
    ('topic list -t', r'(?m)^/joint_states \[sensor_msgs/msg/JointState\]$'),
    ('topic list -c', r'^\d\d\n$'),
    ('topic info /joint_command', r'^Type: sensor_msgs/msg/JointState\nPublisher count: 0\n'
     r'Subscription count: 1\n$'),
    ('topic info -v joint_states', r'Node name: manip_sim\n(.*\n)*  Reliability: RELIABLE'),
    ('topic echo --once /right/eef_pose', r'^header:\n  stamp:\n    sec: 0\n    nanosec: \d+\n'
     r'  frame_id: world\npose:\n  position:\n    x: [-.\de]+\n(.*\n)+---\n$'),
    ('topic echo --once /manip_sim/mjcf', r'^data: .{120,600}\.\.\..?\n---\n$'),
    ('topic echo --once -f /manip_sim/mjcf', r'^data: (.|\n)*</mujoco>(.|\n)*---\n$'),
    ('topic echo --once joint_states --field name', r'^- robot0_joint1\n(- \w+\n)+---\n$'),
    ('topic echo --once --no-arr /arm/joint_states', r'name: <array of 7>\n'),
    ('topic echo --once joint_states sensor_msgs/JointState', r'\nname:\n- robot0_joint1\n'),
    ('topic pub --once /joint_command sensor_msgs/msg/JointState '
     '{header: auto, name: [robot0_joint1], position: [1]}',
     r"^publisher: beginning loop\npublishing #1: sensor_msgs\.msg\.JointState\(header=.*sec="
     r"[1-9]\d+.*name=\['robot0_joint1'\], position=\[1\.0\], velocity=\[\], effort=\[\]\)\n\n$"),
    ('topic pub -r 20 -t 3 /right/gripper/command std_msgs/Float64MultiArray {data: [1.0]}',
     r'(?s)publishing #1: .*publishing #3: .*\n$'),
    ('param list manip_sim --filter control_mode',
     r'^  control_mode\.arm\n  control_mode\.right\n$'),
    ('param list', r'^/manip_sim:\n  (.*\n)*  timestep\n'),
    ('param get /manip_sim control_mode.arm', '^String value is: position\n$'),
    ('param get /manip_sim timestep --hide-type', '^0.002\n$'),
    ('param get /manip_sim lockstep_parts', r"^String values are: \['arm'\]\n$"),
    ('param describe /manip_sim timestep', r'^Parameter name: timestep\n  Type: double\n'
     r'  Description: Physics step\. \[s\]\n  Constraints:\n    Read only: true\n'
     r'    Min value: 0\.0001\n    Max value: 0\.01\n$'),
    ('param set /manip_sim control_mode.arm velocity', '^Set parameter successful\n$'),
    ('param dump manip_sim', r'^/manip_sim:\n  ros__parameters:\n    arena: table\n(.*\n)*'
     r'    control_mode:\n      arm: velocity\n'),
    ('param load /manip_sim two.yaml', r'(?s)^Set parameter control_mode.arm successful\n'
     r'.*Set parameter cartesian_stiffness.right successful\n$'),
    ('param load manip_sim all.yaml', '^Set parameter control_mode.arm successful\n$'),
    ('topic type /joint_states', '^sensor_msgs/msg/JointState\n$'),
    ('topic find sensor_msgs/msg/JointState', r'^(/[\w/]+\n)*/joint_states\n(/[\w/]+\n)*$'),
    ('topic find -c std_msgs/msg/Int8', '^0\n$'),
    ('service find std_srvs/srv/SetBool', r'^(/manip_sim/\w+\n)*/manip_sim/pause\n'),
    ('service find -c std_srvs/srv/Empty', '^0\n$'),
    ('service type manip_sim/reset', '^std_srvs/srv/Trigger\n$'),
    ('service list', r'(?m)^/manip_sim/reset$'),
    ('service list -t', r'(?m)^/manip_sim/reset \[std_srvs/srv/Trigger\]$'),
    ('service call /manip_sim/reset std_srvs/srv/Trigger',
     r"^requester: making request: std_srvs\.srv\.Trigger_Request\(\)\n\nresponse:\n"
     r"std_srvs\.srv\.Trigger_Response\(success=True, message='back at the start'\)\n\n$")]
#: Wrong command, exit code and message.
WRONG = [
    ('topic echo /joint_stats', 1, "unknown published topic '/joint_stats': did you mean "
     "'/joint_states'"),
    ('topic hz joint_command', 1, "unknown published topic 'joint_command': "),
    ('topic info /joint_stats', 1, "unknown topic '/joint_stats': did you mean '/joint_states'"),
    ('topic echo --once joint_states --field postion', 1, "unknown field of joint_states 'postion'"
     ": did you mean 'position'"),
    ('topic pub --once joint_comand sensor_msgs/msg/JointState', 1, "unknown subscribed topic "
     "'joint_comand': did you mean '/joint_command'"),
    ('topic pub --once joint_command std_msgs/String', 1, '/joint_command has the type '
     'sensor_msgs/msg/JointState, not std_msgs/msg/String'),
    ('topic pub --once joint_command sensor_msgs/msg/JointStat', 1, 'did you mean '
     "'sensor_msgs/msg/JointState'"),
    ('topic pub --once joint_command sensor_msg/msg/JointState', 1, "there is no package "
     "'sensor_msg' of messages here: correct the name, or install it ("),
    ('topic pub --once joint_command JointState', 1, "'JointState' is not the type of a message"),
    ('topic pub --once joint_command sensor_msgs/msg/JointState {postion: [1.0]}', 1,
     "unknown field of sensor_msgs/msg/JointState 'postion': did you mean 'position'"),
    ('topic pub --once joint_command sensor_msgs/msg/JointState {position: [a]}', 1,
     'field position of sensor_msgs/msg/JointState is sequence<double>'),
    ('topic pub --once joint_command sensor_msgs/msg/JointState {position: [1.0}', 1, 'not YAML'),
    ('topic pub --once joint_command sensor_msgs/msg/JointState [1.0]', 1, 'must be fields'),
    ('topic pub --once joint..command std_msgs/msg/String', 1, 'topic name must not contain'),
    ('topic pub --rate 0 joint_command std_msgs/msg/String', 2, 'must be above 0'),
    ('param get /manip_sin timestep', 1, "unknown node '/manip_sin': did you mean '/manip_sim'"),
    ('param get /manip_sim timestp', 1, "'timestp': did you mean 'timestep'"),
    ('param describe /manip_sim timestp', 1, "'timestp': did you mean 'timestep'"),
    ('param set /manip_sim timestp 0.001', 1, 'timestep'),
    ('param set /manip_sim control_mode.arm veloc', 1, "Setting parameter failed: parameter "
     "'control_mode.arm': unknown value 'veloc': did you mean 'velocity'"),
    ('param set /manip_sim seed 99999999999999999999', 1, 'cannot use the value'),
    ('param list /manip_sim --filter (', 1, '--filter'),
    ('param delete /manip_sim timestp', 1, "'timestp': did you mean 'timestep'"),
    ('param delete /manip_sim timestep', 1, 'Deleting parameter failed: '),
    ('topic find sensor_msgs/msg/JointStat', 1, "did you mean 'sensor_msgs/msg/JointState'"),
    ('service find JointState', 1, "'JointState' is not the type of a service"),
    ('topic delay /manip_sim/mjcf', 1, 'the messages on /manip_sim/mjcf have no header'),
    ('param load /manip_sim two.yamel', 1, 'two.yamel: [Errno 2] No such file'),
    ('param load /manip_sim other.yaml', 1, 'other.yaml: Param file does not contain'),
    ('param load /manip_sim all.yaml --no-use-wildcard', 1, 'all.yaml: Param file does not'),
    ('param load /manip_sim fast.yaml', 1, 'Set parameter speed_scaling failed: Parameter'),
    ('param load /manip_sim torn.yaml', 1, 'torn.yaml: while parsing'),
    ('topic type /joint_stats', 1, "unknown topic '/joint_stats': did you mean '/joint_states'"),
    ('service type /manip_sim/rest', 1, "did you mean '/manip_sim/reset'"),
    ('service call /manip_sim/rest std_srvs/srv/Trigger', 1, "did you mean '/manip_sim/reset'"),
    ('service call /manip_sim/pause std_srvs/srv/Trigger', 1, '/manip_sim/pause has the type '
     'std_srvs/srv/SetBool, not std_srvs/srv/Trigger'),
    ('service call /manip_sim/pause std_srvs/srv/SetBool {data: 3}', 1, 'field data of '
     'std_srvs/srv/SetBool_Request is boolean'),
    ('topic', 2, 'VERB'), ('topic ecko', 2, "invalid choice: 'ecko'")]
#: Parameter files in the working directory.
FILES = {
    'two.yaml': '/**:\n  ros__parameters: {control_mode.arm: effort}\n'
                '/manip_sim:\n  ros__parameters:\n    cartesian_stiffness:\n'
                '      right: [300.0, 300.0, 300.0, 20.0, 20.0, 20.0]\n',
    'all.yaml': '/**:\n  ros__parameters: {control_mode.arm: velocity}\n',
    'other.yaml': '/other:\n  ros__parameters: {seed: 1}\n', 'torn.yaml': '/manip_sim: [1',
    'fast.yaml': '/manip_sim:\n  ros__parameters: {speed_scaling: 2.0}\n'}


@pytest.fixture(autouse=True)
def _files(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)


def words_of(line):
    """Return the words of a line; YAML in braces or brackets is one."""
    begin = min((line.index(sign) for sign in (' {', ' [') if sign in line), default=len(line))
    return [*line[:begin].split(), *([line[begin + 1:]] if begin < len(line) else [])]


def manip_sim(line):
    try:
        return main(words_of(line))
    except SystemExit as ended:
        return ended.code


@pytest.fixture
def graph(monkeypatch):
    """Let commands use one node: DDS takes seconds to find a second one of this process."""
    # Handlers of signals are for the process of a command.
    monkeypatch.setattr(ros_commands, 'EndSignals', lambda: Mock(wait=lambda timeout_s: False))
    with ros_commands._graph() as graph:
        monkeypatch.setattr(ros_commands, '_graph', lambda: nullcontext(graph))
        yield graph


@pytest.mark.full
def test_each_verb_prints_what_ros2_prints(serve, graph, capsys):
    serve(arena='table', start_paused=True)
    for line, text in DONE:
        assert manip_sim(line) == 0, (line, capsys.readouterr())
        printed = capsys.readouterr().out
        assert re.search(text, printed), (line, printed)


@pytest.mark.full
def test_what_is_wrong_is_said_in_one_line_with_the_nearest_names(
        serve, graph, capsys, monkeypatch):
    serve()
    monkeypatch.setattr(ros_commands, '_UNKNOWN_S', 0.5)
    graph.spin_until(lambda: '/joint_command' in graph.subscribed())
    graph.settle()
    for line, code, text in WRONG:
        assert manip_sim(line) == code, line
        error = capsys.readouterr().err
        assert text in error and error.count('\n') == 1, (line, error)


@pytest.mark.parametrize('line', [
    'service call /manip_sim/reset std_srvs/srv/Trigger', 'topic echo /joint_states',
    'param get /manip_sim timestep'])
def test_a_name_that_is_not_there_is_explained_where_there_is_no_node(
        graph, capsys, monkeypatch, line):
    monkeypatch.setattr(ros_commands, '_UNKNOWN_S', 0.5)
    assert manip_sim(line) == 1
    assert re.search(
        'available: (none|/parameter_events); no other node in ROS domain [0-9]+: start it in a '
        'second shell, with the same ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE\n$',
        capsys.readouterr().err)


def test_names_are_not_listed_before_another_node_and_its_services_are_found(graph, monkeypatch):
    monkeypatch.setattr(ros_commands, '_SETTLED_S', 0.1)
    for limit in ('_UNKNOWN_S', '_ANSWER_S'):
        monkeypatch.setattr(ros_commands, limit, 60.0)
    late = []
    timer = threading.Timer(1.0, lambda: late.append(Client()))
    timer.start()
    graph.settle()
    timer.join()
    name = late[0].node.get_fully_qualified_name()
    try:
        assert name in graph.nodes()
        assert any(service.startswith(f'{name}/') for service in graph.services())
    finally:
        late[0].close()


def test_an_answer_without_success_is_exit_code_one(client, graph, capsys):
    client.node.create_service(SetBool, 'refuses', lambda _, answer: answer)
    ended = threading.Event()
    thread = threading.Thread(target=lambda: client.spin_until(ended.is_set))
    thread.start()
    try:
        assert manip_sim('service call /refuses std_srvs/srv/SetBool') == 1
    finally:
        ended.set()
        thread.join()
    assert 'success=False' in capsys.readouterr().out


@pytest.mark.parametrize('words', ['told', 'told std_msgs/msg/String'])
@pytest.mark.parametrize('qos', [
    qos_profile_sensor_data, QoSProfile(depth=1),
    QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL),
    QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL,
               reliability=QoSReliabilityPolicy.BEST_EFFORT)])
def test_an_echo_matches_the_quality_of_service_of_the_publisher(
        client, graph, qos, words, capsys):
    publisher = client.node.create_publisher(String, 'told', qos)
    publisher.publish(String(data='before'))
    timer = client.node.create_timer(0.05, lambda: publisher.publish(String(data='later')))
    client.spin_until(lambda: client.node.count_publishers('told') > 0)
    ended = threading.Event()
    thread = threading.Thread(target=lambda: client.spin_until(ended.is_set))
    thread.start()
    try:
        assert manip_sim(f'topic echo --once --timeout 100 {words}') == 0
    finally:
        ended.set()
        thread.join()
        timer.cancel()
    latched = (qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
               and qos.reliability != QoSReliabilityPolicy.BEST_EFFORT)
    printed = capsys.readouterr().out
    assert printed in (['data: before\n---\n'] if latched else []) + ['data: later\n---\n']


@pytest.fixture
def spinning(client):
    """Return a node that a thread spins, for commands in processes of their own."""
    ended = threading.Event()
    thread = threading.Thread(target=lambda: client.spin_until(ended.is_set))
    thread.start()
    yield client.node
    ended.set()
    thread.join()


def first_report(line):
    """Return what a command without end prints at first, two lines more than its first one."""
    with subprocess.Popen([sys.executable, '-m', 'manip_sim.cli', *words_of(line)], text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        text = ''.join(process.stdout.readline() for _ in range(3))
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=300.0)
    assert (process.returncode, errors) == (0, '')
    return text


@pytest.mark.full
def test_the_bandwidth_is_that_of_the_serialized_messages(spinning):
    publisher = spinning.create_publisher(String, 'told', 10)
    # Four bytes of encapsulation, four of the length, a zero at the end.
    timer = spinning.create_timer(0.02, lambda: publisher.publish(String(data='x' * 991)))
    text = first_report('topic bw /told')
    timer.cancel()
    found = re.fullmatch(r'Subscribed to \[/told\]\n([.\d]+) KB/s from (\d+) messages\n'
                         r'\tMessage size mean: 1\.00 KB min: 1\.00 KB max: 1\.00 KB\n', text)
    assert found, text
    assert 10.0 < float(found[1]) < 60.0 and 20 <= int(found[2]) <= 100


@pytest.mark.full
def test_the_delay_is_the_age_of_the_stamps(spinning):
    publisher = spinning.create_publisher(PoseStamped, 'told', 10)

    def publish():
        message = PoseStamped()
        message.header.stamp = (spinning.get_clock().now() - Duration(seconds=5.0)).to_msg()
        publisher.publish(message)
    timer = spinning.create_timer(0.02, publish)
    text = first_report('topic delay -w 10 /told')
    timer.cancel()
    found = re.match(r'average delay: ([.\d]+)\n\tmin: ([.\d]+)s max: ([.\d]+)s '
                     r'std dev: [.\d]+s window: 10\n', text)
    assert found, text
    mean, least, most = map(float, found.groups())
    assert 5.0 <= least <= mean <= most < 7.0


@pytest.mark.full
def test_names_are_found_by_type_and_a_parameter_is_deleted_from_another_process(spinning):
    def run(line):
        done = subprocess.run([sys.executable, '-m', 'manip_sim.cli', *words_of(line)],
                              capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, ''), done
        return done.stdout
    publisher = spinning.create_publisher(String, 'told', 10)
    service = spinning.create_service(SetBool, 'refuses', lambda _, answer: answer)
    spinning.declare_parameter('loose', 3, ParameterDescriptor(dynamic_typing=True))
    node = spinning.get_fully_qualified_name()
    assert run('topic find std_msgs/String') == '/told\n'
    assert run('topic find -c std_msgs/msg/String') == '1\n'
    assert run('service find std_srvs/srv/SetBool') == '/refuses\n'
    assert run('topic type /told') == 'std_msgs/msg/String\n'
    assert run('service type /refuses') == 'std_srvs/srv/SetBool\n'
    assert run(f'param delete {node} loose') == 'Deleted parameter successfully\n'
    assert not spinning.has_parameter('loose')
    spinning.destroy_publisher(publisher)
    spinning.destroy_service(service)


def test_the_type_of_a_topic_that_comes_later_is_printed(graph, capsys):
    later = threading.Timer(0.5, graph.node.create_publisher, (String, 'later', 10))
    later.start()
    assert manip_sim('topic type /later') == 0
    assert capsys.readouterr().out == 'std_msgs/msg/String\n'
    later.join()


@pytest.mark.full
@pytest.mark.parametrize('line, begins', [
    ('topic echo /joint_states', b'header:'), ('topic hz /joint_states', b'average rate: '),
    ('topic pub -r 50 /joint_command sensor_msgs/msg/JointState', b'publisher: beginning loop'),
    ('topic pub /nobody_takes_it std_msgs/msg/String', b'publisher: beginning loop')])
def test_ctrl_c_ends_what_has_no_end_with_code_zero_and_no_traceback(serve, line, begins):
    serve()
    with subprocess.Popen([sys.executable, '-m', 'manip_sim.cli', *words_of(line)],
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline().startswith(begins)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=300.0)
    assert process.returncode == 0
    assert b'Traceback' not in errors and errors.count(b'\n') == ('nobody' in line)


@pytest.mark.full
def test_an_echo_ends_with_the_reader_of_its_output(serve):
    serve()
    read, write = os.pipe()
    with subprocess.Popen([sys.executable, '-m', 'manip_sim.cli', 'topic', 'echo', '/clock'],
                          stdout=write, stderr=subprocess.PIPE) as process:
        os.close(write)
        assert os.read(read, 5) == b'clock'
        os.close(read)
        assert process.communicate(timeout=300.0)[1] == b''
    assert process.returncode == 0


PACKAGES = ('std_msgs', 'sensor_msgs', 'geometry_msgs', 'trajectory_msgs', 'visualization_msgs',
            'diagnostic_msgs', 'nav_msgs', 'rcl_interfaces', 'rosgraph_msgs')


@pytest.mark.parametrize('package', PACKAGES)
def test_every_message_that_is_printed_can_be_published(package):
    kinds = [kind for kind in vars(importlib.import_module(f'{package}.msg')).values()
             if hasattr(kind, 'get_fields_and_field_types')]
    assert kinds
    for kind in kinds:
        text = yaml.dump(_plain(kind(), 1000))
        assert _message(kind, yaml.safe_load(text), None) == kind(), text


@pytest.mark.parametrize('kind, fields', [
    (UInt8, '{data: 256}'), (UInt8, '{data: -1}'), (UInt8, '{data: 1.0}'), (Bool, '{data: 1}'),
    (Byte, '{data: 256}'), (Float32, '{data: 1.0e+39}'), (Float64MultiArray, '{data: "12"}'),
    (Float64MultiArray, '{data: 1.0}'), (PoseWithCovariance, '{covariance: [1.0]}'),
    (JointState, '{header: {stamp: {sec: 9999999999}}}'), (JointState, '{header: 1.0}')])
def test_values_that_no_field_holds_are_rejected_with_its_type(kind, fields):
    with pytest.raises(MessageError, match='^field .* is .*, got '):
        _message(kind, yaml.safe_load(fields), None)


def test_values_of_yaml_become_the_numbers_and_messages_of_the_fields():
    pose = _message(PoseStamped, yaml.safe_load(
        '{header: {frame_id: 5}, pose: {position: {x: 1, y: .nan}}}'), None)
    assert (pose.header.frame_id, pose.pose.position.x) == ('5', 1.0)
    assert pose.pose.position.y != pose.pose.position.y
    state = _message(JointState, {'name': ['a', 1], 'effort': [1, 2.5]}, None)
    assert list(state.name) == ['a', '1'] and list(state.effort) == [1.0, 2.5]
    numbers = _message(Float64MultiArray, yaml.safe_load(
        '{layout: {dim: [{label: a, size: 3}]}}'), None)
    assert numbers.layout.dim[0].size == 3


def test_a_check_against_joint_states_names_swapped_joints(client, graph, capsys):
    names = [f'robot0_joint{number}' for number in range(1, 8)]
    publisher = client.node.create_publisher(JointState, '/js', 1)
    message = JointState(name=names, position=[0.0, 0.0, 0.0, 2.0, 0.0, -2.0, 0.0])
    # The command's own node spins; it needs no executor of this one to publish.
    graph.node.create_timer(0.05, lambda: publisher.publish(message))
    code = main(['check', '--robot', 'Panda', '--gripper', 'none', '--against', '/js'])
    text = capsys.readouterr().out
    assert code == 1 and 'Panda0 in arena empty: 2 defects' in text
    assert "'robot0_joint6' is beyond its own too" in text
    assert main(['check', '--against', '/nothing']) == 1
    assert "unknown published topic '/nothing'" in capsys.readouterr().err
