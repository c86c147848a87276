# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How the real-time factor is measured, with a wall clock that the tests move."""

import math
from types import SimpleNamespace

import pytest

from manip_sim.ros.diagnostics import Pace
from manip_sim.runtime.simulation_thread import Progress


class Clockwork:
    """
    A thread whose control periods take as long as a test says, and what Pace measures of it.

    :ivar thread: what Pace sees
    :ivar now_s: wall time [s]
    """

    def __init__(self, period_s, factor, stepping='realtime'):
        self.now_s, self._next_s, self._looks = 100.0, 100.0, 0
        self.thread = SimpleNamespace(progress=Progress(100.0, 0), paused=False,
                                      real_time_factor=factor, stepping=stepping,
                                      period_s=period_s)
        self._pace = Pace(self.thread)
        self._pace.measure(self.now_s)

    def run(self, seconds, takes_s):
        """
        Let control periods take so long; measure once a second, but now and then late.

        :returns: factor and loss of each measurement
        """
        told, end = [], self.now_s + seconds
        while self.now_s < end - 1e-9:
            self._looks += 1
            self.now_s += 1.0 + (0.3, -0.2, 0.0, -0.1)[self._looks % 4]
            while self._next_s + takes_s <= self.now_s:
                self._period(takes_s)
            told.append(self.look())
        return told

    def _period(self, takes_s):
        self._next_s += takes_s
        progress, thread = self.thread.progress, self.thread
        lost_s = max(0.0, takes_s * thread.real_time_factor - thread.period_s)
        thread.progress = Progress(
            self._next_s, progress.time_ns + round(thread.period_s * 1e9), 0,
            progress.lost_s + lost_s if thread.stepping == 'realtime' else 0.0)

    def look(self):
        self._pace.measure(self.now_s)
        return self._pace.factor, self._pace.loss

    def wait(self, seconds):
        """Let nothing happen for so long, and measure once a second."""
        told = []
        for _ in range(round(seconds)):
            self.now_s += 1.0
            told.append(self.look())
        self._next_s = self.now_s
        return told


@pytest.mark.full
@pytest.mark.parametrize('period_s', [0.001, 0.01, 0.2, 1.0])
@pytest.mark.parametrize('factor', [0.1, 0.5, 1.0, 3.0])
def test_the_factor_is_exact_whenever_one_looks(period_s, factor):
    told = Clockwork(period_s, factor).run(40.0, period_s / factor)
    measured = [value for value, _ in told if not math.isnan(value)]
    assert len(measured) >= 3
    assert measured == pytest.approx([factor] * len(measured), rel=1e-6)
    assert max(loss for _, loss in told) < 1e-6


@pytest.mark.parametrize('period_s, asked, takes_s', [
    (0.01, 1.0, 0.0125), (0.2, 0.6, 0.4), (1.0, 3.0, 0.4), (0.001, 10.0, 0.0002)])
def test_time_that_is_lost_is_a_part_of_that_which_was_asked_for(period_s, asked, takes_s):
    told = Clockwork(period_s, asked).run(30.0, takes_s)
    reached = period_s / takes_s
    for factor, loss in told[8:]:
        assert factor == pytest.approx(reached, rel=1e-6)
        assert loss == pytest.approx(1.0 - reached / asked, rel=1e-6)


def test_a_pause_is_no_lost_time():
    clock = Clockwork(0.01, 1.0)
    clock.run(5.0, 0.01)
    clock.thread.paused = True
    assert clock.wait(3.0) == [(0.0, 0.0)] * 3
    clock.thread.paused = False
    told = clock.run(5.0, 0.01)
    assert math.isnan(told[0][0])
    for factor, loss in told[1:]:
        assert factor == pytest.approx(1.0, rel=1e-6)
        assert loss < 1e-6


def test_what_was_before_another_factor_or_a_restart_of_time_does_not_count():
    clock = Clockwork(0.01, 1.0)
    clock.run(5.0, 0.01)
    clock.thread.real_time_factor = 4.0
    for restart in (False, True):
        if restart:
            clock.thread.progress = Progress(clock.now_s, 10_000_000)
        (first, _), *others = clock.run(5.0, 0.0025)
        assert math.isnan(first)
        for factor, loss in others:
            assert factor == pytest.approx(4.0, rel=1e-6)
            assert loss < 1e-6


def test_a_simulation_that_hangs_loses_time_before_its_period_ends():
    clock = Clockwork(0.01, 1.0)
    clock.run(5.0, 0.01)
    told = clock.wait(10.0)
    factors, losses = zip(*told)
    assert list(factors[1:]) == sorted(factors[1:], reverse=True)
    assert list(losses[1:]) == sorted(losses[1:])
    # Of the window of a second, and nine more that were due.
    assert factors[-1] == pytest.approx(1.0 / 10.0, rel=0.2)
    assert losses[-1] == pytest.approx(9.0 / 10.0, rel=0.1)


def test_a_free_simulation_loses_nothing_however_slow():
    told = Clockwork(0.01, 1.0, 'free').run(20.0, 0.05)
    assert {loss for _, loss in told} == {0.0}
    assert told[-1][0] == pytest.approx(0.2, rel=1e-6)
