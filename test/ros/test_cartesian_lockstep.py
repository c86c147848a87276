# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cartesian commands in lockstep, and of several robots."""

from pathlib import Path
import re
import subprocess
import sys

from geometry_msgs.msg import PoseStamped, TwistStamped
from harness import Client, Served
import pytest
from rclpy.duration import Duration
from std_msgs.msg import Float64MultiArray

LOCKSTEP = {'stepping': 'lockstep', 'robot': 'UR5e'}


def twist(y):
    message = TwistStamped()
    message.twist.linear.y = y
    return message


def test_settings_are_taken_at_the_start_for_each_robot(serve):
    node = serve(robots=['one', 'two'], one__robot='UR5e', two__robot='Panda',
                 one__cartesian__right__stiffness=20.0, start_paused=True)
    one, two = (robot.joints.cartesian.settings['right']
                for robot in node.simulation.robots.values())
    assert (one.stiffness, two.stiffness) == (20.0, 150.0)
    assert [topic for topic, _ in node.get_topic_names_and_types()
            if topic.endswith('pose_command')] == [
                '/one/right/pose_command', '/two/right/pose_command']


def drive(node, client):
    """Answer twenty states, first with twists and then with poses."""
    poses = client.listen(PoseStamped, 'right/eef_pose')
    client.publisher(TwistStamped, 'right/target_twist')
    client.publisher(PoseStamped, 'right/target_pose')
    for number in range(20):
        client.spin_until(lambda n=number: any(p.header.stamp.nanosec == 10_000_000 * (n + 1)
                                               for p in poses))
        if number < 10:
            answer, topic = twist(0.1), 'right/target_twist'
        else:
            answer, topic = PoseStamped(pose=poses[-1].pose), 'right/target_pose'
            answer.pose.position.z += 0.01
        answer.header.stamp.nanosec = 10_000_000 * (number + 1)
        client.publish(topic, answer)
    client.spin_until(lambda: node.simulation.step_count == 105)


def test_in_lockstep_a_cartesian_command_is_the_command_of_its_arm(serve, client):
    node = serve(**LOCKSTEP)
    drive(node, client)
    state = node.simulation.robot.state().position.tobytes()
    log, statistics = client.log(), node.commands.robots[0].statistics['arm']
    stale = twist(0.1)
    stale.header.stamp.nanosec = 10_000_000
    client.publish('right/target_twist', stale)
    client.spin_until(lambda: statistics.rejected == 1)
    client.spin_until(lambda: any('the command answers the state of 0.010' in line
                                  for line in log))
    assert node.simulation.step_count == 105
    assert node.simulation.robot.state().position.tobytes() == state


@pytest.mark.full
def test_in_lockstep_the_same_commands_give_the_same_bits():
    states = []
    for _ in range(2):
        served, client = Served(LOCKSTEP), Client()
        drive(served.node, client)
        states.append(served.node.simulation.data.qpos.tobytes())
        client.close()
        served.close()
    assert states[0] == states[1]


@pytest.fixture
def policy():
    """Run the policy of the document in a process."""
    page = Path(__file__).resolve().parents[2] / 'docs' / 'how_to' / 'cartesian.md'
    blocks = re.findall(r'```python\n(.*?)```', page.read_text(), re.DOTALL)
    script = next(block for block in blocks if 'rclpy.spin' in block)
    process = subprocess.Popen([sys.executable, '-c', script])
    yield process
    # Some releases of rclpy miss a SIGTERM that comes while a program starts.
    process.kill()
    process.wait(timeout=300.0)


@pytest.mark.full
def test_the_policy_of_the_document_lifts_the_end_effector(serve, client, request):
    serve(arena='table', publish_rate=20.0, control_mode__arm='effort', stepping='lockstep',
          lockstep_parts=['arm', 'right/gripper'])
    poses = client.listen(PoseStamped, 'right/eef_pose')
    client.spin_until(lambda: bool(poses))
    request.getfixturevalue('policy')
    client.spin_until(lambda: poses[-1].pose.position.z > poses[0].pose.position.z + 0.05)


@pytest.mark.full
def test_the_policy_of_the_document_does_not_answer_before_it_is_heard(client, policy):
    # A client may see states before the publishers of its commands are connected.
    state = PoseStamped()
    state.header.stamp.sec = 1
    publisher = client.publisher(PoseStamped, 'right/eef_pose')
    publisher.publish(state)
    assert publisher.wait_for_all_acked(Duration(seconds=20.0))
    commands = [client.listen(Float64MultiArray, f'right/{part}command')
                for part in ('pose_', 'gripper/')]

    def repeat():
        publisher.publish(state)
        return all(commands)
    client.spin_until(repeat)
    assert [len(taken) for taken in commands] == [1, 1]
