# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cartesian targets: poses, twists and actions, in all modes, against kinematics."""


from end_effector_operator import distance, operator_of, EndEffectorOperator, turned
import mujoco
import numpy as np
import pytest
from sampling import Driven, sampled, whole_robot

from manip_sim.control.cartesian.controller import CartesianController
from manip_sim.control.commands import Status
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.grippers import PandaGripper
from manip_sim.models.object_creation import create_object
from manip_sim.models.robots import robot_names
from manip_sim.models.world import World
from manip_sim.physics.object_spawning import plan_with
from manip_sim.simulation import Simulation

MODES = ['position', 'velocity', 'effort']


@pytest.mark.full
@pytest.mark.parametrize('name', robot_names())
def test_the_end_effectors_of_every_robot_reach_poses_in_position_and_effort_mode(name):
    simulation = whole_robot(name)
    for mode, seed in (('position', 0), ('effort', 1)):
        simulation.robot.set_control_mode('arm', mode)
        ops = [EndEffectorOperator(simulation, arm) for arm in simulation.robot.end_effectors]
        poses = [op.reachable(0.3, seed) for op in ops]
        handles = [op.go_to(pose) for op, pose in zip(ops, poses)]
        ops[0].run_until_done(handles)
        ops[0].run(0.3)
        for op, pose, handle in zip(ops, poses, handles):
            assert handle.status is Status.DONE
            way, turn = distance(op.pose, pose)
            assert way < 1e-3 and turn < 0.01, (mode, op.arm, way, turn)
            assert np.abs(handle.error).max() < 0.01
            assert op.report.unreachable == 0


def test_the_end_effector_goes_straight_and_within_all_limits():
    op = operator_of('Panda')
    start, goal = op.pose, op.reachable(0.6, 3)
    model, joints = op.simulation.model, op.robot.joints
    top = np.array([model.joint(j).user[0] for j in op.part.joints])
    limit = joints.servos.acceleration_limit[joints.indices_of('right')]
    path, speeds = [], [np.zeros(7)]

    def look():
        path.append(op.pose[0])
        speeds.append(op.reference.velocity)
    op.go_to(goal)
    with sampled(Driven(op.simulation, 'arm')) as samples:
        op.run(1.5, look)
    along = (goal[0] - start[0]) / np.linalg.norm(goal[0] - start[0])
    aside = [np.linalg.norm(np.cross(p - start[0], along)) for p in path]
    assert np.linalg.norm(goal[0] - start[0]) > 0.15
    assert max(aside) < 3e-3
    assert np.abs(speeds).max(axis=0).max() > 0.3
    assert (np.abs(speeds) <= top * 1.0001).all()
    assert (np.abs(np.diff(speeds, axis=0)) <= limit * 0.01 * 1.0001).all()
    # In between, too, as the joints do it.
    assert (np.abs(np.diff(samples.velocity, axis=0)) <= 1.5 * limit * 0.002).all()
    # It comes near without going beyond.
    assert max(p @ along for p in path) < goal[0] @ along + 2e-4


@pytest.mark.parametrize(('period_s', 'solutions'), [(0.002, 1), (0.01, 1), (0.02, 2),
                                                     (0.05, 5)])
def test_the_kinematics_is_solved_once_in_twelve_milliseconds(period_s, solutions, monkeypatch):
    op, solved, end_run = operator_of('Panda', period_s=period_s), [], CartesianController.end_run

    def count(controller, commands, targets, places_at_begin):
        solved.append(int(targets.tasks['solutions'][0]))
        end_run(controller, commands, targets, places_at_begin)
    monkeypatch.setattr(CartesianController, 'end_run', count)
    op.go_to(op.reachable(0.5, 1))
    op.run(4 * period_s, lambda: op.robot.moving)  # Whoever asks lets Python look.
    assert sum(solved) == 4 * solutions


