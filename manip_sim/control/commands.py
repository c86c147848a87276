# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Validated commands, with numbers in range, and what became of them.

The newest command that has begun owns a joint, joint by joint, as the ledger notes.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import compress
import math
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.trajectory import Trajectory
from manip_sim.models.robots import RobotModel

C = TypeVar('C', bound='Command')
S = TypeVar('S', bound='JointSetpoint')
#: Largest number of trajectories that wait for their start; clients may send any number.
_MOST_WAITING = 1000
#: Stamps are compared modulo this, so that seconds of any clock keep their nanoseconds [ns].
_STAMPS_NS = 10**15


class Status(Enum):
    """The state or outcome of a command."""

    WAITING = 'waiting'
    RUNNING = 'running'
    DONE = 'done'
    REPLACED = 'replaced'
    ABORTED = 'aborted'


#: Status and reason of trajectories that an empty one ends.
STOPPED = (Status.ABORTED, 'ended by an empty trajectory')


@dataclass
class CommandHandle:
    """
    The state of a submitted command; it may be read from any thread.

    A command is *done* when a position or gripper goal is reached by the setpoint, a pose is
    reached, or a trajectory has ended; a velocity or an effort lasts. It is *replaced* when newer
    commands have taken over all of its joints, and *aborted* by a reset, a change of mode, a
    timeout, a withdrawal or an empty trajectory.

    :ivar status: of the command
    :ivar reason: why it was aborted
    :ivar error: goal minus measured position when it was done [rad or m], in units of the controls
        for a gripper, translation [m] and rotation vector [rad] for a pose, shape (6,); or None
    """

    status: Status = Status.WAITING
    reason: str = ''
    error: FloatArray | None = None

    @property
    def is_active(self) -> bool:
        """True while the command waits or runs."""
        return self.status in (Status.WAITING, Status.RUNNING)

    def end(self, status: Status, reason: str = '', error: FloatArray | None = None) -> None:
        """Set what became of the command; only the first call counts."""
        if self.is_active:
            self.reason, self.error, self.status = reason, error, status


@dataclass(frozen=True, kw_only=True, eq=False)
class Command:
    """
    A command for joints or for a gripper.

    :ivar robot: the robot that it was made for; others have other joints at the same indices
    :ivar parts: the parts that it is for, atomic ones
    :ivar indices: of the robot's controlled joints, or of the gripper's actuators
    :ivar sent_ns: when it was sent, by the sender's clock [ns]; 0: unknown
    :ivar messages: how many messages it stands for: itself and those that it replaced unused
    :ivar clamped: how many numbers were clamped to their range
    :ivar clamped_example: the first of them in words, such as ``joint1 from 9 to 2.8973``
    :ivar handle: what becomes of the command
    """

    #: Times by clocks that a reset does not restart.
    undigested: ClassVar[tuple[str, ...]] = ('sent_ns', 'start_ns')
    #: Shapes of arrays that compiled code reads; where it ends in n, there is one for each joint.
    shapes: ClassVar[Mapping[str, tuple[str | int, ...]]] = {'indices': ('l', 'n')}
    #: True if it changes the way in which joints follow the command before: both take effect.
    adds: ClassVar[bool] = False

    robot: RobotModel
    parts: frozenset[str]
    indices: IntArray
    sent_ns: int = 0
    messages: int = 1
    clamped: int = 0
    clamped_example: str = ''
    handle: CommandHandle = field(default_factory=CommandHandle, compare=False)

    @property
    def sent_s(self) -> float:
        """Time of its sending [s], small enough to keep its nanoseconds; 0: unknown."""
        return self.sent_ns % _STAMPS_NS * 1e-9

    @property
    def goal(self) -> FloatArray | None:
        """Numbers by which a copy of the message before is recognized, or None."""
        return None

    def over(self: C, older: Command) -> C:
        """Return the command, extended by an older one of its kind for the same joints."""
        return replace(self, messages=older.messages + self.messages)

    def without(self: C, indices: IntArray) -> C | None:
        """Return the command without some of its joints, or None if no joint is left."""
        if indices is self.indices:  # As of streams, whose names are looked up once.
            return None
        taken = set(indices.tolist())
        kept = [index not in taken for index in self.indices.tolist()]
        if all(kept):
            return self
        return self._only(np.array(kept)) if any(kept) else None

    def _only(self: C, kept: BoolArray) -> C:
        """Return the command with some of its joints, shape of ``indices``."""
        shapes = ChainMap(*[vars(kind).get('shapes', {}) for kind in type(self).__mro__])
        return replace(self, **{name: getattr(self, name)[..., kept]
                                for name, shape in shapes.items() if shape[-1] == 'n'})


