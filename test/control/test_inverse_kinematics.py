# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Differential inverse kinematics alone, on arms that are so simple that the answer is known."""

from typing import NamedTuple

from end_effector_operator import operator_of
import mujoco
import numpy as np
import pytest

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.law import inverse_kinematics as law
from manip_sim.control.law.inverse_kinematics import find_bend, limit_rate
from manip_sim.control.law.records import ArmMotion, Velocities
from manip_sim.control.law.small_matrices import minimize_in_box
from manip_sim.physics.robot_frames import RobotFrames


def bend(jacobian, step):
    """Return the joint accelerations that keep an end effector straight along a step."""
    result = np.empty(len(step))
    find_bend(jacobian, step, result)
    return result


class Solution(NamedTuple):
    """Velocities of joints at the end of an interval, and what limits them."""

    velocity: FloatArray
    held: BoolArray
    pace: float
    progress: float
    singular: bool
    slowed: bool
    rests: bool


def blank(state):
    """Return arrays for velocities of the joints of an arm."""
    count = len(state.position)
    return Velocities(np.zeros(count), np.zeros(count), np.zeros(count, dtype=bool))


def approach(jacobian, error, state, interval_s, linear_velocity, angular_velocity):
    result, still = blank(state), np.zeros(6)
    return Solution(result.velocity, result.held, *law.approach(
        jacobian, error, state, interval_s, linear_velocity, angular_velocity, still, still,
        False, 0.0, False, result))


def follow_twist(jacobian, twist, state, interval_s):
    result = blank(state)
    return Solution(result.velocity, result.held, *law.follow_twist(
        jacobian, twist, state, interval_s, False, result))


def displace(jacobian, task, low, high, away):
    """Return displacements for a task, and those towards a posture."""
    count = len(away)
    step, drift = np.empty(count), np.empty(count)
    law.displace(jacobian, task, low, high, away, False, step, drift,
                 np.empty(count, dtype=bool), np.empty((count, count)))
    return step, drift


#: A gantry: each joint moves the end effector along or about one axis.
GANTRY = np.eye(6)


def joints(position, velocity=None, low=-np.inf, high=np.inf):
    count = len(position)
    position = np.array(position, dtype=float)
    return ArmMotion(
        position, np.zeros(count) if velocity is None else velocity,
        np.full(count, low), np.full(count, high), np.full(count, 1.0), np.full(count, 4.0),
        position, np.zeros(count))


def drive(solve, interval_s, seconds, velocity=None, **limits):
    """Return positions and velocities of the gantry on its way, as setpoints ramp."""
    position, velocity = np.zeros(6), np.zeros(6) if velocity is None else velocity
    trace = [(position, velocity)]
    for _ in range(round(seconds / interval_s)):
        state = joints(position + interval_s * velocity, velocity, **limits)
        solution = solve(state, interval_s)
        position = position + (velocity + solution.velocity) / 2.0 * interval_s
        velocity = solution.velocity
        trace.append((position, velocity))
    return (np.array(values) for values in zip(*trace))


def drive_to(goal, interval_s, seconds, **arguments):
    return drive(lambda state, interval_s: approach(
        GANTRY, goal - state.position, state, interval_s, 10.0, 10.0),
        interval_s, seconds, **arguments)


@pytest.mark.full
@pytest.mark.parametrize('interval_s', [0.001, 0.01, 0.05])
def test_the_way_is_straight_without_overshoot_and_within_limits(interval_s):
    goal = np.array([0.3, -0.1, 0.0, 0.2, 0.0, 0.05])
    position, velocity = drive_to(goal, interval_s, 4.0)
    np.testing.assert_allclose(position[-1], goal, atol=1e-6)
    assert np.abs(velocity).max() <= 1.0 + 1e-9
    assert np.abs(np.diff(velocity, axis=0)).max() <= 4.0 * interval_s * 1.0001
    assert position[:, 0].max() <= 0.3 + 1e-6
    np.testing.assert_allclose(position, np.outer(position[:, 0] / 0.3, goal), atol=1e-9)


