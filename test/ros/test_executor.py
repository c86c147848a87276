# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The executor: what raises in it, and how it ends."""

import contextlib
import threading
import time
from types import SimpleNamespace

from harness import START_S
import pytest
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.serialization import serialize_message
from std_msgs.msg import Empty, String
from std_srvs.srv import SetBool
from test_log import Lines

from manip_sim.ros.executor import GuardedExecutor, RejectionLog
from manip_sim.viewer.discovery import PolledExecutor


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
    end = time.monotonic() + START_S
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


def test_data_that_cannot_be_read_is_counted_and_told(node, executor, log):
    came = []
    node.create_subscription(String, 'topic', came.append, 10)
    publisher = node.create_publisher(String, 'topic', 10)
    spin_until(executor, lambda: publisher.get_subscription_count() > 0)
    whole = serialize_message(String(data='whole'))
    for count in range(1, 4):
        publisher.publish(whole[:-4])
        spin_until(executor, lambda n=count: log.failed['takes'] == n)
        publisher.publish(whole)
        spin_until(executor, lambda n=count: len(came) == n)
    assert log.failed['takes'] == 3
    assert log._logger.texts == ['/topic: received data that cannot be read as a message of its '
                                 'type']


def test_a_request_that_cannot_be_read_is_counted_and_the_next_one_answered(
        node, executor, log, monkeypatch):
    service = node.create_service(SetBool, 'service', answer)
    client = node.create_client(SetBool, 'service')
    spin_until(executor, client.service_is_ready)

    class Unreadable(contextlib.nullcontext):
        """What the middleware gives where it cannot read a request."""

        def service_take_request(self, request_type):
            service.handle.service_take_request(request_type)
            return None, None
    broken = SimpleNamespace(handle=Unreadable(), srv_type=SetBool, srv_name='service')
    take = executor._take_service
    with monkeypatch.context() as patch:
        patch.setattr(executor, '_take_service', lambda _: take(broken))
        client.call_async(SetBool.Request(data=False))
        spin_until(executor, lambda: log.failed['takes'] == 1)
    answered = client.call_async(SetBool.Request(data=True))
    spin_until(executor, answered.done)
    assert answered.result().success
    assert log.failed == {'callbacks': 0, 'publications': 0, 'takes': 1}
    assert log._logger.texts == ['service: received data that cannot be read as a message of its '
                                 'type']


def answer(request, response):
    response.success = request.data
    return response


def test_what_was_destroyed_while_data_waited_is_no_data_that_cannot_be_read(node, executor, log):
    came = []
    subscriptions = []

    def destroy_the_other(message):
        came.append(message)
        node.destroy_subscription(subscriptions.pop())
    subscriptions += [node.create_subscription(String, 'topic', destroy_the_other, 10)
                      for _ in range(2)]
    publisher = node.create_publisher(String, 'topic', 10)
    spin_until(executor, lambda: publisher.get_subscription_count() == 2)
    publisher.publish(String())
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    spin_until(executor, lambda: came)
    for _ in range(5):
        executor.spin_once(timeout_sec=0.05)
    assert log.failed == {'callbacks': 0, 'publications': 0, 'takes': 0}


@pytest.mark.full
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
        thread.join(timeout=300.0)
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
    thread.join(timeout=300.0)
    assert not thread.is_alive()
    executor.shutdown()


def test_a_callback_of_the_viewer_that_raises_is_told_and_the_next_message_taken(node, log):
    came = []

    def take(message):
        came.append(message.data)
        if message.data == 'bad':
            raise RuntimeError('not today')
    node.create_subscription(String, 'topic', take, 10)
    publisher = node.create_publisher(String, 'topic', 10)
    executor = PolledExecutor(log, context=node.context)
    executor.add_node(node)
    end = time.monotonic() + START_S
    while not publisher.get_subscription_count():
        assert time.monotonic() < end, 'timed out'
    for text in ('bad', 'good'):
        publisher.publish(String(data=text))
    while len(came) < 2:
        assert time.monotonic() < end, 'timed out'
        executor.run_ready()
    executor.shutdown()
    executor.run_ready()
    assert came == ['bad', 'good']
    assert log.failed['callbacks'] == 1
    assert [line for line in log._logger.texts if 'topic: RuntimeError: not today' in line]
