# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What setpoints keep to whatever the messages of a stream do on their way."""

from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')
from end_effector_operator import distance, operator_of, turned  # noqa: E402
from hypothesis import given, settings, strategies as st  # noqa: E402

from manip_sim.control.commands import Status  # noqa: E402
from manip_sim.control.setpoints import SetpointGenerator  # noqa: E402

V, A, LOW, HIGH = 2.0, 15.0, -1.0, 1.0
MESSAGES, LASTS_S, AFTER_S = 150, 4.0, 2.5
JOINTS = np.arange(4)


@dataclass
class Transport:
    """How messages come: all times in message intervals, chances of each message."""

    rate: float
    seed: int
    jitter: float = 0.0
    lost: float = 0.0
    twice: float = 0.0
    late: float = 0.0
    latest: float = 1.5
    stall: float = 0.0
    overtakes: bool = False

    def deliver(self, sent):
        """Return the order in which messages come and when, some of them twice."""
        random, count = np.random.default_rng(self.seed), len(sent)
        delay = self.jitter * np.abs(random.normal(size=count))
        delay += (random.random(count) < self.late) * random.uniform(0.5, self.latest, count)
        arrival = sent + delay / self.rate
        begin = random.uniform(0.0, sent[-1])
        stalls = (arrival > begin) & (arrival < begin + self.stall)
        arrival[stalls] = begin + self.stall
        if not self.overtakes:
            arrival = np.maximum.accumulate(arrival)
        kept = np.flatnonzero(random.random(count) >= self.lost)
        again = kept[random.random(len(kept)) < self.twice]
        # A copy that took the place of another message would be another stream.
        copies = arrival[again] + random.uniform(0.0, 0.45, len(again)) / self.rate
        number = np.concatenate([kept, again])
        arrival = np.concatenate([arrival[kept], copies])
        order = np.argsort(arrival, kind='stable')
        return number[order], arrival[order]


def motions(seconds, seed):
    """Return a sine, a sum of two, a line that stops and one place, at times, shape (n, 4)."""
    random = np.random.default_rng(seed)
    turn, other = 2.0 * np.pi * random.uniform(0.1, 3.0, 2)
    size, speed = random.uniform(0.5, 40.0), random.uniform(-1.5, 1.5)
    return np.stack([
        min(size / turn**2, 0.95) * np.sin(turn * seconds),
        random.uniform(0.0, 0.3) * np.sin(other * seconds) + 0.2 * np.cos(0.3 * turn * seconds),
        np.clip(speed * seconds, LOW, HIGH), np.full(len(seconds), 0.3)], axis=1)


def followed(transport, goals, sent, period_s, interval_s, mode='position', stamped=False,
             longest_s=0.105):
    """Return times, positions and velocities of setpoints, at every interval."""
    setpoints = SetpointGenerator(np.tile([LOW, HIGH], (4, 1)), np.full(4, V), np.full(4, A))
    setpoints.set_stream(JOINTS, longest_s=longest_s)
    number, arrival = transport.deliver(sent)
    setpoints.set_state(JOINTS, goals[0] if mode == 'position' else np.zeros(4), np.zeros(4))
    pieces = max(1, round(period_s / interval_s))
    rows, next_one = [(0.0, setpoints.position, setpoints.velocity)], 0
    for period in range(int((sent[-1] + AFTER_S) / period_s)):
        now_s = setpoints.now_s = period * period_s
        while next_one < len(number) and arrival[next_one] <= now_s:
            last = number[next_one]
            setpoints.go_to(JOINTS, goals[last], period_s, 1, 1e5 + sent[last] if stamped else 0.0,
                            are_velocities=mode != 'position')
            next_one += 1
        for _ in range(pieces):
            setpoints.advance(period_s / pieces)
            rows.append((setpoints.now_s, setpoints.position, setpoints.velocity))
    times, positions, velocities = map(np.array, zip(*rows))
    return times, positions, velocities, goals[last] if len(number) else goals[0]


