# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the viewer sends before the node has been discovered."""

import time

import pytest

rclpy = pytest.importorskip('rclpy', reason='the sender needs ROS 2')
pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from geometry_msgs.msg import PoseStamped, Twist  # noqa: E402
import numpy as np  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402

from manip_sim.viewer.page.latest import ShownStatus  # noqa: E402
from manip_sim.viewer.session import CommandSender  # noqa: E402

#: Longest wait for an answer that has to come, on a busy machine too [s].
PATIENCE_S = 300.0


@pytest.mark.parametrize('forgotten', [False, True])
def test_the_last_goal_waits_for_the_node_unless_it_is_gone(node, forgotten):
    sender, taken = CommandSender(node, 'sim', {}, pytest.fail), []
    sender.prepare({'/arm/joint_command': JointState})
    for goal in (0.1, 0.2):
        sender.move_joints('/', 'arm', 'position', {'joint1': goal})
    if forgotten:
        sender.forget_waiting()
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    node.create_subscription(JointState, '/arm/joint_command', taken.append, 10)
    end = time.monotonic() + (1.0 if forgotten else PATIENCE_S)
    while not taken and time.monotonic() < end:
        sender.send_waiting()
        executor.spin_once(timeout_sec=0.02)
    executor.shutdown()
    assert [list(message.position) for message in taken] == ([] if forgotten else [[0.2]])


def test_a_command_for_a_topic_that_is_gone_is_told_and_not_kept(node):
    told = []
    sender = CommandSender(node, 'sim', {}, told.append)
    sender.prepare({'/arm/joint_command': JointState, '/left/joint_command': JointState})
    sender.move_joints('/', 'arm', 'position', {'joint1': 0.1})
    sender.prepare({'/left/joint_command': JointState})
    # What was waiting is told once when it cannot be sent any more.
    sender.send_waiting()
    sender.send_waiting()
    assert told == ['/arm/joint_command: the node no longer subscribes to this topic']
    assert node.count_publishers('/arm/joint_command') == 0


def test_an_action_is_sent_for_as_many_fingers_as_the_diagnostics_say(node):
    told, sent = [], []
    sender = CommandSender(node, 'sim', {}, told.append)
    sender._publish = lambda topic, message: sent.append((topic, list(message.data)))
    for size, expected in (('2', 2), ('100', 100), ('0', None), ('101', None), ('-1', None),
                           ('abc', None), ('nan', None), ('9' * 30, None)):
        told.clear()
        sent.clear()
        sender.notice('/', [ShownStatus(0, 'right/gripper', '', {'action_size': size}),
                            ShownStatus(0, 'arm', '', {})])
        sender.act('/', 'right/gripper', 1.0)
        if expected is None:
            assert (sent, told) == (
                [], ['right/gripper: the length of an action is not known yet'])
        else:
            assert sent == [('/right/gripper/command', [1.0] * expected)]


def test_a_goal_that_waited_does_not_come_after_a_newer_one(node):
    sender, taken = CommandSender(node, 'sim', {}, pytest.fail), []
    sender.prepare({'/arm/joint_command': JointState})
    sender.move_joints('/', 'arm', 'position', {'joint1': 0.1})
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    node.create_subscription(JointState, '/arm/joint_command', taken.append, 10)
    end = time.monotonic() + PATIENCE_S
    while not node.count_subscribers('/arm/joint_command') and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.02)
    goals = iter(range(1, 1000))
    while not taken and time.monotonic() < end:
        sender.move_joints('/', 'arm', 'position', {'joint1': float(next(goals))})
        executor.spin_once(timeout_sec=0.02)
    # Whatever has come, the next goal is not followed by a former one.
    taken.clear()
    sender.send_waiting()
    sender.move_joints('/', 'arm', 'position', {'joint1': -1.0})
    while not any(list(message.position) == [-1.0] for message in taken):
        assert time.monotonic() < end
        executor.spin_once(timeout_sec=0.02)
    executor.shutdown()
    values = [message.position[0] for message in taken]
    assert 0.1 not in values
    assert values[:-1] == sorted(values[:-1])


