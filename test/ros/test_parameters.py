# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters at the start: what is taken, what is refused and how."""

import re

import pytest
from rcl_interfaces.srv import DescribeParameters, ListParameters

REFUSED = [
    ('robott:=Panda', "unknown parameter 'robott'", "did you mean 'robot'"),
    ('arm.control_mod:=effort', "unknown parameter 'arm.control_mod'", "'arm.control_mode'"),
    ('head.control_mode:=position', "unknown parameter 'head.control_mode'", 'has no head'),
    ('robot:=Pnda', "parameter 'robot'", "did you mean 'Panda'"),
    ('gripper:=PandaGriper', "parameter 'gripper'", "did you mean 'PandaGripper'"),
    ('base:=RethinkMont', "parameter 'base'", "did you mean 'RethinkMount'"),
    ('arena:=tabel', "parameter 'arena'", "did you mean 'table'"),
    ('stepping:=fast', "parameter 'stepping'", 'realtime, free, lockstep'),
    ('idn:=-1', "parameter 'idn'", 'from 0 to 999'),
    ('timestep:=0.1', "parameter 'timestep'", 'from 0.0001 to 0.01 s'),
    ('publish_rate:=333', "parameter 'publish_rate'", '250, 500'),
    ('publish_rate:=fast', "parameter 'publish_rate'", 'must be of type double'),
    ('publish_clock:=1', "parameter 'publish_clock'", 'must be of type bool'),
    ('real_time_factor:=100.0', "parameter 'real_time_factor'", 'from 0.1 to 10'),
    ('lockstep_parts:=[legs]', "parameter 'lockstep_parts'", 'arm, right/gripper'),
    ('arm.command_timeout:=-1.0', "parameter 'arm.command_timeout'", 'from 0'),
]


@pytest.mark.parametrize('parameter, what, hint', REFUSED)
def test_a_wrong_parameter_ends_the_start_with_one_line(parameter, what, hint, sim_process):
    node = sim_process(parameter)
    _, errors = node.communicate(timeout=20.0)
    assert node.returncode == 1
    lines = errors.strip().splitlines()
    assert len(lines) == 1, errors
    assert what in lines[0]
    assert hint in lines[0]


def test_ros_arguments_that_make_no_sense_end_the_start_with_one_line(process):
    node = process('--ros-args', '--nonsense')
    _, errors = node.communicate(timeout=20.0)
    assert node.returncode == 1
    assert 'nonsense' in errors.splitlines()[-1]
    assert 'Traceback' not in errors


def test_other_arguments_are_refused_and_help_is_given(process):
    node = process('Panda')
    assert "unknown argument 'Panda'" in node.communicate(timeout=20.0)[1]
    assert node.returncode == 2
    node = process('--help')
    assert '--ros-args' in node.communicate(timeout=20.0)[0]
    assert node.returncode == 0


def test_an_integer_is_taken_where_a_double_is_meant(serve, client):
    node = serve(publish_rate=50, real_time_factor=2)
    assert node.get_parameter('publish_rate').value == 50.0
    client.state()


def test_every_parameter_is_described(serve, client):
    serve()
    names = client.call(ListParameters, 'manip_sim/list_parameters').result.names
    ours = [name for name in names if not re.match('qos_overrides|use_sim_time|start_type', name)]
    assert {'robot', 'gripper', 'base', 'arena', 'joint_prefix', 'arm.control_mode'} <= set(ours)
    response = client.call(DescribeParameters, 'manip_sim/describe_parameters',
                           DescribeParameters.Request(names=ours))
    live = {'real_time_factor', 'arm.control_mode', 'arm.command_timeout'}
    for descriptor in response.descriptors:
        assert len(descriptor.description) > 10, descriptor.name
        assert descriptor.read_only == (descriptor.name not in live), descriptor.name


def test_use_sim_time_is_answered_with_a_warning(serve, client):
    log = client.log()
    serve(use_sim_time=True)
    client.spin_until(lambda: any('this node makes the time' in line for line in log))
    client.state()
