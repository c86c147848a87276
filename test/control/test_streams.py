# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What is taken for the velocity of a stream of goals, message by message."""

import math
import os
import random
import subprocess
import sys

import numpy as np
import pytest

from manip_sim.control.law.records import blank_state, records
from manip_sim.control.law.streams import take_alone, TRUSTED, wait
from manip_sim.control.setpoints import SetpointGenerator

PERIOD_S, LIMIT = 0.01, np.array([10.0])
JOINT = np.array([0])


class Estimator:
    """What the messages of a stream of one coordinate, or of several, tell."""

    def __init__(self, count=1):
        self._state = blank_state(np.full(count, LIMIT[0]))
        self._all = np.arange(count)

    def take_one(self, goal, now_s, messages=1, stamp_s=0.0):
        joints = records(self._state)
        wait(joints, self._all, np.full(len(self._all), goal, dtype=float), PERIOD_S,
             float(messages), float(stamp_s), False)
        take_alone(joints, now_s)

    def __getattr__(self, name):
        return float(records(self._state)[name][0])

    @property
    def velocity(self):
        return self.rate_goal

    @property
    def on_time(self):
        return self.even > TRUSTED and self.memory < 0.5 * self.elapsed


def taken(*goals, interval_s=PERIOD_S):
    """Return an estimator that has seen goals at even intervals."""
    estimator = Estimator()
    for number, goal in enumerate(goals):
        estimator.take_one(goal, number * interval_s)
    return estimator


def test_a_first_goal_tells_no_velocity_wherever_it_is():
    assert taken(5.0).velocity == 0.0


def test_the_second_goal_of_a_stream_may_be_as_far_as_the_joint_can_accelerate():
    # In an interval of 0.01 s, 2 * 10 * 0.01 rad/s is as much as it may change.
    assert taken(0.0, 0.0019).velocity == pytest.approx(0.19)
    assert taken(0.0, 0.0021).velocity == 0.0


def test_a_stream_of_constant_velocity_has_that_velocity():
    goals = [0.0015 * n for n in range(12)]
    assert taken(*goals).velocity == pytest.approx(0.15)
    assert taken(*goals).jitter == pytest.approx(0.0, abs=1e-15)
    assert taken(*goals).interval == pytest.approx(PERIOD_S)


def test_a_message_that_was_lost_does_not_change_the_velocity():
    estimator = Estimator()
    for number in (*range(12), *range(14, 20)):
        estimator.take_one(0.0015 * number, number * PERIOD_S)
        assert estimator.velocity == pytest.approx(0.15 if number else 0.0)
    assert estimator.interval == pytest.approx(PERIOD_S)


def test_a_message_that_was_late_does_not_change_the_velocity():
    estimator = Estimator()
    for number in range(40):
        if number == 25:
            # It comes with the next one.
            continue
        estimator.take_one(0.0015 * number, number * PERIOD_S + (0.003 if number == 26 else 0.0),
                           messages=2 if number == 26 else 1)
        assert estimator.velocity == pytest.approx(0.15 if number else 0.0, rel=0.05)


@pytest.mark.parametrize('speed', [0.05, 1.0, 30.0])
def test_stamps_by_a_clock_of_any_speed_tell_the_velocity_in_simulation_time(speed):
    random, estimator = np.random.default_rng(4), Estimator()
    velocities = []
    for number in range(600):
        sent_s = number * PERIOD_S
        arrived_s = sent_s + random.uniform(0.0, 0.9 * PERIOD_S)
        estimator.take_one(0.15 * sent_s, arrived_s, stamp_s=1e5 + speed * sent_s)
        velocities.append(estimator.velocity)
    assert velocities[500:] == pytest.approx([0.15] * 100, rel=0.03)


@pytest.mark.parametrize('speed', [0.1, 0.5, 1.0, 2.0, 10.0])
def test_the_speed_of_a_clock_that_stamps_evenly_is_known_after_half_a_second(speed):
    estimator = Estimator()
    for number in range(100):
        sent_s = number * PERIOD_S
        estimator.take_one(0.15 * sent_s, sent_s, stamp_s=1e5 + speed * sent_s)
        if number > 50:
            assert estimator.velocity == pytest.approx(0.15, rel=0.02)


