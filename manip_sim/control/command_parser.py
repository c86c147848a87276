# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Validate input from outside and turn it into commands; nothing is changed here.

Goals of named joints may be those of a ``sensor_msgs/JointState``.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, matrix_of, xyzw_to_wxyz
from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_commands import (
    CartesianPose, CartesianTwist, CartesianWrench, ForceMode, GuardedTwist, PoseAction)
from manip_sim.control.cartesian.cartesian_settings import CartesianSettings
from manip_sim.control.commands import (
    BaseTwist, Command, GripperAction, GripperSetpoint, JointImpedance, JointSetpoint,
    JointTrajectory, NoCommand, TrajectoryStop)
from manip_sim.control.gripper_controller import GripperController
from manip_sim.control.joint_controller import JointController
from manip_sim.control.modes import FIELDS, IMPEDANCE, MODES, names_of_modes, POSITION
from manip_sim.control.trajectory import check_times, Trajectory
from manip_sim.errors import CommandError, describe_choices, UnknownNameError
from manip_sim.models.robots import RobotModel
from manip_sim.models.robots.robot_model import SUBSYSTEMS
from manip_sim.physics.poses_and_twists import MAX_WRENCH, Pose, Twist
from manip_sim.physics.robot_frames import RobotFrames
from manip_sim.quoting import format_value, pluralize, quoted
from manip_sim.validation import (
    clamp, clamped_example, command_numbers, finite_command_numbers,
    positive_number)

#: Number of lists of names whose meaning is cached; a client has a few.
_REMEMBERED = 64
#: A trajectory with more points is rejected: checking it would take too long.
MAX_POINTS = 10_000
#: A start farther ahead is rejected as the stamp of another clock [s].
_MAX_AHEAD_S = 3600.0


@dataclass(frozen=True)
class _Group:
    """
    The named joints that one controller moves.

    :ivar places: indices of the joints among the names, shape (n,)
    :ivar names: of the joints
    :ivar clamps: ranges of their goals, shape (n, 2)
    :ivar indices: for the command
    :ivar modes: names of their control modes; None for joints of a gripper
    """

    parts: frozenset[str]
    places: IntArray
    names: tuple[str, ...]
    clamps: FloatArray
    indices: IntArray
    modes: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        # Many commands share these arrays.
        for shared in (self.places, self.clamps, self.indices):
            shared.setflags(write=False)


@dataclass(frozen=True)
class _Addressed:
    """
    Properties shared by commands for the same joints while the control modes stay.

    :ivar modes: names of the control mode of each joint
    :ivar all_use: the field that all joints use, or None
    :ivar uses: by field, whether each joint uses it
    :ivar takers: by field, the places of the joints that need a number there
    :ivar groups: the joints outside grippers, then the joints of each gripper
    """

    names: tuple[str, ...]
    modes: tuple[str, ...]
    all_use: str | None
    uses: dict[str, BoolArray]
    takers: dict[str, list[int]]
    groups: tuple[_Group, ...]

    @property
    def parts(self) -> frozenset[str]:
        """The parts of all joints."""
        return frozenset().union(*(group.parts for group in self.groups))


