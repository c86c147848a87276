# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Impedance with gains in the message, over the topic."""

import json
import math
import threading

from diagnostic_msgs.srv import AddDiagnostics
from geometry_msgs.msg import TwistStamped, WrenchStamped
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

NAN7 = [math.nan] * 7


def send(node, client, data, accepted):
    client.publish('arm/impedance_command', Float64MultiArray(data=data))
    statistics = node.commands.robots[0].statistics['arm']
    client.spin_until(lambda: statistics.accepted + statistics.rejected == accepted)
    return statistics


def test_a_message_sets_goals_and_gains_of_all_joints_live(serve, client):
    node = serve(start_paused=True, control_mode__arm='impedance')
    send(node, client, [0.3, *NAN7[1:], *NAN7, *NAN7, *[100.0] * 7, *[20.0] * 7], 1)
    node.simulation.data.qfrc_applied[0] = 5.0
    for _ in range(300):
        node.thread.step()
    assert node.simulation.robot.state().position[0] == pytest.approx(0.35, rel=0.01)
    send(node, client, [*NAN7, *NAN7, *NAN7, 200.0, *NAN7[1:], *NAN7], 2)
    for _ in range(300):
        node.thread.step()
    assert node.simulation.robot.state().position[0] == pytest.approx(0.325, rel=0.01)


@pytest.mark.parametrize('data', [
    [], [0.1] * 7, [math.inf] * 35, [*NAN7, *NAN7, *NAN7, *[-1.0] * 7, *NAN7]])
def test_a_message_that_cannot_be_used_is_rejected_and_changes_nothing(data, serve, client):
    node = serve(start_paused=True, control_mode__arm='impedance')
    before = node.simulation.digest()
    assert send(node, client, data, 1).rejected == 1
    node.thread.call(lambda: None)
    assert node.simulation.digest() == before


def test_in_another_mode_a_message_is_rejected(serve, client):
    node = serve(start_paused=True)
    assert send(node, client, [100.0] * 35, 1).rejected == 1
    assert not np.isnan(node.simulation.robot.state().position).any()


def set_one(client, name, value):
    (result,) = client.call(SetParameters, 'manip_sim/set_parameters', SetParameters.Request(
        parameters=[Parameter(name, value=value).to_parameter_msg()])).results
    return result


def wrench_of(z):
    message = WrenchStamped()
    message.wrench.force.z = z
    return message


def test_cartesian_stiffness_is_live_and_a_target_wrench_presses_until_its_timeout(serve, client):
    node = serve(start_paused=True, control_mode__arm='effort',
                 cartesian_stiffness__right=[500.0] * 3 + [30.0] * 3, command_timeout__arm=0.0)
    reader = node.simulation.robot.state
    start = reader().end_effectors['right'].pose.position[2]
    statistics = node.commands.robots[0].statistics['arm']
    for stiffness, number in ((500.0, 1), (1000.0, 2)):
        assert set_one(client, 'cartesian_stiffness.right',
                       [stiffness] * 3 + [30.0] * 3).successful
        client.publish('right/target_wrench', wrench_of(10.0))
        client.spin_until(lambda expected=number: statistics.accepted == expected)
        for _ in range(300):
            node.thread.step()
        moved = reader().end_effectors['right'].pose.position[2] - start
        assert moved == pytest.approx(10.0 / stiffness, rel=0.01)
    assert set_one(client, 'cartesian_stiffness.right', [0.0] * 6).successful
    client.publish('right/target_wrench', wrench_of(10.0))
    client.spin_until(lambda: statistics.rejected == 1)


@pytest.mark.parametrize(('value', 'message'), [
    ([1.0] * 5, 'must be 6 finite numbers'), ([-1.0] * 6, 'must be from 0 to 100000'),
    ([math.nan] * 6, 'finite'), (3.0, 'Wrong parameter type')])
def test_a_stiffness_that_cannot_be_used_is_rejected_and_the_old_one_acts(
        value, message, serve, client):
    node = serve(start_paused=True)
    result = set_one(client, 'cartesian_stiffness.right', value)
    assert not result.successful and message in result.reason
    assert node.simulation.robot.settings['cartesian_stiffness.right'] == [0.0] * 6