def test_a_target_that_jumps_leaves_the_setpoints_continuous():
    op = operator_of('Panda')
    limit = op.robot.joints.servos.acceleration_limit[op.robot.joints.indices_of('right')]
    speeds, random = [], np.random.default_rng(4)

    def jump():
        speeds.append(op.reference.velocity)
        if len(speeds) % 7 == 0:
            op.go_to(op.reachable(0.5, int(random.integers(1000))))
    op.run(1.5, jump)
    assert np.abs(speeds).max() > 0.5
    assert (np.abs(np.diff(speeds, axis=0)) <= limit * 0.01 * 1.0001).all()


@pytest.mark.full
@pytest.mark.parametrize('mode', MODES)
def test_a_twist_moves_the_end_effector_at_that_velocity(mode):
    op = operator_of('Panda', mode=mode)
    wanted = np.array([0.0, 0.05, -0.03, 0.0, 0.0, 0.2])
    start = op.pose
    op.run(0.7, lambda: op.move_at(wanted[:3], wanted[3:]))
    twists = []

    def look():
        op.move_at(wanted[:3], wanted[3:])
        twists.append(op.twist)
    op.run(0.3, look)
    np.testing.assert_allclose(np.mean(twists, axis=0), wanted, atol=0.002)
    # It turns about its own origin.
    way, turn = distance(op.pose, start)
    assert way == pytest.approx(np.linalg.norm(wanted[:3]), abs=0.01)
    assert turn == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize('mode', MODES)
def test_the_end_effector_of_an_arm_with_one_joint_goes_round_it(one_joint_arm, mode):
    robot = one_joint_arm()
    robot.add_gripper(PandaGripper(idn='0_right'))
    op = EndEffectorOperator(Simulation(World([robot])), mode=mode)
    axis, angular = op.simulation.data.joint('robot0_joint1').xanchor, np.array([0.0, 0.3, 0.0])
    op.run(0.5, lambda: op.move_at(np.cross(angular, op.pose[0] - axis), angular))
    assert op.simulation.data.joint('robot0_joint1').qvel[0] == pytest.approx(0.3, abs=0.01)


@pytest.mark.full
@pytest.mark.parametrize('mode', MODES)
def test_without_a_fresh_twist_the_end_effector_stops_after_the_timeout(mode):
    op = operator_of('Panda', mode=mode)
    op.run(0.5, lambda: op.move_at([0.0, 0.1, 0.0]))
    handle = op.move_at([0.0, 0.1, 0.0])
    op.run(0.1)
    assert handle.is_active
    assert op.twist[1] == pytest.approx(0.1, abs=0.01)
    op.run(0.01)
    assert (handle.status, handle.reason) == (Status.ABORTED, 'no fresh twist came in time')
    op.run(0.6)
    rest = op.pose
    op.run(0.5)
    assert np.abs(op.twist).max() < 2e-3
    assert distance(op.pose, rest)[0] < 1e-3


def test_the_timeout_of_a_twist_can_be_set():
    op = operator_of('Panda')
    op.robot.joints.cartesian.set('right', 'twist_timeout', 0.5)
    op.move_at([0.0, 0.1, 0.0])
    op.run(0.45)
    assert op.twist[1] == pytest.approx(0.1, abs=0.005)


def test_a_twist_may_be_given_in_the_axes_of_the_end_effector():
    op = operator_of('UR5e')
    grip_site = op.robot.end_effectors['right'].grip_site
    start, rotation = op.pose
    op.run(0.5, lambda: op.move_at([0.04, 0.0, 0.0], [0.0, 0.0, 0.3], grip_site))
    # It turns about its own z, and so drives along a circle.
    radius, angle = 0.04 / 0.3, 0.3 * 0.5
    expected = rotation @ (radius * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0]))
    np.testing.assert_allclose(op.pose[0] - start, expected, atol=2.5e-3)
    assert distance(op.pose, (start, rotation @ turned([0, 0, 1], angle)))[1] < 0.02


