# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Estimate how the goals of a stream move, whenever their messages arrive.

Nothing here knows of joints: a coordinate is any number that messages bring, such as the position
of a joint, or a component of a translation or of a rotation vector. All coordinates are estimated
at once, each by itself.
"""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray

#: Messages no farther apart than this are a stream, unless it is told otherwise [s].
STREAM_INTERVAL_S = 0.105
#: For how many intervals after a message was due the goals go on, unless it is told otherwise.
_HOLD_INTERVALS = 2.0
#: The clock of a stream averages over so many messages at most.
_MEMORY = 40.0
#: Share of what is known of the speed of the stamps' clock that is kept from message to message.
_RATE_KEPT = 0.98
#: It is taken to run like simulation time as if so much time had told so [s].
_SAME_S = 1.0
#: Shares of a rise and of a fall of the jitter that its measure follows with each message.
_ATTACK, _DECAY = 0.3, 0.03
#: A deviation from the schedule below this share of the interval is none.
_ON_TIME = 0.05
#: After so many messages in a row that are late, or early, by half an interval, it starts again.
_ASTRAY = 12.0
#: So many messages in a row have to be on schedule before it is one.
_TRUSTED = 8.0
#: It then remembers its interval as if it had seen so many messages.
_RESUMES = 6.0
#: After so many messages in a row of which others before seem lost, the stream goes slower.
_SKIPPED = 8.0
#: Two predictions of a goal are as good if both are within this share of its step.
_ALIKE = 0.01
#: Share of a message's word in the average on whether goals follow the arrivals: 0.5 for unknown,
#: 1 for yes. They do from the second value on, and no longer below the first.
_SAYS, _FOLLOWS = 0.1, (0.55, 0.7)
#: By this share of the interval such an arrival may be later before another seems lost.
_PAUSE_LATER = 0.3
#: Uncertainty of the count of messages by their times, at least, and by their goals [intervals].
_TIME_SPREAD, _GOAL_SPREAD = 0.15, 0.05
#: Share of the acceleration by which it may change, and share of it learnt from a message.
_CURVE_SPREAD, _LEARNT = 0.3, 0.2
#: A velocity larger than this many times the last one is a jump.
_JUMP = 1.5
#: A first velocity may be what the acceleration limit allows in so long, at most [s].
_START_S = 0.02


class MessageClock:
    """
    When the messages of streams were sent: arrival times without jitter, lost messages counted.

    A stream is taken to be sent at even intervals, whose length and phase are a line through the
    arrival times, by least squares with a fading memory. Where the values follow the arrival times
    instead, as those of a sender whose own timer jitters, these are the times of sending. Where
    messages carry stamps, the differences of the stamps are the intervals.

    :param count: number of coordinates
    :ivar longest_s: intervals up to this are a stream [s], shape (n,); may be changed
    :ivar interval_s: from message to message [s], shape (n,)
    :ivar sent_s: when the last message would have come without jitter on its way [s], shape (n,)
    :ivar elapsed_s: how long before it the last but one was sent [s], shape (n,)
    :ivar slack_s: how far the last ones came off these times, lost ones included [s], shape (n,)
    :ivar jitter_s: how far arrivals are off the times of sending [s], shape (n,); zero for none
    :ivar on_time: whether the last message was on the schedule, as others before it, shape (n,)
    :ivar lost: how many messages seem to have been lost, shape (n,)
    """

    #: Only counted.
    not_in_digest = ('lost',)

    def __init__(self, count: int) -> None:
        def zeros() -> FloatArray:
            return np.zeros(count)

        self.longest_s = np.full(count, STREAM_INTERVAL_S)
        self.interval_s, self.sent_s, self.elapsed_s = zeros(), zeros(), zeros()
        self.jitter_s, self.slack_s, self.on_time = zeros(), zeros(), np.zeros(count, dtype=bool)
        self.lost = np.zeros(count, dtype=np.int64)
        self._arrived_s = np.full(count, -np.inf)
        self._stamp_s, self._stamp_interval_s = zeros(), zeros()
        self._messages, self._astray, self._skipped = zeros(), zeros(), zeros()
        self._together, self._even = zeros(), zeros()
        # The even schedule: when the last message was due by it, how far arrivals are off it.
        self._due_s, self._spread_s = zeros(), zeros()
        # Whether values follow the arrival times; by the schedule and by these: last velocity,
        # acceleration and interval, shape (2, n) each.
        self._follows, self._says = np.zeros(count, dtype=bool), np.full(count, 0.5)
        self._pace, self._curve, self._both_s = np.zeros((3, 2, count))
        self._stamped, self._sums_s = np.zeros(count, dtype=bool), np.full((2, count), _SAME_S)

    def begun_anew(self) -> MessageClock:
        """Return a clock that has seen no message; settings and counts are those of this one."""
        clock = MessageClock(len(self.longest_s))
        clock.longest_s, clock.lost = self.longest_s, self.lost
        return clock

    def forget(self, indices: IntArray) -> None:
        """Let the next messages be the first of a stream."""
        self._arrived_s[indices] = -np.inf

    def streams(self, indices: IntArray, now_s: float) -> BoolArray:
        """Tell which streams a message would continue if it came now."""
        return np.asarray(now_s - self._arrived_s[indices] <= self.longest_s[indices])

    def take(self, indices: IntArray, streams: BoolArray, now_s: float, period_s: float,
             stamp_s: FloatArray, messages: FloatArray, step: FloatArray, expected: FloatArray,
             spread: FloatArray) -> None:
        """
        Take in that messages came, of which the last one counts.

        :param indices: of the coordinates that they bring
        :param streams: whether they continue a stream, shape of ``indices``
        :param now_s: simulation time [s]
        :param period_s: of a stream that begins, until the second message [s]
        :param stamp_s: when they were sent, by any clock [s]; 0: unknown, shape of ``indices``
        :param messages: how many came since the last call, 1 or more, shape of ``indices``
        :param step: from the last value to the present one, shape of ``indices``
        :param expected: such a step in one interval, and ``spread``: by how much it may differ,
            shape of ``indices``; from them lost messages are told from late ones
        """
        i = indices
        since_s = now_s - self._arrived_s[i]
        number = np.where(streams, self._messages[i] + 1.0, 1.0)
        known = number > 2.0
        interval_s = np.where(streams, np.where(known, self.interval_s[i], since_s / messages),
                              period_s)
        jitter_s = np.where(known, self._spread_s[i], 0.0)
        follows = known & self._follows[i]
        late_s = np.where(follows, since_s - _PAUSE_LATER * interval_s, now_s - self._due_s[i])
        late = np.where(known, late_s / interval_s, messages)
        ticks = count = self._count(late, np.where(follows, 0.0, jitter_s / interval_s), messages,
                                    step, np.where(follows, 0.0, expected), spread)
        stamped = np.zeros(len(i), dtype=bool)
        if stamp_s.any() or self._stamp_s[i].any():
            # Between stamps time is counted by the sender's clock, without them by messages.
            stamped, stamp_interval_s, ticks = self._read_stamps(
                i, streams, since_s, stamp_s, messages, count)
            interval_s = np.where(stamped, stamp_interval_s, interval_s)
            count = np.where(stamped, np.maximum(np.rint(ticks), 1.0), count)
        off_s = np.where(known, now_s - self._due_s[i] - ticks * interval_s, 0.0)
        size = np.abs(off_s)
        # A line through the arrivals: these gains are those of least squares.
        memory = np.minimum(number, _MEMORY)
        gain = 2.0 * (2.0 * memory - 1.0) / (memory * (memory + 1.0))
        slope = 6.0 / (memory * (memory + 1.0)) * ~stamped
        bound_s = np.where(number > 4.0, np.maximum(3.0 * jitter_s, 0.25 * interval_s), np.inf)
        pull_s = np.minimum(np.maximum(off_s, -bound_s), bound_s)
        sent_s = np.where(known, self._due_s[i] + ticks * interval_s + gain * pull_s, now_s)
        elapsed_s = np.where(streams, ticks * interval_s, period_s)
        changed_s = np.maximum(interval_s + slope * pull_s / ticks, 0.2 * interval_s)
        missed_s = np.maximum(elapsed_s - np.maximum(interval_s, period_s), 0.0)
        self.slack_s[i] = np.maximum(np.where(streams, 0.8 * self.slack_s[i], 0.0),
                                     np.minimum(size + missed_s, 2.0 * interval_s))
        rise = np.minimum(size, interval_s) - jitter_s
        jitter_s = jitter_s + np.where(rise > 0.0, _ATTACK, _DECAY) * rise
        even = (count == messages) & (messages == self._together[i]) & (
            np.maximum(size, jitter_s) < _ON_TIME * interval_s)
        self._even[i] = np.where(streams & (even | stamped & self._stamped[i]),
                                 self._even[i] + 1.0, 0.0)
        self.on_time[i] = self._even[i] > np.where(stamped, _MEMORY, _TRUSTED)
        self._together[i], self._stamped[i] = messages, stamped
        far = np.sign(off_s) * (size > 0.5 * np.maximum(interval_s, period_s))
        self._astray[i] = np.where(far * self._astray[i] > 0.0, self._astray[i] + far, far)
        skips = streams & ~stamped & (count > messages)
        self.lost[i] += np.where(skips, count - messages, 0.0).astype(np.int64)
        self._skipped[i] = np.where(skips, self._skipped[i] + 1.0, 0.0)
        slower, again = self._skipped[i] >= _SKIPPED, np.abs(self._astray[i]) >= _ASTRAY
        self.interval_s[i] = np.where(slower, changed_s * count / messages, changed_s)
        self._due_s[i] = np.where(again, now_s, sent_s)
        self._messages[i] = np.where(again, _RESUMES, number)
        self._astray[i] = np.where(again, 0.0, self._astray[i])
        self._skipped[i] = np.where(slower, 0.0, self._skipped[i])
        self._spread_s[i], self._arrived_s[i] = jitter_s, now_s
        self._choose(i, (number > 3.0) & streams & ~stamped, step, elapsed_s, np.where(
            streams, since_s, period_s), now_s)

    def _choose(self, i: IntArray, known: BoolArray, step: FloatArray, even_s: FloatArray,
                since_s: FloatArray, now_s: float) -> None:
        """
        Choose between the even schedule and the arrival times by which one the values follow.

        Which one does predicts the next value better from the last three.

        :param known: whether so many have been seen, and no stamps
        :param step: from the last value to the present one, shape of ``i``
        :param even_s: time from the last message to this one by the schedule [s]
        :param since_s: the same by their arrival [s]
        """
        both_s = np.stack([even_s, np.maximum(since_s, 1e-9)])
        apart_s = (self._both_s[:, i] + both_s) / 2.0
        pace = step / both_s
        error = (pace - self._pace[:, i] - self._curve[:, i] * apart_s) * both_s
        size = error**2 + (_ALIKE * step)**2
        self._curve[:, i] = (pace - self._pace[:, i]) / apart_s
        self._pace[:, i], self._both_s[:, i] = pace, both_s
        total = size[0] + size[1]
        share = np.where(total > 0.0, size[0] / np.where(total > 0.0, total, 1.0), 0.5)
        says = np.where(known, self._says[i] + _SAYS * (share - self._says[i]), 0.5)
        follows = known & (says > np.where(self._follows[i], *_FOLLOWS))
        self._says[i], self._follows[i] = says, follows
        self.sent_s[i] = np.where(follows, now_s, self._due_s[i])
        self.elapsed_s[i] = np.where(follows, both_s[1], even_s)
        self.jitter_s[i] = np.where(follows, 0.0, self._spread_s[i])
        self.slack_s[i] = np.where(follows, 0.0, self.slack_s[i])

    def _read_stamps(self, i: IntArray, streams: BoolArray, since_s: FloatArray,
                     stamp_s: FloatArray, messages: FloatArray, count: FloatArray
                     ) -> tuple[BoolArray, FloatArray, FloatArray]:
        """
        Read the time between messages from their stamps.

        :returns: whether stamps tell it, the interval from message to message in simulation time
            [s], and the number of such intervals, which need not be whole; else ``count``
        """
        stamped_s = np.where(streams, stamp_s - self._stamp_s[i], 0.0)
        stamped = (stamp_s > 0.0) & (self._stamp_s[i] > 0.0) & (stamped_s > 0.0)
        self._stamp_s[i] = stamp_s
        # How fast simulation time runs by the sender's clock: as fast, until messages tell more.
        sums = np.where(streams, self._sums_s[:, i], _SAME_S)
        sums = np.where(stamped, _RATE_KEPT * sums + (since_s, stamped_s), sums)
        self._sums_s[:, i] = sums
        unit_s = np.where(streams & (self._stamp_interval_s[i] > 0.0), self._stamp_interval_s[i],
                          stamped_s / messages)
        ticks = np.where(stamped, stamped_s, 1.0) / np.where(stamped, unit_s, 1.0)
        # The interval follows the sender's slowly, lost messages left out.
        unit_s = unit_s * (1.0 + 0.1 * (ticks / np.maximum(np.rint(ticks), 1.0) - 1.0) * stamped)
        self._stamp_interval_s[i] = unit_s
        ticks = np.where(stamped, stamped_s / np.where(stamped, unit_s, 1.0), count)
        return stamped, unit_s * sums[0] / sums[1], ticks

    @staticmethod
    def _count(late: FloatArray, jitter: FloatArray, messages: FloatArray, step: FloatArray,
               expected: FloatArray, spread: FloatArray) -> FloatArray:
        """Return how many messages were sent, by the time and by how far the goals went."""
        by_goal = step / np.where(expected == 0.0, np.inf, expected)
        weight = np.where((by_goal > 0.5) & (by_goal < late + 1.0 + 3.0 * jitter),
                          (expected / np.maximum(spread, 1e-12))**2, 0.0)
        by_time = 1.0 / (jitter + _TIME_SPREAD)**2
        count = np.rint((late * by_time + by_goal * weight) / (by_time + weight))
        # A message may be as late as it likes, but not come before it is sent.
        most = np.floor(late + 0.5 + np.minimum(2.0 * jitter, 1.0))
        return np.maximum(np.minimum(count, most), messages)


class StreamEstimator:
    """
    An estimator of where the goals of streams are, and how fast, between their messages.

    Its coordinates are numbers of any kind that change smoothly: six of them are a pose, as
    translation and rotation vector. On schedule the velocity is exactly that from message to
    message; what jitters or is lost does not change it.

    :param count: number of coordinates
    :ivar clock: of their messages
    :ivar hold_s: how long goals go on at their velocity after a message was due [s], shape (n,);
        0 for two intervals; may be changed
    :ivar goal: of the last message, shape (n,)
    :ivar velocity: of the goals [1/s], shape (n,)
    :ivar acceleration: of the goals, zero unless their messages are on schedule [1/s^2], shape
        (n,)
    :ivar interval_s: from message to message, or from one control period to the next if messages
        come faster [s], shape (n,)
    :ivar until_s: when the stream has ended if no message comes [s], shape (n,)
    """

    def __init__(self, count: int) -> None:
        def zeros() -> FloatArray:
            return np.zeros(count)

        self.clock = MessageClock(count)
        self.hold_s = zeros()
        self.goal, self.velocity, self.acceleration = zeros(), zeros(), zeros()
        self.interval_s, self.until_s = zeros(), np.full(count, -np.inf)
        #: Velocity of the last step, and how much it changed with it, zero if that was a jump.
        self._last, self._change = zeros(), zeros()
        #: How fast the velocity changes on average, with and without its sign.
        self._curve, self._roughness = zeros(), zeros()

    def begun_anew(self) -> StreamEstimator:
        """Return an estimator of no stream yet; settings and counts are those of this one."""
        estimator = StreamEstimator(len(self.hold_s))
        estimator.clock, estimator.hold_s = self.clock.begun_anew(), self.hold_s
        return estimator

    def forget(self, indices: IntArray) -> None:
        """Let the next goals be the first of a stream."""
        self.clock.forget(indices)
        self.until_s[indices] = -np.inf

    def streams(self, indices: IntArray, now_s: float) -> BoolArray:
        """Tell which goals would continue a stream if they came now."""
        clock = self.clock
        held = (now_s <= self.until_s[indices]) & (
            clock.interval_s[indices] <= clock.longest_s[indices])
        return np.asarray(clock.streams(indices, now_s) | held)

    def at(self, indices: IntArray, now_s: float) -> FloatArray:
        """
        Return where a setpoint is that follows the goals one and a half intervals late.

        :param now_s: time, not before the last message [s]
        """
        age_s = now_s - self.clock.sent_s[indices] - 1.5 * self.interval_s[indices]
        return np.asarray(self.goal[indices] + self.velocity[indices] * age_s)

    def take(self, indices: IntArray, goal: FloatArray, now_s: float, period_s: float,
             acceleration_limit: FloatArray, messages: FloatArray | float = 1.0,
             stamp_s: FloatArray | float = 0.0) -> None:
        """
        Take in the goals of the messages that came at an instant; the last one counts.

        :param goal: shape of ``indices``
        :param now_s: simulation time, after that of the last call for these coordinates [s]
        :param period_s: length of a control period [s]
        :param acceleration_limit: of a jump [1/s^2], shape of ``indices``
        :param messages: how many came at this instant
        :param stamp_s: when the last of them was sent, by any clock [s]; 0: unknown
        """
        clock, streams = self.clock, self.streams(indices, now_s)
        step = np.where(streams, goal - self.goal[indices], 0.0)
        before, interval_s = self._last[indices], clock.interval_s[indices]
        before_s = clock.elapsed_s[indices]
        expected = (before + self._curve[indices] * interval_s) * interval_s
        spread = (_GOAL_SPREAD * np.abs(expected)
                  + _CURVE_SPREAD * self._roughness[indices] * interval_s**2)
        ones = np.ones(len(indices))
        clock.take(indices, streams, now_s, period_s, stamp_s * ones, messages * ones, step,
                   expected, spread)
        elapsed_s = clock.elapsed_s[indices]
        interval_s = np.maximum(clock.interval_s[indices], period_s)
        velocity = step / elapsed_s
        # A smooth stream accelerates about as it did before, even where its velocity changes sign.
        slack = (2.0 * acceleration_limit * np.maximum(period_s, np.minimum(interval_s, _START_S))
                 + _JUMP * self._change[indices])
        smooth = streams & (velocity >= np.minimum(0.0, _JUMP * before) - slack) & (
            velocity <= np.maximum(0.0, _JUMP * before) + slack)
        # A jump does not continue the stream, nor does it end it.
        kept = np.where(streams, self.velocity[indices], 0.0)
        self._change[indices] = np.where(smooth, np.abs(velocity - before), 0.0)
        self.acceleration[indices] = np.where(
            smooth & clock.on_time[indices],
            np.abs(velocity - before) * 2.0 / (elapsed_s + before_s), 0.0)
        curve = np.where(smooth, (velocity - before) / elapsed_s, 0.0)
        self._curve[indices] += _LEARNT * (curve - self._curve[indices])
        self._roughness[indices] += _LEARNT * (np.abs(curve) - self._roughness[indices])
        self.interval_s[indices] = interval_s
        self.goal[indices], self._last[indices] = goal, velocity
        self.velocity[indices] = np.where(smooth, velocity, kept)
        hold_s = np.where(self.hold_s[indices] > 0.0, self.hold_s[indices],
                          _HOLD_INTERVALS * interval_s)
        self.until_s[indices] = (np.maximum(now_s, clock.sent_s[indices]) + interval_s + hold_s
                                 + 3.0 * clock.jitter_s[indices])


class RampEstimator:
    """
    An estimator of the acceleration that lets a stream of velocities pass, but not a jump.

    :param count: number of coordinates
    :ivar clock: of their messages
    """

    def __init__(self, count: int) -> None:
        self.clock = MessageClock(count)
        self._velocity, self._change = np.zeros(count), np.zeros(count)
        self._taken_s = np.full(count, -np.inf)

    def begun_anew(self) -> RampEstimator:
        """Return an estimator of no stream yet; settings and counts are those of this one."""
        estimator = RampEstimator(len(self._velocity))
        estimator.clock = self.clock.begun_anew()
        return estimator

    def forget(self, indices: IntArray) -> None:
        """Let the next velocities be the first of a stream."""
        self.clock.forget(indices)

    def take(self, indices: IntArray, velocity: FloatArray, present: FloatArray, now_s: float,
             period_s: float, acceleration_limit: FloatArray, messages: FloatArray | float = 1.0,
             stamp_s: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """
        Return the acceleration to use for the velocities of a message, and the stream's own.

        :param velocity: wanted [1/s], shape of ``indices``
        :param present: present velocity [1/s], shape of ``indices``
        :param now_s: simulation time [s]
        :param period_s: length of a control period [s]
        :param acceleration_limit: of a jump [1/s^2], shape of ``indices``
        :param messages: how many came at this instant
        :param stamp_s: when the last of them was sent, by any clock [s]; 0: unknown
        :returns: both of the shape of ``indices`` [1/s^2]
        """
        clock, streams = self.clock, self.clock.streams(indices, now_s)
        # Of two messages at one instant the newer counts, and the schedule knows of one.
        new = self._taken_s[indices] != now_s
        fresh, none, ones = indices[new], np.zeros(new.sum()), np.ones(new.sum())
        clock.take(fresh, streams[new], now_s, period_s, stamp_s * ones, messages * ones, none,
                   none, none)
        self._taken_s[indices] = now_s
        elapsed_s = clock.elapsed_s[indices]
        change = np.where(streams, np.abs(velocity - self._velocity[indices]), 0.0)
        # As for positions, a change may be twice the last one plus what the limit allows.
        smooth = streams & (change <= 2.0 * self._change[indices]
                            + 2.0 * acceleration_limit * elapsed_s)
        # Velocities hold for an interval each, so a change comes with the last one.
        own = np.where(new & smooth & clock.on_time[indices], change / elapsed_s, 0.0)
        self._velocity[indices], self._change[indices] = velocity, change
        interval_s = np.where(streams, clock.interval_s[indices], period_s)
        return np.abs(velocity - present) / interval_s, own