@dataclass(frozen=True, kw_only=True, eq=False)
class JointSetpoint(Command):
    """
    Goals for some joints.

    :ivar modes: name of the control mode that each goal is meant for
    :ivar values: at the joints, in SI units, shape of ``indices``
    """

    shapes = {'values': ('d', 'n')}

    modes: tuple[str, ...]
    values: FloatArray

    @property
    def goal(self) -> FloatArray:
        """The goals."""
        return self.values

    def _only(self: S, kept: BoolArray) -> S:
        modes = tuple(compress(self.modes, kept))
        return replace(super()._only(kept), modes=modes)


@dataclass(frozen=True, kw_only=True, eq=False)
class JointImpedance(JointSetpoint):
    """
    Goals of joints in impedance mode, and how they are pulled there; NaN leaves a number as it is.

    :ivar pulls: velocity with respect to which the servos damp, effort that they add, stiffness
        [N m/rad or N/m] and damping [N m s/rad or N s/m], shape (4, n)
    """

    adds: ClassVar[bool] = True
    shapes = {'pulls': ('d', 4, 'n')}

    pulls: FloatArray

    def setpoint(self) -> JointSetpoint | None:
        """Return the goals alone, or None if there are none."""
        kept = np.isfinite(self.values)
        if not kept.any():
            return None
        setpoint = JointSetpoint(robot=self.robot, parts=self.parts, indices=self.indices,
                                 sent_ns=self.sent_ns, messages=self.messages, handle=self.handle,
                                 modes=self.modes, values=self.values)
        return setpoint if kept.all() else setpoint._only(kept)

    def over(self, older: Command) -> JointImpedance:
        """Return the command with what an older one for the same joints says beside it."""
        assert isinstance(older, JointImpedance)
        copied = np.array_equal(self.values, older.values, equal_nan=True) and np.array_equal(
            self.pulls, older.pulls, equal_nan=True)
        return replace(
            self, messages=older.messages + (0 if copied else self.messages),
            values=np.where(np.isnan(self.values), older.values, self.values),
            pulls=np.where(np.isnan(self.pulls), older.pulls, self.pulls))


@dataclass(frozen=True, kw_only=True, eq=False)
class NoCommand(Command):
    """
    A message that names joints of some parts without a number: they go on as before.

    It has no effect, but in lock-step it is the answer of its parts.
    """


