# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a simulation knows of a robot at its start."""

import mujoco
import pytest
from sampling import whole_robot

from manip_sim.models import compose
from manip_sim.simulation import Simulation


def test_the_joints_of_a_twist_are_those_of_a_mobile_base_and_others_have_none():
    assert whole_robot('Panda').robot.twist_joints == ()
    base = whole_robot('PandaOmron').robot.twist_joints
    assert [next(word for word in ('forward', 'side', 'yaw') if word in joint)
            for joint in base] == ['forward', 'side', 'yaw']


@pytest.mark.skipif(mujoco.mj_version() < 3017000, reason='this MuJoCo keeps all shapes of a spec')
def test_shapes_that_are_only_seen_are_left_out_unless_they_are_wanted():
    world = compose('Panda')
    seen, simulated = Simulation(world, visual=True).model, Simulation(world).model
    assert simulated.ngeom < seen.ngeom
    collides = (seen.geom_contype != 0) | (seen.geom_conaffinity != 0)
    assert simulated.ngeom >= collides.sum()
    assert (simulated.nq, simulated.nu) == (seen.nq, seen.nu)


def test_no_command_has_come_too_late_at_the_start():
    timeouts = whole_robot('PandaOmron').robot.joints.timeouts
    assert {'arm', 'torso', 'base'} <= set(timeouts) and set(timeouts.values()) == {0}


@pytest.mark.parametrize('part', ['arm', 'right/gripper'])
def test_a_robot_moves_and_does_not_rest_while_its_joints_or_its_fingers_move(panda_sim, part):
    robot = panda_sim.robot
    panda_sim.advance(1)
    assert robot.resting and not robot.moving
    length = robot.grippers[part].dof if part in robot.grippers else 7
    robot.apply(robot.parse.action(part, [0.5] * length))
    panda_sim.advance(1)
    assert robot.moving and not robot.resting
