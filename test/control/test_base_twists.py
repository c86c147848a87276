# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A mobile base follows a stream of twists evenly, and forgets one that has ended."""

import numpy as np
import pytest

from sampling import whole_robot

PERIOD_S = 0.002


class Base:
    """A base that is driven in control periods of one physics step."""

    def __init__(self, name='PandaOmron'):
        self.simulation = whole_robot(name)
        self.robot = self.simulation.robot
        self.dofs = self.robot.parts['base'].dof_addresses
        self.robot.set_control_mode('base', 'velocity')
        self.speeds, self.efforts = [], []

    @property
    def limit(self):
        joints = self.robot.joints
        return joints.servos.acceleration_limit[joints.indices_of('base')]

    @property
    def accelerations(self):
        return np.abs(np.diff(self.speeds, axis=0)).max(axis=0) / PERIOD_S

    def drive(self, seconds, rate, twist):
        """Send twists at a rate, as a function of time [s]; None sends none."""
        for period in range(round(seconds / PERIOD_S)):
            if period % round(1.0 / rate / PERIOD_S) == 0:
                wanted = twist(period * PERIOD_S)
                if wanted is not None:
                    self.robot.apply(self.robot.parse.twist(*wanted), period_s=PERIOD_S)
            self.simulation.advance(1)
            data = self.simulation.data
            self.speeds.append(data.qvel[self.dofs].copy())
            self.efforts.append(data.qfrc_actuator[self.dofs].copy())


@pytest.mark.full
@pytest.mark.parametrize('rate', [10, 20, 50, 500])
def test_a_stream_of_twists_needs_no_more_acceleration_than_its_own(rate):
    base = Base()
    base.drive(2.0, rate, lambda t: (0.3 * np.sin(np.pi * t), 0.0, 0.4 * np.sin(np.pi * t)))
    own = np.pi * np.array([0.3, 0.3, 0.4])
    base.speeds, base.efforts = base.speeds[250:], base.efforts[250:]
    # It turns meanwhile, so that the joint along y moves too.
    assert (base.accelerations < 1.1 * own).all()
    assert base.accelerations[0] > 0.8 * own[0]


def test_a_jump_keeps_the_acceleration_limit_and_is_reached():
    base = Base()
    base.drive(0.6, 20, lambda t: (0.5, 0.0, 0.0))
    assert base.speeds[-1] == pytest.approx([0.5, 0.0, 0.0], abs=1e-3)
    assert (base.accelerations < 1.05 * base.limit).all()


def test_after_another_command_a_twist_begins_a_stream_from_the_present_velocity():
    base = Base()
    base.drive(0.5, 50, lambda t: (0.4, 0.0, 0.0))
    names = list(base.robot.parts['base'].driven_joints)
    base.robot.apply(*base.robot.parse.joint_command(names, velocity=[0.0, 0.0, 0.0]),
                     period_s=PERIOD_S)
    base.drive(0.02, 50, lambda t: None)
    slow = base.speeds[-1][0]
    base.speeds.clear()
    base.drive(0.3, 50, lambda t: (0.1, 0.0, 0.0))
    assert 0.2 < slow < 0.4
    assert (base.accelerations < 1.05 * base.limit).all()
    assert base.speeds[-1][0] == pytest.approx(0.1, abs=1e-3)
    assert max(speeds[0] for speeds in base.speeds) < slow + 1e-3


def test_a_reset_forgets_the_stream():
    fresh, driven = Base(), Base()
    driven.drive(0.2, 50, lambda t: (0.4, 0.0, 0.1))
    driven.simulation.reset()
    fresh.simulation.reset()
    assert driven.simulation.digest() == fresh.simulation.digest()


@pytest.mark.full
@pytest.mark.parametrize(('name', 'taken'), [
    *(('PandaOmron', taken) for taken in ([0], [1], [2], [0, 1], [1, 2], [0, 1, 2])),
    *(('Tiago', taken) for taken in ([0], [1, 2], [0, 1, 2]))])
def test_joints_taken_by_a_newer_command_leave_the_others_to_the_twist(name, taken):
    base, twist = Base(name), (0.3, 0.0, 0.4)
    base.drive(0.5, 20, lambda t: twist)
    joints = np.array(base.robot.parts['base'].driven_joints)
    base.robot.apply(*base.robot.parse.joint_command(joints[taken], velocity=[0.1] * len(taken)),
                     period_s=PERIOD_S)
    base.drive(0.4, 20, lambda t: None)
    yaw = base.simulation.data.joint(joints[2]).qpos[0]
    expected = np.array([0.3 * np.cos(yaw), 0.3 * np.sin(yaw), 0.4])
    expected[taken] = 0.1
    assert base.speeds[-1] == pytest.approx(expected, abs=0.01)
    # The next twist has them all again.
    base.drive(0.5, 20, lambda t: twist)
    yaw = base.simulation.data.joint(joints[2]).qpos[0]
    assert base.speeds[-1] == pytest.approx(
        [0.3 * np.cos(yaw), 0.3 * np.sin(yaw), 0.4], abs=0.01)


def in_own_frame(base, seconds, twist):
    """Send a twist at 50 Hz, or None; return the twist of the base after each, shape (n, 3)."""
    velocities = []
    for _ in range(round(seconds * 50)):
        base.drive(0.02, 50, lambda t: twist)
        x, y, turning = base.speeds[-1]
        yaw = base.simulation.data.qpos[base.robot.parts['base'].qpos_addresses[2]]
        cos, sin = np.cos(yaw), np.sin(yaw)
        velocities.append([cos * x + sin * y, cos * y - sin * x, turning])
    return np.array(velocities)


@pytest.mark.full
@pytest.mark.parametrize(('name', 'turning'), [
    ('PandaOmron', 0.0), ('PandaOmron', 1.0), ('Tiago', 1.0)])
def test_a_base_does_not_slide_sideways_when_it_speeds_up_turns_and_times_out(name, turning):
    base = Base(name)
    base.robot.set_command_timeout('base', 0.5)
    # It turns on the spot first, so that neither slide joint lies along it.
    base.drive(1.2, 50, lambda t: (0.0, 0.0, 0.5))
    base.drive(1.0, 50, lambda t: (0.0, 0.0, 0.0))
    base.speeds.clear()
    driven = in_own_frame(base, 5.0, (0.9, 0.0, turning))
    assert driven[-1] == pytest.approx([0.9, 0.0, turning], abs=2e-3)
    assert np.abs(driven[:, 1]).max() < 2e-3
    rounding_the_bend = 2.0 * 0.9 * turning
    assert (base.accelerations[:2] < 1.1 * max(base.limit[0], rounding_the_bend)).all()
    braking = in_own_frame(base, 4.0, None)
    assert base.robot.joints.timeouts['base'] == 1
    assert np.abs(braking[:, 1]).max() < 2e-3
    assert np.abs(braking[-1]).max() < 1e-6
    assert base.robot.joints.resting