def test_a_service_is_called_when_it_is_there_and_missed_when_it_is_not(node):
    told, called, paused = [], [], []
    sender = CommandSender(node, 'sim', {}, told.append)
    sender.paused = paused.append
    sender.pause(True)
    sender.prepare({})
    sender.pause(True)
    assert told == 2 * ['pause: the node does not answer']

    def answer(request, response):
        called.append(request.data)
        response.success, response.message = request.data, 'not now'
        return response
    node.create_service(SetBool, '/sim/pause', answer)
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    end = time.monotonic() + PATIENCE_S
    assert sender._clients['pause'].wait_for_service(PATIENCE_S)
    sender.pause(True)
    sender.pause(False)
    while len(told) < 3:
        assert time.monotonic() < end
        executor.spin_once(timeout_sec=0.02)
    executor.shutdown()
    assert (called, paused, told[2:]) == ([True, False], [True], ['pause: not now'])


@pytest.mark.parametrize('command, service', [
    ('step', 'step'), ('reset', 'reset'), ('tare', 'tare_wrench')])
def test_each_button_calls_its_service(node, command, service):
    called = []
    sender = CommandSender(node, 'cell/sim', {}, pytest.fail)
    sender.prepare({})

    def answer(_, response):
        called.append(service)
        response.success = True
        return response
    node.create_service(Trigger, f'/cell/sim/{service}', answer)
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    assert sender._clients[service].wait_for_service(PATIENCE_S)
    getattr(sender, command)()
    end = time.monotonic() + PATIENCE_S
    while not called:
        assert time.monotonic() < end
        executor.spin_once(timeout_sec=0.02)
    executor.shutdown()


def test_a_base_is_driven_and_an_end_effector_sent_in_the_frame_of_its_pose(node):
    taken = {Twist: [], PoseStamped: []}
    sender = CommandSender(node, 'sim', {('/left/', 'right'): 'left/world'}, pytest.fail)
    topics = {'/left/base/cmd_vel': Twist, '/left/right/target_pose': PoseStamped,
              '/right/target_pose': PoseStamped}
    sender.prepare(topics)
    for topic, kind in topics.items():
        node.create_subscription(kind, topic, taken[kind].append, 10)
    sender.drive('/left/', (0.1, -0.2, 0.3))
    for space in ('/left/', '/'):
        sender.reach(space, 'right', np.array([1.0, 2.0, 3.0]), np.array([0.5, -0.5, 0.1, 0.7]))
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    end = time.monotonic() + PATIENCE_S
    while not taken[Twist] or len(taken[PoseStamped]) < 2:
        assert time.monotonic() < end
        sender.send_waiting()
        executor.spin_once(timeout_sec=0.02)
    executor.shutdown()
    twist = taken[Twist][0]
    assert (twist.linear.x, twist.linear.y, twist.angular.z) == (0.1, -0.2, 0.3)
    assert {pose.header.frame_id for pose in taken[PoseStamped]} == {'left/world', 'world'}
    at, turn = taken[PoseStamped][0].pose.position, taken[PoseStamped][0].pose.orientation
    assert [at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z] == [
        1.0, 2.0, 3.0, 0.5, -0.5, 0.1, 0.7]


def test_a_pull_does_not_wait_for_a_node_that_takes_it_and_its_end_tells_people(node):
    told, taken = [], []
    sender = CommandSender(node, 'cell/sim', {}, told.append)
    sender.prepare({'/cell/sim/pull': Marker})
    begin, target = np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    sender.pull('cube', 7, begin, target)
    assert (told, sender._waiting) == ([], {})
    sender.let_go('cube')
    assert told == ['pull: the node does not take pulls']
    node.create_subscription(Marker, '/cell/sim/pull', taken.append, 10)
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    end = time.monotonic() + PATIENCE_S
    while len(taken) < 2 and time.monotonic() < end:
        sender.pull('cube', 7, begin, target)
        sender.let_go('cube')
        executor.spin_once(timeout_sec=0.02)
    executor.shutdown()
    first, last = taken[:2]
    assert (first.ns, first.id, first.action, first.type) == (
        'cube', 7, Marker.ADD, Marker.ARROW)
    assert [[p.x, p.y, p.z] for p in first.points] == [begin.tolist(), target.tolist()]
    assert (last.ns, last.action) == ('cube', Marker.DELETE)
