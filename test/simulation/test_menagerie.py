# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests with models of Menagerie, unmodified, where a checkout is named by MENAGERIE_ROOT."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.simulation.simulation import Simulation

PAIRS = {
    'an iiwa with our gripper': ('menagerie:kuka_iiwa_14', 'Robotiq85Gripper', 'default'),
    'our Panda with an Allegro hand': (
        'Panda', 'menagerie:wonik_allegro/right_hand.xml', 'default')}
PERIOD_S = 0.01


@pytest.fixture(params=PAIRS)
def simulation(request):
    """Return a simulation of an arm and a hand of which one is Menagerie's."""
    root = os.environ.get('MENAGERIE_ROOT')
    if not root:
        pytest.skip('MENAGERIE_ROOT names no checkout of Menagerie')
    robot, gripper, base = PAIRS[request.param]
    for name in (robot, gripper):
        folder = name.partition(':')[2].partition('/')[0]
        if folder and not (Path(root) / folder).is_dir():
            pytest.skip(f'MENAGERIE_ROOT has no {folder}')
    return Simulation(compose(robot, gripper, base))


def followed(simulation, mode):
    """Move all arm joints along a sine; return goals and what was reached, shape (n, joints)."""
    robot = simulation.robot
    names = robot.robot_model.arm_joints
    index = robot.indices_of['arm']
    start = simulation.robot.state().position[index]
    simulation.robot.set_control_mode('arm', mode)
    goals, reached = [], []
    for tick in range(300):
        phase = 2.0 * np.pi * 0.5 * tick * PERIOD_S
        if mode == 'position':
            goal, fields = start + 0.1 * np.sin(phase), ('position',)
        else:
            goal, fields = np.full(len(names), 0.1 * np.pi * np.cos(phase)), ('velocity',)
        robot.apply(*robot.parse.joint_command(names, **{fields[0]: goal}), period_s=PERIOD_S)
        simulation.advance(round(PERIOD_S / simulation.timestep_s))
        goals.append(goal)
        reached.append(getattr(simulation.robot.state(), mode)[index])
    return np.array(goals), np.array(reached)


def test_the_start_pose_is_held_for_ten_seconds(simulation):
    start = simulation.robot.state().position
    for _ in range(100):
        simulation.advance(50)
        np.testing.assert_allclose(simulation.robot.state().position, start, atol=5e-3)


@pytest.mark.parametrize(('mode', 'tolerance'), [('position', 0.01), ('velocity', 0.05)])
def test_the_arm_follows_a_sine(simulation, mode, tolerance):
    goals, reached = followed(simulation, mode)
    np.testing.assert_allclose(reached[50:], goals[49:-1], atol=tolerance)


def test_the_hand_opens_and_closes(simulation):
    part = 'right/gripper'
    gripper = simulation.robot.grippers[part].part.gripper
    spreads = []
    for closing in (-1.0, 1.0):
        simulation.reset()
        simulation.robot.apply(simulation.robot.parse.action(part, np.full(gripper.dof, closing)))
        simulation.advance(round(3.0 / simulation.timestep_s))
        spreads.append(spread(simulation, gripper))
    assert spreads[1] < 0.95 * spreads[0]


def spread(simulation, gripper):
    """Return how far the ends of the fingers are from each other and the palm, at the mean [m]."""
    model, data = simulation.model, simulation.data
    mujoco.mj_kinematics(model, data)
    ends = [name for name in gripper.bodies if not name.endswith('eef')
            and not (model.body_parentid == model.body(name).id).any()]
    points = np.array([data.body(name).xipos for name in [*ends, gripper.root_body]])
    return float(np.linalg.norm(points[:, None] - points[None], axis=2).mean())


def test_the_joints_and_limits_are_those_of_the_files(simulation):
    for part, source in (('arm', PAIRS['an iiwa with our gripper'][0]),):
        if simulation.robot.robot_model.name.startswith('Panda'):
            continue
        folder = Path(os.environ['MENAGERIE_ROOT']) / source.partition(':')[2]
        original = mujoco.MjModel.from_xml_path(str(folder / 'iiwa14.xml'))
        for joint in simulation.robot.parts[part].joints:
            expected = original.joint(joint.removeprefix('robot0_'))
            np.testing.assert_allclose(simulation.model.joint(joint).range, expected.range)