def check_limits(times, positions, velocities, own):
    """Check velocity and acceleration in and between intervals, and the range."""
    steps, bound = np.diff(times)[:, None], np.maximum(A, 2.0 * own)
    assert (np.abs(velocities) <= V * (1.0 + 1e-9)).all()
    assert (positions >= LOW).all() and (positions <= HIGH).all()
    assert (np.abs(np.diff(velocities, axis=0)) / steps <= bound * (1.0 + 1e-6)).all()
    # What is seen of it without being told: changes of the mean velocity.
    means, between = np.diff(positions, axis=0) / steps, (steps[1:] + steps[:-1]) / 2.0
    assert (np.abs(np.diff(means, axis=0)) / between <= 1.02 * bound).all()


def transports():
    share = st.sampled_from([0.0, 0.01, 0.1, 0.3])
    return st.builds(
        Transport, rate=st.floats(np.log(5.0), np.log(1000.0)).map(np.exp),
        seed=st.integers(0, 2**32), jitter=st.sampled_from([0.0, 0.1, 0.3, 1.0, 3.0]), lost=share,
        twice=st.sampled_from([0.0, 0.02, 0.1]), late=st.sampled_from([0.0, 0.05]),
        latest=st.just(3.0), stall=st.sampled_from([0.0, 0.05, 0.2]), overtakes=st.booleans())


PERIODS = st.sampled_from([0.001, 0.002, 0.004, 0.005, 0.01, 0.02, 0.05])
INTERVALS = st.sampled_from([0.002, 0.004])


@pytest.mark.full
@given(transports(), PERIODS, INTERVALS, st.booleans(), st.sampled_from([0.105, 0.5]),
       st.sampled_from([0.0, 0.1, 0.3]))
@settings(max_examples=30)
def test_whatever_the_order_of_arrival_positions_keep_the_limits_and_end_at_the_last_goal(
        transport, period_s, interval_s, stamped, longest_s, timer):
    sent = np.arange(MESSAGES) + 0.37
    sent += np.random.default_rng(transport.seed).uniform(-timer, timer, MESSAGES)
    sent = np.maximum.accumulate(sent)[sent / transport.rate < LASTS_S] / transport.rate
    goals = np.clip(motions(sent, transport.seed), LOW, HIGH)
    own = np.abs(np.diff(goals, 2, axis=0)).max(axis=0) * transport.rate**2
    times, positions, velocities, last = followed(
        transport, goals, sent, period_s, interval_s, 'position', stamped, longest_s)
    check_limits(times, positions, velocities, own)
    np.testing.assert_allclose(positions[-1], last, atol=1e-6)
    np.testing.assert_allclose(velocities[-1], 0.0, atol=1e-6)


@pytest.mark.full
@given(transports(), PERIODS, INTERVALS, st.booleans())
@settings(max_examples=12)
def test_whatever_the_order_of_arrival_velocities_keep_the_limits(
        transport, period_s, interval_s, stamped):
    sent = (np.arange(MESSAGES) + 0.37) / transport.rate
    sent = sent[sent < LASTS_S]
    goals = np.clip(motions(sent, transport.seed), -V, V)
    own = np.abs(np.diff(goals, axis=0)).max(axis=0) * transport.rate
    times, positions, velocities, _ = followed(
        transport, goals, sent, period_s, interval_s, 'velocity', stamped)
    check_limits(times, positions, velocities, own)


@pytest.fixture(scope='module')
def panda_operator():
    """Return an operator of the end effector of a Panda."""
    return operator_of('Panda')


@pytest.mark.full
@given(transports(), st.sampled_from([0.004, 0.01, 0.02, 0.05]), st.booleans(),
       st.sampled_from([0.105, 0.5]), st.sampled_from([0.0, 0.2]))
