# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Payloads over ROS: declared by a service or by parameters, told, and estimated."""

import json

from diagnostic_msgs.srv import AddDiagnostics
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

MASS, CENTER = 0.6, np.array([0.02, 0.03, 0.08])


def hang(simulation):
    """Let a weight pull at the tool of the arm."""
    model, data = simulation.model, simulation.data
    site = simulation.robot.end_effectors['right'].external.site
    body, axes = model.site_bodyid[site], data.site_xmat[site].reshape(3, 3)
    data.xfrc_applied[body, :3] = force = MASS * model.opt.gravity
    data.xfrc_applied[body, 3:] = np.cross(
        data.site_xpos[site] + axes @ CENTER - data.xipos[body], force)


@pytest.mark.full
def test_payloads_of_a_node_are_declared_told_and_estimated(serve, client):
    node = serve(stepping='free', payload__right__mass=0.1)
    robot = node.simulation.robot

    def ask(service, text=''):
        answer = client.call(AddDiagnostics, f'/manip_sim/{service}',
                             AddDiagnostics.Request(load_namespace=text))
        return answer.success, answer.message

    def set_live(name, value):
        kind = ParameterType.PARAMETER_DOUBLE_ARRAY
        return client.call(SetParameters, '/manip_sim/set_parameters', SetParameters.Request(
            parameters=[Parameter(name=name, value=ParameterValue(
                type=kind, double_array_value=value))])).results[0]

    assert robot.payload('right').mass == 0.1
    assert ask('set_payload', json.dumps({'mass': MASS, 'center_of_mass': CENTER.tolist()}))[0]
    assert node.get_parameter('payload.right.mass').value == MASS
    success, told = ask('set_payload')
    assert success and json.loads(told) == [{
        'robot': 'robot0', 'arm': 'right', 'mass': MASS, 'center_of_mass': CENTER.tolist(),
        'inertia': [0.0] * 6}]
    for text, match in (
            ('{mass: -1}', 'the mass of a payload must be positive'), ('{arm: right}', "a 'mass'"),
            ('{mass: 1.0e+30}', 'the mass of a payload must be within 1000'),
            ('{mass: 1, arm: rihgt}', "'rihgt'"), ('{mass: 1, robot: robot1}', "'robot1'"),
            ('{masse: 1}', "did you mean 'mass'"), ('[1', 'YAML'),
            ('{mass: 1, center_of_mass: [0, 0, .nan]}', 'must be finite'),
            ('{mass: 1, inertia: [1, 0, 0, 1, 0, 3]}', 'no body has the inertia')):
        success, message = ask('set_payload', text)
        assert not success and match in message, message
    rejected = set_live('payload.right.inertia', [1.0, 0.0, 0.0, 1.0, 0.0, 3.0])
    assert not rejected.successful and 'no body has the inertia' in rejected.reason
    assert list(node.get_parameter('payload.right.inertia').value) == [0.0] * 6
    assert set_live('payload.right.center_of_mass', [0.0, 0.0, 0.2]).successful
    assert robot.payload('right').center_of_mass == (0.0, 0.0, 0.2)
    node.thread.observe(hang)
    success, message = ask('estimate_payload', '{arm: right}')
    assert success, message
    found = json.loads(message)
    assert found['mass'] == pytest.approx(MASS, rel=0.01)
    np.testing.assert_allclose(found['center_of_mass'], CENTER, atol=0.003)
    assert found['error']['mass'] < 0.01
    node.thread.pause(True)
    success, message = ask('estimate_payload')
    assert not success and 'is paused' in message


def test_an_arm_that_only_another_robot_has_is_no_suggestion(serve, client):
    serve(robots=['two', 'one'], two__robot='Baxter', one__robot='UR5e',
          one__position=[2.0, 0.0, 0.0])
    answer = client.call(AddDiagnostics, '/manip_sim/set_payload', AddDiagnostics.Request(
        load_namespace='{robot: one, arm: left, mass: 1.0}'))
    assert not answer.success
    assert answer.message == "unknown arm with a gripper 'left': available: right"
