# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the files of robots and arenas have besides arms, over topics and parameters."""

from pathlib import Path

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

FILES = Path(__file__).resolve().parents[1] / 'data/files'


def set_keyframe(client, name):
    request = SetParameters.Request(parameters=[Parameter('keyframe', value=name)
                                                .to_parameter_msg()])
    return client.call(SetParameters, 'manip_sim/set_parameters', request).results[0]


def test_a_reset_goes_to_the_keyframe_that_the_parameter_names(serve, client):
    node = serve(start_paused=True, robot=str(FILES / 'keyframes.xml'),
                 arena=str(FILES / 'room.xml'))

    def start(keyframe):
        assert set_keyframe(client, keyframe).successful
        assert client.call(Trigger, 'manip_sim/reset').success
        return node.simulation.robot.state().position.tolist()

    assert node.simulation.robot.state().position.tolist() == [0.1, 0.2]
    assert start('high') == [0.4, 0.5]
    assert node.simulation.data.joint('hinge').qpos[0] == 1.0
    assert start('') == [0.1, 0.2]
    answer = set_keyframe(client, 'hihg')
    assert not answer.successful
    assert "parameter 'keyframe': unknown value 'hihg'" in answer.reason
    assert 'high' in answer.reason