class CommandParser:
    """
    A parser of commands for the parts of a robot.

    :param robot: for which the commands are; its ``format_action`` maps abstract actions
    :param joints: controller of the joints of arms, base, torso, head and legs; only read
    :param grippers: controllers of the grippers, by part; only read
    """

    def __init__(self, robot: RobotModel, joints: JointController,
                 grippers: Mapping[str, GripperController]) -> None:
        self._robot, self._joints, self._grippers = robot, joints, grippers
        self._fingers = {part: gripper.joints for part, gripper in grippers.items()}
        self._gripper_of = {joint: fingers for fingers in self._fingers.values()
                            for joint in fingers.names}
        self._addressed = lru_cache(_REMEMBERED)(self._address)

    def joint_command(self, names: Sequence[str], position: ArrayLike = (),
                      velocity: ArrayLike = (), effort: ArrayLike = (), part: str | None = None
                      ) -> list[Command]:
        """
        Return the commands for goals of some joints; one invalid goal rejects them all.

        Each joint uses the field of its control mode; NaN means no command for the joint. A field
        may also have numbers only for the joints whose mode uses it, in the order of their names;
        finger joints at the end, or coupled to one named before them, need none. Parts that are
        named without any number get a ``NoCommand``.

        :param names: of the joints
        :param position: goals of the joints in position mode [rad or m]
        :param velocity: goals of the joints in velocity mode [rad/s or m/s]
        :param effort: goals of the joints in effort mode [N m or N]
        :param part: whose joints may be named; None for all
        :raises CommandError: if a joint is unknown or named twice, or the numbers do not match
        """
        label = part or 'joint_command'
        names = as_names(names, label)
        columns: dict[str, FloatArray] = {}
        for field, column in zip(FIELDS, (position, velocity, effort)):
            if not (isinstance(column, (tuple, array)) and not column):
                columns[field] = command_numbers(column, f'{label}: {field}')
        if not len(names) and all(np.isnan(numbers).all() for numbers in columns.values()):
            return []
        modes = self._joints.modes  # They may change while this thread reads the command.
        addressed = self._addressed(part, names, modes)
        if len(columns) == 1:  # As most commands are: a number for each joint, all in one field.
            (field, numbers), = columns.items()
            if numbers.shape == (len(names),) and addressed.all_use == field and (
                    np.isfinite(numbers).all()):
                return _commands(self._robot, addressed, numbers)
        values = np.full(len(names), np.nan)
        for field, numbers in columns.items():
            if not numbers.size:
                continue
            placed = self._placed(label, field, numbers, addressed)
            uses = addressed.uses[field]
            surplus = ~(uses | np.isnan(placed))
            if np.count_nonzero(surplus):
                place = np.flatnonzero(surplus)[0]
                raise CommandError(
                    f"{label}: joint '{names[place]}' is in {addressed.modes[place]} mode, which "
                    f'does not use the field {field}: leave it empty, or NaN for this joint')
            values[uses] = placed[uses]
        missing = np.isnan(values)
        if not np.count_nonzero(missing):
            return _commands(self._robot, addressed, values)
        commands, silent = [], addressed.parts
        if not missing.all():
            named = tuple(name for name, gone in zip(names, missing) if not gone)
            commands = _commands(
                self._robot, self._addressed(part, named, modes), values[~missing])
            silent = silent.difference(*(command.parts for command in commands))
        if silent:
            commands.append(NoCommand(
                robot=self._robot, parts=silent, indices=np.empty(0, dtype=np.int64)))
        return commands

    def joint_impedance(self, names: Sequence[str], position: ArrayLike = (),
                        velocity: ArrayLike | None = None, effort: ArrayLike | None = None,
                        stiffness: ArrayLike | None = None, damping: ArrayLike | None = None,
                        part: str | None = None) -> list[Command]:
        """
        Return the command for joints in impedance mode.

        A servo exerts ``stiffness * (position - measured) + damping * (velocity - measured) +
        effort`` and what the motion of its setpoint needs, which goes to the position within the
        limits of the joint. None, nothing or NaN leaves a number as it was: at first the model's
        gains, no effort, and the velocity of the setpoint.

        :param names: of the joints, n of them
        :param position: goals [rad or m], shape (n,)
        :param velocity: with respect to which the servos damp [rad/s or m/s], shape (n,)
        :param effort: to be added, until another one or another mode [N m or N], shape (n,)
        :param stiffness: [N m/rad or N/m], a number or shape (n,)
        :param damping: [N m s/rad or N s/m], a number or shape (n,)
        :param part: whose joints may be named; None for all
        :raises CommandError: if a joint is unknown, named twice or in another mode, or the numbers
            do not match, are infinite, or are not positive gains
        """
        label = part or 'joint_impedance'
        names, joints = as_names(names, label), self._joints
        check_names(names, [joints.names[i] for i in (
            range(len(joints.names)) if part is None else joints.indices_of(part))], label)
        modes, indices = joints.modes, joints.find(names)
        for name, index in zip(names, indices.tolist()):
            if modes[index] != IMPEDANCE.name:
                raise CommandError(f"{label}: joint '{name}' is in {modes[index]} mode, not in "
                                   f'{IMPEDANCE.name} mode')
        columns = {field: _column(label, field, values, len(names)) for field, values in (
            ('position', position), ('velocity', velocity), ('effort', effort),
            ('stiffness', stiffness), ('damping', damping))}
        for field in ('stiffness', 'damping'):
            low = columns[field] <= 0.0
            if low.any():
                place = int(np.argmax(low))
                raise CommandError(
                    f"{label}: {field} of joint '{names[place]}' must be greater than 0, got "
                    f'{columns[field][place]:g}')
        inside, clamped, example = dict(columns), 0, ''
        for field, ranges in (('position', joints.clamps(indices, modes)),
                              ('velocity', joints.ranges_of('velocity', indices)),
                              ('effort', joints.ranges_of('effort', indices))):
            inside[field] = np.clip(columns[field], ranges[:, 0], ranges[:, 1])  # NaN stays.
            before, after = np.nan_to_num(columns[field]), np.nan_to_num(inside[field])
            if (before != after).any():
                clamped += int(np.count_nonzero(before != after))
                example = example or f'{field} of {clamped_example(names, before, after)}'
        return [JointImpedance(
            robot=self._robot, parts=joints.parts_of(indices), indices=indices, clamped=clamped,
            clamped_example=example, modes=(IMPEDANCE.name,) * len(names),
            values=inside.pop('position'), pulls=np.array([*inside.values()]))]

    def action(self, part: str, action: ArrayLike) -> Command:
        """
        Return the command for an abstract action.

        :param part: such as ``arm`` or ``right/gripper``
        :param action: in [-1, 1] for each actuator of the part, or each dof of the gripper
        :raises CommandError: if the length is wrong or a number is not finite
        :raises UnknownNameError: if the part is unknown
        """
        if part in self._grippers:
            gripper = self._grippers[part]
            inside, clamped = _checked_action(action, gripper.dof, f'{part}: an action')
            return GripperAction(robot=self._robot, parts=frozenset([part]),
                                 indices=gripper.indices, action=inside, **clamped)
        indices, modes = self._joints.indices_of(part), self._joints.modes
        inside, clamped = _checked_action(action, len(indices), f'{part}: an action')
        return JointSetpoint(
            robot=self._robot, parts=self._joints.parts_of(indices), indices=indices,
            modes=tuple(modes[i] for i in indices),
            values=self._formatted(part, indices, inside, modes), **clamped)

    def trajectory(self, part: str, names: Sequence[str], times_s: Sequence[float],
                   positions: ArrayLike, velocities: ArrayLike | None = None,
                   accelerations: ArrayLike | None = None, start_ns: int = 0,
                   now_ns: int = 0) -> Command:
        """
        Return the command for a trajectory of some joints of a part.

        The spline is made and checked here, from the present setpoints. Points in the past are
        dropped; a motion that exceeds velocity limits is slowed down as a whole. Without points
        the present trajectories of the joints end.

        :param times_s: of the points, from the start [s]
        :param positions: [rad or m], shape (n_points, n)
        :param velocities: [rad/s or m/s], of that shape, or None
        :param accelerations: [rad/s^2 or m/s^2], of that shape, or None
        :param start_ns: simulation time of the start [ns]; 0 for now
        :param now_ns: present simulation time [ns]
        :raises CommandError: if a joint is unknown, the times do not increase, all points are in
            the past or the numbers do not match; or if the mode of a joint
            follows no trajectories
        """
        joints = self._joints
        indices, names = joints.indices_of(part), as_names(names, part)
        times = command_numbers(times_s, f'{part}: time_from_start')
        if names or times.size:
            check_names(names, [joints.names[i] for i in indices], part)
            indices = joints.find(names)
        if not times.size:
            return TrajectoryStop(
                robot=self._robot, parts=joints.parts_of(indices), indices=indices)
        modes = joints.modes
        for name, i in zip(names, indices):
            if not MODES[modes[i]].follows_trajectories:
                able = names_of_modes(lambda mode: mode.follows_trajectories)
                raise CommandError(f'{part} follows trajectories in {able} mode only, '
                                   f"joint '{name}' is in {modes[i]} mode")
        if times.size > MAX_POINTS:
            raise CommandError(f'{part}: a trajectory may have at most {MAX_POINTS} points, got '
                               f'{times.size}')
        times = finite_command_numbers(times, times.size, f'{part}: time_from_start')
        check_times(times)
        shape = (len(times), len(names))
        asked = _points(part, 'positions', positions, shape)
        goal, clamped = _clamped(asked, joints.clamps(indices, modes), names)
        goal_velocities = (
            None if velocities is None else _points(part, 'velocities', velocities, shape))
        goal_accelerations = (
            None if accelerations is None
            else _points(part, 'accelerations', accelerations, shape))
        if goal_accelerations is not None and goal_velocities is None:
            raise CommandError(f'{part}: accelerations need velocities')
        delay_s = (start_ns - now_ns) * 1e-9 if start_ns else 0.0
        _check_start(part, times, delay_s)
        elapsed_s = max(0.0, -delay_s)
        trajectory, slowed = joints.fitted(
            Trajectory(times, goal, goal_velocities, goal_accelerations), indices, elapsed_s)
        if slowed > 1.0 and elapsed_s > 0.0:
            start_ns = 0
        return JointTrajectory(
            robot=self._robot, parts=joints.parts_of(indices), indices=indices,
            trajectory=trajectory, columns=np.arange(len(names)), start_ns=start_ns,
            slowed=slowed, **clamped)

    def twist(self, forward: float, side: float, yaw: float) -> Command:
        """
        Return the command for a velocity of the mobile base in its own frame.

        :param forward: along x [m/s]
        :param side: along y [m/s]
        :param yaw: about z [rad/s]
        :raises CommandError: if a number is not finite, or no base has a mode that takes it
        """
        indices = self._joints.twist_indices
        if indices is None:
            raise CommandError('base: this robot has no base that takes a twist')
        values = finite_command_numbers([forward, side, yaw], 3, 'base: a twist')
        modes = self._joints.modes
        if not MODES[modes[indices[0]]].takes_twists:
            able = names_of_modes(lambda mode: mode.takes_twists)
            raise CommandError(f'base takes a twist in {able} mode only, it is in '
                               f'{modes[indices[0]]} mode')
        inside, clamped = _clamped(values, self._joints.twist_clamps(indices, modes),
                                   ('linear.x', 'linear.y', 'angular.z'))
        return BaseTwist(
            robot=self._robot, parts=self._joints.parts_of(indices), indices=indices,
            twist=inside, joints=indices, columns=np.arange(3), **clamped)

    def _placed(self, what: str, field: str, given: FloatArray, addressed: _Addressed
                ) -> FloatArray:
        """Return the numbers of a field by joint, NaN where there is none."""
        count = len(addressed.names)
        if np.count_nonzero(np.isinf(given)):
            infinite = np.flatnonzero(np.isinf(given))[0]
            raise CommandError(f'{what}: {field} must be finite, got {given.flat[infinite]} at '
                               f'index {infinite}')
        if given.shape == (count,):
            return given
        placed = np.full(count, np.nan)
        if np.isnan(given).all():
            return placed
        takers = addressed.takers[field]
        observed = [i for i in takers[given.size:] if addressed.names[i] not in self._gripper_of]
        if given.ndim != 1 or given.size > len(takers) or observed:
            raise CommandError(f'{what}: {field} must have {pluralize(count, "number")}, '
                               f'got {given.size}: one for each joint')
        placed[takers[:given.size]] = given
        return placed

    def _address(self, part: str | None, names: tuple[str, ...], modes: tuple[str, ...]
                 ) -> _Addressed:
        """Return the meaning of the names while all joints are in these modes."""
        for gripper in self._fingers.values():
            gripper.check_take_positions(names)
        check_names(names, self._available(part), part or 'joint_command')
        mode_of = dict(zip(self._joints.names, modes))
        meant = tuple(
            POSITION.name if name in self._gripper_of else mode_of[name] for name in names)
        used = [MODES[mode].field for mode in meant]
        return _Addressed(
            names, meant, used[0] if len(set(used)) == 1 else None,
            {field: np.array([use == field for use in used]) for field in FIELDS},
            {field: self._takers(field, names, used) for field in FIELDS},
            (*self._own(names, meant, modes), *self._of_grippers(names)))

    def _available(self, part: str | None) -> list[str]:
        if part is None:
            return [*self._joints.names, *self._gripper_of]
        if part in self._fingers:
            return list(self._fingers[part].names)
        return [self._joints.names[i] for i in self._joints.indices_of(part)]

    def _takers(self, field: str, names: Sequence[str], used: Sequence[str]) -> list[int]:
        followed: set[str] = set()
        takers = []
        for index, (name, use) in enumerate(zip(names, used)):
            if use != field or name in followed:
                continue
            takers.append(index)
            if name in self._gripper_of:
                followed.update(self._gripper_of[name].followers(name))
        return takers

    def _own(self, names: Sequence[str], meant: Sequence[str], modes: Sequence[str]
             ) -> Iterable[_Group]:
        places = [i for i, name in enumerate(names) if name not in self._gripper_of]
        if places:
            joint_names = tuple(names[i] for i in places)
            indices = self._joints.find(joint_names)
            yield _Group(self._joints.parts_of(indices), np.array(places), joint_names,
                         self._joints.clamps(indices, modes), indices,
                         tuple(meant[i] for i in places))

    def _of_grippers(self, names: Sequence[str]) -> Iterable[_Group]:
        for part, gripper in self._fingers.items():
            places = [i for i, name in enumerate(names) if self._gripper_of.get(name) is gripper]
            if places:
                fingers = tuple(names[i] for i in places)
                yield _Group(frozenset([part]), np.array(places), fingers,
                             gripper.ranges(fingers), gripper.actuators_of(fingers))

    def _formatted(self, part: str, indices: IntArray, action: FloatArray, modes: Sequence[str]
                   ) -> FloatArray:
        # format_action knows subsystems, of which one arm of two is only a part.
        subsystem = part if part in SUBSYSTEMS else 'arm'
        whole = self._joints.indices_of(subsystem)
        places = np.flatnonzero(np.isin(whole, indices))
        padded = np.zeros(len(whole))
        padded[places] = action
        ranges = self._joints.ranges(whole, modes)
        return self._robot.format_action(subsystem, padded, ranges)[places]


