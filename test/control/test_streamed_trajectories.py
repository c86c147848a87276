# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Trajectories of one or two points that come regularly, as from servoing tools, are a stream."""

import numpy as np
import pytest

from manip_sim.control.commands import Status
from sampling import whole_robot

PERIOD_S, STEPS = 0.002, 1
#: Amplitude [rad] and frequency [rad/s] of what is sent.
SIZE, RATE = 0.2, np.pi


class Sender:
    """Sends points of a sine for the first joint of a Panda."""

    def __init__(self, name='Panda'):
        self.simulation = whole_robot(name)
        self.robot = self.simulation.robot
        self.joint = self.robot.parts['arm'].driven_joints[0]
        self.begin = self.place
        self.speeds, self.efforts, self.places, self.handles = [], [], [], []

    @property
    def place(self):
        return float(self.simulation.data.joint(self.joint).qpos[0])

    def send(self, sent_s, due_s, velocities, stamped=False):
        times, size = sent_s + np.array(due_s), SIZE * min(1.0, sent_s)
        goals = self.begin + size * np.sin(RATE * times)
        command = self.robot.parse.trajectory(
            'arm', [self.joint], due_s, goals[:, None],
            size * RATE * np.cos(RATE * times)[:, None] if velocities else None, None,
            round(sent_s * 1e9) if stamped else 0, self.simulation.time_ns)
        self.robot.apply(command, period_s=PERIOD_S)
        self.handles.append(command.handle)
        return goals[-1]

    def run(self, seconds):
        data = self.simulation.data.joint(self.joint)
        for _ in range(round(seconds / PERIOD_S)):
            self.simulation.advance(STEPS)
            self.speeds.append(float(data.qvel[0]))
            self.efforts.append(float(data.qfrc_actuator[0]))
            self.places.append(float(data.qpos[0]))

    @property
    def hardest(self):
        """Highest acceleration after the beginning [rad/s^2]."""
        return np.abs(np.diff(self.speeds[700:])).max() / PERIOD_S

    def stream(self, rate, due_s, velocities, delays=(0.0,), lost=(), stamped=False, lasts_s=4.0):
        """Send points at a rate, which arrive with delays one after the other; some are lost."""
        sent = np.arange(round(lasts_s * rate)) / rate + 0.37 / rate
        arrivals = np.maximum.accumulate(sent + np.resize(delays, len(sent)))
        number, last = 0, None
        for period in range(round(lasts_s / PERIOD_S)):
            while number < len(sent) and arrivals[number] <= period * PERIOD_S:
                if number not in lost:
                    last = self.send(float(sent[number]), due_s, velocities, stamped)
                number += 1
            self.run(PERIOD_S)
        return last


def jitter(sd_s, count=997):
    return np.abs(np.random.default_rng(0).normal(0.0, sd_s, count))


@pytest.mark.full
@pytest.mark.parametrize(('rate', 'due', 'velocities', 'stamped'), [
    (100, [1.0], False, False), (100, [1.0], True, True), (100, [2.0], False, True),
    (100, [2.0], True, False), (50, [1.0], False, False), (50, [1.0], True, True),
    (30, [1.0], False, True), (30, [1.0], True, False), (50, [0.0, 1.0], False, False),
    (50, [0.0, 1.0], True, True), (100, [1.0, 2.0], False, True),
    (100, [1.0, 2.0], True, False)])
def test_points_that_are_due_soon_need_hardly_more_than_the_motion_itself(
        rate, due, velocities, stamped):
    ideal = SIZE * RATE**2
    for delays in ((0.0,), jitter(0.002)):
        sender = Sender()
        sender.stream(rate, np.array(due) / rate, velocities, delays, stamped=stamped,
                      lasts_s=2.2)
        assert ideal < sender.hardest * 1.01
        assert sender.hardest < (1.1 if len(delays) == 1 else 1.5) * ideal
        assert np.abs(sender.efforts[700:]).max() < 4.5


@pytest.mark.full
def test_points_that_are_due_at_once_are_a_stream_too():
    sender = Sender()
    sender.stream(100, [0.0], False, jitter(0.002), lasts_s=2.6)
    assert sender.hardest < 1.5 * SIZE * RATE**2


@pytest.mark.full
def test_lost_points_are_bridged_within_the_acceleration_limit():
    sender = Sender()
    sender.stream(100, [0.01], True, lost=set(range(150, 400, 31)))
    limit = sender.robot.joints.servos.acceleration_limit[0]
    assert sender.hardest < 1.05 * limit
    wanted = SIZE * np.sin(RATE * (np.arange(700, 2000) * PERIOD_S))
    assert np.abs(np.array(sender.places[700:]) - sender.begin - wanted).max() < 0.02


@pytest.mark.full
def test_a_stream_that_stops_ends_at_its_last_point_and_its_commands_are_done():
    sender = Sender()
    last = sender.stream(100, [0.02], True)
    sender.run(1.0)
    assert sender.place == pytest.approx(last, abs=1e-4)
    assert [handle.status for handle in sender.handles[-2:]] == [Status.REPLACED, Status.DONE]
    limit = sender.robot.joints.servos.acceleration_limit[0]
    assert np.abs(np.diff(sender.speeds[-500:])).max() / PERIOD_S < 1.2 * limit


@pytest.mark.full
def test_points_that_are_due_later_are_motions_that_end_in_time():
    sender = Sender()
    sender.stream(20, [0.3], True)
    wanted = SIZE * np.sin(RATE * (np.arange(700, 2000) + 1) * PERIOD_S)
    assert np.abs(np.array(sender.places[700:]) - sender.begin - wanted).max() < 4e-3


@pytest.mark.full
def test_a_single_point_after_a_pause_is_a_motion():
    sender = Sender()
    sender.stream(100, [0.02], False, lasts_s=1.0)
    sender.run(0.5)
    command = sender.robot.parse.trajectory('arm', [sender.joint], [0.4], [[sender.place + 0.1]])
    before = sender.place
    sender.robot.apply(command, period_s=PERIOD_S)
    sender.run(0.2)
    assert sender.place == pytest.approx(before + 0.05, abs=1e-3)
    sender.run(0.2)
    assert command.handle.status is Status.DONE
    assert sender.place == pytest.approx(before + 0.1, abs=1e-3)


@pytest.mark.full
@pytest.mark.parametrize(('name', 'gap_s'), [
    ('Panda', 0.15), ('Sawyer', 0.5), ('Panda', 0.9)])
def test_a_point_after_a_gap_of_a_stream_is_approached_within_the_limits(name, gap_s):
    sender = Sender(name)
    gap = range(150, 150 + round(gap_s * 100))
    sender.stream(100, [0.01], False, lost=set(gap), lasts_s=3.0)
    assert sender.hardest < 1.3 * sender.robot.joints.servos.acceleration_limit[0]
    wanted = SIZE * np.sin(RATE * np.arange(1450, 1500) * PERIOD_S)
    np.testing.assert_allclose(np.array(sender.places[1450:]) - sender.begin, wanted, atol=0.01)


@pytest.mark.full
def test_a_motion_right_after_a_stream_takes_its_time():
    sender = Sender()
    last = sender.stream(100, [0.02], False, lasts_s=1.3)
    command = sender.robot.parse.trajectory('arm', [sender.joint], [2.0], [[last + 0.4]])
    sender.robot.apply(command, period_s=PERIOD_S)
    sender.run(1.9)
    assert command.handle.status is Status.RUNNING
    sender.run(0.11)
    assert command.handle.status is Status.DONE
    assert sender.place == pytest.approx(last + 0.4, abs=1e-3)
