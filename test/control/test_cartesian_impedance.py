# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cartesian impedance against closed forms: deflection, decay, posture, limits and wrenches."""

import math
import pickle

from end_effector_operator import EndEffectorOperator, operator_of, turned
import mujoco
import numpy as np
import pytest

from manip_sim.algebra import rotation_vector
from manip_sim.control.commands import Status
from manip_sim.control.law.small_matrices import diagonalize
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.simulation import Simulation
from manip_sim.worlds import Worlds

STIFFNESS = [400.0, 800.0, 1200.0, 30.0, 40.0, 50.0]
#: Fewer joints than an impedance of six axes needs.
SHORT = {'SO101'}


def impedance(name='Panda', stiffness=STIFFNESS, frame='world', **fields):
    """Return the operator of an arm that is an impedance and holds its pose."""
    op = operator_of(name, mode='effort', **fields)
    settings = op.robot.joints.cartesian
    settings.set(op.arm, 'cartesian_stiffness', stiffness)
    settings.set(op.arm, 'cartesian_frame', frame)
    op.go_to(op.pose)
    return op


def push(op, force, torque=(0.0, 0.0, 0.0)):
    """Return a function that lets a wrench act at the end effector, where it is now."""
    data, body = op.simulation.data, int(op.simulation.model.site_bodyid[op.site])

    def act():
        data.xfrc_applied[body, :3] = force
        data.xfrc_applied[body, 3:] = torque + np.cross(
            data.site_xpos[op.site] - data.xipos[body], force)
    return act


def error_of(op, start):
    """Return translation and rotation vector of the end effector from a pose, shape (6,)."""
    place, rotation = op.pose
    return np.concatenate([place - start[0], rotation_vector(rotation @ start[1].T)])


def arm_of(op):
    """Return Jacobian, shape (6, n), and inertia, shape (n, n), of an arm, by MuJoCo."""
    model, data = op.simulation.model, op.simulation.data
    jacobian, inertia = np.zeros((6, model.nv)), np.zeros((model.nv, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], op.site)
    for dof in range(model.nv):
        mujoco.mj_mulM(model, data, inertia[dof], np.eye(model.nv)[dof])
    dofs = op.part.dof_addresses
    return jacobian[:, dofs], inertia[np.ix_(dofs, dofs)]


def mobility(op):
    """Return the inverse inertia of the end effector, shape (6, 6)."""
    jacobian, inertia = arm_of(op)
    return jacobian @ np.linalg.solve(inertia, jacobian.T)


@pytest.mark.parametrize('name', [
    pytest.param(name, marks=[] if name == 'Panda' else pytest.mark.full)
    for name in robot_names()])
def test_a_push_moves_the_end_effector_by_force_over_stiffness(name):
    op = impedance(name)
    start, force = op.pose, np.array([-3.0, 4.0, 5.0])
    op.run(2.0, push(op, force))
    expected = force / STIFFNESS[:3]
    np.testing.assert_allclose(
        error_of(op, start)[:3], expected, atol=0.01 * np.abs(expected).max())
    assert not op.report.texts  # To yield is no failure.
    if name not in SHORT:
        op.run(2.0, push(op, np.zeros(3), [0.0, 0.0, 0.6]))
        assert error_of(op, start)[5] == pytest.approx(0.6 / 50.0, rel=0.01)


@pytest.mark.full
@pytest.mark.parametrize('frame', ['base', 'tool'])
def test_the_axes_of_the_springs_are_those_of_the_chosen_frame(frame):
    op = impedance('UR5e', frame=frame)
    name = {'base': 'robot0_right_center', 'tool': 'gripper0_right_grip_site'}[frame]
    axes = op.simulation.data.site(name).xmat.reshape(3, 3).copy()
    assert np.abs(axes - np.eye(3)).max() > 0.1 or frame == 'base'
    start = op.pose
    op.run(2.0, push(op, axes @ [4.0, 0.0, 0.0]))
    np.testing.assert_allclose(axes.T @ error_of(op, start)[:3], [0.01, 0.0, 0.0], atol=2e-4)


