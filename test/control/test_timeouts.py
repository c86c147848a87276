# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of what a part does when its commands stop."""

import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import UnknownNameError

J1, J2 = 'robot0_joint1', 'robot0_joint2'


@pytest.fixture
def op(panda_op):
    """Return an operator of the Panda whose arm has a timeout of 0.2 s."""
    panda_op.simulation.robot.set_command_timeout('arm', 0.2)
    return panda_op


def timeouts(op, part='arm'):
    return op.simulation.robot.joints.timeouts[part]


def test_position_holds_where_the_way_to_the_goal_has_come_to(op):
    op.go({J1: 2.0})
    op.run(0.2)
    setpoint = op.simulation.robot.controller_state('arm').reference
    op.run(2.0)
    assert timeouts(op) == 1
    assert abs(op.speed(J1)) < 1e-3
    # It brakes within its acceleration limit, not at once and not at the goal.
    limit = op.simulation.robot.joints.servos.acceleration_limit[0]
    way = setpoint.velocity[0]**2 / (2.0 * limit)
    assert op.where(J1)[0] == pytest.approx(setpoint.position[0] + way, abs=1e-3)
    assert 0.05 < way < 0.5


def test_velocity_goes_to_zero(op):
    op.simulation.robot.set_control_mode('arm', 'velocity')
    op.go({J1: 0.5}, 'velocity')
    op.run(0.15)
    assert op.speed(J1) == pytest.approx(0.5, rel=0.02)
    op.run(0.5)
    assert abs(op.speed(J1)) < 1e-3
    assert timeouts(op) == 1


def test_effort_goes_to_gravity_compensation(op):
    op.simulation.robot.set_control_mode('arm', 'effort')
    op.go({J1: 5.0, J2: 3.0}, 'effort')
    op.run(0.1)
    gravity = op.simulation.data.qfrc_gravcomp
    effort = op.simulation.robot.state().effort
    # The effort is that of the last step, the weight that of its end.
    assert effort[:2] - gravity[:2] == pytest.approx([5.0, 3.0], abs=0.01)
    op.run(0.2)
    before = gravity[:2].copy()
    op.simulation.advance(1)
    assert op.simulation.robot.state().effort[:2] == pytest.approx(before, abs=1e-9)
    assert timeouts(op) == 1


def test_repeated_commands_keep_a_part_fresh(op):
    op.simulation.robot.set_control_mode('arm', 'velocity')
    for _ in range(5):
        op.go({J1: 0.2}, 'velocity')
        op.run(0.15)
    assert timeouts(op) == 0
    assert op.speed(J1) == pytest.approx(0.2, rel=0.02)


def test_trajectory_is_finished_however_long_it_is_and_counts_no_time_out(op):
    command = op.follow('arm', [J1], [1.0], [[0.5]])
    op.run(2.0)
    assert command.handle.status is Status.DONE
    assert timeouts(op) == 0
    assert op.where(J1)[0] == pytest.approx(0.5, abs=1e-3)


def test_trajectory_that_starts_later_does_not_time_out_before(op):
    command = op.follow('arm', [J1], [0.5], [[0.3]], start_ns=10**9)
    op.run(2.0)
    assert command.handle.status is Status.DONE
    assert timeouts(op) == 0


def test_trajectory_that_lags_behind_is_not_cut(op):
    limits = op.simulation.model.joint(J1).range
    # Something is in the way for a while.
    high, limits[1] = limits[1], 0.0
    command = op.follow('arm', [J1], [0.5], [[0.4]])
    op.run(0.45)
    assert op.where(J1)[0] == pytest.approx(0.0, abs=0.01)
    limits[1] = high
    op.run(1.5)
    assert command.handle.status is Status.DONE
    assert timeouts(op) == 0
    assert op.where(J1)[0] == pytest.approx(0.4, abs=1e-2)


def test_goal_beside_a_trajectory_times_out_after_its_end(op):
    command = op.follow('arm', [J1], [0.5], [[0.3]])
    (goal,) = op.go({J2: 1.5})
    op.run(0.45)
    assert timeouts(op) == 0
    op.run(0.5)
    assert command.handle.status is Status.DONE
    assert goal.status in (Status.ABORTED, Status.DONE)
    # The hand lies on the floor by then, which holds the joint back by some milliradians.
    setpoint = op.simulation.robot.controller_state('arm').reference
    assert setpoint.position[0] == pytest.approx(0.3, abs=1e-3)


def test_without_a_timeout_a_command_lasts(op):
    op.simulation.robot.set_command_timeout('arm', 0.0)
    op.simulation.robot.set_control_mode('arm', 'velocity')
    op.go({J1: 0.2}, 'velocity')
    op.run(1.0)
    assert op.speed(J1) == pytest.approx(0.2, rel=0.02)
    assert timeouts(op) == 0


def test_timeout_that_is_raised_from_zero_counts_from_the_last_command(panda_op):
    panda_op.simulation.robot.set_control_mode('arm', 'velocity')
    panda_op.go({J1: 0.1}, 'velocity')
    panda_op.run(2.0)
    panda_op.simulation.robot.set_command_timeout('arm', 5.0)
    panda_op.run(2.9)
    assert timeouts(panda_op) == 0
    panda_op.run(0.2)
    assert timeouts(panda_op) == 1


def test_timeout_that_is_lowered_fires(panda_op):
    panda_op.simulation.robot.set_control_mode('arm', 'velocity')
    panda_op.simulation.robot.set_command_timeout('arm', 100.0)
    panda_op.go({J1: 0.1}, 'velocity')
    panda_op.run(0.5)
    panda_op.simulation.robot.set_command_timeout('arm', 0.1)
    panda_op.run(0.02)
    assert timeouts(panda_op) == 1


def test_command_of_another_mode_does_not_keep_a_part_fresh(op):
    stale = [op.simulation.robot.parse.joint_command([J1], [0.5])[0] for _ in range(4)]
    op.simulation.robot.set_control_mode('arm', 'velocity')
    op.go({J1: 0.2}, 'velocity')
    for command in stale:
        op.run(0.06)
        op.simulation.robot.apply(command)
    assert [c.handle.status for c in stale] == [Status.ABORTED] * 4
    assert timeouts(op) == 1


def test_part_that_was_never_commanded_does_not_time_out(op):
    op.run(1.0)
    assert timeouts(op) == 0


def test_timeout_is_counted_once_until_the_next_command(op):
    op.go({J1: 0.1})
    op.run(1.0)
    assert timeouts(op) == 1
    op.go({J1: 0.2})
    op.run(1.0)
    assert timeouts(op) == 2


def test_reset_forgets_the_last_command(op):
    op.go({J1: 0.1})
    op.simulation.reset()
    op.run(1.0)
    assert timeouts(op) == 0


def test_timeout_of_an_unknown_part_tells_what_there_is(op):
    with pytest.raises(UnknownNameError, match=r"^unknown part 'head': available: arm, right$"):
        op.simulation.robot.set_command_timeout('head', 1.0)