def test_stamps_tell_the_velocity_of_a_sender_that_is_not_even():
    estimator, sent_s = Estimator(), 0.0
    random = np.random.default_rng(5)
    for number in range(100):
        sent_s += random.uniform(0.5, 1.5) * PERIOD_S
        estimator.take_one(0.15 * sent_s, sent_s + 1e-3, stamp_s=1e5 + sent_s)
        if number > 1:
            assert estimator.velocity == pytest.approx(0.15, rel=1e-6)


def test_a_stream_has_its_velocity_where_up_to_eight_messages_in_a_row_have_no_stamps():
    random, estimator, velocities = np.random.default_rng(2), Estimator(), []
    for number in range(400):
        sent_s = number * PERIOD_S
        estimator.take_one(0.15 * sent_s, sent_s + random.uniform(0.0, 0.002),
                           stamp_s=1e5 + sent_s if number % 10 < 2 else 0.0)
        velocities.append(estimator.velocity)
    assert velocities[20:] == pytest.approx([0.15] * 380, rel=0.05)


def followed(sent_s, arrived_s, step_s=0.002, amplitude=0.2, omega=np.pi, steps=1, noise=None):
    """
    Return ratio, ripple and hardest acceleration of setpoints that follow a sine, to its.

    Messages are taken each so many steps; ``noise`` is added to their goals.
    """
    generator, taken, rows = SetpointGenerator(
        np.array([[-3.0, 3.0]]), np.array([2.2]), np.array([15.0])), 0, []
    for step in range(round(arrived_s[-1] / step_s)):
        generator.now_s = step * step_s
        while step % steps == 0 and arrived_s[taken] <= generator.now_s + 1e-9:
            goal = amplitude * min(sent_s[taken], 1.0) * np.sin(omega * sent_s[taken])
            goal += 0.0 if noise is None else noise[taken]
            generator.go_to(JOINT, np.array([goal]), step_s * steps)
            taken += 1
        generator.advance(step_s)
        rows.append((generator.now_s, generator.position[0], generator.velocity[0],
                     generator.acceleration[0]))
    time_s, position, velocity, acceleration = np.array(rows[round(3.0 / step_s):]).T
    waves = np.stack([np.sin(omega * time_s), np.cos(omega * time_s), np.ones(len(time_s))], 1)
    fit = np.linalg.lstsq(waves, np.stack([position, velocity], 1), rcond=None)[0]
    ripple = np.sqrt(np.mean((velocity - waves @ fit[:, 1])**2)) / (amplitude * omega)
    return (np.hypot(*fit[:2, 0]) / amplitude, ripple,
            np.abs(acceleration).max() / (amplitude * omega**2))


@pytest.mark.full
@pytest.mark.parametrize(('rate', 'ripple_bound', 'seed'), [
    (10, 0.06, 0), (50, 0.02, 1), (50, 0.02, 0), (100, 0.02, 1)])
def test_goals_of_the_moment_of_a_timer_that_jitters_are_followed(rate, ripple_bound, seed):
    random, number = np.random.default_rng(seed), np.arange(9 * rate)
    sent_s = np.sort(np.abs(number + random.normal(0.0, 0.2, len(number)))) / rate
    sent_s = np.ceil(sent_s / 0.002 - 1e-6) * 0.002
    ratio, ripple, hardest = followed(sent_s, sent_s)
    assert ratio == pytest.approx(1.0, abs=0.03)
    assert ripple < ripple_bound
    assert hardest < 2.5


@pytest.mark.full
@pytest.mark.parametrize(('rate', 'timer', 'way_s', 'hardest_bound', 'seed'), [
    (50, 0.1, 0.002, 2.4, 0), (50, 0.1, 0.002, 2.4, 1), (100, 0.1, 0.001, 2.4, 0),
    (100, 0.2, 0.002, 3.0, 1)])
