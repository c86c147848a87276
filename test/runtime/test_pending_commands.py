# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which answers lock-step accepts: those to the state that was shown last, and only once."""

import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import CommandError
from manip_sim.runtime.change_queue import PendingCommands

SHOWN_NS, NEXT_NS = 3_600_020_000_000, 3_600_030_000_000


@pytest.fixture
def pending(panda_sim):
    return PendingCommands(panda_sim, {'robot0': ['arm']})


@pytest.fixture
def answer(panda_sim, pending):
    """Return a function that answers the state of a stamp with a command."""
    def give(stamp_ns):
        command = panda_sim.robot.parse.action('arm', [0.1] * 7)
        (handle,) = pending.add([command], stamp_ns, None)
        return handle
    return give


def shown(pending):
    pending.may_answer(SHOWN_NS)


def used(pending):
    shown(pending)
    pending.take()


def cleared(pending):
    shown(pending)
    pending.clear('the simulation was reset')


@pytest.mark.parametrize('before', [lambda pending: None, used, cleared],
                         ids=['at the start', 'used', 'cleared'])
def test_nothing_can_be_answered_until_the_next_state_is_shown(pending, answer, before):
    before(pending)
    for stamp_ns in (SHOWN_NS, NEXT_NS):
        with pytest.raises(CommandError, match='all commands for that state have come already$'):
            answer(stamp_ns)
    assert pending.missing == {'robot0': ['arm']}
    assert pending.take() == []
    pending.may_answer(NEXT_NS)
    answer(NEXT_NS)
    assert pending.complete


def test_only_the_state_that_was_shown_last_can_be_answered(pending, answer):
    shown(pending)
    for stamp_ns in (SHOWN_NS - 1, NEXT_NS):
        with pytest.raises(CommandError, match=(
                f'^lockstep: the command answers the state of 3600.{stamp_ns % 10**9:09d} s, the '
                'present state is that of 3600.020000000 s$')):
            answer(stamp_ns)
    assert not pending.complete
    # What gives no stamp answers whatever is shown.
    assert answer(0).status is Status.WAITING and pending.complete


def test_a_reset_aborts_what_waits(pending, answer):
    shown(pending)
    handle = answer(SHOWN_NS)
    pending.clear('the simulation was reset')
    assert (handle.status, handle.reason) == (Status.ABORTED, 'the simulation was reset')
    assert not pending.complete


@pytest.mark.parametrize(('lockstep_parts', 'sent_ns'), [(None, 123_456_789), ({}, 0)])
def test_a_stamp_tells_when_a_command_was_sent_outside_lock_step_only(panda_sim, lockstep_parts,
                                                                      sent_ns):
    pending = PendingCommands(panda_sim, lockstep_parts)
    stamp_ns = 123_456_789 if lockstep_parts is None else panda_sim.time_ns
    command = panda_sim.robot.parse.action('arm', [0.1] * 7)
    (handle,) = pending.add([command], stamp_ns, None)
    ((_, taken),) = pending.take()
    assert taken.sent_ns == sent_ns
    assert taken.handle is handle is command.handle