def setpoint_way(op, seconds, before_each=lambda: None):
    """Return poses of the end effector by setpoints: positions and rotations, by kinematics."""
    model, data = op.simulation.model, mujoco.MjData(op.simulation.model)
    data.qpos[:] = op.simulation.data.qpos
    positions, rotations = [], []

    def look():
        before_each()
        for joint, position in zip(op.part.joints, op.reference.position):
            data.joint(joint).qpos[0] = position
        mujoco.mj_kinematics(model, data)
        positions.append(data.site_xpos[op.site].copy())
        rotations.append(data.site_xmat[op.site].copy())
    op.run(seconds, look)
    return np.array(positions), np.array(rotations)


def aside(positions, direction):
    """Return how far positions come from the straight line that begins at the first one."""
    way, along = positions - positions[0], np.array(direction) / np.linalg.norm(direction)
    return np.linalg.norm(way - np.outer(way @ along, along), axis=1).max()


@pytest.mark.full
@pytest.mark.parametrize('name', ['Panda', 'IIWA', 'Kinova3', 'UR5e'])
@pytest.mark.parametrize('linear', [[0.0, 0.2, 0.0], [0.1, 0.1, -0.1]])
def test_setpoints_of_a_twist_lead_straight_from_rest_and_do_not_turn(name, linear):
    op = operator_of(name)
    positions, rotations = setpoint_way(op, 1.0, lambda: op.move_at(linear))
    speed = np.linalg.norm(linear)
    # Little is lost for gaining speed.
    assert (positions[-1] - positions[0]) @ linear / speed > 0.94 * speed
    assert aside(positions, linear) < 3e-5
    assert np.abs(rotations - rotations[0]).max() < 1e-5


@pytest.mark.full
@pytest.mark.parametrize('name', ['Panda', 'IIWA', 'Kinova3', 'UR5e'])
@pytest.mark.parametrize('way', [[0.0, 0.2, 0.0], [0.0, -0.4, 0.1], [0.1, 0.0, 0.1]])
def test_setpoints_of_a_pose_lead_the_end_effector_there_straight_and_without_delay(name, way):
    op = operator_of(name)
    position, rotation = op.pose
    handle = op.go_to((position + way, rotation))
    positions, rotations = setpoint_way(op, 1.2)
    assert handle.status is Status.DONE
    assert aside(positions, way) < 1e-4
    assert np.abs(rotations - rotations[0]).max() < 2e-4


def test_a_fast_twist_does_not_drift_aside():
    op = operator_of('Panda', period_s=0.05)
    start, rotation = op.pose
    op.run(1.2, lambda: op.move_at([0.0, 0.3, 0.0]))
    way, turn = op.pose[0] - start, distance(op.pose, (start, rotation))[1]
    assert 0.25 < way[1] < 0.36
    assert np.abs(way[[0, 2]]).max() < 2e-3
    assert turn < 5e-3


def test_a_pose_may_be_given_in_a_link():
    op = operator_of('Baxter', 'left')
    goal = op.reachable(0.3)
    data, link = op.simulation.data, 'robot0_left_arm_mount'
    origin, axes = data.body(link).xpos, data.body(link).xmat.reshape(3, 3)
    assert abs(axes[0, 1]) > 0.5
    handle = op.go_to((axes.T @ (goal[0] - origin), axes.T @ goal[1]), link)
    op.run_until_done([handle])
    assert max(distance(op.pose, goal)) < 1e-3


@pytest.mark.parametrize('base', ['default', 'none'])
def test_a_pose_in_the_frame_of_the_end_effector_is_meant_where_that_is_now(base):
    op = operator_of('IIWA', base=base)
    start = op.pose
    handle = op.go_to((np.array([0.0, 0.0, 0.05]), np.eye(3)), op.robot.end_effectors[
        'right'].grip_site)
    op.run_until_done([handle])
    assert max(distance(op.pose, (start[0] + start[1] @ [0.0, 0.0, 0.05], start[1]))) < 1e-3


