# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters at the start: what is taken, what is rejected and how."""

from pathlib import Path
import re
import signal

from forks import ends
from harness import Served
import pytest
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
import yaml

from manip_sim.interface.topics import STALLS
from manip_sim.models.urdf_writer import OWN_PLUGIN

CONFIG = Path(__file__).resolve().parents[2] / 'config'
NO_MESHES = Path(__file__).resolve().parents[1] / 'data/files/no_meshes.urdf'
REJECTED = [
    ('robott:=Panda', "unknown parameter 'robott'", "did you mean 'robot'"),
    ('arm.control_mod:=effort', "unknown parameter 'arm.control_mod'", "'control_mode.arm'"),
    ('arm.control_mode:=effort', "unknown parameter 'arm.control_mode'",
     "did you mean 'control_mode.arm'?"),
    ('arm.command_timeout:=1.0', "unknown parameter 'arm.command_timeout'",
     "did you mean 'command_timeout.arm'?"),
    ('base.command_timeout:=1.0', "unknown parameter 'base.command_timeout'", 'has no base'),
    ('joint_prefix:=left_', "unknown parameter 'joint_prefix'", "did you mean 'prefix' or"),
    ('prefix:=left/', "prefix 'left/'", 'a letter, then at most 63 letters, digits and under'),
    ('prefix:="left arm_"', "prefix 'left arm_'", 'cannot begin the names of joints and frames'),
    ('control_mode.head:=position', "unknown parameter 'control_mode.head'", 'has no head'),
    ('robot:=Pnda', "parameter 'robot'", "did you mean 'Panda'"),
    ('gripper:=PandaGriper', "parameter 'gripper'", "did you mean 'PandaGripper'"),
    ('base:=RethinkMont', "parameter 'base'", "did you mean 'RethinkMount'"),
    ('arena:=tabel', "parameter 'arena'", "did you mean 'table'"),
    ('stepping:=fast', "parameter 'stepping'", 'realtime, free, lockstep'),
    ('idn:=-1', "parameter 'idn'", 'from 0 to 999'),
    ('timestep:=0.1', "parameter 'timestep'", 'from 0.0001 to 0.01 s'),
    ('publish_rate:=333', "parameter 'publish_rate'", '250, 500'),
    ('publish_rate:=1000.0', "parameter 'publish_rate'", 'are: 500; or set timestep:=0.001'),
    ('publish_rate:=30.0', "parameter 'publish_rate'",
     '29.41176471, 31.25; or set timestep:=0.001960784'),
    ('cameras:=agentview', "parameter 'cameras'",
     "got 'agentview': write a list, \"[agentview]\""),
    ('lockstep_parts:=arm', "parameter 'lockstep_parts'", '"[arm]"'),
    ('publish_rate:=fast', "parameter 'publish_rate'", 'must be of type double'),
    ('publish_clock:=1', "parameter 'publish_clock'", 'must be of type bool'),
    ('real_time_factor:=1000.0', "parameter 'real_time_factor'", 'from 0.1 to 100'),
    ('lockstep_parts:=[legs]', "parameter 'lockstep_parts'", 'arm, right, right/gripper'),
    ('command_timeout.arm:=-1.0', "parameter 'command_timeout.arm'", 'from 0'),
    ('seed:=-1', "parameter 'seed'", 'from 0 to 2147483647, got -1'),
    ('armature.arm:=0.1', "parameter 'armature.arm'", "got 0.1: quote it, as in '0.1'"),
]


@pytest.fixture(scope='module')
def rejected():
    """Return how the starts with wrong parameters end, by parameter."""
    parameters = [parameter for parameter, *_ in REJECTED]
    return dict(zip(parameters, ends([['--ros-args', '-p', p] for p in parameters])))


@pytest.mark.full
@pytest.mark.parametrize('parameter, what, hint', REJECTED)
def test_a_wrong_parameter_ends_the_start_with_one_line(parameter, what, hint, rejected):
    code, output, errors = rejected[parameter]
    assert (code, output) == (1, '')
    lines = errors.strip().splitlines()
    assert len(lines) == 1, errors
    assert what in lines[0]
    assert hint in lines[0]


@pytest.mark.full
def test_a_process_of_its_own_ends_as_those_that_are_started_together(sim_process, rejected):
    parameter = REJECTED[0][0]
    node = sim_process(parameter, fresh=True)
    output, errors = node.communicate(timeout=300.0)
    assert (node.returncode, output, errors) == rejected[parameter]


