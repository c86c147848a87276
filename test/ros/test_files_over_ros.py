# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the files of robots and arenas have besides arms, over topics and parameters."""

import math
from pathlib import Path
import sys

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
import pytest
from rcl_interfaces.srv import ListParameters, SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'models'))
from opened_files import OpenedFiles  # noqa: E402

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


@pytest.mark.full
def test_a_drawer_of_the_arena_opens_by_command_and_says_so(serve, client):
    node = serve(stepping='free', arena=str(FILES / 'room.xml'))
    states = client.listen(JointState, 'arena/joint_states')
    commands = client.node.create_publisher(JointState, 'arena/joint_command', 10)
    client.spin_until(lambda: states and commands.get_subscription_count())
    assert list(states[0].name) == ['hinge', 'slide']
    commands.publish(JointState(name=['slide'], position=[0.2]))
    client.spin_until(lambda: abs(states[-1].position[1] - 0.2) < 1e-4)
    assert abs(states[-1].position[0]) < 1e-6
    assert len(states[-1].velocity) == len(states[-1].effort) == 2
    # Commands that do not fit change nothing; a goal out of range is clamped.
    for wrong in (JointState(name=['hinge'], position=[1.0]),
                  JointState(name=['slide'], velocity=[1.0]),
                  JointState(name=['slide', 'slide'], position=[0.0, 0.0]),
                  JointState(name=['slide'], position=[math.inf])):
        commands.publish(wrong)
    commands.publish(JointState(name=['slide'], position=[5.0]))
    client.spin_until(lambda: node.simulation.data.ctrl[node.simulation.model.actuator(
        'drawer').id] == 0.3)
    client.spin_until(lambda: abs(states[-1].position[1] - 0.3) < 1e-3)
    statuses = client.listen(DiagnosticArray, '/diagnostics')

    def counted():
        values = [{pair.key: pair.value for pair in status.values}
                  for message in statuses for status in message.status
                  if status.name == 'manip_sim: arena']
        return values and (values[-1]['accepted'], values[-1]['dropped']) == ('2', '4')
    client.spin_until(counted)


def test_lockstep_can_wait_for_the_joints_of_the_arena(serve, client):
    node = serve(stepping='lockstep', lockstep_parts=['arm', 'arena'],
                 arena=str(FILES / 'room.xml'))
    states = client.listen(JointState, 'arena/joint_states')
    arena = client.node.create_publisher(JointState, 'arena/joint_command', 10)
    arm = client.node.create_publisher(JointState, 'arm/joint_command', 10)
    client.spin_until(lambda: states and arena.get_subscription_count()
                      and arm.get_subscription_count())
    begin = node.simulation.step_count
    assert node.thread.progress.waits_for == {
        'robot0': ['arm'], 'arena': ['arena']}
    arm.publish(JointState(name=['robot0_joint1'], position=[0.0]))
    repeated = len(states)
    client.spin_until(lambda: len(states) > repeated + 2)
    assert node.simulation.step_count == begin
    assert node.thread.progress.waits_for == {'arena': ['arena']}
    stale = JointState(name=['slide'], position=[0.3])
    stale.header.stamp.sec = 1000
    arena.publish(stale)  # Is rejected.
    answer = JointState(header=states[-1].header, name=['slide'], position=[0.2])
    answer.header.frame_id = ''
    arena.publish(answer)
    client.spin_until(lambda: node.simulation.step_count == begin + 5)
    assert node.simulation.data.ctrl[node.simulation.model.actuator('drawer').id] == 0.2
    # Joints without numbers go on as before, which is an answer, too.
    arm.publish(JointState(name=['robot0_joint1'], position=[0.0]))
    arena.publish(JointState(name=['slide']))
    client.spin_until(lambda: node.simulation.step_count == begin + 10)


def test_a_mocap_body_goes_where_its_topic_says(serve, client):
    serve(start_paused=True, arena=str(FILES / 'room.xml'))
    poses = client.listen(PoseStamped, 'objects/marker/pose')
    targets = client.node.create_publisher(PoseStamped, 'objects/marker/target_pose', 10)
    client.spin_until(lambda: poses and targets.get_subscription_count())
    assert poses[0].pose.position.y == 1.0
    target = PoseStamped()
    target.header.frame_id = 'elsewhere'
    targets.publish(target)  # Is rejected.
    target.header.frame_id, target.pose.position.x = 'world', 0.25
    targets.publish(target)

    def moved():
        client.call(Trigger, 'manip_sim/step')
        return poses[-1].pose.position.x == 0.25
    client.spin_until(moved)
    assert poses[-1].pose.position.y == 0.0 and poses[-1].pose.orientation.w == 1.0
    assert client.call(Trigger, 'manip_sim/reset').success
    client.spin_until(lambda: poses[-1].pose.position.y == 1.0)


