# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the force/torque sensor against weight, pushes, closed forms and finite differences."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from manip_sim.models.arenas import TableArena
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

LOAD_KG = 1.0
#: Six poses of the Panda [rad]: the hand down, up, sideways and between.
POSES = [[0.0, 0.2, 0.0, -2.6, 0.0, 2.9, 0.8], [0.0, 0.2, 0.0, -2.6, 0.0, 1.3, 0.8],
         [0.5, -0.5, 0.3, -1.8, 0.4, 1.9, -0.5], [-1.0, 0.3, -0.6, -1.2, 1.2, 3.2, 1.9],
         [1.5, -0.9, 0.9, -2.2, -1.5, 0.6, -2.0], [0.2, 0.1, 0.0, -0.5, 2.0, 2.2, 0.0]]
EEF, PALM = 'gripper0_right_eef', 'gripper0_right_right_gripper'


@pytest.fixture
def sim_with(panda):
    """Return a function that makes a simulation with a load at the grasp frame."""
    def make(load_kg=0.0):
        gripper = panda.grippers['right'].spec
        eef = gripper.body('eef')
        if load_kg:
            eef.mass = load_kg
            eef.inertia = [1e-4] * 3
            eef.explicitinertial = True
        return Simulation(World([panda]))
    return make


def take_pose(simulation, qpos):
    """Put the arm at rest at a pose and hold it there."""
    simulation.reset()
    simulation.data.qpos[:7] = qpos
    simulation.robot.joints.reset(simulation.data)
    for gripper in simulation.robot.grippers.values():
        gripper.reset(simulation.data)
    for _ in range(20):
        simulation.advance(5)
    return simulation.robot.state().end_effectors['right']


def frame_of(simulation):
    """Return origin and rotation of ft_frame in the world."""
    site = simulation.data.site('gripper0_right_ft_frame')
    return site.xpos.copy(), site.xmat.reshape(3, 3).copy()


def push(simulation, force_in_world, body=EEF):
    """Push at the centre of mass of a body and wait until the arm has come to rest."""
    simulation.data.body(body).xfrc_applied[:3] = force_in_world
    for _ in range(100):
        simulation.advance(5)
    return simulation.robot.state().end_effectors['right']


@pytest.mark.parametrize('pose', POSES)
def test_load_changes_the_wrench_by_its_weight_in_the_frame(panda, sim_with, pose):
    empty = take_pose(Simulation(World([panda])), pose).wrench
    simulation = sim_with(LOAD_KG)
    loaded = take_pose(simulation, pose).wrench
    origin, rotation = frame_of(simulation)
    # The sensor tells what the arm does to the tool: it bears the weight, upwards.
    weight_borne = rotation.T @ [0.0, 0.0, 9.81 * LOAD_KG]
    np.testing.assert_allclose(loaded.force - empty.force, weight_borne,
                               atol=0.01 * 9.81 * LOAD_KG)
    lever = rotation.T @ (simulation.data.body(EEF).xipos - origin)
    np.testing.assert_allclose(loaded.torque - empty.torque, np.cross(lever, weight_borne),
                               atol=0.01 * 9.81 * LOAD_KG * 0.1)


@pytest.mark.parametrize('pose', POSES)
def test_external_wrench_is_zero_without_contact(sim_with, pose):
    end = take_pose(sim_with(LOAD_KG), pose)
    np.testing.assert_allclose(end.external_wrench.force, np.zeros(3), atol=1e-6)
    np.testing.assert_allclose(end.external_wrench.torque, np.zeros(3), atol=1e-6)


@pytest.mark.parametrize('axis', range(3))
def test_push_of_five_newtons_reads_five_newtons(panda_sim, axis):
    before = take_pose(panda_sim, POSES[0]).wrench.force
    origin, rotation = frame_of(panda_sim)
    end = push(panda_sim, rotation[:, axis] * 5.0)
    wanted = 5.0 * np.eye(3)[axis]
    np.testing.assert_allclose(end.external_wrench.force, wanted, atol=0.1)
    np.testing.assert_allclose(end.wrench.force - before, -wanted, atol=0.1)


def test_torque_is_that_about_the_origin_of_the_frame(panda_sim):
    take_pose(panda_sim, POSES[2])
    force = np.array([3.0, -4.0, 2.0])
    end = push(panda_sim, force)
    origin, rotation = frame_of(panda_sim)
    lever = panda_sim.data.body(EEF).xipos - origin
    np.testing.assert_allclose(end.external_wrench.torque, rotation.T @ np.cross(lever, force),
                               atol=1e-6)
    np.testing.assert_allclose(end.external_wrench.force, rotation.T @ force, atol=1e-6)


