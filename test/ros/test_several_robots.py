# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Several robots in one node: names, parameters, commands and lock-step of each."""

import numpy as np
import pytest
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from manip_sim.errors import ManipSimError

TWO = {'robots': ['left', 'right'], 'right__robot': 'UR5e'}


def states_of(client, robot):
    return client.listen(JointState, f'{robot}/joint_states')


@pytest.mark.full
def test_each_robot_has_its_own_names_topics_and_parameters(serve, client):
    node = serve(**TWO)
    left, right = states_of(client, 'left'), states_of(client, 'right')
    client.spin_until(lambda: left and right)
    assert left[0].name[0] == 'left_joint1'
    assert right[0].name[0].startswith('right_')
    client.spin_until(lambda: {str(s.header.stamp) for s in left}
                      & {str(s.header.stamp) for s in right})
    names = {name for name, _ in node.get_topic_names_and_types()}
    assert {'/left/arm/command', '/right/right/wrench', '/clock'} <= names
    assert '/joint_states' not in names
    assert node.get_parameter('left.robot').value == 'Panda'
    assert node.get_parameter('right.control_mode.arm').value == 'position'
    # Side by side unless the user says where.
    model = node.simulation.model
    distance = model.body('left_base').pos[1] - model.body('right_base').pos[1]
    assert distance == pytest.approx(1.0)


@pytest.mark.full
def test_a_command_moves_its_robot_and_no_other(serve, client):
    serve(**TWO)
    left, right = states_of(client, 'left'), states_of(client, 'right')
    client.spin_until(lambda: left and right)
    start = np.array(left[-1].position)
    name, goal = right[-1].name[0], right[-1].position[0] + 0.2
    client.publish('right/joint_command', JointState(name=[name], position=[goal]))
    client.spin_until(lambda: abs(right[-1].position[0] - goal) < 1e-3)
    np.testing.assert_allclose(left[-1].position, start, atol=1e-3)


def test_a_joint_of_another_robot_is_rejected(serve, client):
    node = serve(**TWO)
    states = states_of(client, 'left')
    client.spin_until(lambda: states)
    client.publish('right/joint_command', JointState(name=['left_joint1'], position=[0.1]))
    client.spin_until(lambda: node.commands.robots[1].statistics['joint_command'].rejected == 1)


@pytest.mark.full
def test_a_parameter_changes_its_robot_and_no_other(serve, client):
    node = serve(**TWO)
    states = states_of(client, 'left')
    client.spin_until(lambda: states)
    request = SetParametersAtomically.Request(parameters=[
        Parameter('left.control_mode.arm', value='velocity').to_parameter_msg()])
    answer = client.call(SetParametersAtomically, 'manip_sim/set_parameters_atomically', request)
    assert answer.result.successful, answer.result.reason
    left, right = node.simulation.robots.values()
    client.spin_until(lambda: set(left.joints.modes_of(left.joints.indices_of('arm')))
                      == {'velocity'})
    assert set(right.joints.modes_of(right.joints.indices_of('arm'))) == {'position'}


@pytest.mark.full
def test_place_and_prefix_are_what_the_user_says(serve, client):
    node = serve(**TWO, left__position=[1.0, -2.0, 0.0], left__prefix='l_',
                 left__orientation=[0.0, 0.0, np.pi / 2.0])
    states = states_of(client, 'left')
    client.spin_until(lambda: states)
    assert states[0].name[0] == 'l_joint1'
    body = node.simulation.model.body('l_base')
    np.testing.assert_allclose(body.pos[:2], [1.0, -2.0])
    np.testing.assert_allclose(body.quat, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-9)


def test_lockstep_waits_for_every_robot(serve, client):
    node = serve(**TWO, stepping='lockstep')
    left, right = states_of(client, 'left'), states_of(client, 'right')
    client.spin_until(lambda: left and right)
    stamp = left[-1].header.stamp

    def answer(robot, state):
        message = JointState(name=state.name[:1], position=state.position[:1])
        message.header.stamp = stamp
        client.publish(f'{robot}/joint_command', message)
    answer('left', left[-1])
    client.spin_until(lambda: node.commands.robots[0].statistics['joint_command'].accepted == 1)
    count = len(left)
    client.spin_until(lambda: len(left) > count)  # The present state, repeated.
    assert left[-1].header.stamp == stamp
    answer('right', right[-1])
    client.spin_until(lambda: left[-1].header.stamp != stamp)


@pytest.mark.parametrize(('robots', 'what'), [
    (['a', 'a'], "parameter 'robots': the names must differ, got a, a"),
    (['objects'], "'objects' cannot be the name of a robot"),
    (['a b'], "'a b' cannot be the name of a robot"),
    (['_a'], "'_a' cannot be the name of a robot")])
def test_names_that_cannot_be_are_rejected(serve, robots, what):
    with pytest.raises(ManipSimError, match=what):
        serve(robots=robots)


@pytest.mark.parametrize(('parameters', 'what'), [
    ({'robot': 'UR5e'}, "unknown parameter 'robot': did you mean"),
    ({'left__robt': 'UR5e'}, r"unknown parameter 'left\.robt': did you mean 'left\.robot'"),
    ({'left__gripper': '{left: PandaGripper}'}, "unknown arm of Pandaleft 'left': .*right"),
    ({'left__gripper': '{right: Pandagrip}'}, r"'left\.gripper': unknown value 'Pandagrip'"),
    ({'left__robot': 'Pandaa'}, r"parameter 'left\.robot': unknown value 'Pandaa'"),
    ({'left__position': [0.0, 1.0]}, r"'left\.position' must be 3 finite numbers"),
    ({'left__position': [0.0, 1.0, float('nan')]}, r"'left\.position' must be 3 finite numbers"),
    ({'left__lockstep_parts': ['leg']}, r"'left\.lockstep_parts': this robot has no part 'leg'")])
def test_parameters_that_cannot_be_are_rejected(serve, parameters, what):
    with pytest.raises(ManipSimError, match=what):
        serve(robots=['left', 'right'], **parameters)


@pytest.mark.full
def test_the_command_line_exports_what_the_node_serves(process, client, tmp_path):
    from manip_sim.cli.main import main
    from manip_sim.resources import share_directory
    file = str(share_directory() / 'config' / 'hand_over.yaml')
    process('--ros-args', '--params-file', file)
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    served = client.listen(String, 'manip_sim/mjcf', latched)
    client.spin_until(lambda: served)
    assert main(['export', str(tmp_path / 'world.xml'), '--params-file', file]) == 0
    assert (tmp_path / 'world.xml').read_text() == served[0].data


def test_each_arm_may_have_its_own_gripper(serve, client):
    node = serve(robots=['twin', 'other'], twin__robot='Baxter',
                 twin__gripper='{left: PandaGripper, right: none}')
    client.state('twin/left/gripper/joint_states')
    assert [type(gripper).__name__ for gripper in
            node.simulation.robots['twin'].robot_model.grippers.values()] == ['PandaGripper']