@pytest.mark.full
@pytest.mark.parametrize('ratio', [0.2, 0.7, 1.0])
def test_each_mode_decays_with_its_damping_ratio(ratio):
    op = impedance('Panda', timestep_s=0.001)
    op.robot.joints.cartesian.set('right', 'cartesian_damping_ratio', ratio)
    start = op.pose
    # Along a mode of springs and inertia, so that it moves alone.
    rates, modes = np.linalg.eig(mobility(op) @ np.diag(STIFFNESS))
    slowest = int(np.argmin(rates.real))
    mode, rate = modes[:, slowest].real, math.sqrt(rates[slowest].real)
    mode *= min(0.005 / np.abs(mode[:3]).max(), 0.02 / np.abs(mode[3:]).max())
    force = np.diag(STIFFNESS) @ mode
    op.run(6.0, push(op, force[:3], force[3:]))
    np.testing.assert_allclose(error_of(op, start), mode, atol=1e-3)
    op.simulation.data.xfrc_applied[:] = 0.0
    times, shares = 0.01 * np.arange(1, 60), []
    for _ in times:
        op.run(0.01)
        shares.append(error_of(op, start) @ mode / (mode @ mode))
    if ratio == 1.0:
        expected = (1.0 + rate * times) * np.exp(-rate * times)
    else:
        swing = rate * math.sqrt(1.0 - ratio**2)
        expected = np.exp(-ratio * rate * times) * (
            np.cos(swing * times) + ratio * rate / swing * np.sin(swing * times))
    np.testing.assert_allclose(shares, expected, atol=0.03)


@pytest.mark.full
def test_damping_along_and_about_axes_is_that_of_a_linear_system():
    damping = [90.0, 30.0, 120.0, 1.0, 2.0, 3.0]
    op = impedance('Panda', timestep_s=0.001)
    op.robot.joints.cartesian.set('right', 'cartesian_damping', damping)
    op.robot.joints.cartesian.set('right', 'cartesian_damping_ratio', 0.01)
    start = op.pose
    op.run(4.0, push(op, [4.0, 6.0, 8.0]))
    away, inverse = error_of(op, start), mobility(op)
    op.simulation.data.xfrc_applied[:] = 0.0
    rates, modes = np.linalg.eig(np.block([
        [np.zeros((6, 6)), np.eye(6)],
        [-inverse @ np.diag(STIFFNESS), -inverse @ np.diag(damping)]]))
    shares = np.linalg.solve(modes, [*away, *[0.0] * 6])
    for number in range(1, 60):
        op.run(0.01)
        expected = (modes @ (shares * np.exp(0.01 * number * rates))).real[:3]
        np.testing.assert_allclose(error_of(op, start)[:3], expected, atol=4e-4)
    assert np.abs(away[:3]).min() > 0.006


def test_the_posture_yields_as_its_own_stiffness_says_and_the_end_effector_stays():
    op = impedance('Panda')
    start, moved = op.pose, {}
    posture = op.robot.state().position[:7].copy()
    jacobian, inertia = arm_of(op)
    torque = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    torque -= jacobian.T @ np.linalg.solve(
        mobility(op), jacobian @ np.linalg.solve(inertia, torque))
    op.simulation.data.qfrc_applied[op.part.dof_addresses] = torque
    for stiffness in (10.0, 40.0):
        op.robot.joints.cartesian.set('right', 'null_space_stiffness', stiffness)
        op.run(3.0)
        moved[stiffness] = np.abs(op.robot.state().position[:7] - posture).max()
        np.testing.assert_allclose(error_of(op, start), 0.0, atol=1e-3)
    assert moved[10.0] / moved[40.0] == pytest.approx(4.0, rel=0.1) and moved[40.0] > 2e-3