@pytest.mark.full
@pytest.mark.parametrize(('frame', 'follows'), [('world', False), ('robot0_link0', True)])
def test_a_goal_stays_with_its_frame_while_the_base_drives(frame, follows):
    op = operator_of('PandaOmron')
    op.robot.set_control_mode('base', 'velocity')
    goal = op.pose
    data = op.simulation.data
    if follows:
        origin, axes = data.body(frame).xpos, data.body(frame).xmat.reshape(3, 3)
        goal = axes.T @ (goal[0] - origin), axes.T @ goal[1]
    start = op.pose
    op.go_to(goal, frame)
    op.run(1.0)
    op.run(1.0, lambda: op.robot.apply(op.robot.parse.twist(-0.1, 0.0, 0.0), period_s=0.01))
    op.robot.apply(op.robot.parse.twist(0.0, 0.0, 0.0), period_s=0.01)
    op.run(1.0)
    moved = op.pose[0] - start[0]
    np.testing.assert_allclose(moved, [-0.1 if follows else 0.0, 0.0, 0.0], atol=3e-3)


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'effort'])
def test_a_stretched_arm_stays_bounded_and_comes_back(mode):
    op = operator_of('Panda', mode=mode)
    model = op.simulation.model
    top = np.array([model.joint(j).user[0] for j in op.part.joints])
    speeds = []

    def push():
        op.move_at([0.4, 0.0, 0.0])
        speeds.append(op.simulation.data.qvel[op.part.dof_addresses].copy())
    op.run(4.0, push)
    assert np.isfinite(speeds).all()
    assert (np.abs(speeds) <= 1.1 * top).all()
    assert np.abs(speeds[-1]).max() < 0.5
    assert op.report.singular + op.report.joint_limit >= 1
    assert all(text.startswith('right: the twist ') for text in op.report.texts.values())
    x = op.pose[0][0]
    # As far as the forearm and the end effector reach.
    assert x > 0.2
    op.run(1.0, lambda: op.move_at([-0.2, 0.0, 0.0]))
    assert op.pose[0][0] < x - 0.1


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'effort'])
def test_a_target_out_of_reach_is_approached_and_told_once(mode):
    op = operator_of('UR5e', mode=mode)
    start = op.pose
    # A stream of the same target is one target.
    op.run(4.0, lambda: op.go_to((start[0] + [3.0, 0.0, 0.0], start[1])))
    assert op.report.unreachable == 1
    assert op.report.texts['unreachable'].startswith('right: the target is not reached, 2.')
    assert np.abs(op.twist[:3]).max() < 0.03
    assert op.pose[0][0] > start[0][0] + 0.1
    handle = op.go_to(start)
    op.run_until_done([handle])
    assert max(distance(op.pose, start)) < 2e-3
    assert op.report.unreachable == 1


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'effort'])
def test_a_command_for_a_target_out_of_reach_does_not_end(mode):
    op = operator_of('UR5e', mode=mode)
    handle = op.go_to((op.pose[0] + [3.0, 0.0, 0.0], op.pose[1]))
    op.run(8.0)
    assert handle.status is Status.RUNNING


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'effort'])
def test_the_end_of_a_joint_range_is_kept_and_counted(mode):
    op = operator_of('Panda', mode=mode)
    low, high = op.simulation.model.joint('robot0_joint7').range
    grip_site = op.robot.end_effectors['right'].grip_site
    positions = []

    def turn():
        op.move_at([0.0, 0.0, 0.0], [0.0, 0.0, 1.5], grip_site)
        positions.append(op.reference.position[6] if mode == 'position'
                         else op.simulation.data.joint('robot0_joint7').qpos[0])
    op.run(3.0, turn)
    assert high - 0.05 < max(positions) <= high + (0.0 if mode == 'position' else 0.01)
    assert op.report.joint_limit >= 1
    assert op.report.texts['joint_limit'] == (
        'right: the twist is limited by the range of robot0_joint7')


