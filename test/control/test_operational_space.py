# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cartesian targets in effort mode against closed forms, and what actions of OSC_POSE mean."""

from end_effector_operator import distance, operator_of, turned
import mujoco
import numpy as np
import pytest

from manip_sim.algebra import rotation_vector
from manip_sim.control.cartesian.cartesian_settings import CartesianSettings
from manip_sim.control.law.operational_space import accelerate
from manip_sim.control.law.records import Spring


def wanted_motion(jacobian, error, along, settings, velocity_limit):
    """Return velocities of joints far from the ends of their ranges, and what limits them."""
    count = jacobian.shape[1]
    endless, accelerations = np.full(count, np.inf), np.zeros(count)
    _, singular, slowed = accelerate(
        jacobian, error, along, Spring(settings.stiffness, settings.damping,
                                       settings.linear_velocity, settings.angular_velocity),
        velocity_limit, -endless, endless, np.zeros(count), np.zeros(count), False,
        np.zeros(count, dtype=bool), accelerations)
    return accelerations / settings.damping, singular, slowed


def base_axes(op):
    """Return the axes of the arm's mount in the world."""
    name = f'robot0_{op.arm}_center'
    return op.simulation.data.site(name).xmat.reshape(3, 3).copy()


def settle(op):
    """Hold the end effector where it is until all rests."""
    op.go_to(op.pose)
    op.run(1.0)


@pytest.mark.full
@pytest.mark.parametrize(('stiffness', 'ratio'), [(150.0, 1.0), (400.0, 1.0), (150.0, 2.0)])
def test_the_end_effector_moves_as_spring_and_damper_say(stiffness, ratio):
    op = operator_of('Panda', mode='effort', timestep_s=0.001)
    op.robot.joints.cartesian.set('right', 'stiffness', stiffness)
    op.robot.joints.cartesian.set('right', 'damping_ratio', ratio)
    settle(op)
    start, rotation = op.pose
    step = np.array([0.0, 0.02, -0.01])
    op.go_to((start + step, rotation))
    shares = []
    for _ in range(40):
        op.run(0.01)
        shares.append((op.pose[0] - start) @ step / (step @ step))
    time, rate = 0.01 * np.arange(1, 41), np.sqrt(stiffness)
    if ratio == 1.0:
        expected = 1.0 - (1.0 + rate * time) * np.exp(-rate * time)
    else:
        root = np.sqrt(ratio**2 - 1.0)
        fast, slow = rate * (ratio + root), rate * (ratio - root)
        expected = 1.0 - (fast * np.exp(-slow * time) - slow * np.exp(-fast * time)) / (
            fast - slow)
    np.testing.assert_allclose(shares, expected, atol=0.03)
    assert distance(op.pose, (start, rotation))[1] < 2e-3


@pytest.mark.full
@pytest.mark.parametrize('stiffness', [100.0, 300.0])
def test_a_force_moves_the_end_effector_by_what_stiffness_and_inertia_say(stiffness):
    op = operator_of('IIWA', mode='effort')
    op.robot.joints.cartesian.set('right', 'stiffness', stiffness)
    settle(op)
    model, data, start = op.simulation.model, op.simulation.data, op.pose
    force = np.array([0.0, 20.0, 0.0])
    body = int(model.site_bodyid[op.site])

    def push():
        data.xfrc_applied[body, :3] = force
        data.xfrc_applied[body, 3:] = np.cross(
            data.site_xpos[op.site] - data.xipos[body], force)
    op.run(3.0, push)
    jacobian, inertia = np.zeros((6, model.nv)), np.zeros((model.nv, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], op.site)
    for dof in range(model.nv):
        mujoco.mj_mulM(model, data, inertia[dof], np.eye(model.nv)[dof])
    dofs = op.part.dof_addresses
    arm = jacobian[:, dofs]
    mobility = arm @ np.linalg.solve(inertia[np.ix_(dofs, dofs)], arm.T)
    expected = mobility[:, 1] * 20.0 / stiffness
    moved = op.pose[0] - start[0]
    np.testing.assert_allclose(moved, expected[:3], atol=0.03 * np.abs(expected[:3]).max())
    assert 0.001 < moved[1] < 0.2


def test_the_weight_is_carried_also_without_gravity_compensation():
    op = operator_of('Panda', mode='effort', gravity_compensation=False)
    goal = op.reachable(0.2)
    op.run_until_done([op.go_to(goal)])
    op.run(0.5)
    assert max(distance(op.pose, goal)) < 1e-3