def test_a_motion_until_contact_says_how_it_ended(serve, client):
    node = serve(stepping='free')
    ends = client.listen(String, 'manip_sim/contact', QoSProfile(
        depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    statistics = node.commands.robots[0].statistics['arm']
    for number, cause in ((0.05, 'distance'), (-0.04, 'distance')):
        count = len(ends)
        client.publish('right/move_until_contact', Float64MultiArray(
            data=[0.0, 0.0, number, 0.0, 0.0, 0.0, 5.0, 0.03, 9.0]))
        client.spin_until(lambda expected=count: len(ends) > expected)
        end = json.loads(ends[-1].data)
        assert end['arm'] == 'right' and end['robot'] == 'robot0' and end['cause'] == cause
        assert end['distance'] == pytest.approx(0.03, abs=1e-3)
        assert end['duration'] == pytest.approx(0.03 / abs(number), rel=0.2)
    client.publish('right/move_until_contact', Float64MultiArray(data=[0.0] * 9))
    client.spin_until(lambda: statistics.rejected == 1)
    assert len(ends) == 2


def move(client, text):
    """Call the service of motions until contact; return a future of its response."""
    service = client.node.create_client(AddDiagnostics, 'manip_sim/move_until_contact')
    client.spin_until(service.service_is_ready)
    return service.call_async(AddDiagnostics.Request(load_namespace=text))


def test_the_service_of_a_motion_until_contact_answers_at_its_end(serve, client):
    node = serve(stepping='free')
    statistics = node.commands.robots[0].statistics['arm']
    answer = move(client, '{linear: [0, 0, 0.05], force: 5, distance: 0.03, duration: 9.0}')
    client.spin_until(answer.done)
    end = json.loads(answer.result().message)
    assert answer.result().success and end['cause'] == 'distance' and end['arm'] == 'right'
    assert end['distance'] == pytest.approx(0.03, abs=1e-3) and statistics.accepted == 1
    slow = '{linear: [0, 0, 0.0001], force: 50, distance: 1, duration: 90000}'
    first = move(client, slow)
    client.spin_until(lambda: statistics.accepted == 2)
    tare = client.node.create_client(Trigger, 'manip_sim/tare_wrench')
    client.spin_until(tare.service_is_ready)
    other = tare.call_async(Trigger.Request())  # Nobody waits for the end of the motion.
    client.spin_until(other.done)
    assert other.result().success and not first.done()
    client.publish('right/target_twist', TwistStamped())
    client.spin_until(first.done)
    assert not first.result().success and 'replaced by a newer command' in first.result().message
    second = move(client, slow)
    client.spin_until(lambda: statistics.accepted == 4)
    node.thread.change('emergency_stop')
    client.spin_until(second.done)
    assert not second.result().success and 'emergency stop' in second.result().message
    third = move(client, slow)
    client.spin_until(third.done)
    assert not third.result().success and 'emergency stop' in third.result().message


@pytest.mark.parametrize('parameters', [
    {}, {'latency__command': 0.05}, {'robot': 'Baxter', 'lockstep_parts': ['right']}],
    ids=['one arm', 'late', 'one arm of two'])
def test_in_lock_step_a_motion_until_contact_is_the_command_of_its_arm(parameters, serve, client):
    serve(stepping='lockstep', **parameters)
    answer = move(client, '{arm: right, linear: [0, 0, 0.05], force: 50, distance: 0.03, '
                          'duration: 9.0}')
    client.spin_until(answer.done, 10.0)
    assert answer.result().success, answer.result().message
    ended = client.state()
    assert client.state().header.stamp == ended.header.stamp  # The next command is waited for.


def test_the_end_of_the_node_is_told_to_who_waits_for_a_motion(serve, client):
    node = serve(stepping='free')
    answer = move(client, '{linear: [0, 0, 0.0001], force: 50, distance: 1, duration: 90000}')
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    ending = threading.Thread(target=node.end_goals)
    ending.start()
    client.spin_until(answer.done)
    ending.join()
    assert not answer.result().success and answer.result().message == 'the node is ending'


@pytest.mark.parametrize(('text', 'message'), [
    ('', 'the force of a motion until contact must be positive and finite, got None'),
    ('[1, 2]', 'must hold keys and values'), ('{arm: [', 'invalid or unsafe YAML'),
    ('{forse: 5}', "did you mean 'force'"), ('{arm: 3}', "'arm' must be a name"),
    ('{robot: arm}', "unknown robot 'arm'"),
    ('{arm: left, force: 1, distance: 1, duration: 1}', "unknown arm with a gripper 'left'"),
    ('{linear: [1, 2], force: 1, distance: 1, duration: 1}', 'linear'),
    ('{force: .nan, distance: 1, duration: 1}', 'force of a motion')])
def test_requests_that_describe_no_motion_until_contact_are_rejected(
        text, message, serve, client):
    node = serve(start_paused=True)
    answer = move(client, text)
    client.spin_until(answer.done)
    assert not answer.result().success and message in answer.result().message
    assert node.commands.robots[0].statistics['arm'].accepted == 0