@pytest.mark.full
def test_ros_arguments_that_make_no_sense_end_the_start_with_one_line(process):
    node = process('--ros-args', '--nonsense')
    _, errors = node.communicate(timeout=300.0)
    assert node.returncode == 1
    assert 'nonsense' in errors.splitlines()[-1]
    assert 'Traceback' not in errors


def test_other_arguments_are_rejected_and_help_is_given(process):
    for before in ((), ('--ros-args', '-p', 'robot:=UR5e', '--')):
        node = process(*before, 'Panda')
        assert "unknown argument 'Panda': parameters such as" in node.communicate(timeout=300.0)[1]
        assert node.returncode == 2
    node = process('--help')
    assert '--ros-args' in node.communicate(timeout=300.0)[0]
    assert node.returncode == 0


def test_an_integer_is_taken_where_a_double_is_meant(serve, client):
    node = serve(publish_rate=50, real_time_factor=2)
    assert node.get_parameter('publish_rate').value == 50.0
    client.state()


def test_every_parameter_is_described(serve, client):
    serve()
    names = client.call(ListParameters, 'manip_sim/list_parameters').result.names
    all_of_them = client.call(DescribeParameters, 'manip_sim/describe_parameters',
                              DescribeParameters.Request(names=names)).descriptors
    assert not [one.name for one in all_of_them if not one.description]
    ours = [name for name in names if not re.match('qos_overrides|use_sim_time|start_type', name)]
    assert {'robot', 'gripper', 'base', 'arena', 'prefix', 'control_mode.arm'} <= set(ours)
    response = client.call(DescribeParameters, 'manip_sim/describe_parameters',
                           DescribeParameters.Request(names=ours))
    live = {'real_time_factor', 'pause_at', 'expected_command_rate', 'seed', 'keyframe',
            'control_mode.arm',
            'speed_scaling', 'command_timeout.arm', 'timeout_follows_mode.arm',
            'timeout_follows_mode.right',
            'control_mode.right', 'command_timeout.right', 'wrench_cutoff.right',
            *(f'payload.right.{name}' for name in ('mass', 'center_of_mass', 'inertia')),
            'integral_gain.arm', 'integral_gain.right',
            'stream_interval.arm', 'stream_interval.right', 'stream_hold.arm', 'stream_hold.right',
            *(f'reflex.{part}.{quantity}' for part in ('arm', 'right')
              for quantity in ('velocity', 'effort', 'force', 'torque', 'discontinuity',
                               'collision')),
            *(f'cartesian.right.{name}' for name in (
                'stiffness', 'damping_ratio', 'linear_velocity', 'angular_velocity',
                'twist_timeout')),
            'cartesian_stiffness.right', 'cartesian_damping.right',
            'cartesian_damping_ratio.right',
            'null_space_stiffness.right', 'null_space_posture.right', 'cartesian_frame.right'}
    measuring = ('noise.', 'resolution.', 'latency.')
    assert any(name.startswith('noise.') for name in ours)
    for descriptor in response.descriptors:
        assert len(descriptor.description) > 10, descriptor.name
        is_live = descriptor.name in live or descriptor.name.startswith(measuring)
        assert descriptor.read_only != is_live, descriptor.name


@pytest.mark.full
@pytest.mark.parametrize(('file', 'joint'), [
    ('panda.yaml', 'robot0_joint1'), ('topic_based_ros2_control.yaml', 'panda_joint1'),
    ('hand_over.yaml', 'left_joint1'), ('noise_franka.yaml', 'robot0_joint1'),
    ('noise_ideal.yaml', 'robot0_joint1'), ('noise_ur.yaml', 'robot0_joint1')])
def test_the_files_of_the_folder_config_start_a_node(file, joint, request, client):
    served = Served({}, ['--ros-args', '--params-file', str(CONFIG / file)])
    request.addfinalizer(served.close)
    topic = 'left/joint_states' if joint.startswith('left') else 'joint_states'
    assert client.state(topic).name[0] == joint
    assert {path.name for path in CONFIG.glob('*.yaml')} == {
        'hand_over.yaml', 'noise_franka.yaml', 'noise_ideal.yaml', 'noise_ur.yaml', 'panda.yaml',
        'topic_based_ros2_control.yaml'}


def values_of_all_parameters(client):
    names = client.call(ListParameters, 'manip_sim/list_parameters').result.names
    values = client.call(GetParameters, 'manip_sim/get_parameters',
                         GetParameters.Request(names=names)).values
    return {name: parameter_value_to_python(value) for name, value in zip(names, values)}


