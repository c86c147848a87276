# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Warnings about what was received."""

import random
import string

import pytest
from sensor_msgs.msg import JointState

from manip_sim.errors import CommandError
from manip_sim.ros.executor import kind_of, RejectionLog


class Lines:
    """A logger that keeps its lines, and a clock that stands still until it is set."""

    def __init__(self):
        self.texts = []
        self.now_s = 100.0

    def warning(self, text):
        self.texts.append(text)


@pytest.fixture
def lines():
    return Lines()


@pytest.fixture
def log(lines):
    return RejectionLog(lines, clock=lambda: lines.now_s)


def test_a_kind_of_error_is_told_once_a_second_for_each_topic(log, lines):
    for topic in ('a', 'b'):
        for kind in ('1', '2'):
            for _ in range(100):
                log.warn(topic, kind, f'{topic}{kind}')
    assert lines.texts == ['a1', 'a2', 'b1', 'b2']
    lines.now_s += 1.01
    log.warn('a', '1', 'again')
    assert lines.texts[4:] == ['again (99 more before)']


def test_memory_is_bounded_whatever_the_kinds(log):
    for kind in range(5000):
        log.warn('topic', str(kind), 'text')
        log.warn('topic', str(kind), 'text')
    assert len(log._logged_s) <= 1000
    assert len(log._left_out) <= 1000


def raised(name):
    try:
        raise CommandError(f'no joint {name}')
    except CommandError as error:
        return error


def test_the_kind_of_an_error_does_not_depend_on_its_text():
    assert kind_of(raised('a')) == kind_of(raised("x'y'z"))
    try:
        raise CommandError('another line')
    except CommandError as error:
        assert kind_of(error) != kind_of(raised('a'))
    assert kind_of(ValueError('never raised')) == 'ValueError'


def test_failures_are_counted(log, lines):
    for _ in range(3):
        log.failure('callbacks', '~/reset', raised('a'))
    for _ in range(2):
        log.unreadable('arm/command')
    assert log.failed == {'callbacks': 3, 'publications': 0, 'takes': 2}
    assert lines.texts == ['~/reset: CommandError: no joint a', 'arm/command: received data that '
                           'cannot be read as a message of its type']


@pytest.mark.full
def test_names_with_apostrophes_do_not_flood_the_log(sim_process, client):
    log = client.log()
    sim_process()
    client.state()
    publisher = client.publisher(JointState, 'arm/joint_command')
    rng = random.Random(1)
    begin = client.node.get_clock().now()
    for _ in range(2000):
        name = "x'" + ''.join(rng.choices(string.ascii_lowercase, k=12)) + "'y"
        publisher.publish(JointState(name=[name], position=[0.0]))
        client.executor.spin_once(timeout_sec=0.001)
    client.state()
    elapsed_s = (client.node.get_clock().now() - begin).nanoseconds * 1e-9
    rejections = [text for text in log if 'arm/joint_command: ' in text]
    assert 1 <= len(rejections) <= elapsed_s + 2


@pytest.mark.full
def test_a_joint_name_cannot_forge_a_line_of_the_log(sim_process, client):
    node = sim_process()
    client.state()
    publisher = client.publisher(JointState, 'arm/joint_command')
    for _ in range(5):
        publisher.publish(JointState(name=['x\n[ERROR] forged\x1b[2J'], position=[0.0]))
        client.state()
    publisher.publish(JointState(name=['a' * 10_000_000], position=[0.0]))
    for _ in range(5):
        client.state()
    node.terminate()
    _, errors = node.communicate(timeout=300.0)
    assert 'forged' in errors
    assert '\x1b' not in errors
    assert not any(line.startswith('[ERROR] forged') for line in errors.splitlines())
    assert max(len(line) for line in errors.splitlines()) < 1000