def test_goals_that_jitter_in_time_and_on_their_way_are_averaged(
        rate, timer, way_s, hardest_bound, seed):
    random, number = np.random.default_rng(seed), np.arange(9 * rate)
    sent_s = np.sort(np.abs(number + random.normal(0.0, timer, len(number)))) / rate
    arrived_s = np.maximum.accumulate(sent_s + np.abs(random.normal(0.0, way_s, len(sent_s))))
    ratio, ripple, hardest = followed(sent_s, arrived_s)
    assert ratio == pytest.approx(1.0, abs=0.03)
    assert ripple < 0.05
    assert hardest < hardest_bound


@pytest.mark.full
@pytest.mark.parametrize(('rate', 'timer', 'way_s', 'seed'), [
    (100, 0.1, 0.002, 0), (100, 0.1, 0.002, 1), (100, 0.2, 0.0, 0), (250, 0.2, 0.001, 1)])
def test_goals_that_jitter_are_averaged_though_control_periods_hide_when_they_came(
        rate, timer, way_s, seed):
    random, number = np.random.default_rng(seed), np.arange(6 * rate)
    sent_s = np.sort(number + 0.37 + random.normal(0.0, timer, len(number))) / rate
    arrived_s = sent_s + np.abs(random.normal(0.0, way_s, len(sent_s)))
    # One that comes with the next is the first that shows it.
    arrived_s[rate] += 0.9 / rate
    arrived_s = np.maximum.accumulate(arrived_s)
    ratio, ripple, hardest = followed(np.abs(sent_s), arrived_s, steps=round(500 / rate))
    assert ratio == pytest.approx(1.0, abs=0.04)
    assert ripple < 0.05
    assert hardest < 3.5


def test_a_stream_is_on_schedule_again_once_its_goals_are_smooth():
    random, estimator = np.random.default_rng(0), Estimator()
    on_time = []
    for number in range(900):
        jitters = 200 <= number < 400
        if number != 250:
            # That one comes with the next.
            sent_s = (number + jitters * random.normal(0.0, 0.1)) * PERIOD_S
            estimator.take_one(0.2 * math.sin(math.pi * sent_s), number * PERIOD_S,
                               messages=2 if number == 251 else 1)
            on_time.append(estimator.on_time)
    assert all(on_time[20:200])
    assert not any(on_time[210:399])
    assert all(on_time[-100:])


@pytest.mark.full
@pytest.mark.parametrize('rate', [10, 50, 100])
def test_goals_of_an_even_timer_that_jitter_on_their_way_are_followed(rate):
    random, sent_s = np.random.default_rng(0), np.arange(9 * rate) / rate
    late_s = np.abs(random.normal(0.0, 0.2 if rate > 10 else 0.1, len(sent_s))) / rate
    ratio, ripple, hardest = followed(sent_s, np.maximum.accumulate(sent_s + late_s))
    assert ratio == pytest.approx(1.0, abs=0.02)
    assert ripple < 0.02
    assert hardest < 1.5


@pytest.mark.full
@pytest.mark.parametrize('seed', range(3))
def test_few_messages_of_a_timer_that_jitters_are_taken_for_lost(seed):
    random, estimator, count = np.random.default_rng(seed), Estimator(), 800
    sent_s = np.sort(np.arange(1, count + 1) + random.normal(0.0, 0.2, count)) * PERIOD_S
    for time_s in np.ceil(sent_s / 0.002) * 0.002:
        estimator.take_one(0.2 * np.sin(np.pi * time_s), time_s)
    assert 0 <= estimator.lost <= 0.005 * count


@pytest.mark.parametrize('seed', range(3))
def test_messages_that_were_lost_are_counted(seed):
    random, estimator = np.random.default_rng(seed), Estimator()
    kept = random.random(800) > 0.03
    kept[:20] = kept[-1] = True
    for number in np.flatnonzero(kept):
        estimator.take_one(0.2 * np.sin(np.pi * number * PERIOD_S), number * PERIOD_S)
    assert estimator.lost == np.count_nonzero(~kept)


@pytest.mark.parametrize(('rate', 'steps', 'size'), [
    (100, 5, 1e-3), (100, 1, 1e-3), (500, 1, 1e-4), (500, 1, 1e-3), (50, 1, 1e-3)])
