# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands are taken by the simulation's thread or their own, where rclpy has what that uses."""

from concurrent.futures import ThreadPoolExecutor
import os
import threading
import time
from types import SimpleNamespace as Plain

import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.logging import LoggingSeverity
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from manip_sim import rclpy_internals
from manip_sim.ros import command_inbox
from manip_sim.ros.command_inbox import CommandThread, create_command_inbox
from manip_sim.ros.command_subscribers import COMMAND_DEPTH, CommandSubscription
from manip_sim.ros.executor import RejectionLog
from manip_sim.ros.feature import Output

COMMAND = JointState(name=['robot0_joint1'], position=[0.1])


@pytest.fixture
def inbox(node):
    """Return an inbox, its log, and the messages of the topic ``command`` that it has taken."""
    log, taken = RejectionLog(node.get_logger()), []
    inbox = create_command_inbox(node, log)
    CommandSubscription(
        Plain(node=node, is_built=False), JointState, 'command', taken.append, inbox)
    yield inbox, log, taken
    inbox.close()


def took_s(function):
    begin = time.monotonic()
    function()
    return time.monotonic() - begin


class Another(rclpy_internals.WaitSet):
    """A wait set of another release, which wants one number less."""

    def __init__(self, subscriptions, guards, timers, clients, services, context):
        super().__init__(subscriptions, guards, timers, clients, services, 0, context)


def lacking(monkeypatch, what):
    """Let rclpy lack what the inbox uses, and return what the warning says of it."""
    if what == 'another signature':
        monkeypatch.setattr(command_inbox, 'WaitSet', Another)
        return '__init__'
    if what == 'no function':
        function = rclpy_internals._function
        monkeypatch.setattr(rclpy_internals, '_function', lambda name: (
            None if 'on_new_message' in name else function(name)))
        return '(no rcl_subscription_set_on_new_message_callback in librcl.so)'
    api = dict(vars(rclpy_internals._C_API))
    if what == 'no class':
        del api['WaitSet']
    else:
        api['Subscription'] = type('Subscription', (rclpy_internals._C_API.Destroyable,), {})
    monkeypatch.setattr(rclpy_internals, '_C_API', Plain(**api))
    return {'no class': 'no WaitSet.clear_entities', 'no method': 'no Subscription.pointer, '
            'no Subscription.take_message)'}[what]


@pytest.mark.parametrize('what', ['another signature', 'no class', 'no function', 'no method'])
def test_an_rclpy_that_lacks_what_is_used_leaves_commands_to_the_executor_and_a_warning_says_so(
        what, node, monkeypatch):
    said = lacking(monkeypatch, what)
    lines = []
    told = Plain(context=node.context, get_logger=lambda: Plain(warning=lines.append))
    files = os.listdir('/proc/self/fd')
    assert create_command_inbox(told, RejectionLog(node.get_logger())) is None
    (line,) = lines
    assert line.startswith('this rclpy cannot wait for commands alone (') and said in line
    assert len(os.listdir('/proc/self/fd')) == len(files)


@pytest.mark.parametrize('error', [
    rclpy_internals.RCLError('Failed to set a callback: not supported'),
    OSError(24, 'Too many open files')])
def test_messages_that_cannot_be_counted_are_left_to_the_executor_and_a_warning_says_so_once(
        error, node, client, monkeypatch):
    def fail(*_):
        raise error
    lines, taken = [], []
    monkeypatch.setattr(node, 'get_logger', lambda: Plain(warning=lines.append))
    inbox = create_command_inbox(node, RejectionLog(node.get_logger()))
    if isinstance(error, OSError):
        monkeypatch.setattr(inbox, '_counter', fail)
    else:
        monkeypatch.setattr(command_inbox, 'count_messages', fail)
    for topic in ('command', 'other'):
        CommandSubscription(
            Plain(node=node, is_built=False), JointState, topic, taken.append, inbox)
    (line,) = lines
    assert f'cannot wait for commands alone ({error})' in line
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    client.publish('command', COMMAND)
    client.spin_until(lambda: executor.spin_once(timeout_sec=0.02) or taken)
    executor.shutdown()
    inbox.close()


def test_messages_that_later_ones_have_replaced_are_not_waited_for(inbox, client):
    inbox, _, taken = inbox
    publisher = client.publisher(JointState, 'command')
    for _ in range(3 * COMMAND_DEPTH):
        publisher.publish(COMMAND)
    assert publisher.wait_for_all_acked(Duration(seconds=60.0))
    inbox.take(3 * COMMAND_DEPTH)
    assert len(taken) == COMMAND_DEPTH
    inbox.wait(0.2)
    assert len(taken) == COMMAND_DEPTH
    publisher.publish(COMMAND)
    client.spin_until(lambda: inbox.wait(0.02) or len(taken) == COMMAND_DEPTH + 1)


