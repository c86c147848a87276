# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of setpoints against closed forms and limits, at every instant, without any physics."""

import numba
import numpy as np
import pytest

from manip_sim.control.law import setpoint_motion
from manip_sim.control.law.loads import no_loads
from manip_sim.control.law.records import readable, SERVO
from manip_sim.control.law.servo_rates import drive
from manip_sim.control.law.setpoint_motion import braking_velocity, follow
from manip_sim.control.setpoints import SetpointGenerator
from manip_sim.physics.physics import Kinematics, WorldArrays

V, A = 2.0, 8.0
ONE = np.array([0])
#: Each period of 10 ms in the intervals that the simulation uses.
PERIOD_S, INTERVALS_S = 0.01, (0.004, 0.004, 0.002)


def generator(count=1, velocity=V, acceleration=A, low=-50.0, high=50.0):
    return SetpointGenerator(np.tile([low, high], (count, 1)).astype(float),
                             np.full(count, velocity), np.full(count, acceleration))


@numba.njit
def lead(joints, indices, motion):
    """Let joints be led as in compiled periods."""
    follow(joints, indices, motion)


def led(setpoints, motion):
    """Set the first joint by a position, a velocity and an acceleration, as a trajectory does."""
    lead(setpoints.joints, ONE, np.array([motion]))
    setpoints.moving = True


class Course:
    """What a generator of one joint did: time, position, velocity, acceleration, in arrays."""

    def __init__(self, setpoints):
        self._setpoints = setpoints
        self._rows = [self._now()]

    def _now(self):
        s = self._setpoints
        return s.now_s, s.position[0], s.velocity[0], s.acceleration[0]

    def advance(self, *intervals_s):
        for interval_s in intervals_s:
            self._setpoints.advance(interval_s)
            self._rows.append(self._now())
        return self

    def __getattr__(self, name):
        names = ('time', 'position', 'velocity', 'acceleration')
        if name not in names:
            raise AttributeError(name)
        return np.array([row[names.index(name)] for row in self._rows])


