# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Requests and messages that make callbacks raise: the node tells, counts and goes on."""

import time

from diagnostic_msgs.msg import DiagnosticArray
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger


def simulation_values(array):
    return {pair.key: pair.value for pair in array.status[0].values}


@pytest.mark.full
@pytest.mark.parametrize('service_type, name', [
    (SetParameters, 'set_parameters'), (SetParametersAtomically, 'set_parameters_atomically')])
def test_a_parameter_of_an_unknown_type_is_survived_told_and_counted(service_type, name,
                                                                     sim_process, client):
    log = client.log()
    sim_process()
    client.state()
    bad = client.node.create_client(service_type, f'manip_sim/{name}')
    client.spin_until(bad.service_is_ready)
    for _ in range(10):  # As many as the service keeps.
        bad.call_async(service_type.Request(parameters=[
            Parameter(name='real_time_factor', value=ParameterValue(type=99))]))
    client.spin_until(lambda: any(f'{name}: ValueError: 99' in text for text in log))
    arrays = client.listen(DiagnosticArray, '/diagnostics')
    client.spin_until(lambda: bool(arrays)
                      and int(simulation_values(arrays[-1])['failed_callbacks']) == 10)
    assert sum('ValueError' in text for text in log) <= 2
    # The service that raised and all the others still answer.
    good = client.call(service_type, f'manip_sim/{name}', service_type.Request(parameters=[
        Parameter(name='real_time_factor', value=ParameterValue(type=3, double_value=2.0))]))
    assert (good.results[0] if name == 'set_parameters' else good.result).successful
    assert client.call(Trigger, 'manip_sim/tare_wrench').success
    values = client.call(GetParameters, 'manip_sim/get_parameters',
                         GetParameters.Request(names=['real_time_factor'])).values
    assert values[0].double_value == 2.0


def unreadable():
    """Return serialized joint states with a name that is not UTF-8, and some that end early."""
    good = serialize_message(JointState(name=['joint'], position=[0.1]))
    return [good.replace(b'joint', b'\xff\xfe\xed\xa0\x80'), good[:6], good[:20],
            good[:4] + b'\xff' * 40]


@pytest.mark.full
def test_messages_that_cannot_be_read_are_counted_and_do_not_stop_their_topic(sim_process, client):
    log = client.log()
    sim_process()
    client.state()
    begin = time.monotonic()
    publisher = client.publisher(JointState, 'arm/joint_command')
    for goal in (0.1, 0.2, 0.3, 0.2, 0.3):
        for message in unreadable():
            publisher.publish(message)
        # What comes after them arrives: never more than five wait for a node that is slow.
        client.publish('arm/joint_command', JointState(name=['robot0_joint1'], position=[goal]))
        client.spin_until(lambda goal=goal: abs(client.state().position[0] - goal) < 0.01)
    arrays = client.listen(DiagnosticArray, '/diagnostics')

    def dropped():
        arm = next(status for status in arrays[-1].status if status.name == 'manip_sim: arm')
        return next(int(pair.value) for pair in arm.values if pair.key == 'dropped')
    client.spin_until(lambda: bool(arrays) and dropped() == 20)
    for text in ('the data cannot be read as a message of the type JointState',
                 'arm has no joint'):
        told = [line for line in log if text in line]
        assert 1 <= len(told) <= time.monotonic() - begin + 1
        assert told[0].startswith('rejected a message on arm/joint_command: ')
    assert client.call(SetBool, 'manip_sim/pause', SetBool.Request(data=True)).success
