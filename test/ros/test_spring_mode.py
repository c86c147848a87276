# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The control mode of another package that is installed, through the node's interface alone."""

import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState

from manip_sim.control.modes import MODES, Position

ARM = [f'robot0_joint{n}' for n in range(1, 8)]
STIFFNESS, PUSH_N_M = 100.0, 3.0


@pytest.fixture
def installed(install_example, monkeypatch):
    """Install the example; the modes are put back afterwards."""
    monkeypatch.syspath_prepend(install_example('spring_mode'))
    monkeypatch.setattr(MODES, '_modes', dict(MODES._modes))
    monkeypatch.setattr(MODES, '_offers', set())


def set_mode(client, mode):
    parameter = Parameter('control_mode.arm', value=mode).to_parameter_msg()
    (result,) = client.call(SetParameters, 'manip_sim/set_parameters',
                            SetParameters.Request(parameters=[parameter])).results
    return result


class Unusable(Position):
    name = 'unusable'

    def gains(self, joints):
        return -1.0, 1.0


class Failing(Position):
    name = 'failing'

    def gains(self, joints):
        raise RuntimeError('not today')


@pytest.mark.full
@pytest.mark.parametrize('mode, reason', [
    (Unusable, 'the stiffness of servos must be positive'), (Failing, 'not today')])
def test_a_mode_that_cannot_be_used_is_rejected_with_the_reason(
        serve, client, monkeypatch, mode, reason):
    monkeypatch.setattr(MODES, '_modes', dict(MODES._modes))
    MODES.add(mode())
    node = serve()
    result = set_mode(client, mode.name)
    assert not result.successful and reason in result.reason
    assert node.get_parameter('control_mode.arm').value == 'position'
    assert set_mode(client, 'velocity').successful
    assert node.simulation.robot.joints.mode_of(ARM[0]) == 'velocity'


@pytest.mark.full
def test_an_installed_mode_is_a_choice_and_joints_in_it_yield_as_springs(
        installed, serve, client):
    node = serve(start_paused=True, control_mode__arm='springs')
    (described,) = client.call(
        DescribeParameters, 'manip_sim/describe_parameters',
        DescribeParameters.Request(names=['control_mode.arm'])).descriptors
    assert described.additional_constraints == (
        'One of: position, velocity, effort, impedance, springs.')
    (timeout,) = client.call(GetParameters, 'manip_sim/get_parameters',
                             GetParameters.Request(names=['command_timeout.arm'])).values
    assert timeout.double_value == 0.0

    states = client.listen(JointState, 'arm/joint_states')
    goal = node.simulation.robot.state().position[:7] + 0.1
    client.publish('arm/joint_command', JointState(name=ARM, position=list(goal)))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)

    def settle():
        """Advance by 5 s, and return the positions that are published then."""
        for _ in range(500):
            node.thread.step()
        last = node.simulation.time_ns
        client.spin_until(lambda: bool(states) and last == (
            states[-1].header.stamp.sec * 10**9 + states[-1].header.stamp.nanosec))
        return np.array(states[-1].position)

    np.testing.assert_allclose(settle(), goal, atol=1e-3)
    dofs = node.simulation.robot.joints.dofs(np.arange(7))
    node.simulation.data.qfrc_applied[dofs] = PUSH_N_M
    np.testing.assert_allclose(settle() - goal, PUSH_N_M / STIFFNESS, rtol=0.01)

    assert set_mode(client, 'velocity').successful
    refused = set_mode(client, 'sprngs')
    assert not refused.successful and "did you mean 'springs'?" in refused.reason
    assert set_mode(client, 'springs').successful
    client.spin_until(lambda: node.simulation.robot.joints.mode_of(ARM[0]) == 'springs')