@pytest.mark.full
@pytest.mark.parametrize('mode', ['effort', 'position'])
def test_a_redundant_arm_is_drawn_to_the_posture_that_is_set_and_back(mode):
    op = impedance('IIWA')
    start, initial = op.pose, op.robot.state().position[:7].copy()
    jacobian, _ = arm_of(op)
    # Another posture with the same pose: where a torque in the null space leads to.
    op.robot.joints.cartesian.set('right', 'null_space_stiffness', 0.0)
    op.simulation.data.qfrc_applied[op.part.dof_addresses] = 4.0 * np.linalg.svd(jacobian)[2][-1]
    op.run(1.0)
    op.simulation.data.qfrc_applied[:] = 0.0
    op.run(3.0)
    op.robot.joints.cartesian.set('right', 'null_space_stiffness', 10.0)
    other = op.robot.state().position[:7].copy()
    assert np.abs(other - initial).max() > 0.2
    if mode == 'position':
        op.robot.set_control_mode('arm', mode)
        op.go_to(start)
    for posture, reached in (('initial', initial), (other.tolist(), other),
                             (str(initial.tolist()), initial), (other, other)):
        op.robot.joints.cartesian.set('right', 'null_space_posture', posture)
        op.run(4.0)
        np.testing.assert_allclose(op.robot.state().position[:7], reached, atol=0.02)
        np.testing.assert_allclose(error_of(op, start), 0.0, atol=2e-3)
    assert op.robot.settings['null_space_posture.right'] == str(other.tolist())


def test_a_posture_that_is_set_is_kept_by_resets_states_and_worlds():
    worlds = Worlds(compose('Panda'), 2)
    posture = [0.0, 0.3, 0.4, -2.4, 0.0, 2.7, 0.8]
    simulation = Simulation(compose('Panda'))
    simulation.reset(0)
    for robot in (simulation.robot, worlds.robot[1]):
        settings = robot.joints.cartesian
        settings.set('right', 'null_space_posture', posture)
        robot.set_control_mode('arm', 'effort')
        settings.set('right', 'cartesian_stiffness', STIFFNESS)
        pose = robot.state().end_effectors['right'].pose
        robot.apply(robot.parse_cartesian.pose('right', pose.position, pose.quat_xyzw))
    simulation.advance(50)
    worlds.advance(50)
    assert worlds.digest()[1] == simulation.digest() != worlds.digest()[0]
    state = pickle.loads(pickle.dumps(simulation.save()))
    simulation.advance(50)
    digest, ended = simulation.digest(), simulation.robot.state().position
    simulation.robot.joints.cartesian.set('right', 'null_space_posture', 'initial')
    simulation.restore(state)
    simulation.advance(50)
    assert simulation.digest() == digest
    assert (simulation.robot.state().position == ended).all()
    simulation.reset()
    assert simulation.robot.settings['null_space_posture.right'] == str(posture)


@pytest.mark.parametrize(('value', 'message'), [
    ([0.0] * 6, 'must have 7 numbers'), ([math.nan] * 7, 'finite'), ('home', "must be 'initial'"),
    ('[0, x]', "must be 'initial'"),
    ([0.0, 0.0, 0.0, 1.0, 0.0, 2.0, 0.0], 'robot0_joint4.* must be from -3.07.* to -0.06')])
def test_a_posture_that_cannot_be_used_is_rejected(value, message):
    op = impedance('Panda')
    digest = op.simulation.digest()
    with pytest.raises(CommandError, match=message):
        op.robot.joints.cartesian.set('right', 'null_space_posture', value)
    assert op.simulation.digest() == digest


def test_a_far_goal_is_approached_within_the_limit_and_without_overshoot():
    op = impedance('Panda')
    op.robot.joints.cartesian.set('right', 'linear_velocity', 0.2)
    place, rotation = op.pose
    handle = op.go_to((place + [0.0, 0.2, 0.0], rotation))
    speeds, places = [], []
    for _ in range(200):
        before = op.pose[0]
        op.run(0.02)
        speeds.append(np.linalg.norm(op.pose[0] - before) / 0.02)
        places.append(op.pose[0][1] - place[1])
    assert 0.15 < max(speeds) < 0.21
    assert max(places) < 0.2005 and places[-1] == pytest.approx(0.2, abs=1e-3)
    assert handle.status is Status.DONE


