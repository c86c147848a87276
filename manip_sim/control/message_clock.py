# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""When the messages of a stream were sent; nothing here knows what they bring."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.sender_rate import SenderRate

#: Messages no farther apart than this are a stream, unless set otherwise [s].
STREAM_INTERVAL_S = 0.105
#: The clock of a stream averages over so many messages at most.
_MEMORY = 40.0
#: So far off, in intervals and beside jitter, a message tells nothing of the sender's clock.
_ODD = 4.0
#: Shares of a rise and of a fall of the jitter that its measure follows with each message.
_ATTACK, _DECAY = 0.3, 0.03
#: A deviation from the schedule below this share of the interval is none.
_ON_TIME = 0.05
#: After so many messages in a row that are late, or early, by half an interval, it starts again.
_ASTRAY = 12
#: So many messages in a row have to be on schedule before it is one.
_TRUSTED = 8
#: It then remembers its interval as if it had seen so many messages.
_RESUMES = 6
#: After so many messages in a row of which others before seem lost, the stream goes slower.
_SKIPPED = 8
#: For so many messages more it may turn out that none was lost.
_DOUBTED = 4
#: Share of the slack that is kept from message to message, and how much of it is missed time.
_SLACK_KEPT, _MISSED = 0.93, 1.5
#: An error of a predicted goal below this share of its step is none.
_ALIKE = 0.01
#: Share of the sums of such errors that is kept from message to message, after so many messages.
_ERRORS_KEPT, _SETTLED = 0.97, 8
#: A share of the arrivals in the times of sending below the first is none; from the second on
#: they tell how many messages were lost.
_SHARES = 0.1, 0.75
#: Two messages are sent at least this share of the time apart in which they come.
_SHORTEST = 0.1
#: By this share of the interval such an arrival may be later before another seems lost.
_PAUSE_LATER = 0.3
#: Uncertainty of the count of messages by their times, at least [intervals].
_TIME_SPREAD = 0.15
#: Intervals by the schedule and by the arrivals that differ by less than this share are equal.
_SAME_INTERVAL = 1e-6


class _Arrival(NamedTuple):
    """
    How messages that came continue a stream, before its clock takes them in.

    :ivar streams: whether they do
    :ivar since_s: how long after the last one they came [s]
    :ivar number: of messages in the stream
    :ivar known: whether the interval of the stream was known before
    :ivar stamped: whether stamps tell when they were sent
    :ivar interval_s: from message to message [s]
    :ivar jitter_s: how far arrivals were off the even schedule before [s]
    :ivar sent: how many messages were sent, lost ones included
    :ivar ticks: how many intervals ago the last one was due, which need not be whole
    :ivar off_s: how much later than due the last one has come [s]
    """

    streams: bool
    since_s: float
    number: int
    known: bool
    stamped: bool
    interval_s: float
    jitter_s: float
    sent: int
    ticks: float
    off_s: float