@settings(max_examples=12)
def test_whatever_the_order_of_arrival_poses_keep_the_limits_and_end_at_the_last_one(
        panda_operator, transport, period_s, stamped, longest_s, hold_s):
    op, (joints, period) = panda_operator, (panda_operator.robot.joints, period_s)
    op.simulation.reset()
    op.period_s = period
    indices, steps = joints.indices_of('right'), round(period / op.simulation.timestep_s)
    limit = joints.acceleration_limits(indices)
    top = np.array([op.simulation.model.joint(j).user[0] for j in op.part.joints])
    op.robot.set_stream('arm', longest_s=longest_s)
    op.robot.set_stream('arm', hold_s=hold_s)
    sent = np.arange(0.0, 1.2, 1.0 / transport.rate)
    number, arrival = transport.deliver(sent)
    (start, rotation), next_one, handle, speeds = op.pose, 0, None, [np.zeros(len(top))]
    begin_s, now_s = op.simulation.time_s, 0.0
    while now_s < arrival.max(initial=0.0) + 5.0 and (
            next_one < len(number) or handle is not None and handle.is_active):
        while next_one < len(number) and arrival[next_one] <= now_s:
            angle = 2.0 * np.pi * 0.8 * (sent_s := sent[number[next_one]])
            pose = (start + 0.03 * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0]),
                    turned([0.0, 0.6, 0.8], 0.12 * np.sin(angle)) @ rotation)
            handle = op.go_to(pose, sent_ns=round((1e5 + sent_s) * 1e9) if stamped else 0)
            next_one += 1
        op.simulation.advance(steps)
        now_s = op.simulation.time_s - begin_s
        speeds.append(op.reference.velocity)
    assert (np.abs(speeds) <= 1.0001 * top).all()
    assert (np.abs(np.diff(speeds, axis=0)) <= 1.0001 * limit * period).all()
    if handle is not None:
        assert handle.status is Status.DONE
        assert max(distance(op.pose, pose)) < 5e-3


def test_a_stop_that_messages_tell_in_time_may_use_the_streams_own_acceleration():
    # Else the setpoint would have to go past the goal.
    sent = np.arange(200) / 100.0
    goals = np.tile(np.minimum(0.6 * sent, 0.6)[:, None], 4)
    _, positions, velocities, _ = followed(Transport(100.0, 0), goals, sent, 0.01, 0.002)
    assert positions.max() <= 0.6 + 1e-9
    assert np.abs(np.diff(velocities, axis=0)).max() / 0.002 == pytest.approx(60.0, rel=1e-6)


def by_chance(rate, seed):
    """Return a transport by which one message comes in each period, copies and others."""
    return Transport(rate, seed, jitter=0.5, twice=0.3, overtakes=True)


@pytest.mark.parametrize(('rate', 'seed'), [(500.0, 7), (500.0, 16), (250.0, 0), (250.0, 29)])
def test_messages_that_seem_on_schedule_do_not_stop_a_stream_that_goes_on(rate, seed):
    sent = (np.arange(4 * MESSAGES) + 0.37) / rate
    goals = np.clip(motions(sent, seed), LOW, HIGH)
    own = np.abs(np.diff(goals, 2, axis=0)).max(axis=0) * rate**2
    check_limits(*followed(by_chance(rate, seed), goals, sent, 1 / rate, 1 / rate)[:3], own)


def test_velocities_that_seem_on_schedule_are_not_followed_by_jerks():
    sent = (np.arange(4 * MESSAGES) + 0.37) / 500.0
    goals = np.tile(1.9 * np.sin(9.0 * sent)[:, None], 4)
    times, positions, velocities, _ = followed(
        by_chance(500.0, 0), goals, sent, 0.002, 0.002, 'velocity')
    accelerations = np.abs(np.diff(velocities, axis=0)) / np.diff(times)[:, None]
    assert accelerations.max() <= 2.0 * 1.9 * 9.0 * (1.0 + 1e-6)