@pytest.mark.full
@pytest.mark.parametrize(('linear', 'angular'), [
    ([0.2, 0.2, 0.2], [-2.0, -2.0, -1.0]), ([-0.3, 0.0, 0.0], [-1.0, -1.0, -2.0])])
def test_joints_brake_before_a_twist_brings_them_to_an_end_of_their_range(linear, angular):
    op = operator_of('Panda')
    positions = []

    def move():
        op.move_at(linear, angular)
        positions.append(op.reference.position.copy())
    op.run(3.0, move)
    assert op.report.joint_limit >= 1
    limit = op.robot.joints.servos.acceleration_limit[op.robot.joints.indices_of('right')]
    assert (np.abs(np.diff(positions, 2, axis=0)) <= 1.001 * limit * op.period_s**2).all()


def test_both_end_effectors_move_at_once_and_one_alone_leaves_the_other():
    simulation = whole_robot('Baxter')
    right, left = EndEffectorOperator(simulation, 'right'), EndEffectorOperator(simulation, 'left')
    goals = right.reachable(0.3, 5), left.reachable(0.3, 6)
    handles = right.go_to(goals[0]), left.go_to(goals[1])
    assert [sorted(simulation.robot.joints.parts_of(op.robot.joints.indices_of(op.arm)))
            for op in (right, left)] == [['right'], ['left']]
    right.run_until_done(handles)
    right.run(1.0)
    assert max(distance(right.pose, goals[0])) < 1e-3
    before = right.reference.position
    handle = left.go_to(left.reachable(0.2, 7))
    left.run_until_done([handle])
    np.testing.assert_allclose(right.reference.position, before, atol=2e-3)
    assert max(distance(right.pose, goals[0])) < 1e-3


def test_a_joint_that_a_newer_command_names_is_lost_and_the_others_go_on():
    op = operator_of('Panda')
    goal = op.pose
    handle = op.go_to(goal)
    op.run(0.5)
    (here,) = op.simulation.data.joint('robot0_joint3').qpos
    op.robot.apply(*op.robot.parse.joint_command(['robot0_joint3'], [here + 0.3]), period_s=0.01)
    op.run(2.0)
    assert op.simulation.data.joint('robot0_joint3').qpos[0] == pytest.approx(here + 0.3, abs=1e-3)
    assert max(distance(op.pose, goal)) < 2e-3
    positions = [0.1, 0.2, 0.3, -2.0, 0.1, 2.0, 0.2]
    op.robot.apply(*op.robot.parse.joint_command(op.part.joints, positions), period_s=0.01)
    op.run(2.0)
    np.testing.assert_allclose(op.reference.position, positions, atol=1e-6)
    assert handle.status is Status.DONE


def test_an_end_effector_that_has_come_to_rest_costs_nothing():
    op = operator_of('UR5e')
    op.run_until_done([op.go_to(op.reachable(0.2))])
    op.run(0.5)
    assert not op.robot.moving


def test_the_same_commands_give_the_same_bits():
    def final():
        op = operator_of('Panda')
        op.run(0.3, lambda: op.move_at([0.02, 0.03, 0.0]))
        op.go_to(op.reachable(0.3))
        op.run(0.3)
        op.act(0.3, -0.2, 1.0, 0.1, 0.0, 0.2)
        op.run(0.3)
        op.robot.set_control_mode('arm', 'effort')
        op.act(0.3, -0.2, 1.0, 0.1, 0.0, 0.2)
        op.run(0.3)
        return op.simulation.data.qpos.tobytes(), op.simulation.data.qvel.tobytes()
    assert final() == final()