class MessageClock:
    """
    When the messages of a stream were sent: arrival times without jitter, lost messages counted.

    A stream is taken to be sent at even intervals, whose length and phase are a line through the
    arrival times, by least squares with a fading memory. Where a sender's own timer jitters, its
    values follow the arrival times instead; the times of sending lie between both, the nearer to
    one the better it predicts the values. Where messages carry stamps, the differences of the
    stamps are the intervals.

    :param longest_s: intervals up to this are a stream [s]
    :param hold_s: how long a stream goes on after a message was due [s]; 0 for two intervals
    :ivar where: indices of the coordinates that the messages bring, a slice where possible
    :ivar interval_s: from message to message [s]
    :ivar sent_s: when the last message would have come without jitter on its way [s]
    :ivar elapsed_s: how long before it the last but one was sent [s]
    :ivar slack_s: how far the last ones came off these times, lost ones included [s]
    :ivar jitter_s: how far arrivals are off the times of sending [s]; zero for none
    :ivar spread_s: the same of arrivals and the even schedule [s]
    :ivar number: of messages, up to the last one
    :ivar even: how many messages in a row were on the schedule, up to the last one
    :ivar on_time: whether these are enough for a schedule
    :ivar relapsed: whether the last message was not on the schedule, though on time before
    :ivar fitted: whether goals were fitted that are off schedule, as an estimator notes
    :ivar until_s: when the stream ends that goes on without messages [s]
    """

    #: Another form of the indices.
    not_in_digest = ('where',)

    def __init__(self, longest_s: float = STREAM_INTERVAL_S, hold_s: float = 0.0) -> None:
        self.longest_s, self.hold_s = longest_s, hold_s
        self.indices = np.empty(0, dtype=np.int64)
        self.where: slice | IntArray = slice(0)
        self.interval_s = self.sent_s = self.elapsed_s = 0.0
        self.jitter_s = self.slack_s = 0.0
        self.on_time = self.relapsed = self.fitted = False
        self.until_s = -math.inf
        self._arrived_s = -math.inf
        self.number = self.even = self._astray = self._skipped = self._together = 0
        # The even schedule: when the last message was due by it, how far arrivals are off it.
        self._due_s = self.spread_s = 0.0
        # How many of the last messages may have been late instead of lost, and how long yet.
        self._doubtful = self._doubted = 0
        # Share of the arrivals in the times of sending, the errors of goals as predicted by the
        # schedule and by the arrivals, and the last two intervals by both, None unless they are
        # of one stream.
        self._share, self._errors = 0.0, (0.0, 0.0)
        self._before: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._stamped, self._stamp_s, self._stamp_interval_s = False, 0.0, 0.0
        self._rate = SenderRate()

    def forget(self) -> None:
        """Let the next message be the first of a stream."""
        self._arrived_s = self.until_s = -math.inf

    def continues(self, now_s: float) -> bool:
        """Return whether a message would continue the stream if it came now."""
        return now_s - self._arrived_s <= self.longest_s or (
            now_s <= self.until_s and self.interval_s <= self.longest_s)

    def notice_pause(self, now_s: float, stamp_s: float, messages: int) -> None:
        """
        Let a message begin a stream if time went on for its sender while simulation time stood.

        :param now_s: when it comes [s]
        :param stamp_s: when it was sent, by any clock [s]; 0: unknown
        :param messages: how many came since the last call of :meth:`take`
        """
        sent_s = (self._rate.measured * (stamp_s - self._stamp_s)
                  if stamp_s and self._stamp_s else messages * self.interval_s)
        if self.number > _TRUSTED and (
                self._due_s + sent_s - now_s > self.longest_s + 3.0 * self.spread_s):
            self.forget()

    def take(self, now_s: float, period_s: float, stamp_s: float, messages: int,
             by_goal: Callable[[float, float], tuple[float, float]] | None = None,
             errors: Callable[[FloatArray], FloatArray] | None = None) -> int:
        """
        Take in that messages came, of which the last one counts.

        :param now_s: simulation time [s]
        :param period_s: of a stream that begins, until the second message [s]
        :param stamp_s: when the last one was sent, by any clock [s]; 0: unknown
        :param messages: how many came since the last call, 1 or more
        :param by_goal: returns how many intervals the goals moved on, times its certainty, and
            that certainty; given the interval [s] and the largest number that is possible
        :param errors: returns sums of squares of errors, and of the last step; given the factors
            of the last steps in the prediction of the next one, shape (2, 2)
        :returns: how many messages seem to have been lost; -1 if one less than before
        """
        came = self._arrival(now_s, period_s, stamp_s, messages, by_goal)
        elapsed_s = came.ticks * came.interval_s if came.streams else period_s
        slack_s, jitter_s = self._deviations(came, elapsed_s, period_s)
        due_s, changed_s = self._fitted(came, now_s)
        self._note_schedule(came, messages, jitter_s)
        skips = came.streams and not came.stamped and came.sent > messages
        self._skipped = self._skipped + 1 if skips else 0
        far = abs(came.off_s) > 0.5 * max(came.interval_s, period_s)
        far_off = int(math.copysign(far, came.off_s))
        self._astray = self._astray + far_off if far_off * self._astray > 0 else far_off
        slower, again = self._skipped >= _SKIPPED, abs(self._astray) >= _ASTRAY
        self.interval_s = changed_s * came.sent / messages if slower else changed_s
        self._due_s = now_s if again else due_s
        self.number = _RESUMES if again else came.number
        self._astray = 0 if again else self._astray
        self._skipped = 0 if slower else self._skipped
        self.spread_s, self._arrived_s = jitter_s, now_s
        self._share_out(came, now_s, (
            elapsed_s, max(came.since_s, 1e-9) if came.streams else period_s), errors)
        self.slack_s = (1.0 - self._share) * slack_s
        return self._lose(came.sent - messages if skips else 0,
                          came.off_s < -0.5 * came.interval_s)

    def _arrival(self, now_s: float, period_s: float, stamp_s: float, messages: int,
                 by_goal: Callable[[float, float], tuple[float, float]] | None) -> _Arrival:
        """Return how messages that came continue the stream, as :meth:`take` gets them."""
        streams, since_s = self.continues(now_s), now_s - self._arrived_s
        number = self.number + 1 if streams else 1
        known = number > 2
        if known:
            interval_s, jitter_s = self.interval_s, self.spread_s
        else:
            interval_s, jitter_s = (since_s / messages if streams else period_s), 0.0
        count = messages
        if known and self._share > _SHARES[1]:
            late_s = since_s - _PAUSE_LATER * interval_s
            count = max(round(late_s / interval_s), messages)
        elif known:
            count = self._count((now_s - self._due_s) / interval_s, jitter_s / interval_s,
                                messages, interval_s, by_goal)
        stamped, ticks = False, float(count)
        if stamp_s or self._stamp_s:
            # Between stamps time is counted by the sender's clock, without them by messages.
            stamped, stamp_interval_s, stamp_ticks = self._read_stamps(
                streams, since_s, stamp_s, messages)
            if stamped:
                interval_s, ticks = stamp_interval_s, stamp_ticks
                count = max(round(ticks), 1)
        off_s = now_s - self._due_s - ticks * interval_s if known else 0.0
        return _Arrival(streams, since_s, number, known, stamped, interval_s, jitter_s, count,
                        ticks, off_s)

    def _deviations(self, came: _Arrival, elapsed_s: float, period_s: float
                    ) -> tuple[float, float]:
        """Return the slack with a message that came, and how far arrivals are off the schedule."""
        size = abs(came.off_s)
        missed_s = max(elapsed_s - max(came.interval_s, period_s), 0.0)
        slack_s = max(_SLACK_KEPT * self.slack_s if came.streams else 0.0,
                      min(size + _MISSED * missed_s, 2.0 * came.interval_s))
        rise = min(size, came.interval_s) - came.jitter_s
        return slack_s, came.jitter_s + (_ATTACK if rise > 0.0 else _DECAY) * rise

    def _fitted(self, came: _Arrival, now_s: float) -> tuple[float, float]:
        """Return when a message was due, and the interval, by a line through the arrivals."""
        # These gains are those of least squares.
        memory = min(float(came.number), _MEMORY)
        gain = 2.0 * (2.0 * memory - 1.0) / (memory * (memory + 1.0))
        slope = 0.0 if came.stamped else 6.0 / (memory * (memory + 1.0))
        interval_s = came.interval_s
        bound_s = max(3.0 * came.jitter_s, 0.25 * interval_s) if came.number > 4 else math.inf
        pull_s = min(max(came.off_s, -bound_s), bound_s)
        due_s = (self._due_s + came.ticks * interval_s + gain * pull_s if came.known else now_s)
        return due_s, max(interval_s + slope * pull_s / came.ticks, 0.2 * interval_s)

    def _note_schedule(self, came: _Arrival, messages: int, jitter_s: float) -> None:
        """Count how many messages in a row are on schedule."""
        even = (came.sent == messages == self._together
                and max(abs(came.off_s), jitter_s) < _ON_TIME * came.interval_s)
        even = even or came.stamped and self._stamped
        self.even = self.even + 1 if came.streams and even else 0
        self.relapsed = self.on_time and not self.even
        self.on_time = self.even > (_MEMORY if came.stamped else _TRUSTED)
        self._together, self._stamped = messages, came.stamped

    def _share_out(self, came: _Arrival, now_s: float, intervals_s: tuple[float, float],
                   errors: Callable[[FloatArray], FloatArray] | None) -> None:
        """
        Take the message to have been sent between the schedule and its arrival.

        :param intervals_s: since the last one, by the schedule and by the arrivals
        """
        if came.stamped or not came.streams or errors is None:
            self._share, self._errors, self._before = 0.0, (0.0, 0.0), None
        else:
            self._compare(came.number > _SETTLED, intervals_s, errors)
        self._before = (intervals_s, self._before[0] if self._before else intervals_s)
        share, sent_s, elapsed_s = self._share, self._due_s, intervals_s[0]
        if share:
            sent_s += share * (now_s - sent_s)
            elapsed_s = max(sent_s - self.sent_s, _SHORTEST * intervals_s[1])
        self.sent_s, self.elapsed_s = sent_s, elapsed_s
        self.jitter_s = (1.0 - share) * self.spread_s

    def _lose(self, lost: int, early: bool) -> int:
        """Return how many messages were lost, less those that only had seemed to be."""
        if lost:
            self._doubtful, self._doubted = lost, _DOUBTED
        elif self._doubted:
            self._doubted -= 1
            if early and self._doubtful:
                # The schedule has run ahead: the last messages were late, and none was lost.
                self._doubtful -= 1
                return -1
        return lost

    def _compare(self, known: bool, intervals_s: tuple[float, float],
                 errors: Callable[[FloatArray], FloatArray]) -> None:
        """
        Compare how well the even schedule and the arrival times predict values from three before.

        :param known: whether so many have been seen
        :param intervals_s: from the last message to this one by the schedule, and by their arrival
        """
        even_s, since_s = intervals_s
        before = self._before
        if known and before and (abs(even_s - since_s) > _SAME_INTERVAL * even_s or any(
                abs(a - b) > _SAME_INTERVAL * a for a, b in before)):
            factors = []
            for now_s, last_s, first_s in zip(intervals_s, *before):
                # Constant acceleration from step to step.
                bend = (now_s + last_s) / (last_s + first_s)
                factors.append((now_s / last_s * (1.0 + bend), -now_s / first_s * bend))
            by_even, by_arrival, step = errors(np.array(factors)).tolist()
            self._errors = (_ERRORS_KEPT * self._errors[0] + by_even,
                            _ERRORS_KEPT * self._errors[1] + by_arrival + _ALIKE**2 * step)
        by_even, by_arrival = self._errors
        share = by_even / (by_even + by_arrival) if by_even > 0.0 else 0.0
        self._share = share if share > _SHARES[0] else 0.0

    def _read_stamps(self, streams: bool, since_s: float, stamp_s: float, messages: int
                     ) -> tuple[bool, float, float]:
        """
        Read the time between messages from their stamps.

        :returns: whether stamps determine it, the interval from message to message in simulation
            time [s], and the number of such intervals, which need not be whole
        """
        stamped_s = stamp_s - self._stamp_s if streams else 0.0
        stamped = stamp_s > 0.0 and self._stamp_s > 0.0 and stamped_s > 0.0
        self._stamp_s = stamp_s
        if not streams:
            self._rate = SenderRate()
            self._stamp_interval_s = 0.0
        if not stamped:
            return False, 0.0, 0.0
        self._rate = self._rate.after(
            since_s, stamped_s, _ODD * self.interval_s + 3.0 * self.spread_s)
        unit_s = self._stamp_interval_s or stamped_s / messages
        ticks = stamped_s / unit_s
        # The interval follows the sender's slowly, lost messages left out.
        unit_s *= 1.0 + 0.1 * (ticks / max(round(ticks), 1) - 1.0)
        self._stamp_interval_s = unit_s
        return True, unit_s * self._rate.value, stamped_s / unit_s

    @staticmethod
    def _count(late: float, jitter: float, messages: int, interval_s: float,
               by_goal: Callable[[float, float], tuple[float, float]] | None) -> int:
        """Return how many messages were sent, by the time and by how far the goals went."""
        # A message may be as late as it likes, but not come before it is sent.
        most = math.floor(late + 0.5 + min(2.0 * jitter, 1.0))
        if most <= messages:
            return messages
        moved, certain = (by_goal or _unmoved)(interval_s, late + 1.0 + 3.0 * jitter)
        if not (math.isfinite(moved) and math.isfinite(certain)):
            # Goals of joints without a range may be so far away that their squares overflow.
            moved = certain = 0.0
        by_time = 1.0 / (jitter + _TIME_SPREAD)**2
        return max(min(round((late * by_time + moved) / (by_time + certain)), most), messages)


def _unmoved(interval_s: float, most: float) -> tuple[float, float]:
    return 0.0, 0.0
