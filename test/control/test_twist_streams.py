# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Twists that come regularly are followed evenly, however short the control periods are."""

from end_effector_operator import operator_of
import numpy as np
import pytest

INTERVAL_S = 0.01


def along_a_circle(op, messages=100, begin=50, lose=()):
    """Follow twists at 100 Hz along a circle; return times [s], velocities there and of joints."""
    periods = round(INTERVAL_S / op.period_s)
    steps = round(op.period_s / op.simulation.timestep_s)
    found = []
    for message in range(messages):
        time_s = message * INTERVAL_S
        size = 0.1 * min(1.0, 2.0 * time_s)
        if message not in lose:
            op.move_at([size * np.sin(6.0 * time_s), size * np.cos(6.0 * time_s), 0.0],
                       [0.0, 0.0, 0.3 * np.sin(3.0 * time_s)])
        for period in range(periods):
            op.simulation.advance(steps)
            if message >= begin:
                _, speeds, _ = np.split(op.robot.measured('arm'), 3)
                found.append((time_s + (period + 1) * op.period_s, op.twist, speeds))
    return tuple(np.array(of) for of in zip(*found))


def accelerations(op, speeds):
    return np.abs(np.diff(speeds, axis=0)).max(axis=0) / op.period_s


@pytest.mark.full
@pytest.mark.parametrize('name', ['Panda', 'UR5e', 'Baxter'])
def test_short_control_periods_need_no_more_acceleration_than_those_of_the_stream(name):
    often, seldom = operator_of(name, period_s=0.002), operator_of(name, period_s=INTERVAL_S)
    _, _, speeds = along_a_circle(often)
    _, _, coarse = along_a_circle(seldom)
    needed = accelerations(seldom, coarse)
    assert needed.max() > 0.5
    assert (accelerations(often, speeds) < 1.2 * needed + 0.1).all()


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'velocity', 'effort'])
@pytest.mark.parametrize('period_s', [0.002, INTERVAL_S])
def test_the_end_effector_has_each_velocity_when_the_next_one_is_due(mode, period_s):
    op = operator_of('Panda', mode=mode, period_s=period_s)
    times, twists, _ = along_a_circle(op)
    sent = times - INTERVAL_S
    wanted = 0.1 * np.stack([np.sin(6.0 * sent), np.cos(6.0 * sent)], axis=1)
    assert np.abs(twists[:, :2] - wanted).max() < (0.002 if mode != 'effort' else 0.004)


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'effort'])
def test_a_lost_twist_is_bridged(mode):
    kept, lossy = operator_of('Panda', mode=mode, period_s=0.002), operator_of(
        'Panda', mode=mode, period_s=0.002)
    _, twists, speeds = along_a_circle(kept)
    _, others, disturbed = along_a_circle(lossy, lose=(70,))
    assert np.abs(twists - others)[:, :3].max() < (0.01 if mode == 'position' else 0.02)
    assert (accelerations(lossy, disturbed) < 3.0 * accelerations(kept, speeds) + 0.5).all()
