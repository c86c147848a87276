# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the force/torque sensor against weight, pushes, closed forms and finite differences."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.arenas import TableArena
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

LOAD_KG = 1.0
#: Six poses of the Panda [rad]: the end effector down, up, sideways and between.
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


def force_in_world(simulation):
    """Return the external force in the axes of the world [N]."""
    force = simulation.robot.state().end_effectors['right'].external_wrench.force
    return frame_of(simulation)[1] @ force


BALL_KG, GRAVITY = 0.2, np.array([0.0, 0.0, -9.81])


@pytest.fixture
def thrown(panda):
    """Return a function that makes a simulation in which a ball flies towards the end effector."""
    def make():
        simulation = Simulation(World([panda], objects=[{
            'name': 'ball', 'shape': 'sphere', 'size': 0.03, 'mass': BALL_KG,
            'position': [2.0, 0.0, 1.0]}]))
        for _ in range(20):
            simulation.advance(5)
        ball = simulation.data.joint('ball_joint')
        ball.qpos[:3] = simulation.data.site('gripper0_right_ft_frame').xpos + [0.3, 0.0, -0.04]
        ball.qvel[:3] = [-2.0, 0.0, 0.6]
        return simulation, ball.qvel
    return make


@pytest.mark.full
@pytest.mark.parametrize('moves', [False, True])
@pytest.mark.parametrize('steps', [1, 5, 50])
def test_the_external_force_of_each_period_is_the_change_of_momentum_of_a_ball(
        thrown, steps, moves):
    simulation, velocity = thrown()
    robot, period_s, forces = simulation.robot, steps * simulation.timestep_s, []
    if moves:
        robot.apply(*robot.parse.joint_command(['robot0_joint6'], [3.5]), period_s=period_s)
    for _ in range(150 // steps):
        before = velocity[:3].copy()
        simulation.advance(steps)
        by_gravity = BALL_KG * GRAVITY * period_s
        forces.append((by_gravity - BALL_KG * (velocity[:3] - before)) / period_s)
        np.testing.assert_allclose(force_in_world(simulation), forces[-1], atol=1e-6)
    # It was stopped or bounced off within a period of 0.1 s, or within ten of 0.01 s.
    impulse = np.sum(forces, axis=0) * period_s
    assert impulse[0] < -0.9 * BALL_KG * 2.0
    assert not forces[0].any() or np.abs(forces[0]).max() < 1e-6


def test_the_torque_of_a_period_is_the_moment_of_a_ball_without_friction(thrown):
    simulation, _ = thrown()
    simulation.model.geom_friction[:] = 0.0
    ball, touched = simulation.data.body('ball'), 0
    for _ in range(150):
        origin, rotation = frame_of(simulation)
        # A spring leads it to a point in the hand, beside the middle: it hits the hand, and stays.
        ball.xfrc_applied[:3] = 500.0 * (origin + rotation @ [0.05, 0.0, 0.04] - ball.xpos)
        middle = ball.xpos.copy()
        simulation.advance(1)
        end = simulation.robot.state().end_effectors['right'].external_wrench
        # The force goes through the middle of the ball, where that was at the begin of the step.
        origin, rotation = frame_of(simulation)
        moment = np.cross(rotation.T @ (middle - origin), end.force)
        np.testing.assert_allclose(
            end.torque, moment, atol=1e-4 * np.linalg.norm(end.force) + 1e-9)
        touched += np.linalg.norm(moment) > 0.1
    assert touched > 50


@pytest.mark.full
@pytest.mark.parametrize('steps', [1, 5, 20])
def test_the_cutoff_is_that_of_a_low_pass_in_simulated_time(panda_sim, steps):
    take_pose(panda_sim, POSES[0])
    panda_sim.robot.set_wrench_cutoff('right', 3.0)
    panda_sim.data.body(EEF).xfrc_applied[:3] = [0.0, 0.0, 5.0]
    seconds = 0.0
    for _ in range(100 // steps):
        panda_sim.advance(steps)
        seconds += steps * panda_sim.timestep_s
        wanted = 5.0 * -np.expm1(-2.0 * np.pi * 3.0 * seconds)
        assert np.linalg.norm(panda_sim.robot.state().end_effectors[
            'right'].external_wrench.force) == pytest.approx(wanted, rel=1e-3)
    panda_sim.data.body(EEF).xfrc_applied[:3] = 0.0
    panda_sim.advance(steps)
    assert wanted > force_in_world(panda_sim)[2] > 0.4 * wanted
    for _ in range(2000 // steps):
        panda_sim.advance(steps)
    assert not force_in_world(panda_sim).any()


def test_a_filter_begins_at_the_present_wrench_and_ends_without_a_trace(panda_sim):
    push(panda_sim, [0.0, 0.0, 5.0])
    panda_sim.robot.set_wrench_cutoff('right', 1.0)
    np.testing.assert_allclose(force_in_world(panda_sim), [0.0, 0.0, 5.0], atol=1e-9)
    panda_sim.data.body(EEF).xfrc_applied[:3] = 0.0
    panda_sim.advance(5)
    assert force_in_world(panda_sim)[2] > 4.0
    panda_sim.robot.set_wrench_cutoff('right', 0.0)
    assert not force_in_world(panda_sim).any()


def test_a_tare_zeroes_the_filtered_wrench(panda_sim):
    panda_sim.robot.set_wrench_cutoff('right', 1.0)
    panda_sim.data.body(EEF).xfrc_applied[:3] = [0.0, 0.0, 5.0]
    for _ in range(10):
        panda_sim.advance(5)
    assert 1.0 < force_in_world(panda_sim)[2] < 4.0
    panda_sim.robot.tare_wrench()
    assert not force_in_world(panda_sim).any()


@pytest.mark.parametrize('cutoff', [-1.0, float('nan'), float('inf')])
def test_a_cutoff_that_is_no_frequency_is_rejected(panda_sim, cutoff):
    with pytest.raises(CommandError, match='^the cutoff of a wrench must be positive'):
        panda_sim.robot.set_wrench_cutoff('right', cutoff)


def test_a_cutoff_of_an_arm_that_is_not_there_names_those_that_are(panda_sim):
    with pytest.raises(UnknownNameError, match='right'):
        panda_sim.robot.set_wrench_cutoff('left', 1.0)


def test_a_gripper_that_is_tied_to_the_world_feels_the_tie(panda):
    panda.grippers['right'].spec.add_equality(
        name='tie', name1='eef', type=mujoco.mjtEq.mjEQ_CONNECT,
        objtype=mujoco.mjtObj.mjOBJ_BODY)
    simulation = Simulation(World([panda]))
    simulation.data.body('robot0_link5').xfrc_applied[:3] = [20.0, 0.0, 0.0]
    for _ in range(100):
        simulation.advance(5)
    # A tie ahead of a mode of position takes its share of the push.
    assert not simulation.data.ncon
    assert force_in_world(simulation)[0] < -0.5


def test_contact_with_a_table_reads_as_a_push(panda):
    # At the start the pads are 1.011 m above the floor, half a pad below that is in the table.
    simulation = Simulation(World([panda], TableArena(table_height_m=1.006, cube=False)))
    for _ in range(100):
        simulation.advance(5)
    table, total = simulation.model.geom('table_collision').id, np.zeros(3)
    for index in range(simulation.data.ncon):
        contact, result = simulation.data.contact[index], np.empty(6)
        assert table in contact.geom
        mujoco.mj_contactForce(simulation.model, simulation.data, index, result)
        on_second_geom = contact.frame.reshape(3, 3).T @ result[:3]
        total += on_second_geom if contact.geom[0] == table else -on_second_geom
    # What acts in a step belongs to the instant at which it begins.
    simulation.advance(1)
    assert total[2] > 5.0
    np.testing.assert_allclose(force_in_world(simulation), total, atol=1e-2)


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