def test_a_message_that_is_larger_than_the_buffer_is_taken_whole(inbox, client):
    inbox, _, taken = inbox
    for count in (1, 1000, 100_000, 1):
        message = JointState(position=[0.5] * count)
        client.publish('command', message)
        client.spin_until(lambda: inbox.wait(0.02) or taken)
        assert deserialize_message(taken.pop(), JointState) == message


def test_after_its_end_an_inbox_takes_nothing_and_files_are_closed(node, client):
    files, taken = len(os.listdir('/proc/self/fd')), []
    inbox = create_command_inbox(node, RejectionLog(node.get_logger()))
    subscription = CommandSubscription(
        Plain(node=node, is_built=False), JointState, 'command', taken.append, inbox)
    publisher = client.publisher(JointState, 'command')
    inbox.close()
    for _ in range(2):
        publisher.publish(COMMAND)
        assert publisher.wait_for_all_acked(Duration(seconds=60.0))
        inbox.wake()
        inbox.take()
        inbox.wait(0.01)
    subscription.close()
    inbox.close()
    assert not taken
    assert len(os.listdir('/proc/self/fd')) == files


def test_subscriptions_come_and_go_while_another_thread_waits(node, inbox, client):
    inbox, log, _ = inbox
    files, ended = len(os.listdir('/proc/self/fd')), threading.Event()

    def run():
        while not ended.is_set():
            inbox.wait(0.2)
    thread = threading.Thread(target=run)
    thread.start()
    try:
        publisher = client.node.create_publisher(JointState, 'other', 10)
        for _ in range(20):
            subscription = CommandSubscription(
                Plain(node=node, is_built=False), JointState, 'other', (taken := []).append, inbox)
            client.spin_until(lambda: publisher.publish(COMMAND) or taken)
            subscription.close()
    finally:
        ended.set()
        thread.join()
    assert log.failed == {'callbacks': 0, 'publications': 0, 'takes': 0}
    assert len(os.listdir('/proc/self/fd')) == files


def test_a_wake_ends_the_wait_that_is_or_the_next_one(inbox):
    inbox = inbox[0]
    inbox.wake()
    assert took_s(lambda: inbox.wait(300.0)) < 150.0
    assert took_s(lambda: inbox.wait(0.05)) >= 0.04
    threading.Timer(0.1, inbox.wake).start()
    assert took_s(lambda: inbox.wait(300.0)) < 150.0


def test_messages_are_taken_by_who_waits_and_not_by_the_executor(node, inbox, client):
    inbox, _, taken = inbox
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    publisher = client.publisher(JointState, 'command')
    for _ in range(3):
        publisher.publish(COMMAND)
    for _ in range(10):
        executor.spin_once(timeout_sec=0.02)
    assert not taken
    client.spin_until(lambda: inbox.wait(0.05) or len(taken) == 3)
    taken.clear()
    for _ in range(6):
        publisher.publish(COMMAND)
    client.spin_until(lambda: inbox.take() or len(taken) >= 2)
    # No more than asked for, for the sake of the physics, and not more than there is.
    assert len(taken) == 2
    inbox.take(3)
    assert len(taken) == 5
    inbox.take(10)
    assert len(taken) == 6
    executor.shutdown()


def test_what_a_message_raises_is_told_and_counted_and_the_next_one_is_taken(
        node, inbox, client):
    inbox, log, taken = inbox

    def fail(data):
        taken.append(data)
        raise RuntimeError('broken')
    CommandSubscription(Plain(node=node, is_built=False), JointState, 'fails', fail, inbox)
    for _ in range(2):
        client.publish('fails', COMMAND)
    client.spin_until(lambda: inbox.wait(0.02) or len(taken) == 2)
    assert log.failed['callbacks'] == 2


def test_after_the_end_of_the_context_waits_are_short_and_nothing_is_raised(node, inbox):
    inbox = inbox[0]
    rclpy.shutdown(context=node.context)
    inbox.take()
    for _ in range(3):
        inbox.wait(0.01)
    node.destroy_node()
    inbox.wake()
    inbox.take()
    assert took_s(lambda: inbox.wait(600.0)) < 300.0