def test_a_new_goal_does_not_change_the_force_at_once():
    op = impedance('Panda')
    op.robot.joints.cartesian.set('right', 'linear_velocity', 0.1)
    op.run(1.0, push(op, np.array([0.0, 20.0, 0.0])))
    place, rotation = op.pose
    before = op.robot.state().effort[:7].copy()
    op.go_to((place + [0.0, 0.0, 0.1], turned([0.0, 0.0, 1.0], 0.3) @ rotation))
    op.simulation.advance(1)
    np.testing.assert_allclose(op.robot.state().effort[:7], before, atol=0.5)


def test_a_stream_of_poses_is_followed_with_its_velocity_and_acceleration():
    op = impedance('UR5e', [2000.0] * 3 + [200.0] * 3)
    place, rotation = op.pose
    errors = []
    for number in range(150):
        angle = 2.0 * math.pi * 0.5 * 0.01 * number
        goal = place + 0.05 * np.array([0.0, math.sin(angle), 1.0 - math.cos(angle)])
        op.go_to((goal, rotation))
        op.run(0.01)
        errors.append(np.linalg.norm(op.pose[0] - goal))
    # A delay of one and a half intervals, as in other modes.
    assert max(errors[60:]) < 0.05 * math.pi * 0.015 + 0.5e-3


def test_a_twist_moves_the_end_effector_and_ends():
    op = impedance('UR5e')
    start = op.pose[0]
    for _ in range(50):
        op.robot.apply(op.robot.parse_cartesian.twist('right', [0.0, 0.0, 0.1], [0.0] * 3))
        op.run(0.02)
    assert op.pose[0][2] - start[2] == pytest.approx(0.1, abs=0.01)
    op.run(2.0)
    stopped = op.pose[0]
    op.run(0.5)
    np.testing.assert_allclose(op.pose[0], stopped, atol=1e-4)


def wrench(op, force, torque=(0.0, 0.0, 0.0), frame=''):
    command = op.robot.parse_cartesian.wrench(op.arm, force, torque, frame)
    op.robot.apply(command)
    return command


def test_a_target_wrench_moves_springs_as_a_push_does_and_ends_after_the_timeout():
    op = impedance('Panda')
    op.robot.set_command_timeout('arm', 0.2, ends_targets=False)
    start = op.pose
    for _ in range(20):
        wrench(op, [0.0, 0.0, 6.0], [0.0, 0.0, 0.5])
        op.run(0.1)
    error = error_of(op, start)
    assert error[2] == pytest.approx(6.0 / 1200.0, rel=0.01)
    assert error[5] == pytest.approx(0.5 / 50.0, rel=0.01)
    op.run(2.0)
    np.testing.assert_allclose(error_of(op, start), 0.0, atol=1e-4)


def test_a_target_wrench_without_a_timeout_lasts_until_another():
    op = impedance('Panda')
    op.robot.set_command_timeout('arm', 0.0)
    start = op.pose
    wrench(op, [4.0, 0.0, 0.0])
    op.go_to(start)  # Targets leave it.
    op.run(2.0)
    assert error_of(op, start)[0] == pytest.approx(0.01, rel=0.01)
    wrench(op, [0.0] * 3)
    op.run(2.0)
    np.testing.assert_allclose(error_of(op, start), 0.0, atol=1e-4)


def test_a_target_wrench_without_a_target_holds_the_end_effector_where_it_is():
    op = operator_of('Panda', mode='effort')
    op.robot.joints.cartesian.set('right', 'cartesian_stiffness', STIFFNESS)
    start = op.pose
    frame = 'gripper0_right_grip_site'
    axes = op.simulation.data.site(frame).xmat.reshape(3, 3).copy()
    op.robot.set_command_timeout('arm', 0.0)
    assert wrench(op, [0.0, 0.0, 4.0], frame=frame).handle.status is Status.DONE
    op.run(2.0)
    base = op.simulation.data.site('robot0_right_center').xmat.reshape(3, 3)
    expected = base @ (base.T @ axes @ [0.0, 0.0, 4.0] / STIFFNESS[:3])
    np.testing.assert_allclose(error_of(op, start)[:3], expected, atol=1e-4)