def sine(transport, period_s, interval_s, frequency_hz=0.5, stamped=False, seconds=6.0):
    """Return peak acceleration over that of the sine, ratio, and lag in message intervals."""
    turn, sent = 2.0 * np.pi * frequency_hz, np.arange(0.37, seconds * transport.rate)
    sent = sent / transport.rate
    size = min(0.2, 2.0 / turn**2)
    goals = np.tile((size * np.minimum(1.0, sent) * np.sin(turn * sent))[:, None], 4)
    times, positions, velocities, _ = followed(
        transport, goals, sent, period_s, interval_s, stamped=stamped)
    chosen = (times > 2.0) & (times < seconds - 0.1)
    times, positions = times[chosen], positions[chosen, 0]
    peak = np.abs(np.diff(velocities[chosen, 0]) / np.diff(times)).max() / (size * turn**2)
    basis = np.stack([np.sin(turn * times), np.cos(turn * times), np.ones_like(times)], axis=1)
    (a, b, _), *_ = np.linalg.lstsq(basis, positions, rcond=None)
    return peak, np.hypot(a, b) / size, -np.arctan2(b, a) / turn * transport.rate


@pytest.mark.full
@pytest.mark.parametrize(('rate', 'frequency_hz'), [
    (100, 0.5), (100, 2.0), (100, 5.0), (500, 5.0), (50, 1.0)])
def test_clean_sines_pass_in_full_one_and_a_half_intervals_late(rate, frequency_hz):
    # The first message is sent 0.37 intervals before the period that takes it.
    peak, ratio, lag = sine(Transport(rate, 0), 1.0 / rate, min(0.005, 1.0 / rate), frequency_hz)
    assert peak == pytest.approx(1.0, rel=0.02)
    assert ratio == pytest.approx(1.0, abs=0.02)
    assert lag == pytest.approx(1.5 + 0.63, abs=0.02)


@pytest.mark.full
@pytest.mark.parametrize(('rate', 'control_rate', 'jitter_s', 'lost', 'late', 'stamped'), [
    (100, 100, 0.002, 0.0, 0.0, False), (100, 500, 0.002, 0.0, 0.0, False),
    (250, 250, 0.001, 0.0, 0.0, False), (500, 500, 0.0005, 0.0, 0.0, False),
    (100, 100, 0.0, 0.01, 0.0, False), (250, 500, 0.001, 0.01, 0.02, False),
    (100, 100, 0.0, 0.0, 0.05, False), (250, 500, 0.001, 0.01, 0.02, True),
    (100, 500, 0.004, 0.0, 0.0, True)])
def test_jitter_and_loss_hardly_change_the_acceleration_of_a_smooth_stream(
        rate, control_rate, jitter_s, lost, late, stamped):
    transport = Transport(rate, 1, jitter_s * rate, lost, late=late)
    peak, ratio, _ = sine(transport, 1.0 / control_rate, min(0.004, 1.0 / control_rate),
                          stamped=stamped)
    assert peak < (1.7 if late else 1.5)
    assert ratio == pytest.approx(1.0, abs=0.03)


@pytest.mark.full
@pytest.mark.parametrize('rate', [2, 3, 5, 8])
def test_slow_streams_are_smooth_once_their_interval_is_admitted(rate):
    sent = np.arange(0.0, 12.0, 1.0 / rate)
    goals = np.tile((0.08 * sent - 0.5)[:, None], 4)
    ripples = []
    for longest_s in (0.105, 0.6):
        times, _, velocities, _ = followed(Transport(rate, 0), goals, sent, 0.01, 0.004,
                                           longest_s=longest_s)
        chosen = velocities[(times > 6.0) & (times < 11.0), 0]
        ripples.append(np.ptp(chosen) / 0.08)
    assert ripples[0] > 0.5
    assert ripples[1] < 0.05
