# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A publisher whose reader is stopped: it drops messages without waiting, until it is read."""

import signal
import subprocess
import sys

import pytest
from rclpy.qos import HistoryPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

from manip_sim.ros.executor import RejectionLog
from manip_sim.ros.feature import Output

EVERYTHING = QoSProfile(history=HistoryPolicy.KEEP_ALL)
#: More than a publisher of Fast DDS keeps while nobody acknowledges.
MANY = 20_000
LAST = 1_000_000
#: Subscribes, and tells when the last message has come.
READER = f"""
import rclpy
from rclpy.qos import HistoryPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

rclpy.init()
node = rclpy.create_node('reader')
node.create_subscription(
    Clock, 'times', lambda m: m.clock.sec == {LAST} and print('last', flush=True),
    QoSProfile(history=HistoryPolicy.KEEP_ALL))
rclpy.spin(node)
"""


class Lines(list):
    """A logger that keeps its lines."""

    def warning(self, text):
        self.append(text)


@pytest.fixture
def reader():
    process = subprocess.Popen([sys.executable, '-c', READER], text=True, stdout=subprocess.PIPE)
    yield process
    process.kill()
    process.communicate()


def times(count):
    message = Clock()
    for message.clock.sec in range(count):
        yield message


@pytest.mark.full
def test_an_output_whose_reader_stops_drops_messages_at_once_and_recovers_with_the_reader(
        client, reader):
    lines, publisher = Lines(), client.node.create_publisher(Clock, 'times', EVERYTHING)
    log = RejectionLog(lines)
    output = Output(publisher, log)
    assert not output.has_subscribers and not output.wanted
    client.spin_until(lambda: output.wanted)
    reader.send_signal(signal.SIGSTOP)
    publish, tries = publisher.publish, []
    publisher.publish = lambda message: (tries.append(message.clock.sec), publish(message))
    for message in times(MANY):
        output.publish(message)
        if log.failed['publications']:
            break
    # From the first message that was not taken on, none waits for the reader.
    assert log.failed['publications'] == 1 and 'RCLError' in lines[0]
    tried = len(tries)
    assert output.has_subscribers and not output.wanted
    for message in times(100):
        output.publish(message)
    assert len(tries) == tried
    assert log.failed['publications'] == 102
    assert lines[1] == '/times: a reader does not acknowledge, messages are dropped until it ' \
                       'does or is gone'
    reader.send_signal(signal.SIGCONT)
    client.spin_until(lambda: output.wanted)
    failed = log.failed['publications']
    message = Clock()
    message.clock.sec = LAST
    output.publish(message)
    assert reader.stdout.readline() == 'last\n'
    assert log.failed['publications'] == failed