def force_mode(op, axis, force, limit):
    selection, wrench, limits = (np.zeros(6) for _ in range(3))
    selection[axis], wrench[axis], limits[axis] = 1.0, force, limit
    op.robot.apply(op.robot.parse_cartesian.force_mode(op.arm, selection, wrench, limits))


def test_force_mode_approaches_at_its_limit_presses_with_its_force_and_stays_at_its_end():
    op = impedance('Panda', arena='table', contacts=True)
    op.robot.set_command_timeout('arm', 0.2, ends_targets=False)
    start, forces = op.pose, []
    for number in range(40):
        force_mode(op, 2, -10.0, 0.1)
        op.run(0.1)
        if number == 7:
            assert op.twist[2] == pytest.approx(-0.1, rel=0.05)
        forces.append(op.robot.state().end_effectors['right'].external_wrench.force)
    # In ft_frame, whose z is that of a hand that points down.
    assert np.linalg.norm(forces[-1]) == pytest.approx(10.0, rel=0.02)
    error = error_of(op, start)
    assert error[2] < -0.1 and np.abs(error[[0, 1]]).max() < 5e-3
    op.run(2.0)
    np.testing.assert_allclose(op.pose[0][2], start[0][2] + error[2], atol=2e-3)
    assert np.abs(op.twist).max() < 1e-3


@pytest.mark.parametrize('messages', ['half lost', 'twice', 'never again'])
def test_a_force_mode_off_schedule_goes_on_at_its_velocity_or_ends(messages):
    op = impedance('Panda')
    op.robot.set_command_timeout('arm', 0.2, ends_targets=False)
    velocities = []
    for number in range(20):
        for _ in range({'half lost': (number + 1) % 2, 'twice': 2, 'never again': number < 5}[
                messages]):
            op.robot.apply(op.robot.parse_cartesian.force_mode(
                'right', [0, 0, 1, 0, 0, 0], [0, 0, 5, 0, 0, 0], [1, 1, 0.05, 1, 1, 1]))
        op.run(0.1)
        velocities.append(op.twist[2])
    if messages == 'never again':
        before = op.pose[0]
        op.run(1.0)
        assert abs(velocities[4]) > 0.04 and np.abs(op.pose[0] - before).max() < 1e-4
    else:
        np.testing.assert_allclose(velocities[5:], 0.05, rtol=0.02)


@pytest.mark.full
@pytest.mark.parametrize('axis', range(6))
def test_a_chosen_axis_without_force_yields_and_is_braked_beyond_its_limit(axis):
    op = impedance('Panda', [800.0] * 3 + [80.0] * 3)
    op.robot.set_command_timeout('arm', 0.0)
    force_mode(op, axis, 0.0, 0.05)
    push_at, start = np.zeros(6), op.pose
    push_at[axis] = 2.0 if axis < 3 else 0.2
    speeds = []
    for _ in range(60):
        op.run(0.01, push(op, push_at[:3], push_at[3:]))
        speeds.append(op.twist[axis])
    assert 0.04 < max(speeds) < 0.1
    assert error_of(op, start)[axis] > 0.01
    others = np.delete(error_of(op, start), axis)
    assert np.abs(others).max() < 5e-3


@pytest.mark.parametrize(('rows', 'message'), [
    (([0.5] * 6, [1.0] * 6, [0.1] * 6), 'must be 0 or 1'),
    (([1.0] * 6, [1.0] * 6, [0.0] * 6), 'must be above 0'),
    (([1.0] * 5, [1.0] * 6, [0.1] * 6), 'selection of force mode must have 6'),
    (([1.0] * 6, [math.nan] * 6, [0.1] * 6), 'wrench of force mode must be finite'),
    (([1.0] * 6, [1e308] * 6, [0.1] * 6), 'wrench of force mode must be within 1e.06')])
def test_a_force_mode_that_cannot_be_used_is_rejected(rows, message):
    with pytest.raises(CommandError, match=message):
        impedance('Panda').robot.parse_cartesian.force_mode('right', *rows)