@pytest.mark.full
def test_a_redundant_arm_is_drawn_to_its_posture_and_comes_to_rest():
    op = operator_of('Kinova3', mode='effort')
    start = op.robot.state().position[:7]
    op.go_to(op.pose)
    # A push at the elbow, which lets the end effector where it is.
    elbow = op.simulation.model.joint(op.part.joints[3]).bodyid[0]
    op.simulation.data.xfrc_applied[elbow, 1] = 30.0
    op.run(1.0)
    pushed = op.robot.state().position[:7]
    assert np.abs(pushed - start).max() > 0.05
    op.simulation.data.xfrc_applied[:] = 0.0
    op.run(3.0)
    np.testing.assert_allclose(op.robot.state().position[:7], start, atol=0.01)
    assert np.abs(op.simulation.data.qvel[op.part.dof_addresses]).max() < 0.01


def way_of_joints(robot, mode, turns):
    """Raise an end effector by 5 cm after whole turns of endless joints; return how joints go."""
    op = operator_of(robot, mode=mode)
    endless = [joint for joint in op.part.joints
               if not op.simulation.model.joint(joint).limited[0]]
    for joint, count in zip(endless, turns):
        op.simulation.data.joint(joint).qpos[0] += 2.0 * np.pi * count
    # As if the joints had gone there: setpoints come along, the posture stays at the start.
    posture = op.robot.joints.cartesian.posture.copy()
    op.simulation.forward()
    op.robot.joints.reset(op.simulation.data)
    op.robot.joints.cartesian.posture[:] = posture
    op.run(0.1)
    start, (position, rotation) = op.robot.state().position.copy(), op.pose
    op.go_to((position + [0.0, 0.0, 0.05], rotation))
    op.run(3.0)
    assert op.pose[0][2] == pytest.approx(position[2] + 0.05, abs=2e-3)
    return op.robot.state().position - start


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'velocity', 'effort'])
@pytest.mark.parametrize(('robot', 'turns'), [
    ('Kinova3', (0, 0, 0, 1)), ('Kinova3', (2, -1, 0, -3))])
def test_whole_turns_of_endless_joints_make_no_difference_to_a_pose(robot, turns, mode):
    np.testing.assert_allclose(way_of_joints(robot, mode, turns),
                               way_of_joints(robot, mode, (0,) * 4), atol=2e-3)


@pytest.mark.parametrize('stepping', [(0.002, 0.01), (0.01, 0.05)])
def test_the_stiffest_setting_is_stable(stepping):
    timestep_s, period_s = stepping
    op = operator_of('UR5e', mode='effort', timestep_s=timestep_s, period_s=period_s)
    op.robot.joints.cartesian.set('right', 'stiffness', 1000.0)
    goal = op.reachable(0.2)
    op.run_until_done([op.go_to(goal)])
    op.run(0.5)
    assert max(distance(op.pose, goal)) < 1e-3
    assert op.simulation.diverged is None


