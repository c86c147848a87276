# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The law of another package that is installed: chosen, tuned and restored by the node."""

import importlib

import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from manip_sim.errors import ParameterError
from manip_sim.models import compose
from manip_sim.simulation import Simulation

ARM = [f'robot0_joint{n}' for n in range(1, 8)]
NAMES = ['law.arm.damping', 'law.arm.friction', 'law.arm.slowest', 'law.arm.stiffness']
MODE = 'law:compensated'


@pytest.fixture(autouse=True)
def installed(install_example, package_on_path, monkeypatch):
    """Install the example and a second package."""
    monkeypatch.syspath_prepend(install_example('friction_compensation'))
    package_on_path('manip_sim.laws', 'other_laws', """
from manip_sim.laws import law

@law(parameters={'stiffness': 50.0})
def soft(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    effort[:] = bias + parameters[0] * (setpoint[:, 0] - q) - 20.0 * v

@law
def broken(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    effort[0] = len(open('log'))
""", {'soft': 'soft', 'broken': 'broken'})


def set_one(client, name, value):
    (result,) = client.call(SetParameters, 'manip_sim/set_parameters', SetParameters.Request(
        parameters=[Parameter(name, value=value).to_parameter_msg()])).results
    return result


def get(client, *names):
    return [value.double_value for value in client.call(
        GetParameters, 'manip_sim/get_parameters', GetParameters.Request(names=[*names])).values]


def of_laws(client):
    listed = client.call(ListParameters, 'manip_sim/list_parameters', ListParameters.Request(
        prefixes=['law'], depth=0)).result.names
    return sorted(listed)


def trigger(client, name):
    answer = client.call(Trigger, f'manip_sim/{name}', Trigger.Request())
    assert answer.success, answer.message
    return answer.message


def test_a_law_is_chosen_and_tuned_at_the_start_and_live(serve, client):
    node = serve(start_paused=True, control_mode__arm=MODE, law__arm__stiffness=150)
    robot = node.simulation.robot
    assert of_laws(client) == NAMES
    assert get(client, 'law.arm.stiffness', 'law.arm.damping') == [150.0, 30.0]
    assert robot.law_parameters('arm')['stiffness'] == 150.0
    assert set_one(client, 'law.arm.stiffness', 400.0).successful
    assert robot.law_parameters('arm')['stiffness'] == 400.0
    for value, text in ((float('nan'), 'finite number'), ('high', 'Wrong parameter type')):
        result = set_one(client, 'law.arm.stiffness', value)
        assert not result.successful and text in result.reason
    assert robot.law_parameters('arm')['stiffness'] == 400.0
    (described,) = client.call(
        DescribeParameters, 'manip_sim/describe_parameters',
        DescribeParameters.Request(names=['law.arm.stiffness'])).descriptors
    assert "law 'compensated'" in described.description and not described.read_only


@pytest.mark.parametrize(('parameters', 'laws'), [
    ({'robot': 'Baxter', 'control_mode__arm': MODE, 'law__left__stiffness': 150.0},
     {'right': 300.0, 'left': 150.0}),
    ({'robot': 'Baxter', 'control_mode__arm': MODE, 'control_mode__right': 'law:soft',
      'law__left__stiffness': 150.0, 'law__right__stiffness': 60.0},
     {'right': 60.0, 'left': 150.0}),
    ({'robot': 'Baxter', 'control_mode__arm': MODE, 'control_mode__right': 'position',
      'law__left__stiffness': 150.0}, {'left': 150.0}),
    ({'control_mode__right': MODE, 'law__arm__stiffness': 150.0}, {'arm': 150.0})],
    ids=['both arms', 'a law for each arm', 'all arms but one', 'the other name of an arm'])
def test_a_law_by_any_name_of_a_part_has_the_parameters_of_its_arms(
        parameters, laws, serve, client):
    robot = serve(start_paused=True, **parameters).simulation.robot
    assert {part: robot.law_parameters(part)['stiffness'] for part in robot.laws} == laws
    assert {name: get(client, name) for name in of_laws(client) if 'stiffness' in name} == {
        f'law.{part}.stiffness': [stiffness] for part, stiffness in laws.items()}