def test_another_mode_ends_a_wrench_and_what_the_springs_hold():
    op = impedance('Panda')
    op.robot.set_command_timeout('arm', 0.0)
    wrench(op, [0.0, 0.0, 12.0])
    op.run(1.0)
    late = op.robot.parse_cartesian.wrench('right', [0.0, 0.0, 1.0], [0.0] * 3)
    for mode in ('position', 'effort'):
        op.robot.set_control_mode('arm', mode)
        op.run(0.5)
    start = op.pose
    op.go_to(start)
    op.run(1.0)
    np.testing.assert_allclose(error_of(op, start), 0.0, atol=1e-4)
    op.robot.set_control_mode('arm', 'position')
    op.robot.apply(late)
    assert late.handle.status is Status.ABORTED and 'no impedance' in late.handle.reason


def test_stiffness_changes_live_and_zero_gives_back_the_other_control():
    op = impedance('Panda')
    start, force = op.pose, np.array([0.0, 0.0, 6.0])
    op.run(1.0, push(op, force))
    op.robot.joints.cartesian.set('right', 'cartesian_stiffness', [600.0] * 3 + [30.0] * 3)
    op.run(1.0, push(op, force))
    assert error_of(op, start)[2] == pytest.approx(0.01, rel=0.01)
    op.robot.joints.cartesian.set('right', 'cartesian_stiffness', [0.0] * 6)
    op.simulation.data.xfrc_applied[:] = 0.0
    op.run(1.0)
    assert np.abs(error_of(op, start)[:3]).max() < 1e-3


def test_gains_that_are_too_high_for_the_timestep_are_stable():
    op = impedance('Panda', [1e5] * 3 + [1e4] * 3, timestep_s=0.005)
    op.robot.joints.cartesian.set('right', 'cartesian_damping_ratio', 2.0)
    op.robot.joints.cartesian.set('right', 'cartesian_damping', [1e5] * 6)
    place, rotation = op.pose
    op.go_to((place + [0.0, 0.05, 0.05], turned([1.0, 0.0, 0.0], 0.2) @ rotation))
    op.run(3.0)
    assert np.abs(op.robot.state().velocity[:7]).max() < 1e-3


@pytest.mark.parametrize('goal', [[0.402, 0.046, -0.112], [0.355, -0.032, -0.071]])
def test_springs_that_are_stronger_than_the_joints_rest_on_a_floor(goal):
    op = EndEffectorOperator(Simulation(compose('SO101', base='none')), mode='effort')
    op.robot.joints.cartesian.set('right', 'cartesian_stiffness', [300.0] * 3 + [20.0] * 3)
    op.robot.joints.cartesian.set('right', 'cartesian_frame', 'world')
    op.go_to((np.array(goal), op.pose[1]))
    op.run(8.0)
    strongest, effort = op.robot.limits('arm')[:, 1], op.robot.state().effort[:5]
    assert (np.abs(effort) <= strongest).all() and np.abs(effort).max() > 0.999 * strongest.max()
    assert op.simulation.data.ncon  # It presses.
    for _ in range(30):
        op.run(0.01)
        assert np.abs(op.robot.state().velocity[:5]).max() < 0.002


@pytest.mark.parametrize('setting', ['cartesian_stiffness', 'cartesian_damping'])
@pytest.mark.parametrize(('value', 'message'), [
    ([1.0] * 5, 'must have 6 numbers'), ([math.nan] * 6, 'finite'), (3.0, 'must have'),
    ([-1.0, *[1.0] * 5], 'not be negative'), ('stiff', 'cartesian_')])
def test_a_stiffness_that_cannot_be_used_is_rejected(setting, value, message):
    op = impedance('Panda')
    digest = op.simulation.digest()
    with pytest.raises(CommandError, match=message):
        op.robot.joints.cartesian.set('right', setting, value)
    assert op.simulation.digest() == digest


@pytest.mark.parametrize('name', ['Panda', 'UR5e', 'SO101'])
def test_the_greatest_wrenches_do_not_make_the_physics_diverge(name):
    op = impedance(name)
    for wrench in 1e6 * np.vstack([np.eye(6), -np.ones(6)]):
        for command in (op.robot.parse_cartesian.wrench('right', wrench[:3], wrench[3:]),
                        op.robot.parse_cartesian.force_mode('right', [1] * 6, wrench, [1.0] * 6)):
            op.robot.apply(command)
            op.run(0.2)
            assert op.simulation.diverged is None