def test_push_on_a_link_before_the_sensor_does_not_count(panda_sim):
    take_pose(panda_sim, POSES[0])
    end = push(panda_sim, [5.0, 0.0, 5.0], body='robot0_link5')
    np.testing.assert_allclose(end.external_wrench.force, np.zeros(3), atol=1e-6)


def test_push_is_read_within_five_percent_while_the_arm_moves(panda_sim, run):
    take_pose(panda_sim, POSES[0])
    panda_sim.robot.set_control_mode('arm', 'velocity')
    force = np.array([0.0, 0.0, 5.0])
    panda_sim.robot.apply(*panda_sim.robot.parse.joint_command(
        panda_sim.robot.joint_names[:7], velocity=[0.5, -0.3, 0.4, 0.5, -0.8, 0.5, 1.0]))
    panda_sim.data.body(EEF).xfrc_applied[:3] = force
    errors, speeds = [], []

    def compare():
        _, rotation = frame_of(panda_sim)
        end = panda_sim.robot.state().end_effectors['right']
        errors.append(np.linalg.norm(end.external_wrench.force - rotation.T @ force))
        speeds.append(np.linalg.norm(end.twist.linear))

    run(panda_sim, 0.5, compare)
    assert max(speeds) > 0.2
    assert max(errors) < 0.05 * 5.0


def test_fingers_that_press_on_each_other_are_no_external_force(panda_sim, run):
    panda_sim.robot.apply(panda_sim.robot.parse.action('right/gripper', [1.0]))
    run(panda_sim, 1.0)
    assert panda_sim.data.ncon > 0 or np.abs(panda_sim.robot.state().position[7:]).max() < 1e-3
    force = panda_sim.robot.state().end_effectors['right'].external_wrench.force
    np.testing.assert_allclose(force, np.zeros(3), atol=1e-6)


def test_contact_with_a_table_reads_as_a_push(panda):
    # At the start the pads are 1.011 m above the floor, half a pad below that is in the table.
    simulation = Simulation(World([panda], TableArena(table_height_m=1.006)))
    for _ in range(100):
        simulation.advance(5)
    _, rotation = frame_of(simulation)
    force = rotation @ simulation.robot.state().end_effectors['right'].external_wrench.force
    table, total = simulation.model.geom('table_collision').id, np.zeros(3)
    for index in range(simulation.data.ncon):
        contact, result = simulation.data.contact[index], np.empty(6)
        assert table in contact.geom
        mujoco.mj_contactForce(simulation.model, simulation.data, index, result)
        on_second_geom = contact.frame.reshape(3, 3).T @ result[:3]
        total += on_second_geom if contact.geom[0] == table else -on_second_geom
    assert force[2] > 5.0
    np.testing.assert_allclose(force, total, atol=1e-6)


def test_tare_zeroes_the_present_wrench_and_reset_forgets_it(panda_sim):
    take_pose(panda_sim, POSES[0])
    _, rotation = frame_of(panda_sim)
    push(panda_sim, rotation[:, 2] * 5.0)
    panda_sim.robot.tare_wrench()
    tared = panda_sim.robot.state().end_effectors['right']
    np.testing.assert_array_equal(tared.external_wrench.force, np.zeros(3))
    np.testing.assert_array_equal(tared.external_wrench.torque, np.zeros(3))
    released = push(panda_sim, np.zeros(3))
    np.testing.assert_allclose(released.external_wrench.force, [0, 0, -5.0], atol=0.1)
    panda_sim.reset()
    after = panda_sim.robot.state().end_effectors['right'].external_wrench.force
    np.testing.assert_allclose(after, np.zeros(3), atol=1e-6)


def test_velocity_and_pose_agree_with_finite_differences(panda_sim, run):
    panda_sim.robot.set_control_mode('arm', 'velocity')
    panda_sim.robot.apply(*panda_sim.robot.parse.joint_command(
        panda_sim.robot.joint_names[:7], velocity=[0.5, -0.3, 0.4, 0.3, -0.8, 0.5, 1.0]))
    run(panda_sim, 0.3)
    ends = []
    for _ in range(3):
        ends.append(panda_sim.robot.state().end_effectors['right'])
        panda_sim.advance(1)
    before, now, after = ends
    linear = (after.pose.position - before.pose.position) / 0.004
    np.testing.assert_allclose(now.twist.linear, linear, atol=1e-3)
    first, last = (Rotation.from_quat(end.pose.quat_xyzw) for end in (before, after))
    turn = last * first.inv()
    np.testing.assert_allclose(now.twist.angular, turn.as_rotvec() / 0.004, atol=2e-3)
    assert np.linalg.norm(linear) > 0.1


def test_frame_of_the_wrench_is_the_grippers(panda_sim):
    assert panda_sim.robot.end_effectors['right'].ft_frame == 'gripper0_right_ft_frame'
    assert panda_sim.model.site('gripper0_right_ft_frame').bodyid[0] == (
        panda_sim.model.body(PALM).id)
