# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Motions until contact: what ends them, and what is reported."""

import math
import pickle

from end_effector_operator import operator_of
import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import CommandError, UnknownNameError

DOWN = [0.0, 0.0, -0.05]


def guarded(op, linear=DOWN, force=5.0, distance=0.4, duration_s=12.0, frame=''):
    """Begin a motion until contact; return its handle."""
    return op.apply(op.robot.parse_cartesian.until_contact(
        'right', linear, [0.0] * 3, force=force, distance=distance, duration_s=duration_s,
        frame=frame))


def rests(op):
    op.run(0.5)
    before = op.pose[0]
    op.run(0.5)
    return np.abs(op.pose[0] - before).max() < 1e-4 and np.abs(op.twist).max() < 2e-3


@pytest.mark.parametrize('mode', [
    'position', pytest.param('velocity', marks=pytest.mark.full), 'effort'])
def test_contact_ends_a_motion_and_is_reported_where_it_was(mode):
    op = operator_of('Panda', mode=mode, arena='table', contacts=True)
    start = op.pose[0]
    handle = guarded(op)
    op.run_until_done([handle], 10.0)
    contact = op.report.contact
    assert handle.status is Status.DONE and contact.cause == 'contact'
    peak = np.linalg.norm(contact.wrench[:3])  # An impact, with stiff servos.
    assert 5.0 <= peak < 150.0
    assert contact.distance == pytest.approx(np.linalg.norm(contact.position - start), abs=1e-9)
    assert contact.duration_s == pytest.approx(contact.distance / 0.05, abs=0.2)
    assert rests(op)
    np.testing.assert_allclose(op.pose[0], contact.position, atol=1e-3)
    force = op.robot.state().end_effectors['right'].external_wrench.force
    assert np.linalg.norm(force) < peak


@pytest.mark.parametrize('speed', [0.02, 0.1])
def test_a_stiff_arm_that_has_stopped_presses_no_more_than_the_force_that_ended_its_motion(speed):
    op = operator_of('Panda', arena='table', contacts=True)
    op.run_until_done([guarded(op, [0.0, 0.0, -speed])], 15.0)
    assert op.report.contact.cause == 'contact'
    op.run(0.5)
    force = op.robot.state().end_effectors['right'].external_wrench.force
    assert np.linalg.norm(force) < 5.0
    np.testing.assert_allclose(op.pose[0], op.report.contact.position, atol=2e-3)


@pytest.mark.parametrize(('limits', 'cause'), [
    ({'distance': 0.1}, 'distance'), ({'duration_s': 1.234}, 'time')])
def test_distance_and_time_end_a_motion(limits, cause):
    op = operator_of('UR5e')
    handle = guarded(op, **limits)
    op.run(3.0)
    contact = op.report.contact
    assert handle.status is Status.DONE and contact.cause == cause
    if cause == 'distance':
        assert 0.1 <= contact.distance < 0.1 + 0.05 * 0.011
    else:
        assert 1.234 <= contact.duration_s < 1.234 + 0.011
    assert rests(op)
    np.testing.assert_allclose(op.pose[0], contact.position, atol=1e-4)


@pytest.mark.parametrize('mode', ['position', 'effort'])
def test_a_timeout_of_commands_does_not_end_a_motion_that_has_its_own_end(mode):
    op = operator_of('UR5e', mode=mode)
    op.robot.set_command_timeout('arm', 0.3)
    handle = guarded(op, distance=0.05)
    assert op.robot.busy_parts == {'arm'}
    op.run(2.0)
    assert handle.status is Status.DONE and op.report.contact.cause == 'distance'
    assert op.robot.busy_parts == frozenset() and rests(op)
    assert op.robot.joints.timeouts == {'arm': 0}
    op.simulation.data.qfrc_applied[op.part.dof_addresses[0]] = 3.0
    op.run(1.0)
    assert abs(op.robot.state().velocity[0]) < 1e-2  # It holds the arm.


def test_it_needs_no_fresh_messages_and_a_newer_command_takes_the_arm():
    op = operator_of('UR5e')
    handle = guarded(op)
    op.run(1.0)
    assert handle.is_active and op.twist[2] == pytest.approx(-0.05, rel=0.05)
    op.go_to(op.pose)
    assert handle.status is Status.REPLACED
    op.run(12.0)
    assert op.report.contact is None
    first, second = guarded(op), guarded(op, [0.0, 0.0, 0.05], distance=0.02)
    op.run(1.0)
    assert first.status is Status.REPLACED and second.status is Status.DONE


def test_a_late_motion_ends_by_the_force_whether_somebody_reads_it_or_not():
    outcomes = []
    for reads in (False, True):
        op = operator_of('Panda')
        op.robot.set_payload('right', 1.0)  # It holds nothing, so the world seems to lift it.
        op.robot.sensing.set('latency.command', 0.014)
        handle = guarded(op)
        for _ in range(3):
            op.run(0.01)
            if reads:
                op.robot.state()
        assert handle.status is Status.DONE and op.report.contact.cause == 'contact'
        outcomes.append((op.report.contact.duration_s, op.simulation.digest()))
    assert outcomes[0] == outcomes[1] and outcomes[0][0] == 0.0


def test_what_touches_already_ends_it_at_once():
    op = operator_of('Panda', arena='table', contacts=True)
    op.run_until_done([guarded(op)], 10.0)
    again = guarded(op, force=0.5)
    op.run(0.02)
    assert again.status is Status.DONE and op.report.contact.duration_s < 0.02


def test_a_reset_ends_it_and_a_restored_state_goes_on_to_the_same_bits():
    op = operator_of('Panda')
    guarded(op, distance=0.06)
    op.run(0.5)
    saved = pickle.dumps(op.simulation.save())
    op.run(1.0)
    assert op.report.contact.cause == 'distance'
    digest = op.simulation.digest()
    op.simulation.restore(pickle.loads(saved))
    op.run(1.0)
    assert op.simulation.digest() == digest
    handle = guarded(op)
    op.simulation.reset()
    assert handle.status is Status.ABORTED


@pytest.mark.parametrize(('change', 'message'), [
    ({'force': 0.0}, 'force of a motion until contact must be positive'),
    ({'distance': math.nan}, 'distance of a motion until contact'),
    ({'duration_s': -1.0}, 'duration of a motion until contact'),
    ({'linear': [0.0, 0.0, math.inf]}, 'finite'), ({'frame': 'flange'}, 'unknown frame')])
def test_limits_that_are_no_limits_are_rejected(change, message):
    op = operator_of('UR5e')
    digest = op.simulation.digest()
    with pytest.raises(CommandError, match=message):
        guarded(op, **change)
    with pytest.raises(UnknownNameError, match='left'):
        op.robot.parse_cartesian.until_contact(
            'left', DOWN, [0.0] * 3, force=1.0, distance=1.0, duration_s=1.0)
    assert op.simulation.digest() == digest