def test_actuators_of_tendons_are_commanded_by_their_names(serve, client):
    node = serve(stepping='free', robot=str(FILES / 'differential_wrist.xml'))
    states = client.listen(JointState, 'actuators/states')
    commands = client.node.create_publisher(JointState, 'actuators/command', 10)
    client.spin_until(lambda: states and commands.get_subscription_count())
    assert list(states[0].name) == ['robot0_sum', 'robot0_difference', 'robot0_spin']
    commands.publish(JointState(name=['robot0_yaw'], position=[0.1]))  # Is rejected.
    commands.publish(JointState(name=['robot0_sum', 'robot0_difference'], position=[0.8, 0.2]))
    client.spin_until(lambda: abs(states[-1].position[0] - 0.8) < 1e-2
                      and abs(states[-1].position[1] - 0.2) < 1e-2)
    assert len(states[-1].velocity) == len(states[-1].effort) == 3
    counts = node.surroundings.statistics['actuators']
    assert (counts.accepted, counts.rejected) == (1, 1)


def test_what_belongs_to_no_arm_has_topics_of_its_own(serve, client):
    serve(stepping='free', robot=str(FILES / 'turning_laser.xml'))
    states = client.listen(JointState, 'other/joint_states')
    arm = client.listen(JointState, 'right/joint_states')
    commands = client.node.create_publisher(JointState, 'other/joint_command', 10)
    client.spin_until(lambda: states and arm and commands.get_subscription_count())
    assert list(states[0].name) == ['robot0_tilt'] and 'robot0_tilt' not in arm[0].name
    commands.publish(JointState(name=['robot0_tilt'], position=[0.4]))
    client.spin_until(lambda: abs(states[-1].position[0] - 0.4) < 5e-3)


@pytest.mark.full
def test_no_parameter_that_is_set_later_reads_a_file(serve, client, tmp_path):
    serve(start_paused=True, robot=str(FILES / 'keyframes.xml'), arena=str(FILES / 'room.xml'),
          cameras=['overview'], lidars=['{name: flat}'], randomization='', spawn_roots=[''])
    for name in ('secret.yaml', 'secret.xml', 'secret'):
        (tmp_path / name).write_text('<mujoco/>')
    opened = OpenedFiles(tmp_path)
    (tmp_path / 'secret').read_text()
    assert opened.take() == {'secret'}
    names = client.call(ListParameters, 'manip_sim/list_parameters').result.names
    assert {'robot', 'task', 'objects', 'randomization', 'spawn_roots', 'keyframe'} <= set(names)
    for path in (str(tmp_path / 'secret.yaml'), str(tmp_path / 'secret.xml'), str(tmp_path)):
        for value in (path, [path], f'{{file: {path}}}'):
            results = client.call(SetParameters, 'manip_sim/set_parameters', SetParameters.Request(
                parameters=[Parameter(name, value=value).to_parameter_msg() for name in names]))
            assert not any(result.successful for result in results.results)
    assert not opened.take()
    opened.close()


def test_a_hand_alone_is_driven_in_lockstep_and_describes_itself(serve, client):
    node = serve(stepping='lockstep', robot=str(FILES / 'lone_hand.xml'))
    states = client.listen(JointState, 'right/gripper/joint_states')
    wrenches = client.listen(WrenchStamped, 'right/wrench')
    commands = client.node.create_publisher(Float64MultiArray, 'right/gripper/command', 10)
    client.spin_until(lambda: states and commands.get_subscription_count())
    assert list(states[0].name) == ['robot0_a', 'robot0_b', 'robot0_c']
    for _ in range(5):
        before = node.simulation.data.time
        commands.publish(Float64MultiArray(data=[1.0, 1.0, -1.0]))
        client.spin_until(lambda: node.simulation.data.time > before)  # noqa: B023
    client.spin_until(lambda: states[-1].position[0] > 1e-3)
    assert abs(states[-1].position[2]) < 1e-3
    client.spin_until(lambda: wrenches)
    assert wrenches[0].header.frame_id == 'robot0_right_hand_ft_frame'