def test_goals_with_noise_take_at_most_four_times_their_acceleration(rate, steps, size):
    sent_s = (np.arange(6 * rate) + 0.37) / rate
    noise = np.random.default_rng(3).normal(0.0, size, len(sent_s))
    ratio, ripple, hardest = followed(sent_s, sent_s, steps=steps, noise=noise)
    assert ratio == pytest.approx(1.0, abs=0.03)
    assert ripple < 0.04
    assert hardest < 4.0


@pytest.mark.parametrize('rate', [100, 250, 500])
@pytest.mark.parametrize('later', [0.3, 0.45])
def test_messages_that_come_twice_are_followed_as_if_they_came_once(rate, later):
    sent_s = np.repeat((np.arange(6 * rate) + 0.37) / rate, 2)
    arrived_s = sent_s.copy()
    arrived_s[1::2] += later / rate
    ratio, ripple, hardest = followed(sent_s, arrived_s)
    assert ratio == pytest.approx(1.0, abs=0.005)
    assert ripple < 0.01
    assert hardest < 1.2


def streamed(arrived_s, goals, step_s=0.002, seconds=6.0):
    """Return times, positions, accelerations, and how many messages seem to have been lost."""
    generator, taken, rows = SetpointGenerator(
        np.array([[-3.0, 3.0]]), np.array([2.2]), np.array([15.0])), 0, []
    for step in range(round(seconds / step_s)):
        generator.now_s = step * step_s
        while taken < len(goals) and arrived_s[taken] <= generator.now_s + 1e-9:
            generator.go_to(JOINT, goals[taken:taken + 1], step_s)
            taken += 1
        generator.advance(step_s)
        rows.append((generator.now_s, generator.position[0], generator.acceleration[0]))
    return (*np.array(rows).T, int(generator.counts[1, 0]))


def test_messages_that_come_fast_after_a_stall_are_late_and_not_lost():
    sent_s = (np.arange(3000) + 0.37) / 500.0
    arrived_s, stalled = sent_s.copy(), (sent_s > 3.6) & (sent_s < 3.66)
    arrived_s[stalled] = 3.66 + 0.001 * np.arange(np.count_nonzero(stalled))
    time_s, position, acceleration, lost = streamed(
        np.maximum.accumulate(arrived_s), 0.2 * np.sin(np.pi * sent_s))
    begun = time_s > 1.0
    off = position - 0.2 * np.sin(np.pi * (time_s - 0.003))
    assert np.abs(off[begun]).max() < 0.05
    assert np.abs(off[time_s > 5.0]).max() < 2e-3
    assert np.abs(acceleration[begun]).max() <= 15.0 * (1.0 + 1e-9)
    assert lost < 50


@pytest.mark.parametrize(('before', 'after'), [(200, 50), (100, 50), (50, 200), (100, 110)])
def test_messages_of_a_sender_that_changes_its_rate_are_not_lost(before, after):
    sent_s = np.concatenate([np.arange(0.37 / before, 3.0, 1.0 / before),
                             np.arange(3.0 + 0.37 / after, 6.0, 1.0 / after)])
    *_, lost = streamed(sent_s, 0.2 * np.sin(np.pi * sent_s))
    assert lost < 12


def test_messages_that_are_not_sent_in_a_pause_are_not_lost():
    sent_s = (np.arange(1500) + 0.37) / 250.0
    sent_s = sent_s[(sent_s < 3.3) | (sent_s > 3.8)]
    *_, lost = streamed(sent_s, 0.2 * np.sin(np.pi * sent_s))
    assert lost == 0


@pytest.mark.parametrize('jump', [0.005, 0.02, 0.05, -0.02])
@pytest.mark.parametrize('rate', [100, 250])
def test_a_stream_that_jumps_and_speeds_up_at_once_keeps_the_limit(jump, rate):
    number = np.arange(4 * rate)
    goals = np.where(number < 2 * rate, 0.2 * number, 0.4 * rate + 1.0 * (number - 2 * rate))
    goals = goals / rate + jump * (number >= 2 * rate)
    time_s, _, acceleration, _ = streamed(number / rate, goals, seconds=3.5)
    assert np.abs(acceleration[time_s > 1.0]).max() <= 15.0 * (1.0 + 1e-9)