def test_the_way_takes_little_longer_than_the_shortest():
    position, velocity = drive_to(np.array([0.09, 0, 0, 0, 0, 0.0]), 0.01, 3.0)
    # Up with the limit of 4, down with half of it: v^2 / 8 + v^2 / 4 = 0.09.
    assert velocity.max() == pytest.approx(np.sqrt(0.09 / (1 / 8 + 1 / 4)), rel=0.06)
    there = np.flatnonzero(np.abs(position[:, 0] - 0.09) > 1e-5)[-1] * 0.01
    assert there < velocity.max() / 4.0 + velocity.max() / 2.0 + 0.05


def test_a_joint_in_motion_brakes_and_comes_back():
    position, velocity = drive_to(np.zeros(6), 0.01, 3.0, velocity=np.array([0.9, 0, 0, 0, 0, 0]))
    # v^2 / (2 a), and an interval until the first answer counts.
    assert 0.9**2 / 8.0 - 1e-3 <= position[:, 0].max() < 0.9**2 / 8.0 + 0.005
    np.testing.assert_allclose(position[-1], 0.0, atol=1e-6)


@pytest.mark.full
@pytest.mark.parametrize('interval_s', [0.001, 0.01, 0.05])
def test_a_joint_on_the_way_to_a_pose_beyond_its_range_stops_at_the_end(interval_s):
    position, velocity = drive_to(np.array([0.5, -0.5, 0.0, 0.1, 0.0, 0.0]), interval_s, 4.0,
                                  low=-0.2, high=0.2)
    assert np.abs(position).max() <= 0.2 + 1e-9
    np.testing.assert_allclose(position[-1], [0.2, -0.2, 0.0, 0.1, 0.0, 0.0], atol=1e-5)
    assert np.abs(np.diff(velocity, axis=0)).max() <= 4.0 * interval_s * 1.0001


@pytest.mark.full
@pytest.mark.parametrize('interval_s', [0.001, 0.01, 0.05])
def test_joints_brake_before_a_twist_brings_them_to_the_end_of_their_range(interval_s):
    twist = np.array([0.9, -0.9, 0.3, 0.0, 0.0, 0.0])
    position, velocity = drive(
        lambda state, interval_s: follow_twist(GANTRY, twist, state, interval_s),
        interval_s, 3.0, low=-0.4, high=0.4)
    assert np.abs(position).max() <= 0.4 + 1e-9
    np.testing.assert_allclose(position[-1, :3], [0.4, -0.4, 0.4], atol=1e-3)
    # Down with half of the limit of 4, of which a long interval takes some more.
    assert np.abs(np.diff(velocity, axis=0)).max() <= 4.0 * interval_s * 1.0001
    fast = np.flatnonzero(velocity[:, 0] > 0.9 - 1e-6)
    assert 0.4 - position[fast[-1], 0] == pytest.approx(0.9**2 / 4.0, abs=0.9 * 3 * interval_s)


def test_a_joint_at_its_limit_is_held_and_another_does_its_part():
    # Two joints move the end effector along x, the first has come to its end.
    jacobian = np.zeros((6, 2))
    jacobian[0] = [1.0, 0.5]
    at = np.array([1.0, 0.0])
    state = ArmMotion(at, np.zeros(2), np.array([-1.0, -1.0]), np.array([1.0, 1.0]), np.ones(2),
                      np.full(2, 1e3), at, np.zeros(2))
    solution = follow_twist(jacobian, np.array([0.1, 0, 0, 0, 0, 0]), state, 0.01)
    np.testing.assert_allclose(solution.velocity, [0.0, 0.2], atol=1e-9)
    np.testing.assert_array_equal(solution.held, [True, False])
    assert solution.progress == pytest.approx(1.0)
    away = follow_twist(jacobian, np.array([-0.1, 0, 0, 0, 0, 0]), state, 0.01)
    assert not away.held.any()
    np.testing.assert_allclose(jacobian[0] @ away.velocity, -0.1)