def as_names(names: Sequence[str], what: str) -> tuple[str, ...]:
    """
    Return the names of joints as a tuple.

    :param what: noun for their receiver, for the message
    :raises CommandError: if they are not a sequence of texts
    """
    try:
        texts = tuple(names)
        ''.join(texts)  # It takes nothing but texts.
        if not isinstance(names, str):
            return texts
    except TypeError:
        pass
    raise CommandError(f'{what}: names of joints must be a sequence of texts, '
                       f'got {format_value(names)}')


def check_names(names: Sequence[str], available: Sequence[str], what: str) -> None:
    """
    Check the names of joints.

    :param available: the joints that can be commanded
    :param what: what takes them, for the message
    :raises CommandError: if there are none, one is unknown, or one comes twice
    """
    if not len(names):
        raise CommandError(f'{what}: no joint is named')
    known = set(available)
    for name in names:
        if name not in known:
            raise CommandError(f'{what} has no joint {quoted(name)} that can be commanded: '
                               f'{describe_choices(name, available)}')
    if len(set(names)) != len(names):
        twice = next(name for name in names if list(names).count(name) > 1)
        raise CommandError(f"{what}: joint '{twice}' is named twice")


def _commands(robot: RobotModel, addressed: _Addressed, values: FloatArray) -> list[Command]:
    """Return the commands for the goals of all joints that are addressed."""
    commands: list[Command] = []
    for group in addressed.groups:
        inside, clamped = _clamped(values[group.places], group.clamps, group.names)
        common: dict[str, Any] = {'robot': robot, 'parts': group.parts, 'indices': group.indices,
                                  'values': inside, **clamped}
        commands.append(GripperSetpoint(joints=group.names, **common) if group.modes is None
                        else JointSetpoint(modes=group.modes, **common))
    return commands


