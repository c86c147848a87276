# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Properties of the parsers of commands, for any numbers and names."""

import math
import sys

import numpy as np
import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, settings, strategies as st  # noqa: E402
from sampling import whole_robot  # noqa: E402

from manip_sim.control.commands import (  # noqa: E402
    BaseTwist, GripperAction, GripperSetpoint, JointSetpoint, JointTrajectory, NoCommand,
    TrajectoryStop)
from manip_sim.errors import CommandError, UnknownNameError  # noqa: E402

MODES = {'arm': 'position', 'torso': 'effort', 'base': 'velocity'}
#: A mobile base, a torso and an arm, in three modes, and a gripper.
SIMULATION = whole_robot('PandaOmron')
for part, mode in MODES.items():
    SIMULATION.robot.set_control_mode(part, mode)
ROBOT = SIMULATION.robot
PARSE, JOINTS = ROBOT.parse, ROBOT.joints
PARTS = {name: part for name, part in ROBOT.parts.items() if part.actuators}
HAND = 'right/gripper'
FINGERS = [name for name in ROBOT.parts[HAND].joints]
NAMES = [*JOINTS.names, *FINGERS]

SMALL = st.floats(-10.0, 10.0)
ANY = st.floats() | SMALL | st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e308, 5e-324])
#: Also what is no number at all, or so large that it is no double.
JUNK = st.none() | st.text(max_size=3) | st.booleans() | st.integers() | st.just(10**400)
STAMPS_NS = st.integers(0, 2**62) | st.integers(0, 2 * 10**10)


def numbers(count, elements=ANY):
    """Return lists that mostly have as many numbers as are needed."""
    return st.lists(elements, min_size=count, max_size=count) | st.lists(
        elements | JUNK, max_size=count + 1)


def names_of_joints(most):
    return st.lists(st.sampled_from(NAMES), unique=True, min_size=1, max_size=most) | st.lists(
        st.sampled_from(NAMES) | st.text(max_size=5), max_size=most)


def everything():
    """Return all that a command could change, as bytes."""
    setpoints = JOINTS.setpoints
    arrays = [SIMULATION.data.qpos, SIMULATION.data.qvel, SIMULATION.data.ctrl,
              SIMULATION.data.act, *(value for value in vars(setpoints).values()
                                     if isinstance(value, np.ndarray)),
              ROBOT.parts[HAND].gripper.current_action]
    return [array.tobytes() for array in arrays], list(JOINTS.commands.running), list(
        JOINTS.commands.waiting), [JOINTS.mode_of(name) for name in JOINTS.names]


def parsed(parse, *arguments, **options):
    """Return commands, or None where they are rejected as documented; nothing changes."""
    before = everything()
    try:
        commands = parse(*arguments, **options)
    except CommandError as error:
        assert str(error).isprintable() and len(str(error)) < 1000
        commands = None
    assert everything() == before
    return commands


def usable(values, count):
    """Return whether values are finite numbers, and as many as are needed."""
    # A whole number may be greater than any double.
    return len(values) == count and all(
        isinstance(v, (float, int)) and abs(v) <= sys.float_info.max for v in values)


def check_setpoint(command, part):
    """Check that a setpoint is finite, within its ranges and for joints of a part."""
    assert len(set(command.indices.tolist())) == len(command.indices) == len(command.values)
    assert command.modes == tuple(JOINTS.mode_of(JOINTS.names[i]) for i in command.indices)
    low, high = JOINTS.clamps(command.indices).T
    assert np.isfinite(command.values).all()
    assert (low <= command.values).all() and (command.values <= high).all()
    if part is not None:
        assert {JOINTS.names[i] for i in command.indices} <= set(ROBOT.parts[part].driven_joints)


@given(st.data(), st.sampled_from(sorted(PARTS)))
def test_an_action_is_rejected_or_within_the_limits_of_its_part(data, part):
    count = PARTS[part].gripper.dof if PARTS[part].gripper else len(PARTS[part].actuators)
    action = data.draw(numbers(count))
    command = parsed(PARSE.action, part, action)
    if all(type(value) is float for value in action):
        assert (command is not None) == usable(action, count)
    if command is None:
        return
    clamped = np.clip(np.array(action, dtype=float), -1.0, 1.0)
    assert command.clamped == np.count_nonzero(clamped != np.array(action, dtype=float))
    if part == HAND:
        assert type(command) is GripperAction
        np.testing.assert_array_equal(command.action, clamped)
        return
    check_setpoint(command, part)
    # Back from the middles and half widths of the ranges.
    low, high = JOINTS.ranges(command.indices).T
    np.testing.assert_allclose(command.values, (low + high) / 2.0 + clamped * (high - low) / 2.0,
                               rtol=1e-12, atol=1e-12)


