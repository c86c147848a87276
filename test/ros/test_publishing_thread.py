# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The thread that publishes: in order, and nothing waits for it but who has to."""

import signal
import subprocess
import sys
import threading
import time

import pytest
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

from manip_sim.rclpy_internals import publish_bytes, RCLError
from manip_sim.ros.executor import RejectionLog
from manip_sim.ros.feature import Output, PublishingThread

EVERYTHING = QoSProfile(history=HistoryPolicy.KEEP_ALL)
READER = """
import rclpy
from rclpy.qos import HistoryPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

rclpy.init()
node = rclpy.create_node('reader')
node.create_subscription(
    Clock, 'times', lambda _: None, QoSProfile(history=HistoryPolicy.KEEP_ALL))
rclpy.spin(node)
"""


@pytest.fixture
def thread():
    thread = PublishingThread(1000)
    yield thread
    thread.stop()


@pytest.fixture
def reader():
    process = subprocess.Popen([sys.executable, '-c', READER])
    yield process
    process.kill()
    process.wait()


def at(seconds):
    message = Clock()
    message.clock.sec = seconds
    return message


def test_messages_and_bytes_arrive_in_the_order_in_which_they_were_published(client, thread):
    got = []
    client.node.create_subscription(
        Clock, 'times', lambda message: got.append(message.clock.sec), EVERYTHING)
    publisher = client.node.create_publisher(Clock, 'times', EVERYTHING)
    output = Output(publisher, RejectionLog(client.node.get_logger()), thread)
    client.spin_until(lambda: output.wanted)
    for number in range(300):
        output.publish(at(number) if number % 3 else serialize_message(at(number)))
    client.spin_until(lambda: len(got) == 300)
    assert got == list(range(300))


def test_a_publication_that_waits_holds_up_only_who_flushes(thread):
    gate, published, flushed = threading.Event(), [], threading.Event()
    thread.add(gate.wait)
    for number in range(5):
        thread.add(lambda number=number: published.append(number))
    waiting = threading.Thread(target=lambda: (thread.flush(), flushed.set()))
    waiting.start()
    assert not flushed.wait(0.05) and not published
    gate.set()
    waiting.join()
    assert published == [0, 1, 2, 3, 4]


def test_all_that_waits_is_published_at_the_end_and_by_the_caller_after_it():
    thread, published = PublishingThread(1000), []
    thread.flush()
    for number in range(100):
        thread.add(lambda number=number: published.append(number))
    thread.stop()
    assert published == list(range(100))
    thread.add(lambda: published.append('late'))
    thread.flush()
    thread.stop()
    assert published[-1] == 'late' and thread.is_alive


def test_who_adds_too_many_waits_for_earlier_ones():
    thread, gate, added, published = PublishingThread(10), threading.Event(), [], []
    thread.add(gate.wait)

    def add():
        for number in range(50):
            thread.add(lambda: published.append(None))
            added.append(number)
    adding = threading.Thread(target=add)
    adding.start()
    while len(added) < 8:
        pass
    adding.join(0.05)
    # With the first one, ten.
    assert len(added) == 8 and not published
    gate.set()
    adding.join()
    thread.stop()
    assert len(published) == 50


def test_a_thread_that_has_failed_is_seen_and_holds_up_nobody(thread, monkeypatch):
    monkeypatch.setattr(threading, 'excepthook', lambda _: None)
    thread.add(lambda: 1 / 0)
    thread.flush()
    assert not thread.is_alive


def test_a_publication_that_flushes_does_not_wait_for_itself(thread):
    done = threading.Event()
    thread.add(lambda: (thread.flush(), done.set()))
    assert done.wait(300.0)


@pytest.mark.full
def test_other_threads_go_on_while_a_publication_waits_for_its_reader(client, reader):
    publisher = client.node.create_publisher(Clock, 'times', EVERYTHING)
    client.spin_until(lambda: publisher.get_subscription_count() > 0)
    reader.send_signal(signal.SIGSTOP)
    ticks, ends, content = [0], threading.Event(), serialize_message(at(1))

    def tick():
        while not ends.wait(0.002):
            ticks[0] += 1
    ticking = threading.Thread(target=tick)
    ticking.start()
    try:
        during = 0
        for _ in range(50):  # On a busy machine other threads may have had no turn by chance.
            with pytest.raises(RCLError, match='Failed to publish: .*publish'):
                for _ in range(20_000):
                    begin, before = time.monotonic(), ticks[0]
                    publish_bytes(publisher, content)
            # It has waited for 100 ms; rclpy's own function lets no other thread run meanwhile.
            assert time.monotonic() - begin > 0.09
            during = max(during, ticks[0] - before)
            if during >= 5:
                break
        assert during >= 5
    finally:
        ends.set()
        ticking.join()
        reader.send_signal(signal.SIGCONT)