def _clamped(values: FloatArray, ranges: FloatArray, names: Sequence[str]
             ) -> tuple[FloatArray, dict[str, Any]]:
    """Return numbers in their ranges, and what their command says of those that were not."""
    inside, count = clamp(values, ranges)
    return inside, {} if not count else {
        'clamped': count, 'clamped_example': clamped_example(names, values, inside)}


def _checked_action(action: ArrayLike, count: int, what: str
                    ) -> tuple[FloatArray, dict[str, Any]]:
    """Return the numbers of an action in [-1, 1], and the same as :func:`_clamped`."""
    numbers = finite_command_numbers(action, count, what)
    return _clamped(numbers, np.array([-1.0, 1.0]), [f'data[{i}]' for i in range(count)])


def _column(what: str, field: str, values: ArrayLike | None, count: int) -> FloatArray:
    """Return a number for each joint, NaN where there is none."""
    numbers = np.array([]) if values is None else command_numbers(values, f'{what}: {field}')
    if not numbers.size:
        return np.full(count, np.nan)
    if np.isinf(numbers).any():
        raise CommandError(f'{what}: {field} must be finite, got {numbers[np.isinf(numbers)][0]}')
    if numbers.ndim == 0 and field in ('stiffness', 'damping'):
        return np.full(count, float(numbers))
    if numbers.shape != (count,):
        raise CommandError(f'{what}: {field} must have {pluralize(count, "number")}, one for each '
                           f'joint, got the shape {numbers.shape}')
    return np.array(numbers, dtype=float)