@given(names_of_joints(6), st.data())
def test_a_joint_command_is_rejected_or_finite_and_within_limits(names, data):
    fields = {field: data.draw(st.just([]) | st.lists(ANY, max_size=len(names) + 1)
                               | st.lists(ANY, min_size=len(names), max_size=len(names)))
              for field in ('position', 'velocity', 'effort')}
    part = data.draw(st.none() | st.sampled_from(sorted(PARTS)))
    commands = parsed(PARSE.joint_command, names, **fields, part=part)
    if commands is None:
        return
    seen = []
    for command in commands:
        if isinstance(command, GripperSetpoint):
            low, high = ROBOT.grippers[HAND].joints.ranges(command.joints).T
            assert np.isfinite(command.values).all()
            assert (low <= command.values).all() and (command.values <= high).all()
            seen += command.joints
        elif isinstance(command, NoCommand):
            assert not len(command.indices) and command.parts
            assert not command.parts & frozenset().union(*(
                other.parts for other in commands if other is not command))
        else:
            assert type(command) is JointSetpoint
            check_setpoint(command, part)
            seen += [JOINTS.names[i] for i in command.indices]
    # Each joint is commanded once at most, and only if it was named.
    assert len(seen) == len(set(seen)) and set(seen) <= set(names)


@given(st.data())
def test_what_a_joint_command_says_of_each_joint_does_not_depend_on_their_order(data):
    names = data.draw(st.lists(st.sampled_from(JOINTS.names), unique=True, min_size=1))
    wanted = {name: data.draw(st.just(np.nan) | SMALL) for name in names}
    if all(np.isnan(value) for value in wanted.values()):
        return

    def result(order):
        fields = {field: [wanted[name] if JOINTS.mode_of(name) == field else np.nan
                          for name in order] for field in ('position', 'velocity', 'effort')}
        (command,) = (c for c in PARSE.joint_command(order, **fields)
                      if not isinstance(c, NoCommand))
        return {JOINTS.names[i]: value for i, value in zip(command.indices, command.values)}
    found = result(names)
    assert found == result(data.draw(st.permutations(names)))
    for name, value in found.items():
        ((low, high),) = JOINTS.clamps(JOINTS.find([name]))
        assert value == min(max(wanted[name], low), high)
    assert set(found) == {name for name, value in wanted.items() if not np.isnan(value)}


@st.composite
def trajectories(draw):
    names = draw(st.lists(st.sampled_from(ROBOT.parts['arm'].driven_joints), unique=True,
                          min_size=1, max_size=3) | names_of_joints(3))
    times = draw(st.lists(ANY, max_size=4) | st.lists(
        st.floats(0.0, 100.0), unique=True, max_size=4).map(sorted))

    def rows(elements):
        row = st.lists(elements, min_size=len(names), max_size=len(names))
        return draw(st.lists(row, min_size=len(times), max_size=len(times)) | st.lists(
            st.lists(elements, max_size=4), max_size=4))
    positions = rows(draw(st.sampled_from([ANY, SMALL, SMALL])))
    velocities = draw(st.booleans()) and rows(draw(st.sampled_from([ANY, SMALL, SMALL]))) or None
    accelerations = draw(st.booleans()) and rows(SMALL) or None
    return names, times, positions, velocities, accelerations


@pytest.mark.full
@settings(max_examples=150)
@given(trajectories(), STAMPS_NS, st.sampled_from(['arm', 'right', 'torso', 'base']))
def test_a_trajectory_is_rejected_or_finite_and_within_limits(trajectory, start_ns, part):
    now_ns = 10**10
    command = parsed(PARSE.trajectory, part, *trajectory, start_ns=start_ns, now_ns=now_ns)
    if command is None or isinstance(command, TrajectoryStop):
        assert command is None or len(trajectory[1]) == 0
        return
    assert type(command) is JointTrajectory
    names, times, *_ = trajectory
    motion, limits = command.trajectory, JOINTS.clamps(command.indices)
    assert [JOINTS.names[i] for i in command.indices] == names
    assert command.slowed >= 1.0 and command.start_ns in (0, start_ns)
    assert (np.diff(motion.times_s) > 0.0).all()
    assert np.isfinite(motion.positions).all()
    assert (limits[:, 0] <= motion.positions).all() and (motion.positions <= limits[:, 1]).all()
    if command.slowed == 1.0:
        np.testing.assert_array_equal(motion.times_s, times)
    for time_s in np.linspace(0.0, motion.end_s, 7):
        assert all(np.isfinite(values).all() for values in motion.at(time_s))