def test_wrong_frames_modes_and_wrenches_are_rejected():
    op = impedance('Panda')
    with pytest.raises(UnknownNameError, match="'flange'.*base, tool, world"):
        op.robot.joints.cartesian.set('right', 'cartesian_frame', 'flange')
    parse = op.robot.parse_cartesian
    with pytest.raises(CommandError, match='must be finite'):
        parse.wrench('right', [math.inf, 0.0, 0.0], [0.0] * 3)
    with pytest.raises(CommandError, match='torque of a target wrench must be within 1e.06'):
        parse.wrench('right', [0.0] * 3, [0.0, -1e308, 0.0])
    with pytest.raises(CommandError, match='must have 3 numbers'):
        parse.wrench('right', [0.0] * 2, [0.0] * 3)
    with pytest.raises(CommandError, match='unknown frame'):
        parse.wrench('right', [0.0] * 3, [0.0] * 3, 'flange')
    with pytest.raises(UnknownNameError, match='left'):
        parse.wrench('left', [0.0] * 3, [0.0] * 3)
    op.robot.joints.cartesian.set('right', 'cartesian_stiffness', [0.0] * 6)
    with pytest.raises(CommandError, match='needs effort mode and a cartesian_stiffness.right'):
        parse.wrench('right', [0.0] * 3, [0.0] * 3)


def script(robot, place, number):
    """Apply what happens at a time: a goal, a wrench, another stiffness."""
    parse = robot.parse_cartesian
    if number == 3:
        robot.apply(parse.pose('right', place + [0.0, 0.05, 0.02], [1.0, 0.0, 0.0, 0.0]))
    if number == 8:
        robot.apply(parse.wrench('right', [3.0, 0.0, -5.0], [0.1, 0.0, 0.0]))
    if number == 10:
        robot.apply(parse.force_mode('right', [1, 0, 0, 0, 0, 1], [4.0] * 6, [0.1] * 6))
    if number == 12:
        robot.joints.cartesian.set('right', 'cartesian_stiffness', STIFFNESS[::-1])


def test_restored_and_pickled_states_and_worlds_go_on_to_the_same_bits():
    world = compose('Panda')
    simulation, worlds = Simulation(world), Worlds(world, 2)
    robots = [simulation.robot, *(worlds.robot[i] for i in range(2))]
    for robot in robots:
        robot.set_control_mode('arm', 'effort')
        robot.joints.cartesian.set('right', 'cartesian_stiffness', STIFFNESS)
    place = simulation.robot.state().end_effectors['right'].pose.position
    digests, saved = [], {}
    for number in range(20):
        saved[number] = pickle.dumps(simulation.save())
        for robot in robots:
            script(robot, place, number)
        simulation.advance(20)
        worlds.advance(20)
        digests.append(simulation.digest())
        assert set(worlds.digest()) == {digests[-1]}
    assert len(set(digests)) == 20
    for begin in (5, 11):
        simulation.restore(pickle.loads(saved[begin]))
        for number in range(begin, 20):
            script(simulation.robot, place, number)
            simulation.advance(20)
            assert simulation.digest() == digests[number]


def test_eigenvalues_are_those_of_numpy():
    random = np.random.default_rng(3)
    for count in (1, 2, 5, 7, 9):
        root = random.normal(size=(count, count)) * 10.0 ** random.uniform(-3, 3, count)
        matrix = root @ root.T
        expected, vectors = np.linalg.eigvalsh(matrix), np.empty((count, count))
        diagonal = matrix.copy()
        diagonalize(diagonal, vectors)
        scale = np.abs(matrix).max()
        np.testing.assert_allclose(np.sort(np.diag(diagonal)), expected, atol=1e-12 * scale)
        np.testing.assert_allclose(vectors @ vectors.T, np.eye(count), atol=1e-13)
        np.testing.assert_allclose(
            vectors @ np.diag(np.diag(diagonal)) @ vectors.T, matrix, atol=1e-12 * scale)
