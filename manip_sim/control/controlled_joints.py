# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The driven joints of a robot: names, parts, modes, limits and setpoints, to be read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.commands import Ledger
from manip_sim.control.modes import default_mode, MODES
from manip_sim.control.servos import Servos
from manip_sim.control.setpoints import SetpointGenerator
from manip_sim.control.trajectory import Trajectory
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.physics.parts import Part
from manip_sim.physics.physics import Physics

#: A trajectory that would have to be slowed down more than this is rejected.
_MAX_SLOWDOWN = 1000.0
#: Largest number of times that it is slowed down further; two are nearly always enough.
_MOST_ROUNDS = 10
#: Words in the names of the joints of a mobile base that moves along x, y and turns about z.
_TWIST_JOINTS = ('forward', 'side', 'yaw')


@dataclass(frozen=True)
class JointReference:
    """
    Setpoints and commanded efforts of some joints at one instant.

    :ivar position: [rad or m], shape (n,)
    :ivar velocity: [rad/s or m/s], shape (n,)
    :ivar acceleration: [rad/s^2 or m/s^2], shape (n,)
    :ivar effort: commanded, or exerted by a law of a user; zero for joints that servos move
        [N m or N], shape (n,)
    :ivar gives_effort: whether a joint has a commanded effort and no setpoint, shape (n,)
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray
    gives_effort: BoolArray


@dataclass(frozen=True)
class ControllerState:
    """
    Reference and measured state of some joints.

    :ivar names: of the driven joints, n of them
    :ivar reference: their setpoints and commanded efforts
    :ivar position: measured [rad or m], shape (n,)
    :ivar velocity: measured [rad/s or m/s], shape (n,)
    :ivar effort: of the actuators at the joint in the last physics step [N m or N], shape (n,)
    """

    names: tuple[str, ...]
    reference: JointReference
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray


class ControlledJoints:
    """
    The joints that actuators drive, each with its servo, its setpoint and its control mode.

    Methods that take the name of a part raise an ``UnknownNameError`` if there is none.

    :param physics: of the world, prepared by ``add_setpoint_activation``, at the start
    :param parts: by name; the parts of one arm and of both arms may overlap
    :param atomic: the names of the parts that do not overlap
    :param gains_are_highest: whether gains of the model are upper bounds, see :class:`Servos`
    :ivar names: of the driven joints, in the order of their indices
    :ivar modes: the names of their control modes
    :ivar twist_indices: the joints x, y and yaw of a mobile base that takes a twist, or None
    :ivar servos: of the joints
    :ivar setpoints: of the joints
    :ivar commands: that have not ended
    """

    def __init__(self, physics: Physics, parts: Mapping[str, Part],
                 atomic: Sequence[str], gains_are_highest: bool = False) -> None:
        driven = [(actuator, joint) for name in atomic for actuator, joint in
                  zip(parts[name].actuators, parts[name].driven_joints) if joint is not None]
        self.names = [joint for _, joint in driven]
        self._index_of = {name: index for index, name in enumerate(self.names)}
        self._indices_of = {name: self.find([j for j in part.driven_joints if j])
                            for name, part in parts.items()}
        self._part_of = [name for name in atomic for _ in parts[name].driven_joints]
        self.twist_indices = self._find_twist_joints(parts)
        self._sideways = 'base' not in parts or parts['base'].sideways
        self.servos = Servos(
            physics, [a for a, _ in driven], self.names, gains_are_highest)
        self.setpoints = SetpointGenerator(
            self.servos.position_clamp(), self.servos.cruising_velocity,
            self.servos.acceleration_limit)
        self.commands = Ledger(len(self.names))
        self.modes = tuple(default_mode(part) for part in self._part_of)
        self._effort = np.zeros(len(self.names))

    def _find_twist_joints(self, parts: Mapping[str, Part]) -> IntArray | None:
        if 'base' not in parts:
            return None
        words = [set((joint or '').split('_')) for joint in parts['base'].driven_joints]
        candidates = [[i for i, w in enumerate(words) if key in w] for key in _TWIST_JOINTS]
        if any(len(indices) != 1 for indices in candidates):
            return None
        return self._indices_of['base'][[indices[0] for indices in candidates]]

    @property
    def effort(self) -> FloatArray:
        """Commanded efforts of the joints [N m or N], shape (n,), a view."""
        return self._effort

    @property
    def lowered(self) -> tuple[str, ...]:
        """A sentence for each servo whose gains were lowered, as they were not stable."""
        return self.servos.lowered

    def indices_of(self, part: str) -> IntArray:
        """Return the indices of a part's driven joints."""
        if part not in self._indices_of:
            raise UnknownNameError('part', part, self._indices_of)
        return self._indices_of[part]

    def find(self, names: Sequence[str]) -> IntArray:
        """Return the indices of driven joints."""
        return np.array([self._index_of[name] for name in names], dtype=np.int64)

    def parts_of(self, indices: IntArray) -> frozenset[str]:
        """Return the atomic parts that joints belong to."""
        return frozenset([self._part_of[i] for i in indices.tolist()])

    def mode_of(self, name: str) -> str:
        """Return the control mode of a driven joint."""
        return self.modes[self._index_of[name]]

    def modes_of(self, indices: IntArray) -> tuple[str, ...]:
        """Return the control modes of driven joints."""
        modes = self.modes
        return tuple([modes[i] for i in indices.tolist()])

    def ranges(self, indices: IntArray, modes: Sequence[str] | None = None) -> FloatArray:
        """
        Return the ranges that actions span, shape (n, 2), a copy.

        :param modes: of all joints, as :attr:`modes` was when they were looked up; a thread beside
            that of the simulation has to look once only; None: the present ones
        """
        return self._of_modes(lambda mode: MODES[mode].ranges(self.servos), indices, modes)

    def _of_modes(self, find: Callable[[str], FloatArray], indices: IntArray,
                  modes: Sequence[str] | None) -> FloatArray:
        modes = self.modes if modes is None else modes
        by_mode = {mode: find(mode) for mode in set(modes)}
        return np.array([by_mode[modes[i]][i] for i in indices]).reshape(-1, 2)

    def acceleration_limits(self, indices: IntArray) -> FloatArray:
        """Return the acceleration limits of setpoints [rad/s^2 or m/s^2], shape (n,), a copy."""
        return np.array(self.servos.acceleration_limit[indices])

    def velocity_limits(self, indices: IntArray) -> FloatArray:
        """Return the velocity limits [rad/s or m/s], shape (n,), a copy."""
        return np.array(self.servos.velocity_limit[indices])

    def clamps(self, indices: IntArray, modes: Sequence[str] | None = None) -> FloatArray:
        """
        Return the ranges to which goals are clamped, shape (n, 2), a copy.

        :param modes: of all joints, as for :meth:`ranges`
        """
        return self._of_modes(lambda mode: MODES[mode].clamps(self.servos), indices, modes)

    def ranges_of(self, field: str, indices: IntArray) -> FloatArray:
        """Return the lowest and highest values of a field of joints, shape (n, 2), a copy."""
        return np.array(self.servos.ranges[field][indices])

    def efforts_allowed(self, indices: IntArray) -> FloatArray:
        """Return the greatest efforts of joints [N m or N], shape (n,)."""
        return np.asarray(np.abs(self.servos.ranges['effort'][indices]).max(axis=1))

    def dofs(self, indices: IntArray) -> IntArray:
        """Return the addresses of joints in ``qvel``, shape (n,)."""
        return np.asarray(self.servos.dofs[indices])

    def measured(self, indices: IntArray, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """Return measured position and velocity of joints, copies, each of shape (n,)."""
        return data.qpos[self.servos.qpos[indices]], data.qvel[self.servos.dofs[indices]]

    def twist_clamps(self, indices: IntArray, modes: Sequence[str]) -> FloatArray:
        """
        Return the ranges to which twists of the mobile base are clamped, shape (3, 2), a copy.

        :param indices: :attr:`twist_indices`
        :param modes: of all joints, as for :meth:`ranges`
        """
        clamps = self.clamps(indices, modes)
        if not self._sideways:
            clamps[1] = 0.0
        return clamps

    def fitted(self, trajectory: Trajectory, indices: IntArray, elapsed_s: float
               ) -> tuple[Trajectory, float]:
        """
        Return a trajectory that keeps to the velocity limits, and the factor of its duration.

        A trajectory that is slowed down begins now.

        :param indices: the joints that follow it, from where their setpoints are now
        :param elapsed_s: how long it has been running [s]
        :raises CommandError: if it is much too fast, or its spline is not finite
        """
        position, velocity = self.setpoints.position[indices], self.setpoints.velocity[indices]
        limit, slowed, whole = self.servos.velocity_limit[indices], trajectory, 1.0
        slowed.begin_at(position, velocity, elapsed_s)
        # The velocity at which the motion begins stays, so once may not be enough, and then
        # little is gained by the same again.
        for _ in range(_MOST_ROUNDS):
            highest = slowed.highest_velocity()
            factor = float((highest / limit).max(initial=0.0))
            if factor <= 1.0 + 1e-6:
                break
            whole *= factor if whole == 1.0 else factor**2
            if whole > _MAX_SLOWDOWN:
                worst = int(np.argmax(highest / limit))
                raise CommandError(
                    f"joint '{self.names[indices[worst]]}' would have to move at "
                    f'{highest[worst]:g} per second, its limit is {limit[worst]:g}')
            slowed = trajectory.slowed(whole, elapsed_s)
            slowed.begin_at(position, velocity)
        return slowed, whole

    def limited(self, part: str) -> int:
        """Return how often streamed goals of a part required more than the velocity limits."""
        return int(self.setpoints.counts[0, self.indices_of(part)].sum())

    def lost(self, part: str) -> int:
        """Return how many messages of a part's streams seem to have been lost before they came."""
        return int(self.setpoints.counts[1, self.indices_of(part)].max(initial=0))

    def controller_state(self, part: str, data: mujoco.MjData, efforts: FloatArray
                         ) -> ControllerState:
        """
        Return the reference and the measured state of a part's driven joints, copies.

        :param efforts: of all degrees of freedom [N m or N], shape (nv,)
        """
        indices, setpoints = self.indices_of(part), self.setpoints
        gives = self.servos.gives_effort(indices)
        reference = JointReference(
            setpoints.position[indices], setpoints.velocity[indices],
            setpoints.acceleration[indices], np.where(gives, self._effort[indices], 0.0),
            gives & np.array([MODES[mode].law is None for mode in self.modes_of(indices)], bool))
        dofs = self.servos.dofs[indices]
        return ControllerState(
            tuple(self.names[i] for i in indices), reference,
            data.qpos[self.servos.qpos[indices]], data.qvel[dofs], efforts[dofs])