@given(numbers(3))
def test_a_twist_is_rejected_or_finite_and_within_limits(values):
    if len(values) != 3:
        return
    command = parsed(PARSE.twist, *values)
    if all(type(value) is float for value in values):
        assert (command is not None) == usable(values, 3)
    if command is not None:
        assert type(command) is BaseTwist
        low, high = JOINTS.clamps(command.indices).T
        np.testing.assert_array_equal(
            command.twist, np.clip(np.array(values, dtype=float), low, high))


FRAMES = st.sampled_from(['', 'world', 'robot0_link3', 'nowhere']) | st.text(max_size=4)


@given(numbers(3), numbers(4, st.floats(-1.0, 1.0) | ANY), FRAMES, st.booleans())
def test_a_target_pose_is_rejected_or_a_rigid_motion(position, quat, frame, unit):
    size = math.hypot(*quat) if usable(quat, 4) else 0.0
    if unit and 1e-3 < size < 1e3:
        quat = [q / size for q in quat]
    command = parsed(ROBOT.parse_cartesian.pose, 'right', position, quat, frame)
    if command is not None:
        np.testing.assert_array_equal(command.position, position)
        assert np.abs(command.position).max() <= 1e4
        np.testing.assert_allclose(command.rotation @ command.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(command.rotation) == pytest.approx(1.0)


@given(numbers(3), numbers(3), FRAMES)
def test_a_target_twist_is_rejected_or_keeps_its_direction_within_limits(linear, angular, frame):
    command = parsed(ROBOT.parse_cartesian.twist, 'right', linear, angular, frame)
    if command is None:
        return
    settings_of_arm = JOINTS.cartesian.settings['right']
    for given_half, half, limit in (
            (linear, command.twist[:3], settings_of_arm.linear_velocity),
            (angular, command.twist[3:], settings_of_arm.angular_velocity)):
        given_half = np.array(given_half, dtype=float)
        assert np.linalg.norm(half) <= limit * (1.0 + 1e-12)
        np.testing.assert_allclose(np.cross(half, given_half), 0.0, atol=1e-9)
        assert half @ given_half >= 0.0
        if np.linalg.norm(given_half) <= limit:
            np.testing.assert_array_equal(half, given_half)


@given(numbers(6))
def test_a_pose_action_is_rejected_or_clamped(action):
    command = parsed(ROBOT.parse_cartesian.action, 'right', action)
    if all(type(value) is float for value in action):
        assert (command is not None) == usable(action, 6)
    if command is not None:
        np.testing.assert_array_equal(
            command.action, np.clip(np.array(action, dtype=float), -1.0, 1.0))


@given(st.text(max_size=8))
def test_a_part_is_one_of_the_robot_or_rejected_with_those_that_there_are(part):
    if part in ROBOT.parts:
        return
    for parse in (lambda: PARSE.action(part, [0.0]),
                  lambda: ROBOT.parse_cartesian.action(part, [0.0]),
                  lambda: PARSE.joint_command(['x'], [0.0], part=part),
                  lambda: PARSE.trajectory(part, ['x'], [1.0], [[0.0]])):
        with pytest.raises(UnknownNameError, match='available: '):
            parse()


#: Is commanded and moves, unlike the one above.
MOVED = whole_robot('Panda')


@pytest.mark.full
@settings(max_examples=60)
@given(st.lists(st.sampled_from(['action', 'joints', 'trajectory', 'fingers', 'pose']),
                min_size=1, max_size=3), st.data())
def test_no_accepted_command_makes_the_physics_diverge(kinds, data):
    robot = MOVED.robot
    arm, hand = list(robot.parts['arm'].driven_joints), robot.parts[HAND]
    wild = st.floats(allow_nan=False, allow_infinity=False) | SMALL
    for kind in kinds:
        values = data.draw(st.lists(wild, min_size=7, max_size=7))
        try:
            command = {
                'action': lambda v: [robot.parse.action('arm', v)],
                'joints': lambda v: robot.parse.joint_command(arm, v),
                'trajectory': lambda v: [robot.parse.trajectory(
                    'arm', arm, [0.01, 0.5], [v, v[::-1]], now_ns=MOVED.time_ns)],
                'fingers': lambda v: [robot.parse.action(HAND, v[:hand.gripper.dof])],
                'pose': lambda v: [robot.parse_cartesian.pose('right', v[:3], [1, 0, 0, 0])],
            }[kind](values)
        except CommandError:
            continue
        robot.apply(*command, period_s=0.01)
        MOVED.advance(5)
        assert MOVED.diverged is None
        low, high = JOINTS.clamps(JOINTS.find(arm)).T
        position = robot.measured('arm')[:7]
        assert (low - 0.05 <= position).all() and (position <= high + 0.05).all()