_DIGEST = """
import hashlib
import numpy as np
from manip_sim.control.setpoints import SetpointGenerator
random, digest = np.random.default_rng(0), hashlib.sha256()
setpoints = SetpointGenerator(np.tile([-0.5, 0.5], (3, 1)), np.full(3, 2.0), np.full(3, 15.0))
for period in range(150):
    if random.random() < 0.8:
        goals = 0.6 * np.sin(period * np.array([0.02, 0.03, 0.05])) + random.normal(0.0, 1e-3, 3)
        setpoints.go_to(np.arange(3), goals, 0.01, 1,
                        1.0 + 0.01 * period if period > 110 else 0.0,
                        are_velocities=60 < period < 90)
    for duration_s in (0.004, 0.004, 0.002):
        setpoints.advance(duration_s)
    digest.update(setpoints._state.tobytes())
print(digest.hexdigest())
"""


@pytest.mark.full
def test_compiled_laws_give_the_same_bits_as_plain_python():
    digests = {subprocess.run(
        [sys.executable, '-W', 'ignore', '-c', _DIGEST], check=True, capture_output=True,
        text=True, env={**os.environ, **more}).stdout for more in (
            {}, {'NUMBA_DISABLE_JIT': '1'})}
    assert len(digests) == 1


@pytest.mark.full
@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('are_velocities', [False, True])
def test_joints_follow_alike_whichever_of_them_share_a_message(are_velocities, seed):
    # Some joints start later, pause, and come twice; the oracle has each of them alone.
    random, count = np.random.default_rng(seed), 5
    limits = np.array([[-3.0, 3.0]]), np.array([2.2]), np.array([15.0])
    together = SetpointGenerator(*(np.repeat(limit, count, axis=0) for limit in limits))
    alone = [SetpointGenerator(*limits) for _ in range(count)]
    together.set_stream(np.array([1, 3]), longest_s=0.5, hold_s=0.03)
    for joint in (1, 3):
        alone[joint].set_stream(JOINT, longest_s=0.5, hold_s=0.03)
    begin, pause = random.integers(0, 30, (2, count))

    def go_to(setpoints, joints, goals):
        setpoints.go_to(joints, goals, PERIOD_S, are_velocities=are_velocities)
    for period in range(90):
        awake = (period >= begin) & ((period < 30 + pause) | (period >= 45 + pause // 4))
        goals = 0.1 * np.sin(0.1 * period * (1 + np.arange(count)))
        joints = random.permutation(np.flatnonzero(awake))
        for message in np.split(joints, np.sort(random.integers(0, count, 2))):
            go_to(together, message, goals[message])
        if random.random() < 0.2 and joints.size:
            go_to(together, joints[:1], goals[joints[:1]])
            go_to(alone[joints[0]], JOINT, goals[joints[:1]])
        for joint, generator in enumerate(alone):
            if awake[joint]:
                go_to(generator, JOINT, goals[[joint]])
        for generator in (together, *alone):
            for _ in range(2):
                generator.advance(PERIOD_S / 2)
        np.testing.assert_allclose(
            together.position, np.concatenate([one.position for one in alone]), atol=1e-12)


@pytest.mark.parametrize('seed', range(40))
@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_any_finite_goals_times_and_stamps_are_taken(seed):
    rng, estimator, now_s, stamp_s = random.Random(seed), Estimator(2), 0.0, 0.0
    numbers = (0.0, 1.0, -1.0, 5e-324, 1e150, -1e200, 1e308, -1e308, 0.1)
    for _ in range(60):
        now_s += PERIOD_S * rng.choice((1, 1, 1, 2, 3, 5, 9, 30))
        # What a message can hold: a nanosecond to 68 years.
        stamp_s = rng.choice((0.0, now_s, stamp_s + 0.01, stamp_s + 1e-9, 1e-9, 2147483647.0))
        estimator.take_one(rng.choice(numbers), now_s, rng.choice((1, 1, 1, 2, 50)), stamp_s)
    assert abs(estimator.lost) < 2**40