def _points(part: str, field: str, values: ArrayLike, shape: tuple[int, int]) -> FloatArray:
    try:
        numbers = command_numbers(values, f'{part}: {field}')
    except CommandError:  # No numbers, or points of different lengths.
        numbers = np.empty(0)
    if numbers.shape != shape:
        raise CommandError(f'{part}: {field} must have {pluralize(shape[1], "number")} at each of '
                           f'{pluralize(shape[0], "point")}')
    if not np.isfinite(numbers).all():
        raise CommandError(f'{part}: {field} must be finite')
    return numbers


def _check_start(part: str, times: FloatArray, delay_s: float) -> None:
    if delay_s > _MAX_AHEAD_S:
        raise CommandError(f'{part}: the trajectory would start in {delay_s:.0f} s of simulation '
                           'time, by its stamp: set use_sim_time in the node that sends it, or '
                           'leave the stamp zero')
    if delay_s < 0.0 and times[-1] + delay_s < 0.0:
        raise CommandError(f'{part}: the trajectory ended {-(times[-1] + delay_s):.3f} s ago, by '
                           'its stamp')


class CartesianParser:
    """
    A parser of Cartesian commands for the arms of a robot.

    :param robot: for which the commands are
    :param joints: controller of the joints; only read
    :param frames: of the robot
    """

    def __init__(self, robot: RobotModel, joints: JointController, frames: RobotFrames) -> None:
        self._robot = robot
        self._joints = joints
        self._frames = frames

    def rebind(self, model: mujoco.MjModel) -> None:
        """Take over the ids of the robot's frames in another model."""
        self._frames.rebind(model)

    @property
    def _settings(self) -> Mapping[str, CartesianSettings]:
        return self._joints.cartesian.settings

    def pose(self, arm: str, position: ArrayLike, quat_xyzw: ArrayLike, frame: str = ''
             ) -> CartesianPose:
        """
        Return the command to bring ``grip_site`` of an arm to a pose.

        :param position: in the frame [m], shape (3,)
        :param quat_xyzw: in the frame, of length 1, shape (4,)
        :param frame: a link of the robot or a frame on one; empty for ``world``
        :raises CommandError: if the frame is unknown, or the numbers are not a pose
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        of_arm = self._of(arm)
        target_frame = self._frames.find(frame, f'{arm}: a target pose')
        pose = Pose.checked(position, quat_xyzw)
        return CartesianPose(
            **of_arm, frame=target_frame, position=pose.position,
            rotation=matrix_of(xyzw_to_wxyz(pose.quat_xyzw)))

    def twist(self, arm: str, linear: ArrayLike, angular: ArrayLike, frame: str = ''
              ) -> CartesianTwist:
        """
        Return the command for a velocity of ``grip_site`` of an arm.

        A velocity above the limit of the settings is scaled down to it, and counted as clamped.

        :param linear: [m/s], shape (3,)
        :param angular: [rad/s], shape (3,)
        :param frame: whose axes the velocity is in; empty for ``world``
        :raises CommandError: if the frame is unknown, or a number is not finite or too great
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        of_arm = self._of(arm)
        target_frame = self._frames.find(frame, f'{arm}: a target twist')
        twist = Twist.checked(linear, angular)
        settings = self._settings[arm]
        halves = [_shortened(twist.linear, settings.linear_velocity),
                  _shortened(twist.angular, settings.angular_velocity)]
        return CartesianTwist(
            **of_arm, frame=target_frame, twist=np.concatenate([vector for vector, _ in halves]),
            clamped=sum(clamped for _, clamped in halves))

    def until_contact(self, arm: str, linear: ArrayLike, angular: ArrayLike, *, force: float,
                      distance: float, duration_s: float, frame: str = '') -> GuardedTwist:
        """
        Return the command for a velocity of ``grip_site`` of an arm until contact.

        ``reports[arm].contact`` of the Cartesian controller has where it ended, and why.

        :param linear: [m/s], shape (3,)
        :param angular: [rad/s], shape (3,)
        :param force: size of the external force on the tool that ends it [N]
        :param distance: of ``grip_site`` from where it is now, which ends it [m]
        :param duration_s: simulation time that ends it [s]
        :param frame: whose axes the velocity is in; empty for ``world``
        :raises CommandError: if the frame is unknown, a velocity is not finite, or a number that
            ends the motion is not above 0
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        twist = self.twist(arm, linear, angular, frame)
        limits = {name: positive_number(value, f'{arm}: the {name} of a motion until contact',
                                        CommandError) for name, value in (
            ('force', force), ('distance', distance), ('duration', duration_s))}
        return GuardedTwist(**vars(twist), force=limits['force'], distance=limits['distance'],
                            duration_s=limits['duration'])

    def wrench(self, arm: str, force: ArrayLike, torque: ArrayLike, frame: str = ''
               ) -> CartesianWrench:
        """
        Return the command for a wrench that an impedance adds to that of its springs.

        :param force: that ``grip_site`` pushes with [N], shape (3,)
        :param torque: about ``grip_site`` [N m], shape (3,)
        :param frame: whose axes the wrench is in; empty for ``world``
        :raises CommandError: if the frame is unknown, a number is not finite or too great, or the
            arm is not an impedance
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        of_arm = self._of(arm)
        target_frame = self._frames.find(frame, f'{arm}: a target wrench')
        wrench = np.concatenate([
            _wrench(force, 3, f'{arm}: the force of a target wrench'),
            _wrench(torque, 3, f'{arm}: the torque of a target wrench')])
        self._check_impedance(arm, 'a target wrench')
        return CartesianWrench(**of_arm, frame=target_frame, wrench=wrench)

    def force_mode(self, arm: str, selection: ArrayLike, wrench: ArrayLike, limits: ArrayLike
                   ) -> ForceMode:
        """
        Return the command for an impedance to exert a wrench along and about chosen axes.

        Its springs do not act there; along and about the other axes they hold the target.

        :param selection: 1 for the axes of the springs that are chosen, else 0, shape (6,)
        :param wrench: force and torque there [N, N m], shape (6,); the others are not used
        :param limits: velocities there [m/s, rad/s], above 0, shape (6,); the others are not used
        :raises CommandError: if a number is not finite or out of range, or the arm is not an
            impedance
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        of_arm, numbers = self._of(arm), [
            finite_command_numbers(value, 6, f'{arm}: the {name} of force mode')
            for value, name in (
                (selection, 'selection'), (wrench, 'wrench'), (limits, 'limits'))]
        _wrench(numbers[1], 6, f'{arm}: the wrench of force mode')
        chosen = numbers[0] == 1.0
        if not (chosen | (numbers[0] == 0.0)).all():
            raise CommandError(f'{arm}: the selection of force mode must be 0 or 1 for each axis, '
                               f'got {numbers[0].tolist()}')
        if not (numbers[2][chosen] > 0.0).all():
            raise CommandError(f'{arm}: the limits of force mode must be above 0 for the axes '
                               f'that are chosen, got {numbers[2].tolist()}')
        self._check_impedance(arm, 'force mode')
        return ForceMode(
            **of_arm, frame=self._frames.find('', arm), selection=chosen,
            wrench=np.where(chosen, numbers[1], 0.0), limits=np.where(chosen, numbers[2], 1.0))

    def _check_impedance(self, arm: str, what: str) -> None:
        if not self._joints.impedes(arm):
            raise CommandError(f'{arm}: {what} needs effort mode and a cartesian_stiffness.{arm} '
                               'that is not zero')

    def action(self, arm: str, action: ArrayLike) -> PoseAction:
        """
        Return the command for an action of robosuite's OSC_POSE.

        :param action: six numbers in [-1, 1]: along x, y, z and about x, y, z
        :raises CommandError: if the length is wrong or a number is not finite
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        of_arm = self._of(arm)
        inside, clamped = _checked_action(action, 6, f'{arm}: a pose action')
        return PoseAction(**of_arm, action=inside, **clamped)

    def _of(self, arm: str) -> dict[str, Any]:
        """Return what all commands for an arm have in common."""
        if arm not in self._settings:
            raise UnknownNameError('arm with a gripper', arm, self._settings)
        indices = self._joints.indices_of(arm)
        return {'robot': self._robot, 'parts': self._joints.parts_of(indices),
                'indices': indices, 'arm': arm}


def _wrench(values: ArrayLike, count: int, what: str) -> FloatArray:
    numbers = finite_command_numbers(values, count, what)
    if np.abs(numbers).max() > MAX_WRENCH:
        raise CommandError(f'{what} must be within {MAX_WRENCH:g}, got {numbers.tolist()}')
    return numbers


def _shortened(vector: FloatArray, limit: float) -> tuple[FloatArray, int]:
    """Return a vector shortened to a limit, and how many of its numbers changed."""
    size = length(vector)
    if size <= limit:
        return vector, 0
    return vector * (limit / size), int(np.count_nonzero(vector))
