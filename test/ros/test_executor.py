# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The executor: what raises in it, and how it ends."""

import threading
import time

from harness import DOMAIN
import pytest
import rclpy
from rclpy.clock import Clock, ClockType
from std_msgs.msg import Empty
from test_log import Lines

from manip_sim.ros.executor import GuardedExecutor
from manip_sim.ros.log import RejectionLog


@pytest.fixture
def node():
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    node = rclpy.create_node('node', context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


@pytest.fixture
def log():
    return RejectionLog(Lines())


@pytest.fixture
def executor(node, log):
    executor = GuardedExecutor(log, context=node.context)
    executor.add_node(node)
    yield executor
    executor.shutdown()


def spin_until(executor, condition):
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end, 'timed out'
        executor.spin_once(timeout_sec=0.05)


def test_a_timer_that_raises_is_called_again(node, executor, log):
    def fail():
        raise RuntimeError('not today')
    node.create_timer(0.01, fail, clock=Clock(clock_type=ClockType.STEADY_TIME))
    spin_until(executor, lambda: log.failed['callbacks'] == 5)


def test_a_message_that_cannot_be_taken_does_not_block_its_topic(node, executor, log,
                                                                 monkeypatch):
    came = []
    subscription = node.create_subscription(Empty, 'topic', came.append, 10)
    publisher = node.create_publisher(Empty, 'topic', 10)
    spin_until(executor, lambda: publisher.get_subscription_count() > 0)
    with monkeypatch.context() as patch:
        def fail(taken):
            subscription.handle.take_message(Empty, False)
            raise RuntimeError('cannot be read')
        patch.setattr(executor, '_take_subscription', fail)
        publisher.publish(Empty())
        spin_until(executor, lambda: log.failed['callbacks'] == 1)
    publisher.publish(Empty())
    spin_until(executor, lambda: len(came) == 1)


def test_it_ends_at_any_moment_without_an_exception(node, log):
    ticks = []
    node.create_timer(1e-4, lambda: ticks.append(1), clock=Clock(clock_type=ClockType.STEADY_TIME))
    raised = []

    def spin(executor):
        try:
            executor.spin()
        except Exception as error:
            raised.append(error)
    for n in range(200):
        executor = GuardedExecutor(log, context=node.context)
        executor.add_node(node)
        thread = threading.Thread(target=spin, args=(executor,))
        thread.start()
        time.sleep(n * 1e-5)
        executor.end()
        thread.join(timeout=10.0)
        assert not thread.is_alive()
        executor.shutdown()
    assert len(ticks) > 200
    assert not raised
    assert log.failed['callbacks'] == 0


def test_it_ends_with_its_context(node, log):
    executor = GuardedExecutor(log, context=node.context)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    node.context.shutdown()
    thread.join(timeout=10.0)
    assert not thread.is_alive()
    executor.shutdown()
