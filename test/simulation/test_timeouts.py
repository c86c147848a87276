# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of what a part does when its commands stop."""

import pytest

J1 = 'robot0_joint1'


@pytest.fixture
def arm(panda_sim):
    """Return the drive of the Panda's arm with a time-out of 0.2 s."""
    panda_sim.set_command_timeout('arm', 0.2)
    return panda_sim.drive('arm')


def test_position_holds_where_the_way_to_the_goal_has_come_to(panda_sim, arm, run):
    panda_sim.apply(arm.joint_command([J1], [2.0], [], []))
    run(panda_sim, 2.0)
    assert arm.timeouts == 1
    # At the velocity limit of 2.175 rad/s for 0.2 s.
    assert panda_sim.state().position[0] == pytest.approx(0.435, abs=0.03)
    assert abs(panda_sim.state().velocity[0]) < 1e-3


def test_velocity_goes_to_zero(panda_sim, arm, run):
    panda_sim.set_control_mode('arm', 'velocity')
    panda_sim.apply(arm.joint_command([J1], [], [0.5], []))
    run(panda_sim, 0.15)
    assert panda_sim.state().velocity[0] == pytest.approx(0.5, rel=0.02)
    run(panda_sim, 0.5)
    assert abs(panda_sim.state().velocity[0]) < 1e-3
    assert arm.timeouts == 1


def test_effort_goes_to_gravity_compensation(panda_sim, arm, run):
    panda_sim.set_control_mode('arm', 'effort')
    panda_sim.apply(arm.joint_command([J1], [], [], [5.0]))
    run(panda_sim, 0.1)
    assert panda_sim.state().effort[0] == pytest.approx(5.0, abs=1e-6)
    run(panda_sim, 0.2)
    assert panda_sim.state().effort[0] == pytest.approx(panda_sim.data.qfrc_gravcomp[0], abs=1e-9)
    assert arm.timeouts == 1


def test_repeated_commands_keep_a_part_fresh(panda_sim, arm, run):
    panda_sim.set_control_mode('arm', 'velocity')
    for _ in range(5):
        panda_sim.apply(arm.joint_command([J1], [], [0.2], []))
        run(panda_sim, 0.15)
    assert arm.timeouts == 0
    assert panda_sim.state().velocity[0] == pytest.approx(0.2, rel=0.02)


def test_trajectory_is_finished_however_long_it_is(panda_sim, arm, run):
    panda_sim.apply(arm.trajectory([J1], [1.0], [[0.5]], None, None))
    run(panda_sim, 0.9)
    assert arm.timeouts == 0
    run(panda_sim, 0.6)
    assert panda_sim.state().position[0] == pytest.approx(0.5, abs=1e-3)


def test_without_a_timeout_a_command_lasts(panda_sim, arm, run):
    panda_sim.set_command_timeout('arm', 0.0)
    panda_sim.set_control_mode('arm', 'velocity')
    panda_sim.apply(arm.joint_command([J1], [], [0.2], []))
    run(panda_sim, 1.0)
    assert panda_sim.state().velocity[0] == pytest.approx(0.2, rel=0.02)
    assert arm.timeouts == 0