def test_subscriptions_of_watched_publishers_that_come_or_go_are_noted(node, inbox, client):
    inbox = inbox[0]
    publishers = [node.create_publisher(JointState, topic, 10) for topic in ('one', 'two')]
    for publisher in publishers:
        inbox.watch(publisher)
    for publisher, topic in zip(publishers, ('one', 'two')):
        for count in (1, 0):
            before = inbox.matches
            inbox.wait(0.05)
            assert inbox.matches == before
            if count:
                subscription = client.node.create_subscription(JointState, topic, id, 10)
            else:
                client.node.destroy_subscription(subscription)
            client.spin_until(
                lambda before=before: inbox.wait(0.02) or inbox.matches != before)
            # What has been noted is counted too.
            assert publisher.get_subscription_count() == count
        inbox.forget(publisher)
        inbox.forget(publisher)
    inbox.close()
    inbox.watch(publishers[0])
    assert inbox.matches is None


def test_a_middleware_that_tells_of_no_subscriptions_is_asked_for_them(node, inbox, monkeypatch):
    def fail(publisher, descriptor):
        raise rclpy_internals.RCLError('not supported')
    monkeypatch.setattr(command_inbox, 'MatchCounter', fail)
    inbox = inbox[0]
    inbox.watch(node.create_publisher(JointState, 'one', 10))
    assert inbox.matches is None


def test_in_lockstep_publishers_are_asked_for_subscriptions_when_some_come_or_go(
        serve, client, monkeypatch):
    node = serve(stepping='lockstep', lockstep_parts=['right'])
    states = client.listen(JointState, 'right/joint_states')
    client.spin_until(lambda: bool(states))
    asked, counted = [], Output._counted
    monkeypatch.setattr(Output, '_counted', lambda self: (
        asked.append(self._publisher.topic_name) or counted(self)))

    def round_trip():
        before = node.simulation.time_ns
        client.publish('right/joint_command', JointState(name=['robot0_joint1'], position=[0.1]))
        client.spin_until(lambda: node.simulation.time_ns > before)
    round_trip()
    client.spin_until(lambda: not asked.clear() and not round_trip() and not asked)
    others = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: bool(others))


@pytest.mark.full
@pytest.mark.parametrize('lacks', [False, True])
@pytest.mark.parametrize('stepping', ['lockstep', 'realtime'])
def test_commands_are_used_whoever_takes_them(serve, client, monkeypatch, stepping, lacks):
    if lacks:
        lacking(monkeypatch, 'another signature')
    log = client.log(LoggingSeverity.WARN)
    node, threads = serve(stepping=stepping), []
    parse = node.simulation.robot.parse.joint_command

    def seen(*arguments):
        threads.append(threading.current_thread().name)
        return parse(*arguments)
    node.simulation.robot.parse.joint_command = seen
    for count in range(1, 6):
        client.publish('arm/joint_command', COMMAND)
        client.spin_until(
            lambda sent=count: node.commands.robots[0].statistics['arm'].accepted == sent)
    assert len(threads) == 5
    if lacks:
        assert not {'physics', 'commands'} & set(threads)
        client.spin_until(lambda: bool(log))
    else:
        # In real time a flood of messages must not take time from the physics.
        assert set(threads) == {'physics' if stepping == 'lockstep' else 'commands'}
    assert len([line for line in log if 'cannot wait for commands alone' in line]) == lacks


def test_a_command_that_came_before_a_step_is_used_in_it(serve, client):
    node = serve(stepping='lockstep', start_paused=True, control_mode__arm='effort')
    publisher = client.publisher(JointState, 'arm/joint_command')
    effort = JointState(name=['robot0_joint1'], effort=[5.0])
    for count in range(1, 6):
        publisher.publish(effort)
        # Topics and services have no common order: only what was acknowledged has come.
        assert publisher.wait_for_all_acked(Duration(seconds=60.0))
        effort.effort[0] += 1.0
        assert client.call(Trigger, 'manip_sim/step').success
        assert node.commands.robots[0].statistics['arm'].accepted == count
        address = node.simulation.robot.joints.servos._activation[0]
        assert node.simulation.data.act[address] == pytest.approx(4.0 + count)


class Waking:
    """An inbox without messages, which counts."""

    def __init__(self):
        self.taken = self.waits = 0
        self._wake = threading.Event()

    def wake(self):
        self._wake.set()

    def wait(self, timeout_s):
        self.waits += 1
        self._wake.wait(timeout_s)
        self._wake.clear()

    def take(self, most):
        self.taken += 1


def test_the_thread_of_commands_takes_at_once_what_somebody_waits_for_and_waits_itself_else():
    inbox = Waking()
    thread = CommandThread(inbox)
    thread.start()
    try:
        with ThreadPoolExecutor(1) as pool:
            asked = [pool.submit(thread.take) for _ in range(3)]
            try:
                for one in asked:
                    one.result(timeout=30.0)
            finally:
                thread.stop()
    finally:
        thread.stop()
    assert inbox.taken == 3
    assert inbox.waits > 0