class TrajectoryReference(NamedTuple):
    """
    Reference of the joints of a trajectory at an instant, arrays of shape (n,).

    :ivar position: [rad or m]
    :ivar velocity: [rad/s or m/s]
    :ivar acceleration: [rad/s^2 or m/s^2]
    :ivar points_ahead: number of its points that are still to come
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    points_ahead: int


@dataclass(frozen=True, kw_only=True, eq=False)
class JointTrajectory(Command):
    """
    A trajectory for some joints.

    :ivar trajectory: of all joints that it was made for
    :ivar columns: of the trajectory, which the joints of ``indices`` follow
    :ivar start_ns: simulation time of its time zero [ns]; 0 for when it takes effect
    :ivar start_s: the same since the last reset [s]; None until it is known
    :ivar slowed: factor by which it was slowed down to keep to velocity limits; 1 if it was not
    """

    shapes = {'columns': ('l', 'n')}

    trajectory: Trajectory
    columns: IntArray
    start_ns: int = 0
    start_s: float | None = None
    slowed: float = 1.0

    @property
    def sent_s(self) -> float:
        """Its time zero, as that of other commands."""
        return self.start_ns % _STAMPS_NS * 1e-9

    def own_trajectory(self) -> JointTrajectory:
        """Return the command with a trajectory of its joints alone."""
        return replace(self, trajectory=self.trajectory.of(self.columns),
                       columns=np.arange(len(self.columns)))

    def motion(self, times_s: ArrayLike) -> FloatArray:
        """
        Return position, velocity and acceleration of its joints at some times.

        :param times_s: since the last reset [s]
        :returns: the three on the first axis, then the shape of ``times_s``, then the joints
        """
        since_s = np.asarray(times_s) - (self.start_s or 0.0)
        return self.trajectory.at(since_s)[..., self.columns]

    def as_setpoint(self, modes: tuple[str, ...]) -> JointSetpoint:
        """Return the command to go to the last point, in the modes of its joints."""
        return JointSetpoint(
            robot=self.robot, parts=self.parts, indices=self.indices, clamped=self.clamped,
            handle=self.handle, modes=modes,
            values=self.trajectory.positions[-1, self.columns])


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectoryStop(Command):
    """The end of the trajectories of some joints, which come to rest."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BaseTwist(Command):
    """
    A velocity of a mobile base in its own frame.

    :ivar twist: along x [m/s], along y [m/s], about z [rad/s], shape (3,)
    :ivar joints: the joints x, y and yaw of the base, shape (3,)
    :ivar columns: which of these each of ``indices`` is
    """

    shapes = {'twist': ('d', 3), 'joints': ('l', 3), 'columns': ('l', 'n')}

    twist: FloatArray
    joints: IntArray
    columns: IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class GripperCommand(Command):
    """A command for a gripper, with the ``indices`` of its actuators."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GripperAction(GripperCommand):
    """
    An action of a gripper, which lasts until its next command.

    :ivar action: for ``GripperModel.format_action``, shape (dof,)
    """

    action: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class GripperSetpoint(GripperCommand):
    """
    Positions for some joints of a gripper.

    :ivar joints: their names
    :ivar values: [rad or m], in the order of ``joints``
    """

    joints: tuple[str, ...]
    values: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class GripperGrasp(GripperSetpoint):
    """
    A position for one joint; all other fingers close by the same fraction of their range.

    Fingers that are stopped on the way to an end of their range press with all the force allowed.

    :ivar max_effort: of the actuators, at their joints [N or N m]; 0 for their own limits
    :ivar max_velocity: of the joint [rad/s or m/s]; 0 for its own limit
    """

    max_effort: float = 0.0
    max_velocity: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class GripperSuction(GripperCommand):
    """
    Controls for the suction cups of a gripper.

    :ivar controls: in the order of the cups, shape (n,)
    """

    controls: FloatArray


class Ledger:
    """
    The commands for some joints, or for the actuators of a gripper, that have not ended.

    At most one that runs owns a joint. Who took it last is known after that command has ended.

    :param count: number of joints
    :ivar running: commands that own the joints of their indices, in the order of these
    :ivar waiting: trajectories that start later, in the order of their starts; they own no joints
        yet
    """

    remembered = ('running', 'waiting', '_owners')

    def __init__(self, count: int) -> None:
        self.running: list[Command] = []
        self.waiting: list[JointTrajectory] = []
        #: Of the command that took each joint last, or of what took the joint from all commands.
        self._owners = [CommandHandle(Status.DONE) for _ in range(count)]

    @property
    def trajectories(self) -> list[JointTrajectory]:
        """All trajectories, including those that start later."""
        return [*self.waiting, *self.of(JointTrajectory)]

    def of(self, kind: type[C]) -> list[C]:
        """Return the commands of a kind that run."""
        return [command for command in self.running if isinstance(command, kind)]

    def take(self, command: Command, indices: IntArray | None = None) -> None:
        """
        Give a command joints, which all other commands lose.

        :param indices: of the joints; None for those that it names
        """
        self._pass_on(command.indices if indices is None else indices, command.handle,
                      Status.REPLACED)

    def begin(self, command: Command) -> None:
        """
        Let a command run that has taken its joints.

        Commands run in the order of their joints, as their order of arrival must make no
        difference.
        """
        self.running.append(command)
        if len(self.running) > 1:
            self.running.sort(key=_first_joint)

    def replace(self, older: Command, newer: Command) -> None:
        """Let a command run in place of one that runs for the same joints."""
        self._own(newer.indices, newer.handle)
        self.running[self.running.index(older)] = newer
        older.handle.end(Status.REPLACED)

    def start(self, trajectory: JointTrajectory) -> None:
        """Let a trajectory that waits take its joints from what runs, not from what waits."""
        self.waiting.remove(trajectory)
        self._own(trajectory.indices, trajectory.handle)
        self.running = list(_without(self.running, trajectory.indices, Status.REPLACED))

    def release(self, indices: IntArray, status: Status, reason: str = '') -> None:
        """Take joints from the commands that own or await them; end those that have none left."""
        self._pass_on(indices, CommandHandle(Status.ABORTED, reason), status, reason)

    def _pass_on(self, indices: IntArray, owner: CommandHandle, status: Status, reason: str = ''
                 ) -> None:
        self._own(indices, owner)
        if self.running:
            self.running = list(_without(self.running, indices, status, reason))
        if self.waiting:
            self.waiting = list(_without(self.waiting, indices, status, reason))

    def _own(self, indices: IntArray, handle: CommandHandle) -> None:
        for index in indices.tolist():
            self._owners[index] = handle

    def enqueue(self, trajectory: JointTrajectory) -> None:
        """
        Let a trajectory wait; commands that run, or start before it, go on until it starts.

        It is aborted if too many wait.
        """
        before = [older for older in self.waiting if _start(older) < _start(trajectory)]
        after = self.waiting[len(before):]
        if len(self.waiting) >= _MOST_WAITING:
            trajectory.handle.end(
                Status.ABORTED, f'{_MOST_WAITING} trajectories wait for their starts already')
            return
        rest = _without(after, trajectory.indices, Status.REPLACED)
        self.waiting = sorted([*before, *rest, trajectory],
                              key=lambda waiting: (_start(waiting), _first_joint(waiting)))

    def stop(self, stop: TrajectoryStop) -> IntArray:
        """Take joints from all trajectories, and return those that followed one."""
        self.waiting = list(_without(self.waiting, stop.indices, *STOPPED))
        followed = [np.intersect1d(stop.indices, command.indices)
                    for command in self.of(JointTrajectory)]
        stopped = np.concatenate([np.empty(0, dtype=np.int64), *followed])
        self.release(stopped, *STOPPED)
        self._own(stop.indices, CommandHandle(Status.ABORTED, STOPPED[1]))
        return stopped

    def finish(self, command: Command, error: FloatArray) -> None:
        """
        End a command that is done; its joints stay its own until a newer one takes them.

        :param error: goal minus measured position
        """
        self.running.remove(command)
        command.handle.end(Status.DONE, error=error)

    def withdraw(self, handle: CommandHandle, reason: str) -> IntArray:
        """
        Abort a command.

        :param reason: why, for the handle
        :returns: the joints that it was the last to take
        """
        indices = np.array([index for index, owner in enumerate(self._owners) if owner is handle],
                           dtype=np.int64)
        self.running = [command for command in self.running if command.handle is not handle]
        self.waiting = [command for command in self.waiting if command.handle is not handle]
        handle.end(Status.ABORTED, reason)
        self._own(indices, CommandHandle(Status.ABORTED, reason))
        return indices

    def end(self, status: Status, reason: str = '') -> None:
        """End the handles of all commands; what the joints do is up to the caller."""
        for command in (*self.running, *self.waiting):
            command.handle.end(status, reason)

    def current_owner(self, command: Command) -> CommandHandle | None:
        """
        Return what took joints from a command that has been applied, or None if it has them all.

        A trajectory that starts later has its joints until another command takes some of them.
        """
        for waiting in self.waiting:
            if waiting.handle is command.handle:
                return None if len(waiting.indices) == len(command.indices) else CommandHandle()
        owners = (self._owners[index] for index in command.indices.tolist())
        return next((owner for owner in owners if owner is not command.handle), None)

    def awaits(self, handle: CommandHandle) -> bool:
        """Return whether a trajectory has been applied and waits for its start."""
        return any(waiting.handle is handle for waiting in self.waiting)


def takes_from(newer: Command, older: Command) -> bool:
    """
    Return whether a command takes its joints from an older one that has not begun either.

    A trajectory that begins later takes them only from trajectories that do not begin before it,
    and a stop from all trajectories.
    """
    if newer.adds or older.adds:
        return False
    if isinstance(newer, GripperCommand) or isinstance(older, GripperCommand):
        return newer.parts == older.parts
    if isinstance(newer, JointTrajectory) and newer.start_ns:
        return isinstance(older, JointTrajectory) and older.start_ns >= newer.start_ns
    return isinstance(older, JointTrajectory) or not isinstance(newer, TrajectoryStop)


def _start(trajectory: JointTrajectory) -> float:
    """Return when a trajectory starts, since the last reset [s]."""
    return -math.inf if trajectory.start_s is None else trajectory.start_s


def _first_joint(command: Command) -> int:
    return int(command.indices.min())


def _without(commands: Iterable[C], indices: IntArray, status: Status, reason: str = ''
             ) -> Iterator[C]:
    """Yield the rest of commands that lose some joints; end commands that lose all."""
    for command in commands:
        rest = command.without(indices)
        if rest is None:
            command.handle.end(status, reason)
        else:
            yield rest