@pytest.mark.full
@pytest.mark.parametrize('name', ['Panda', 'Baxter', 'GR1'])
@pytest.mark.parametrize('mode', ['position', 'effort'])
def test_an_action_of_one_moves_the_goal_by_five_centimetres_in_one_period(name, mode):
    op = operator_of(name, mode=mode, period_s=0.05)
    start, axes = op.pose, base_axes(op)
    op.act(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    op.run(0.05)
    way, turn = distance(op.goal, (start[0] + axes @ [0.05, 0.0, 0.0], start[1]))
    # GR1's waist gives way a little, and the goal goes with it.
    assert way < 1e-3 and turn < 1e-3
    op.run(1.5)
    assert distance(op.pose, op.goal)[0] < 1e-3


def test_an_action_turns_about_the_axes_of_the_base():
    op = operator_of('Baxter', 'left', period_s=0.05)
    start, axes = op.pose, base_axes(op)
    op.act(0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    op.run(1.5)
    expected = axes @ turned([0.0, 1.0, 0.0], 0.5) @ axes.T @ start[1]
    way, turn = distance(op.pose, (start[0], expected))
    assert way < 1e-3 and turn < 1e-3


def test_the_next_action_begins_where_the_end_effector_is_and_not_at_the_last_goal():
    op = operator_of('Panda', mode='effort', period_s=0.05)
    start = op.pose[0]
    op.act(0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    op.run(0.05)
    here = op.pose[0]
    assert 0.0 < here[1] - start[1] < 0.03
    op.act(0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(op.goal[0], here + [0.0, 0.05, 0.0], atol=1e-12)
    # Zero is a stop.
    op.act(*[0.0] * 6)
    np.testing.assert_allclose(op.goal[0], here, atol=1e-12)


def test_a_goal_of_an_action_goes_with_the_base():
    op = operator_of('PandaOmron', period_s=0.05)
    op.robot.set_control_mode('base', 'velocity')
    op.act(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    op.run(1.0)
    before = op.goal[0]
    op.run(1.0, lambda: op.robot.apply(op.robot.parse.twist(0.2, 0.0, 0.0), period_s=0.05))
    np.testing.assert_allclose(op.goal[0] - before, [0.2, 0.0, 0.0], atol=0.02)
    assert distance(op.pose, op.goal)[0] < 5e-3


@pytest.mark.full
@pytest.mark.parametrize('axis', range(3))
@pytest.mark.parametrize('way', [-0.05, 0.05])
def test_a_motion_far_from_the_ends_of_all_ranges_is_limited_by_none(axis, way):
    op = operator_of('Panda', mode='effort')
    position, rotation = op.pose
    goal = position.copy()
    goal[axis] += way
    op.run_until_done([op.go_to((goal, rotation))])
    assert op.report.counts == {'unreachable': 0, 'joint_limit': 0, 'singular': 0, 'slowed': 0,
                                'aside': 0}


@pytest.mark.parametrize('end', [0, 1])
@pytest.mark.parametrize('outwards', [True, False])
def test_a_joint_at_an_end_of_its_range_limits_motions_beyond_it_alone(end, outwards):
    op = operator_of('UR5e', mode='effort')
    model, data = op.simulation.model, op.simulation.data
    joint = op.part.joints[0]
    sign = (-1.0, 1.0)[end]
    data.joint(joint).qpos[0] = model.joint(joint).range[end] - 5e-4 * sign
    mujoco.mj_forward(model, data)
    position, rotation = op.pose
    # A turn about the axis of the first joint moves that joint alone.
    turn = turned([0.0, 0.0, 1.0], sign * (0.02 if outwards else -0.02))
    base = data.joint(joint).xanchor
    op.go_to((base + turn @ (position - base), turn @ rotation))
    op.run(op.period_s)
    assert (op.report.counts['joint_limit'] > 0) == outwards


@pytest.mark.parametrize(('error', 'expected'), [
    ([0.01, 0.0, 0.02, 0.0, -0.03, 0.0], None),
    ([3.0, 0.0, 4.0, 0.0, 0.0, 0.01], [0.3, 0.0, 0.4, 0.0, 0.0, None]),
    ([0.0, 0.01, 0.0, 6.0, 0.0, -8.0], [0.0, None, 0.0, 0.36, 0.0, -0.48])])
def test_way_and_turn_to_a_goal_are_each_limited_to_the_velocity_of_the_settings(error, expected):
    settings = CartesianSettings(linear_velocity=0.5, angular_velocity=0.6)
    error = np.array(error)
    balance = settings.stiffness / settings.damping * error
    expected = balance if expected is None else np.array(
        [b if e is None else e for b, e in zip(balance, expected)])
    velocity, singular, slowed = wanted_motion(
        np.eye(6), error, np.zeros(6), settings, np.full(6, 10.0))
    np.testing.assert_allclose(velocity, expected, atol=1e-12)
    assert not slowed and not singular


@pytest.mark.parametrize(('smallest', 'share', 'singular'), [
    (0.02, 1.0, True), (0.028, 0.55, True), (0.028, -0.55, True), (0.028, 0.45, False),
    (0.032, 0.55, False), (0.02, 0.0, False), (0.9, 1.0, False), (0.9, 0.0, False)])
def test_it_is_singular_if_most_of_the_motion_is_what_the_arm_cannot_do(smallest, share, singular):
    jacobian = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, smallest])
    twist = 0.8 * np.array([np.sqrt(1.0 - share**2), 0.0, 0.0, 0.0, 0.0, share])
    _, found, _ = wanted_motion(
        jacobian, np.zeros(6), twist, CartesianSettings(), np.full(6, 100.0))
    assert found == singular


def test_an_end_effector_that_shall_not_move_is_not_kept_from_it_by_a_singularity():
    _, singular, _ = wanted_motion(
        np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 0.0]), np.zeros(6), np.zeros(6), CartesianSettings(),
        np.full(6, 10.0))
    assert not singular


def test_a_motion_that_is_too_fast_for_a_joint_is_slowed_down_as_a_whole():
    settings, error = CartesianSettings(), np.array([0.1, 0.05, 0.0, 0.0, 0.0, 0.0])
    free, _, freely = wanted_motion(np.eye(6), error, np.zeros(6), settings, np.full(6, 10.0))
    limits = np.full(6, 10.0)
    limits[0] = free[0] / 4.0
    slow, _, slowed = wanted_motion(np.eye(6), error, np.zeros(6), settings, limits)
    np.testing.assert_allclose(slow, free / 4.0, atol=1e-12)
    assert slowed and freely is False


@pytest.mark.parametrize('axis', [[1.0, 0.0, 0.0], [0.0, -0.6, 0.8], [-2 / 3, 2 / 3, 1 / 3]])
@pytest.mark.parametrize('angle', [0.0, 1e-9, 0.5, 2.0, 3.14])
def test_a_rotation_vector_has_the_axis_and_the_angle_of_the_rotation(axis, angle):
    np.testing.assert_allclose(
        rotation_vector(turned(axis, angle)), angle * np.array(axis), atol=1e-12)