def test_joints_that_are_all_at_their_ends_give_nothing():
    jacobian = np.zeros((6, 1))
    jacobian[0] = 1.0
    state = joints([1.0], high=1.0)
    solution = follow_twist(jacobian, np.array([0.1, 0, 0, 0, 0, 0]), state, 0.01)
    np.testing.assert_array_equal(solution.velocity, [0.0])
    assert solution.held.all() and solution.progress == 0.0


@pytest.mark.parametrize('small', [0.0, 1e-9, 1e-3, 0.01, 0.03])
def test_near_a_singularity_velocities_stay_bounded(small):
    jacobian = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, small])
    state = joints([0.0] * 6)
    error = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.1])
    solution = approach(jacobian, error, state, 0.01, 1.0, 1.0)
    assert np.isfinite(solution.velocity).all()
    assert np.abs(solution.velocity).max() <= 1.0
    assert solution.singular == (small < 0.02)
    # As it does where the other direction is free: up with the acceleration limit.
    assert solution.velocity[0] > (0.01 if small < 2e-3 else 1e-3)


def test_a_twist_that_is_too_fast_is_slowed_down_in_its_direction():
    state = joints([0.0] * 6, np.array([1.0, 0.5, 0, 0, 0, 0]))
    solution = follow_twist(GANTRY, np.array([4.0, 2.0, 0, 0, 0, 0]), state, 0.01)
    assert solution.slowed
    np.testing.assert_allclose(solution.velocity, [1.0, 0.5, 0, 0, 0, 0], atol=1e-12)


def test_what_is_left_free_goes_to_the_posture_and_does_not_move_the_end_effector():
    # The first and the last of seven joints both move the end effector along x.
    jacobian = np.hstack([np.eye(6), np.eye(6)[:, :1]])
    state = ArmMotion(np.zeros(7), np.zeros(7), np.full(7, -9.0), np.full(7, 9.0), np.ones(7),
                      np.full(7, 1e3), np.array([0.1, 0.2, 0, 0, 0, 0, -0.1]), np.zeros(7))
    solution = approach(jacobian, np.zeros(6), state, 0.01, 1.0, 1.0)
    np.testing.assert_allclose(solution.velocity, [0.3, 0, 0, 0, 0, 0, -0.3], atol=1e-12)


