# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands are taken by the simulation's thread or their own, where rclpy has what that uses."""

from concurrent.futures import ThreadPoolExecutor
import threading
import time
from types import SimpleNamespace as Plain

import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.logging import LoggingSeverity
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from manip_sim import rclpy_internals
from manip_sim.ros import command_inbox
from manip_sim.ros.command_inbox import CommandThread, create_command_inbox
from manip_sim.ros.command_subscribers import CommandSubscription
from manip_sim.ros.rejection_log import RejectionLog

COMMAND = JointState(name=['robot0_joint1'], position=[0.1])


@pytest.fixture
def inbox(node):
    """Return an inbox, its log, and the messages of the topic ``command`` that it has taken."""
    log, taken = RejectionLog(node.get_logger()), []
    inbox = create_command_inbox(node, log)
    CommandSubscription(
        Plain(node=node, is_built=False), JointState, 'command', taken.append, inbox)
    return inbox, log, taken


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
    api = dict(vars(rclpy_internals._C_API))
    if what == 'no class':
        del api['WaitSet']
    else:
        api['Subscription'] = type('Subscription', (rclpy_internals._C_API.Destroyable,), {})
    monkeypatch.setattr(rclpy_internals, '_C_API', Plain(**api))
    return {'no class': 'no WaitSet.add_guard_condition', 'no method': 'no Subscription.pointer, '
            'no Subscription.take_message)'}[what]


@pytest.mark.parametrize('what', ['another signature', 'no class', 'no method'])
def test_an_rclpy_that_lacks_what_is_used_leaves_commands_to_the_executor_and_a_warning_says_so(
        what, node, monkeypatch):
    said = lacking(monkeypatch, what)
    lines = []
    told = Plain(**{name: getattr(node, name) for name in (
        'create_guard_condition', 'destroy_guard_condition', 'context')},
        get_logger=lambda: Plain(warning=lines.append))
    guards = len(list(node.guards))
    assert create_command_inbox(told, RejectionLog(node.get_logger())) is None
    (line,) = lines
    assert line.startswith('this rclpy cannot wait for commands alone (') and said in line
    assert len(list(node.guards)) == guards


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
        address = node.simulation.robot.joints._servos._activation[0]
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
