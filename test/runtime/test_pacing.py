# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of deadlines; time is told, so nothing here waits."""

import pytest

from manip_sim.runtime.simulation_thread import Pacer


def count_due(pacer, until_s, tick_s, start_s=0.0):
    """Ask in ticks of wall time and count the periods that are due."""
    ticks = round((until_s - start_s) / tick_s)
    return sum(pacer.is_due(start_s + (i + 1) * tick_s) for i in range(ticks))


def test_first_period_is_due_one_period_after_the_start():
    pacer = Pacer(0.01, 1.0, now_s=5.0)
    assert pacer.deadline_s == pytest.approx(5.01)
    assert not pacer.is_due(5.0099)
    assert pacer.is_due(5.0101)
    assert not pacer.is_due(5.0102)


def test_a_hundred_thousand_deadlines_do_not_drift():
    pacer = Pacer(0.002, 1.0, now_s=0.0)
    for n in range(1, 100_001):
        assert pacer.is_due(n * 0.002 + 1e-6)
    assert pacer.deadline_s == pytest.approx(100_001 * 0.002, abs=1e-9)
    assert pacer.missed == 0


def test_late_answers_do_not_shift_the_later_deadlines():
    pacer = Pacer(0.01, 1.0, now_s=0.0)
    for n in range(1, 101):
        assert pacer.is_due(n * 0.01 + (0.004 if n % 3 else 0.0001))
    assert pacer.deadline_s == pytest.approx(1.01)


@pytest.mark.parametrize(('factor', 'periods'), [(0.5, 50), (1.0, 100), (2.0, 200)])
def test_factor_is_simulation_time_per_wall_time(factor, periods):
    pacer = Pacer(0.01, factor, now_s=0.0)
    assert count_due(pacer, 1.0005, 0.0005) == periods


def test_small_backlog_is_caught_up():
    pacer = Pacer(0.01, 1.0, now_s=0.0, backlog_s=0.1)
    answers = [pacer.is_due(0.055) for _ in range(7)]
    assert answers == [True] * 5 + [False] * 2
    assert pacer.missed == 0


def test_large_backlog_is_dropped_and_counted():
    pacer = Pacer(0.01, 1.0, now_s=0.0, backlog_s=0.1)
    answers = [pacer.is_due(1.005) for _ in range(3)]
    assert answers == [True, False, False]
    # Of the hundred periods that were due one is run.
    assert pacer.missed == 99
    assert pacer.deadline_s == pytest.approx(1.015)


def test_backlog_is_dropped_when_it_is_longer_than_a_tenth_of_a_second():
    late, too_late = (Pacer(0.01, 1.0, now_s=0.0) for _ in range(2))
    assert sum(late.is_due(0.01 + 0.099) for _ in range(20)) == 10
    assert late.missed == 0
    assert sum(too_late.is_due(0.01 + 0.101) for _ in range(20)) == 1
    assert too_late.missed == 10


def test_change_of_the_factor_makes_no_burst():
    pacer = Pacer(0.01, 0.1, now_s=0.0)
    assert not pacer.is_due(0.099)
    pacer.set_real_time_factor(10.0, now_s=0.099)
    assert not pacer.is_due(0.0995)
    assert pacer.is_due(0.1001)
    assert not pacer.is_due(0.1002)
    assert pacer.missed == 0


def test_restart_makes_no_burst_after_a_pause():
    pacer = Pacer(0.01, 1.0, now_s=0.0)
    pacer.restart(50.0)
    assert not pacer.is_due(50.005)
    assert pacer.is_due(50.0101)
    assert not pacer.is_due(50.0102)
    assert pacer.missed == 0


def test_time_that_is_lost_in_parts_of_periods_adds_up():
    # A period of 1/3 s of wall time that takes 0.4 s: of three seconds half a second is lost.
    pacer = Pacer(1.0, 3.0, now_s=0.0)
    now_s, periods = 0.0, 0
    while now_s < 100.0:
        now_s = max(now_s, pacer.deadline_s)
        assert pacer.is_due(now_s)
        now_s += 0.4
        periods += 1
    # The last period and the backlog that is still made up for are not lost.
    assert 0.0 < 3.0 * now_s - periods - pacer.lost_s < 1.5
    assert pacer.missed == pytest.approx(50, abs=1)