@pytest.mark.full
def test_a_dump_of_all_parameters_starts_an_equal_node(sim_process, process, client, tmp_path):
    first = sim_process('robot:=PandaOmron', 'publish_rate:=50', 'control_mode.arm:=effort',
                        'command_timeout.base:=0.25', 'lockstep_parts:=[arm, base]')
    client.state()
    dumped = values_of_all_parameters(client)
    assert dumped['control_mode.base'] == 'velocity' and dumped['command_timeout.base'] == 0.25
    tree = {}
    for name, value in dumped.items():  # Dots are levels, as in the files of ros2 param dump.
        *groups, leaf = name.split('.')
        level = tree
        for group in groups:
            level = level.setdefault(group, {})
        assert leaf not in level, f'{name} is a parameter and a group of parameters'
        level[leaf] = list(value) if isinstance(value, (list, tuple)) else value
    file = tmp_path / 'dump.yaml'
    file.write_text(yaml.safe_dump({'/manip_sim': {'ros__parameters': tree}}))
    first.send_signal(signal.SIGTERM)
    first.wait(timeout=300.0)
    client.spin_until(lambda: not client.node.count_publishers('joint_states'))
    process('--ros-args', '--params-file', str(file))
    client.state()
    assert values_of_all_parameters(client) == dumped


def test_use_sim_time_is_answered_with_a_warning(serve, client):
    log = client.log()
    serve(use_sim_time=True)
    client.spin_until(lambda: any('this node is the source of the time' in line for line in log))
    client.state()


@pytest.mark.full
@pytest.mark.parametrize('told, parameters', [
    (True, {'ros2_control_tag': True, 'stepping': 'lockstep'}),
    (False, {'ros2_control_tag': True, 'stepping': 'lockstep',
             'ros2_control_plugin': OWN_PLUGIN}),
    (False, {'ros2_control_tag': True}), (False, {'stepping': 'lockstep'})])
def test_a_hardware_component_that_would_stall_lockstep_is_warned_of(told, parameters, serve,
                                                                     client):
    log = client.log()
    node = serve(**parameters)
    node.get_logger().info('all has been told')
    client.spin_until(lambda: 'all has been told' in log)
    assert (STALLS in log) == told


@pytest.mark.full
def test_what_is_wrong_with_the_start_is_told(serve, client):
    log = client.log()
    place = {f'{name}__position': [0.0, 0.0, 0.0] for name in ('a', 'b')}
    node = serve(robots=['a', 'b'], start_paused=True, **place)
    assert node.simulation.start_defects
    for defect in node.simulation.start_defects:
        client.spin_until(lambda told=f'start: {defect}': told in log)


def test_each_cause_of_missing_meshes_is_a_warning(serve, client):
    log = client.log(Log.WARN)
    serve(robot=str(NO_MESHES))
    for words in ("'gone.stl' (no such file", "source the workspace that has 'elsewhere'",
                  'nothing touches it, and it cannot be seen'):
        client.spin_until(lambda words=words: any(words in text for text in log))


def test_parameters_may_be_set_before_the_simulation_runs_and_after_it_has_ended(serve):
    node = serve()
    node.stop()
    for name, value in (('real_time_factor', 2.0), ('control_mode.arm', 'effort'),
                        ('command_timeout.right', 1.0)):
        (result,) = node.set_parameters([Parameter(name, value=value)])
        assert result.successful


@pytest.mark.full
@pytest.mark.parametrize(('name', 'value', 'reason'), [
    ('timestep', 0.001, "parameter 'timestep' is read-only: set it at the start"),
    ('control_mode.arms', 'effort', "unknown parameter 'control_mode.arms': did you mean "
     "'control_mode.arm'")])
def test_a_change_that_is_rejected_says_what_to_do(name, value, reason, serve, client):
    serve(start_paused=True)
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    (result,) = client.call(SetParameters, '/manip_sim/set_parameters', request).results
    assert not result.successful
    assert result.reason.startswith(reason)


@pytest.mark.full
def test_a_change_of_several_parameters_changes_none_if_one_value_cannot_be(serve):
    node = serve(start_paused=True)
    result = node.set_parameters_atomically([
        Parameter('real_time_factor', value=2.0), Parameter('control_mode.arm', value='torque')])
    assert not result.successful
    assert result.reason.startswith("parameter 'control_mode.arm': unknown value 'torque': ")
    assert node.thread.real_time_factor == node.get_parameter('real_time_factor').value == 1.0