def streamed(goal_at, seconds, rate=100, setpoints=None):
    """Return the course of goals that come at a rate, None for no message."""
    setpoints = setpoints or generator()
    course, period_s = Course(setpoints), 1.0 / rate
    for k in range(round(seconds * rate)):
        goal = goal_at(k * period_s)
        if goal is not None:
            setpoints.go_to(ONE, np.array([goal]), period_s)
        pieces = -(-round(period_s * 1000) // 4)
        course.advance(*[period_s / pieces] * pieces)
    return course


def time_optimal_s(distance):
    """Return how long a way takes that begins and ends at rest within the limits."""
    ramp = V * V / A
    return distance / V + V / A if distance > ramp else 2.0 * np.sqrt(distance / A)


@pytest.mark.parametrize('distance', [0.01, 0.1, 0.4, 1.0, 5.0])
def test_step_takes_little_longer_than_the_shortest_time(distance):
    course = streamed(lambda t: distance if t == 0.0 else None, time_optimal_s(distance) + 1.0)
    arrival = course.time[np.argmax(course.position > distance * 0.999)]
    # Behind come two low-pass stages of 20 ms.
    assert time_optimal_s(distance) * 0.9 < arrival < time_optimal_s(distance) + 0.2
    assert course.position[-1] == distance
    assert (course.velocity[-1], course.acceleration[-1]) == (0.0, 0.0)
    assert not course._setpoints.moving


@pytest.mark.parametrize('distance', [-3.0, -0.1, 0.02, 1.0])
def test_step_never_goes_past_the_goal_and_never_back(distance):
    course = streamed(lambda t: distance if t == 0.0 else None, 3.0)
    way = course.position * np.sign(distance)
    assert way.max() <= abs(distance)
    assert np.diff(way).min() >= -1e-12


def test_limits_hold_at_every_instant_for_random_goals_and_intervals():
    random = np.random.default_rng(5)
    for _ in range(15):
        setpoints = generator()
        course = Course(setpoints)
        for _ in range(6):
            # The goal of a step, a velocity or a stop; the last one may be on its way still.
            kind, value = random.choice(['go', 'speed', 'hold']), random.uniform(-1.0, 1.0)
            if kind == 'go':
                setpoints.go_to(ONE, np.array([3.0 * value]), 0.02)
            else:
                setpoints.set_velocity(ONE, np.array([V * value if kind == 'speed' else 0.0]))
            course.advance(*random.uniform(0.001, 0.02, random.integers(12, 60)))
        steps = np.diff(course.time)
        assert np.abs(course.velocity).max() <= 1.01 * V
        assert np.abs(course.acceleration).max() <= 1.05 * A
        assert (np.abs(np.diff(course.position)) <= 1.01 * V * steps + 1e-12).all()
        assert (np.abs(np.diff(course.velocity)) <= 1.1 * A * steps + 1e-12).all()


@pytest.mark.full
def test_goals_are_not_passed_whatever_the_intervals_are():
    random = np.random.default_rng(6)
    for _ in range(15):
        setpoints, goal = generator(), random.uniform(-2.0, 2.0)
        setpoints.go_to(ONE, np.array([goal]), 0.01)
        course = Course(setpoints)
        while setpoints.now_s < 4.0:
            course.advance(random.choice([0.001, 0.002, 0.004, 0.02, random.uniform(1e-3, 0.02)]))
        assert ((course.position - goal) * np.sign(goal)).max() <= 1e-4 * abs(goal)
        assert course.position[-1] == goal


@pytest.mark.full
def test_velocity_and_acceleration_are_the_rates_of_the_position():
    setpoints = generator()
    setpoints.go_to(ONE, np.array([0.5]), PERIOD_S)
    course = Course(setpoints).advance(*[1e-4] * 9000)
    middle = (course.velocity[1:] + course.velocity[:-1]) / 2.0
    np.testing.assert_allclose(np.diff(course.position) / 1e-4, middle, atol=1e-3)
    np.testing.assert_allclose(np.diff(course.velocity) / 1e-4, course.acceleration[1:], atol=0.1)


def test_path_hardly_depends_on_how_finely_it_is_cut():
    ends = []
    for pieces in (1, 4, 20):
        setpoints = generator()
        setpoints.go_to(ONE, np.array([1.0]), 0.02)
        ends.append(Course(setpoints).advance(*[0.02 / pieces] * (20 * pieces)).position[-1])
    np.testing.assert_allclose(ends, ends[-1], atol=0.02)


@pytest.mark.parametrize('rate', [10, 20, 50, 100, 500])
def test_stream_of_constant_speed_passes_with_one_and_a_half_intervals_of_delay(rate):
    course = streamed(lambda t: 0.5 * t, 2.0, rate)
    late = course.time > 1.5
    np.testing.assert_allclose(course.velocity[late], 0.5, rtol=1e-9)
    delay_s = course.time[late] - course.position[late] / 0.5
    np.testing.assert_allclose(delay_s, 1.5 / rate, rtol=1e-6)
    np.testing.assert_allclose(course.acceleration[late], 0.0, atol=1e-6)


def test_goals_that_come_five_times_a_second_are_steps():
    course = streamed(lambda t: 0.1 * t, 3.0, rate=5)
    for k in range(2, 14):
        step = course.velocity[(course.time > 0.2 * k) & (course.time <= 0.2 * (k + 1) + 1e-9)]
        assert step.max() > 0.15
        assert abs(step[-1]) < 0.02


@pytest.mark.full
@pytest.mark.parametrize('phase', [0.0, 0.25, 0.5])
@pytest.mark.parametrize('frequency_hz', [0.5, 1.0, 2.0])
def test_streamed_sine_passes_in_full_with_one_and_a_half_intervals_of_delay(frequency_hz, phase):
    # Where it turns back it accelerates harder than a step may, and two goals may be equal.
    turn, shift_s = 2.0 * np.pi * frequency_hz, 0.01 * phase
    slow = generator(acceleration=0.4 * 0.1 * turn**2)
    course = streamed(lambda t: 0.1 * np.sin(turn * (t + shift_s)) * min(1.0, t * frequency_hz),
                      8.0, setpoints=slow)
    late = course.time > 8.0 - 2.0 / frequency_hz
    time, position = course.time[late], course.position[late]
    basis = np.stack([np.sin(turn * time), np.cos(turn * time), np.ones_like(time)], axis=1)
    (sine, cosine, middle), *_ = np.linalg.lstsq(basis, position, rcond=None)
    assert np.hypot(sine, cosine) == pytest.approx(0.1, rel=5e-3)
    assert -np.arctan2(cosine, sine) / turn + shift_s == pytest.approx(0.015, abs=2e-4)
    np.testing.assert_allclose(position, basis @ [sine, cosine, middle], atol=1e-4)


def test_stream_that_stops_lands_on_its_last_goal_without_going_past():
    course = streamed(lambda t: 0.5 * min(t, 1.0), 2.5)
    assert course.position.max() <= 0.5 + 1e-9
    assert course.position[-1] == pytest.approx(0.5, abs=1e-9)
    arrival = course.time[np.argmax(course.position > 0.5 - 1e-4)]
    assert arrival < 1.1


@pytest.mark.parametrize(('hold_s', 'goes_on_s'), [(0.0, 0.02), (0.1, 0.1), (0.004, 0.004)])
def test_stream_that_falls_silent_goes_on_brakes_and_comes_back(hold_s, goes_on_s):
    setpoints = generator()
    setpoints.set_stream(ONE, hold_s=hold_s)
    course = streamed(lambda t: 0.5 * t if t <= 1.0 else None, 2.5, setpoints=setpoints)
    # The next message was due 10 ms after the last one.
    holds = (course.time > 0.5) & (course.time < 1.01 + goes_on_s)
    np.testing.assert_allclose(course.velocity[holds], 0.5, rtol=1e-6)
    assert course.velocity[np.argmax(course.time > 1.01 + goes_on_s + 0.0101)] < 0.47
    assert np.abs(course.acceleration[course.time > 0.5]).max() <= A * (1.0 + 1e-9)
    furthest = 0.5 + 0.5 * (goes_on_s - 0.005) + 0.5**2 / (2.0 * A)
    assert furthest - 1e-3 < course.position.max() < furthest + 0.5 * 0.004
    assert course.position[-1] == 0.5
    assert not setpoints.moving


@pytest.mark.full
@pytest.mark.parametrize('commands', ['positions', 'velocities'])
def test_a_joint_keeps_its_limit_after_a_fast_stream_though_others_move(commands):
    setpoints = generator(2, low=-1.0, high=1.0)
    one, other = Course(setpoints), np.array([1])
    for k in range(500):
        now_s = k * PERIOD_S
        setpoints.go_to(other, np.array([0.1 * np.sin(now_s)]), PERIOD_S)
        if commands == 'positions' and (now_s < 1.0 or now_s > 2.0 and k % 3):
            # The first stream has 40 rad/s^2 of its own; of the second each third goal is missing.
            goal = 0.01 * np.sin(63.0 * now_s) if now_s < 1.0 else 0.5 * (k % 100 > 50)
            setpoints.go_to(ONE, np.array([goal]), PERIOD_S)
        elif commands == 'velocities' and (now_s < 1.0 or k == 250):
            # At last it brakes before the end of its range.
            velocity = 0.6 * np.sin(63.0 * now_s) if now_s < 1.0 else 1.5
            setpoints.go_to(ONE, np.array([velocity]), PERIOD_S, are_velocities=True)
        one.advance(*INTERVALS_S)
    assert np.abs(one.acceleration[one.time < 1.0]).max() > 3.0 * A
    assert np.abs(one.acceleration[one.time > 2.0]).max() <= A * (1.0 + 1e-9)


@pytest.mark.full
@pytest.mark.parametrize('rate', [50, 100, 500])
def test_stream_beyond_the_end_of_the_range_brakes_and_leaves_within_the_limit(rate):
    # At the end, where it is cut off, its velocity of 1.9 rad/s stops from goal to goal.
    course = streamed(lambda t: min(1.9 * np.sin(t), 1.0), 3.0, rate, generator(high=1.0))
    begun = course.time > 0.4
    assert np.abs(course.acceleration[begun]).max() <= A * (1.0 + 1e-9)
    assert course.position.max() == pytest.approx(1.0, abs=1e-6)
    way = np.diff(course.position[(course.time > 0.4) & (course.time < 1.5)])
    assert way.min() > -1e-4


@pytest.mark.full
@pytest.mark.parametrize('stamped', [False, True])
@pytest.mark.parametrize('pause_s', [0.5, 4.0])
def test_a_pause_in_which_the_sender_goes_on_is_only_a_step_of_the_goals(pause_s, stamped):
    setpoints, messages = generator(), 0
    course = Course(setpoints)
    for k in range(600):
        messages += 1 if k != 300 else 1 + round(pause_s / PERIOD_S)
        sent_s = messages * PERIOD_S
        setpoints.go_to(ONE, np.array([0.2 * np.sin(np.pi * sent_s)]), PERIOD_S,
                        1 if k != 300 else 1 + round(pause_s / PERIOD_S),
                        1e5 + sent_s if stamped else 0.0)
        course.advance(*INTERVALS_S)
    goes_on = course.time > 3.5
    sent_s = course.time + pause_s + PERIOD_S - 1.5 * PERIOD_S
    np.testing.assert_allclose(
        course.position[goes_on], 0.2 * np.sin(np.pi * sent_s[goes_on]), atol=2e-3)
    assert np.abs(course.acceleration[course.time > 1.0]).max() <= A * (1.0 + 1e-9)


def test_jump_inside_a_stream_is_a_step_and_not_a_velocity():
    course = streamed(lambda t: 0.5 * t + (1.0 if t >= 0.995 else 0.0), 3.0)
    assert np.abs(course.velocity).max() <= 1.01 * V
    after = course.time > 1.0
    np.testing.assert_allclose(course.position[-100:], 1.0 + 0.5 * (course.time[-100:] - 0.015),
                               atol=1e-6)
    # Once up to the velocity limit and once down again; what the stream does is in it.
    assert np.abs(course.acceleration[after]).max() < 4.0 * A


@pytest.mark.parametrize('rate', [100, 500])
def test_stream_that_begins_at_full_speed_is_taken_up_within_bounds(rate):
    course = streamed(lambda t: 1.5 * t, 1.0, rate)
    assert np.abs(course.acceleration).max() < 5.5 * A
    assert course.velocity.max() < 1.01 * V
    assert course.velocity[-1] == pytest.approx(1.5)


def test_repeated_goal_of_a_step_changes_nothing():
    once = streamed(lambda t: 1.0 if t == 0.0 else None, 1.5)
    again = streamed(lambda t: 1.0, 1.5)
    np.testing.assert_allclose(again.position, once.position, atol=1e-9)


def test_of_two_goals_at_one_instant_the_newer_counts():
    setpoints = generator()
    course = Course(setpoints)
    for k in range(100):
        for goal in (-1.0, 0.5 * k * PERIOD_S):
            setpoints.go_to(ONE, np.array([goal]), PERIOD_S)
        course.advance(*INTERVALS_S)
    course.advance(*INTERVALS_S * 100)
    assert course.position[-1] == pytest.approx(0.495, abs=1e-9)
    assert course.position.min() > -0.3


def delivered(kind, random, count):
    """Return when the messages of a regular sender arrive, in order, and when they were sent."""
    if kind == 'late':
        sent = np.arange(count) * PERIOD_S
        return np.maximum.accumulate(sent + random.uniform(0.0, 1.5 * PERIOD_S, count)), sent
    sent = np.arange(count) * PERIOD_S / float(kind)
    return sent, sent


def jittered(kind, goal_at, seconds, seed, until_s=np.inf):
    """Return the course of a stream of which 0, 1 or 2 messages come in each period."""
    arrival, sent = delivered(kind, np.random.default_rng(seed), round(seconds * 150))
    setpoints = generator()
    course, next_one = Course(setpoints), 0
    for k in range(round(seconds / PERIOD_S)):
        newest, messages = None, 0
        while arrival[next_one] <= k * PERIOD_S + 1e-9:
            if sent[next_one] <= until_s:
                newest, messages = sent[next_one], messages + 1
            next_one += 1
        if newest is not None:
            setpoints.go_to(ONE, np.array([goal_at(newest)]), PERIOD_S, messages)
        course.advance(*INTERVALS_S)
    return course


@pytest.mark.full
@pytest.mark.parametrize('kind', ['late', '0.9', '0.93', '0.97', '1.03', '1.1'])
def test_stream_whose_messages_jitter_keeps_its_velocity_within_thirty_percent(kind):
    for seed in range(2):
        course = jittered(kind, lambda t: 0.5 * t, 8.0, seed)
        late = course.time > 2.0
        assert np.abs(course.velocity[late] / 0.5 - 1.0).max() < 0.3
        assert course.velocity[late].mean() == pytest.approx(0.5, rel=0.01)
        delay_s = course.time[late] - course.position[late] / 0.5
        assert delay_s.min() > 0.0 and delay_s.max() < 0.06


@pytest.mark.full
@pytest.mark.parametrize('kind', ['late', '0.9', '1.1'])
def test_stream_whose_messages_jitter_lands_on_its_last_goal(kind):
    for seed in range(2):
        course = jittered(kind, lambda t: 0.5 * t, 4.0, seed, until_s=2.0)
        last = course.position[-1]
        assert 1.0 - 0.5 * PERIOD_S / 0.9 <= last <= 1.0
        # It goes on while messages may only be late, and brakes within the limit.
        assert course.position.max() < last + 0.5**2 / (2.0 * A) + 0.5 * 4.0 * PERIOD_S
        assert np.abs(course.acceleration).max() <= A * (1.0 + 1e-9)
        assert not course._setpoints.moving


@pytest.mark.full
@pytest.mark.parametrize('kind', ['late', '0.9', '1.1'])
def test_sine_whose_messages_jitter_is_still_followed(kind):
    turn = 2.0 * np.pi
    course = jittered(kind, lambda t: 0.1 * np.sin(turn * t), 8.0, 0)
    late = course.time > 3.0
    time, position = course.time[late], course.position[late]
    basis = np.stack([np.sin(turn * time), np.cos(turn * time)], axis=1)
    (sine, cosine), *_ = np.linalg.lstsq(basis, position, rcond=None)
    assert np.hypot(sine, cosine) == pytest.approx(0.1, rel=0.06)
    assert 0.0 < -np.arctan2(cosine, sine) / turn < 0.05


def test_velocity_is_reached_and_left_with_the_acceleration_limit():
    setpoints = generator()
    setpoints.set_velocity(ONE, np.array([1.0]))
    course = Course(setpoints).advance(*[0.004] * 100)
    # Closed form: a ramp of V / A, then a line.
    expected = np.where(course.time < 0.125, A * course.time**2 / 2.0, course.time - 0.0625)
    np.testing.assert_allclose(course.position, expected, atol=1e-12)
    begin = course.position[-1]
    setpoints.set_velocity(ONE, np.zeros(1))
    course.advance(*[0.004] * 100)
    assert course.position[-1] - begin == pytest.approx(1.0 / (2.0 * A), abs=1e-12)
    assert not setpoints.moving


@pytest.mark.full
@pytest.mark.parametrize('sign', [-1.0, 1.0])
@pytest.mark.parametrize('interval_s', [0.001, 0.004, 0.02])
def test_velocity_is_braked_before_the_range_ends(interval_s, sign):
    setpoints = generator(low=-1.0, high=1.0)
    setpoints.set_velocity(ONE, np.array([sign * V]))
    course = Course(setpoints).advance(*[interval_s] * round(3.0 / interval_s))
    assert course.position[-1] == pytest.approx(sign, abs=1e-6)
    assert np.abs(course.position).max() <= 1.0
    assert (np.abs(np.diff(course.velocity)) <= 1.01 * A * interval_s).all()
    # It leaves the end again as soon as it is told to.
    setpoints.set_velocity(ONE, np.array([-sign * V]))
    course.advance(*[interval_s] * round(0.2 / interval_s))
    assert course.velocity[-1] == pytest.approx(-sign * min(V, A * 0.2), rel=0.05)


def test_placed_setpoint_comes_to_rest_from_its_velocity():
    setpoints = generator()
    setpoints.go_to(ONE, np.array([3.0]), PERIOD_S)
    course = Course(setpoints).advance(*[0.004] * 50)
    setpoints.set_state(ONE, np.array([-0.3]), np.array([1.2]))
    assert (setpoints.position[0], setpoints.velocity[0]) == (-0.3, 1.2)
    course.advance(*[0.004] * 100)
    assert course.position[-1] == pytest.approx(-0.3 + 1.2**2 / (2.0 * A), abs=1e-12)
    assert not setpoints.moving


@pytest.mark.parametrize('velocity', [1.5, -1.5, 0.0])
def test_setpoint_is_placed_within_its_range_where_nothing_moves_on(velocity):
    setpoints = generator(2, low=-1.0, high=1.0)
    setpoints.set_state(np.arange(2), np.array([1.3, -1.3]), np.full(2, velocity))
    np.testing.assert_array_equal(setpoints.position, [1.0, -1.0])
    np.testing.assert_array_equal(setpoints.velocity, [min(velocity, 0.0), max(velocity, 0.0)])


@pytest.mark.parametrize('sign', [-1.0, 1.0])
@pytest.mark.parametrize('begins', [
    lambda setpoints: setpoints.set_velocity(ONE, np.zeros(1)),
    lambda setpoints: setpoints.come_back(ONE, np.array([0.2])),
    lambda setpoints: setpoints.go_to(ONE, np.array([0.2]), PERIOD_S),
    lambda setpoints: setpoints.go_to(ONE, setpoints.velocity, PERIOD_S, are_velocities=True),
    lambda setpoints: setpoints.brake(ONE),
], ids=['stop', 'come back', 'go to', 'go on', 'brake'])
def test_setpoint_too_fast_for_the_rest_of_its_range_slows_down_evenly_in_it(begins, sign):
    setpoints = generator(low=-1.0, high=1.0)
    # 0.5 m are left, and braking with the limit would take 1 m.
    setpoints.set_state(ONE, np.array([0.5 * sign]), np.array([4.0 * sign]))
    begins(setpoints)
    course = Course(setpoints).advance(*INTERVALS_S * 40)
    assert np.abs(course.position).max() <= 1.0
    braking = sign * course.velocity > 0.5
    np.testing.assert_allclose(course.acceleration[braking][1:], -16.0 * sign, rtol=0.02)
    at_end = sign * course.position > 1.0 - 1e-6
    assert at_end.any() and (sign * course.velocity[at_end] <= 1e-3).all()


@pytest.mark.parametrize('first_s', [0.004, 0.002])
@pytest.mark.parametrize('sign', [-1.0, 1.0])
def test_setpoint_that_brakes_at_the_end_of_its_range_rests_after_one_interval(sign, first_s):
    setpoints = generator(low=-1.0, high=1.0)
    setpoints.interval_s = first_s
    led(setpoints, [sign, 2.0 * sign, 0.0])
    setpoints.brake(ONE)
    assert setpoints.acceleration[0] == pytest.approx(-2.0 * sign / first_s)
    setpoints.advance(first_s)
    assert (setpoints.position[0], setpoints.velocity[0]) == (sign, 0.0)


def test_setpoint_that_moves_brakes_and_comes_back():
    setpoints = generator()
    setpoints.set_state(ONE, np.array([0.5]), np.array([1.5]))
    setpoints.come_back(ONE, np.array([0.5]))
    course = Course(setpoints).advance(*[0.004] * 400)
    assert 0.55 < course.position.max() < 0.5 + 1.5**2 / (2.0 * A) + 1e-3
    assert course.position[-1] == 0.5
    assert (np.abs(np.diff(course.velocity)) <= 1.05 * A * np.diff(course.time)).all()


def test_setpoint_does_not_run_ahead_of_a_joint_that_is_held():
    setpoints, lead = generator(2), np.array([0.1, 0.1])
    setpoints.go_to(np.array([0, 1]), np.array([2.0, 2.0]), PERIOD_S)
    for _ in range(400):
        setpoints.advance(0.004)
        # The first one is held at zero, the second one goes along.
        hold_back(setpoints, np.array([0.0, setpoints.position[1]]), lead)
        assert setpoints.position[0] <= 0.1
    assert setpoints.position[1] == pytest.approx(2.0)
    assert setpoints.position[0] == pytest.approx(0.1)
    # Released it starts from where it is held, not with the velocity it would have had.
    course = Course(setpoints).advance(*[0.004] * 3)
    assert np.abs(course.velocity).max() <= A * 0.012 * 1.05


def test_followed_setpoint_comes_to_rest_where_the_motion_ends():
    setpoints = generator()
    led(setpoints, [0.4, 0.8, 3.0])
    assert (setpoints.position[0], setpoints.velocity[0], setpoints.acceleration[0]) == (
        0.4, 0.8, 3.0)
    course = Course(setpoints).advance(*[0.004] * 100)
    assert course.position[-1] == pytest.approx(0.4 + 0.8**2 / (2.0 * A), abs=1e-12)


def test_joints_do_not_know_of_each_other():
    alone, both = generator(1), generator(2)
    for k in range(100):
        if k % 3 == 0:
            alone.go_to(ONE, np.array([np.sin(0.05 * k)]), PERIOD_S)
            both.go_to(np.array([1]), np.array([np.sin(0.05 * k)]), PERIOD_S)
        if k == 50:
            both.set_velocity(np.array([0]), np.array([1.0]))
        alone.advance(PERIOD_S)
        both.advance(PERIOD_S)
        assert both.position[1] == alone.position[0]
    assert both.at_rest(np.array([1])) == alone.at_rest(ONE)
    assert both.position[0] > 0.2


@pytest.mark.parametrize('interval_s', [0.001, 0.02])
@pytest.mark.parametrize('distance', [-2.0, -1e-9, 1e-4, 0.3])
def test_braking_velocity_leaves_the_way_of_a_constant_deceleration(interval_s, distance):
    # Compiled, only other laws call it.
    function = getattr(braking_velocity, 'py_func', braking_velocity)
    velocity = function(distance, A, interval_s)
    left = abs(distance) - abs(velocity) * interval_s
    assert velocity * distance > 0.0
    assert velocity**2 / (2.0 * A) == pytest.approx(left, rel=1e-6, abs=1e-16)
    assert function(0.0, 1.0, interval_s) == 0.0


def hold_back(setpoints, measured, effort, velocity=0.0, carried=0.0, constraint=0.0,
              force=np.inf):
    """Let servos of joints that cannot keep up hold back their setpoints, by efforts at most."""
    count = len(measured)
    none, places = np.zeros(count), np.arange(count)
    frames = np.zeros((0, 3)), np.zeros((0, 3, 3))
    kinematics = Kinematics(measured, np.zeros((count, 6)), np.zeros((1, 3)), *frames, *frames)
    world = WorldArrays(kinematics, none + velocity, none, none, none + carried,
                        none + constraint, *(none.copy() for _ in range(4)))
    servos = np.zeros(count, SERVO)
    for field in ('qpos', 'dof', 'activation', 'control'):
        servos[field] = places
    servos['gear'] = servos['stiffness'] = 1.0
    servos['low'], servos['high'], servos['compensated'] = -effort, effort, True
    servos['least'], servos['most'] = -force, force
    drive(world, readable(servos), np.full((count, count), -1), setpoints.joints,
          no_loads(), none, none, 0.002)


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_setpoint_may_lead_by_the_effort_that_the_weight_leaves(sign):
    for carried, lead in ((0.0, 1.0), (0.4, 0.6), (-0.4, 1.4), (1.2, 0.05)):
        setpoints = generator(low=-9.0, high=9.0)
        setpoints.set_state(ONE, np.array([sign * 3.0]), np.zeros(1))
        hold_back(setpoints, np.array([sign * 0.5]), np.ones(1), carried=sign * carried)
        assert setpoints.position[0] == pytest.approx(sign * (0.5 + lead))


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_setpoint_leads_no_farther_than_its_actuator_can_pull_where_the_weight_helps(sign):
    for carried, force, lead in ((-0.4, 1.0, 1.0), (-0.4, 1.2, 1.2), (0.4, 1.0, 0.6),
                                 (0.4, 0.5, 0.5)):
        setpoints = generator(low=-9.0, high=9.0)
        setpoints.set_state(ONE, np.array([sign * 3.0]), np.zeros(1))
        hold_back(setpoints, np.array([sign * 0.5]), np.ones(1), carried=sign * carried,
                  force=force)
        assert setpoints.position[0] == pytest.approx(sign * (0.5 + lead))


@pytest.mark.parametrize('seeks', [True, False])
def test_a_setpoint_that_is_held_back_goes_on_with_its_joint_but_not_back(seeks):
    for speed, expected in ((0.2, 0.2), (9.0, 0.6), (-0.2, 0.0)):
        setpoints = generator(low=-9.0, high=9.0)
        setpoints.set_state(ONE, np.array([3.0]), np.array([0.6]))
        if not seeks:
            setpoints.set_velocity(ONE, np.array([0.6]))
        setpoints.advance(0.002)
        before = setpoints.velocity[0]
        hold_back(setpoints, np.array([0.5]), np.ones(1), speed)
        expected = min(expected, before)
        assert setpoints.velocity[0] == pytest.approx(expected)
        assert setpoints.position[0] == pytest.approx(1.5 + 0.002 * expected)


def test_a_setpoint_of_a_joint_that_presses_goes_on_with_its_mean_velocity():
    def held(speeds, constraint):
        setpoints = generator(low=-9.0, high=9.0)
        setpoints.set_state(ONE, np.array([3.0]), np.array([0.6]))
        for speed in speeds:
            setpoints.joints['position'], setpoints.joints['velocity'] = 3.0, 0.6
            hold_back(setpoints, np.array([0.5]), np.ones(1), speed, constraint=constraint)
        return setpoints.velocity[0]

    swings, slides = [-0.2, 0.2] * 50, [0.2] * 100
    # Of an effort of 1, contacts take 0.9 or push on.
    assert held(swings, 0.0) == held(slides, 0.0) == held(swings, 0.9) == pytest.approx(0.2)
    assert 0.0 <= held(swings, -0.9) < 0.01
    assert held(slides, -0.9) == pytest.approx(0.2, rel=0.05)


def test_a_setpoint_that_was_dragged_away_at_rest_goes_back_when_it_is_woken():
    setpoints = generator()
    setpoints.go_to(ONE, np.array([0.5]), PERIOD_S)
    while setpoints.moving:
        setpoints.advance(0.002)
    assert setpoints.position[0] == pytest.approx(0.5)
    setpoints.resume()
    assert not setpoints.moving  # There is nothing to do.
    hold_back(setpoints, np.array([0.2]), np.array([0.1]))
    assert setpoints.position[0] == pytest.approx(0.3) and not setpoints.moving
    setpoints.resume()
    assert setpoints.moving
    for _ in range(1000):
        setpoints.advance(0.002)
    assert not setpoints.moving and setpoints.position[0] == pytest.approx(0.5)


def test_a_ramp_ends_exactly_at_its_goal_whatever_its_slope():
    rng = np.random.default_rng(5)
    goal, slope = rng.uniform(-1.9, 1.9, (2, 2000))
    goal[::2], slope = 0.0, np.abs(slope) + 0.5
    setpoints, joints = generator(2000), np.arange(2000)
    setpoints.set_state(joints, np.zeros(2000), rng.uniform(-1.9, 1.9, 2000))
    setpoint_motion.ramp_to(setpoints.joints, joints, goal, 1.0, slope)
    setpoints.moving = True
    for _ in range(2100):
        setpoints.advance(0.004)
    np.testing.assert_array_equal(setpoints.velocity, goal)