def test_parameters_of_laws_come_and_go_with_the_law(serve, client):
    node = serve(start_paused=True)
    assert of_laws(client) == []
    assert set_one(client, 'control_mode.arm', MODE).successful
    assert of_laws(client) == NAMES
    assert set_one(client, 'law.arm.stiffness', 77.0).successful
    assert set_one(client, 'control_mode.arm', 'law:soft').successful
    assert of_laws(client) == ['law.arm.stiffness']
    assert get(client, 'law.arm.stiffness') == [50.0]
    assert set_one(client, 'law.arm.stiffness', 60.0).successful
    assert node.simulation.robot.law_parameters('arm')['stiffness'] == 60.0
    refused = set_one(client, 'control_mode.arm', 'law:sof')
    assert not refused.successful and "did you mean 'law:soft'" in refused.reason
    assert set_one(client, 'control_mode.arm', 'position').successful
    assert of_laws(client) == [] and not node.simulation.robot.laws


def test_a_restored_state_brings_its_law_with_its_parameters(serve, client):
    node = serve(start_paused=True, control_mode__arm=MODE, law__arm__stiffness=150.0)
    assert set_one(client, 'law.arm.stiffness', 200.0).successful
    digest = trigger(client, 'save_state')
    assert set_one(client, 'control_mode.arm', 'velocity').successful
    assert trigger(client, 'restore_state') == digest
    assert of_laws(client) == NAMES and get(client, 'law.arm.stiffness') == [200.0]
    assert node.simulation.robot.law_parameters('arm')['stiffness'] == 200.0
    assert set_one(client, 'control_mode.arm', 'law:soft').successful
    assert trigger(client, 'restore_state') == digest
    assert of_laws(client) == NAMES and get(client, 'law.arm.stiffness') == [200.0]
    trigger(client, 'reset')
    assert get(client, 'law.arm.stiffness') == [200.0]


@pytest.mark.parametrize(('parameters', 'text'), [
    ({'control_mode__arm': 'law:compensate'}, "did you mean 'law:compensated'"),
    ({'control_mode__arm': MODE, 'law__arm__stifness': 1.0}, "did you mean 'law.arm.stiffness'"),
    ({'control_mode__arm': MODE, 'law__arm__stiffness': 'high'}, 'must be of type double'),
    ({'law__arm__stiffness': 1.0}, "unknown parameter 'law.arm.stiffness'"),
    ({'control_mode__arm': 'law:broken'}, "law 'broken' cannot be compiled")])
def test_what_no_law_can_be_stops_the_start_with_the_reason(parameters, text, serve):
    with pytest.raises((ParameterError, Exception), match=text):
        serve(start_paused=True, **parameters)


def test_a_law_that_cannot_be_compiled_is_refused_and_the_mode_stays(serve, client):
    node = serve(start_paused=True)
    result = set_one(client, 'control_mode.arm', 'law:broken')
    assert not result.successful and 'cannot be compiled' in result.reason
    assert node.get_parameter('control_mode.arm').value == 'position'
    assert not node.simulation.robot.laws


def test_a_law_makes_the_same_digest_in_the_node_and_in_process(serve, client):
    node = serve(start_paused=True, control_mode__arm=MODE, law__arm__friction=0.2)
    client.publish('arm/joint_command', JointState(name=ARM[:1], position=[0.4]))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    for _ in range(50):
        node.thread.step()
    simulation = Simulation(compose('Panda'))
    robot = simulation.robot
    compensated = importlib.import_module('friction_compensation').compensated
    robot.set_law('arm', compensated, friction=0.2)
    simulation.reset(0)  # As the node at its start.
    robot.apply(*robot.parse.joint_command(ARM[:1], position=[0.4]), period_s=0.01)
    for _ in range(50):
        simulation.advance(5)
    assert np.abs(robot.state().position[0] - 0.4) < 0.2
    assert trigger(client, 'save_state') == simulation.digest()