def test_a_frame_is_a_body_or_a_site_that_is_turned_on_it():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody><body name="link" pos="1 2 3" euler="0 0 90"><geom size="1"/>
        <site name="tip" pos="0.5 0 0" euler="90 0 0"/></body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    frames = RobotFrames(model, ['link'], ['tip'])
    position, rotation = frames.find('tip', 'a test').pose(data)
    np.testing.assert_allclose(position, [1.0, 2.5, 3.0], atol=1e-12)
    np.testing.assert_allclose(rotation, [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    position, rotation = frames.find('link', 'a test').pose(data)
    np.testing.assert_allclose(position, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    position, rotation = frames.find('', 'a test').pose(data)
    np.testing.assert_array_equal(rotation, np.eye(3))


def test_the_acceleration_that_keeps_an_end_effector_straight_is_that_of_its_centripetal_one():
    op = operator_of('Panda')
    model, data, dofs = op.simulation.model, op.simulation.data, op.part.dof_addresses
    step = np.array([0.3, -0.2, 0.1, 0.4, 0.2, -0.3, 0.5])

    def jacobian():
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        full = np.empty((6, model.nv))
        mujoco.mj_jacSite(model, data, full[:3], full[3:], op.site)
        return full[:, dofs]
    # Not far from stretched.
    data.qpos[op.part.qpos_addresses[3]] = -1.0
    at = jacobian()
    data.qpos[op.part.qpos_addresses] += 1e-6 * step
    centripetal = (jacobian() - at) @ step / 1e-6
    directions, sizes, _ = np.linalg.svd(at)
    assert 0.03 < sizes[5] < 0.1
    needed = np.abs(at.T @ directions[:, 5]) / sizes[5]**2 * np.linalg.norm(centripetal)
    # It counts in full at a singular value of 0.06.
    np.testing.assert_allclose(
        bend(np.ascontiguousarray(at), step), needed * 0.06 / sizes[5], rtol=2e-3, atol=0.1)


def test_a_rate_is_lowered_exactly_where_the_end_effector_would_have_to_bend_too_much():
    draw, lowered = np.random.default_rng(0), 0
    for _ in range(300):
        jacobian, step = draw.normal(size=(6, 7)), draw.normal(size=7)
        jacobian[draw.integers(6)] *= draw.uniform(0.005, 1.0)
        jacobian[3:] /= np.linalg.norm(jacobian[3:], axis=0)
        limit, rate = draw.uniform(1.0, 20.0, 7), draw.uniform(0.01, 5.0)
        highest = np.sqrt((limit / bend(jacobian, step)).min())
        found = limit_rate(jacobian, step, limit, rate)
        assert found == pytest.approx(min(rate, highest), rel=1e-12)
        lowered += highest < rate
    assert 30 < lowered < 270


def test_displacements_without_bounds_are_those_of_the_bounded_search():
    # Bounds that the posture alone would meet, by next to nothing, call for the bounded search.
    draw, taken = np.random.default_rng(1), 0
    for _ in range(200):
        jacobian, task, away = draw.normal(size=(6, 7)), 0.2 * draw.normal(size=6), np.zeros(7)
        jacobian[0] *= draw.uniform(0.01, 1.0)
        if np.linalg.norm(np.linalg.pinv(jacobian) @ task) > 0.99:  # Not possible here.
            continue
        free, _ = displace(jacobian, task, np.full(7, -9.0), np.full(7, 9.0), away)
        taken += 1
        searched, drift = displace(jacobian, task, free - 1e-9, free + 1e-9, draw.normal(size=7))
        np.testing.assert_allclose(free, searched, atol=1e-8)
        np.testing.assert_allclose(
            jacobian @ free, task, atol=1e-6 * np.linalg.norm(task) + 1e-12)
        assert np.abs(drift).max() <= 2e-9
    assert 50 < taken < 200


def minimum(*problem):
    """Return where a quadratic function is smallest within bounds."""
    matrix, added, vector, low, high = problem
    place = np.empty(len(vector))
    minimize_in_box(matrix, added, vector, low, high, place)
    return place


@pytest.mark.parametrize('rank', [7, 6, 2])
def test_a_minimum_within_bounds_has_no_slope_but_into_the_bounds(rank):
    draw, met = np.random.default_rng(rank), 0
    for _ in range(300):
        root, vector = draw.normal(size=(7, rank)), draw.normal(size=7)
        matrix, added = root @ root.T, 10.0**draw.uniform(-9.0, -1.0)
        low, high = -draw.uniform(0.0, 1.0, 7), draw.uniform(0.0, 1.0, 7)
        place = minimum(matrix, added, vector, low, high)
        slope = matrix @ place + added * place - vector
        assert (low <= place).all() and (place <= high).all()
        # The conditions of Karush, Kuhn and Tucker, which are sufficient here.
        assert (slope[place > low] < 1e-7).all() and (slope[place < high] > -1e-7).all()
        met += np.count_nonzero((place == low) | (place == high))
    assert met > 300


def test_a_minimum_within_bounds_that_allow_nothing_is_at_them():
    low = np.array([0.2, -0.3, 0.0])
    np.testing.assert_array_equal(minimum(np.eye(3), 1e-9, np.ones(3), low, low), low)


def test_a_joint_beyond_its_range_comes_back_where_nothing_is_wanted():
    high = np.array([-1e-4, *[1.0] * 5])
    step, _ = displace(GANTRY, np.zeros(6), np.full(6, -1.0), high, np.zeros(6))
    np.testing.assert_allclose(step, [-1e-4, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