def test_a_change_of_mode_and_a_reset_end_a_target():
    op = operator_of('Panda')
    handle = op.go_to(op.reachable(0.4))
    op.run(0.2)
    op.robot.set_control_mode('arm', 'velocity')
    assert (handle.status, handle.reason) == (Status.ABORTED, 'the control mode is velocity now')
    op.run(0.5)
    assert np.abs(op.twist).max() < 1e-3
    handle = op.go_to(op.reachable(0.4))
    op.run(0.2)
    op.simulation.reset()
    assert (handle.status, handle.reason) == (Status.ABORTED, 'the simulation was reset')
    op.run(0.3)
    assert np.abs(op.twist).max() < 1e-3


def test_a_command_timeout_ends_a_target():
    op = operator_of('Panda')
    op.robot.set_command_timeout('arm', 0.2)
    handle = op.go_to(op.reachable(0.5))
    op.run(0.3)
    assert (handle.status, handle.reason) == (
        Status.ABORTED, 'no fresh command came in time')
    op.run(0.5)
    assert np.abs(op.twist).max() < 1e-3


POSE = ([0.5, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize(('make', 'what'), [
    (lambda p: p.pose('right', [np.nan, 0.0, 0.0], POSE[1]), '^position must be finite'),
    (lambda p: p.pose('right', POSE[0], [0.0] * 4), 'of length 1, got .* of length 0'),
    (lambda p: p.pose('right', POSE[0], [0.0, 0.0, np.inf, 1.0]), 'orientation must be finite'),
    (lambda p: p.pose('right', [2e4, 0.0, 0.0], POSE[1]), 'within 10000 m of the origin'),
    (lambda p: p.pose('right', *POSE, 'link3'),
     r"^right: a target pose: unknown frame 'link3': did you mean 'robot0_link3'"),
    (lambda p: p.twist('right', [0.0] * 3, [0.0] * 3, 'tool'),
     "^right: a target twist: unknown frame 'tool'"),
    (lambda p: p.twist('right', [0.0, np.nan, 0.0], [0.0] * 3), 'linear velocity must be finite'),
    (lambda p: p.twist('right', [0.0] * 3, [2e3, 0.0, 0.0]), 'angular velocity must be within'),
    (lambda p: p.action('right', [0.0] * 5), '^right: a pose action must have 6 numbers, got 5'),
    (lambda p: p.action('right', [0.0] * 5 + [np.nan]), 'must be finite')])
def test_what_cannot_be_meant_is_rejected(make, what, panda_sim):
    with pytest.raises(CommandError, match=what):
        make(panda_sim.robot.parse_cartesian)


def test_an_arm_or_a_setting_that_is_not_there_is_told(panda_sim):
    robot = panda_sim.robot
    for make in (lambda: robot.parse_cartesian.action('left', [0.0] * 6),
                 lambda: robot.joints.cartesian.set('left', 'stiffness', 1.0),
                 lambda: robot.joints.cartesian.goal('left', panda_sim.data)):
        with pytest.raises(UnknownNameError, match="unknown arm with a gripper 'left'"):
            make()
    with pytest.raises(UnknownNameError, match="unknown Cartesian setting 'stiffnes'"):
        robot.joints.cartesian.set('right', 'stiffnes', 1.0)
    with pytest.raises(CommandError, match='^stiffness must be positive and finite, got nan'):
        robot.joints.cartesian.set('right', 'stiffness', np.nan)
    assert robot.joints.cartesian.goal('right', panda_sim.data) is None


def test_what_is_too_much_is_clamped_and_counted(panda_sim):
    parse = panda_sim.robot.parse_cartesian
    command = parse.action('right', [2.0, 0.0, -3.0, 0.5, 0.0, 1.0])
    assert command.clamped == 2
    np.testing.assert_array_equal(command.action, [1.0, 0.0, -1.0, 0.5, 0.0, 1.0])
    twist = parse.twist('right', [3.0, 0.0, 4.0], [0.0, 0.1, 0.0])
    assert twist.clamped == 2
    np.testing.assert_allclose(twist.twist, [0.6, 0.0, 0.8, 0.0, 0.1, 0.0])


def test_a_stream_of_twists_goes_on_where_it_is_when_the_mode_changes():
    op = operator_of('Panda')
    op.run(1.0, lambda: op.move_at([0.0, 0.1, 0.0]))
    op.robot.set_control_mode('arm', 'effort')
    lowest = []

    def look():
        op.move_at([0.0, 0.1, 0.0])
        lowest.append(op.twist[1])
    op.run(0.5, look)
    assert min(lowest) > -0.01
    assert op.twist[1] == pytest.approx(0.1, abs=0.01)


def test_a_twist_long_after_the_last_one_begins_where_the_end_effector_is_now():
    op = operator_of('Panda', mode='effort')
    op.run(0.3, lambda: op.move_at([0.0, 0.1, 0.0]))
    op.robot.set_control_mode('arm', 'position')
    joint = op.part.joints[0]
    op.robot.apply(*op.robot.parse.joint_command([joint], [-0.5]), period_s=0.01)
    op.run(2.0)
    op.robot.set_control_mode('arm', 'effort')
    here = op.pose
    op.run(0.5, lambda: op.move_at([0.0, 0.0, 0.0]))
    way, turn = distance(op.pose, here)
    assert way < 1e-3 and turn < 5e-3


def test_after_a_reset_a_twist_begins_at_the_start():
    op = operator_of('Panda', mode='effort')
    start = op.pose
    op.run(1.0, lambda: op.move_at([0.0, 0.1, 0.0]))
    op.simulation.reset()
    op.run(0.05, lambda: op.move_at([0.0, 0.0, 0.0]))
    assert distance(op.goal, start)[0] < 1e-4


def test_an_object_that_is_spawned_on_the_way_changes_nothing():
    finals = []
    for spawns in (False, True):
        op = operator_of('Panda')
        goal = op.reachable(0.4)
        op.go_to(goal)
        op.run(0.2)
        if spawns:
            ball = create_object({'name': 'ball', 'shape': 'sphere', 'size': 0.1, 'mass': 0.2,
                                  'position': [1.5, 0.0, 2.0]})
            op.simulation.change_objects(plan_with(op.simulation.plan, ball))
        op.run(1.0)
        finals.append(op.robot.state().position)
        assert max(distance(op.pose, goal)) < 1e-3
    np.testing.assert_allclose(*finals, atol=1e-9)


def test_an_end_effector_that_passes_a_singularity_slows_down_and_stays_on_its_way():
    op = operator_of('Sawyer')
    start, model, data = op.pose, op.simulation.model, mujoco.MjData(op.simulation.model)
    data.qpos[:] = op.simulation.data.qpos
    data.qpos[op.part.qpos_addresses] += [-0.234, 0.214, 0.433, -0.7, 0.463, -0.664, 0.704]
    mujoco.mj_kinematics(model, data)
    goal = data.site_xpos[op.site].copy(), data.site_xmat[op.site].reshape(3, 3).copy()
    along = (goal[0] - start[0]) / np.linalg.norm(goal[0] - start[0])
    aside, handle = [], op.go_to(goal)
    op.run(2.5, lambda: aside.append(np.linalg.norm(np.cross(op.pose[0] - start[0], along))))
    assert max(aside) < 2e-3
    assert op.report.aside == 0 and handle.status is Status.DONE


@pytest.mark.full
def test_whoever_leaves_the_way_by_centimetres_says_so():
    told = []
    for seed in range(6):
        op = operator_of('Panda')
        goal, before = op.reachable(0.8, seed), op.report.aside
        op.go_to(goal)
        positions, _ = setpoint_way(op, 2.0)
        told.append((aside(positions, goal[0] - positions[0]), op.report.aside - before))
    assert max(told)[0] > 0.015
    assert all(count >= 1 for distance, count in told if distance > 0.011)
    assert all(count == 0 for distance, count in told if distance < 0.009)
