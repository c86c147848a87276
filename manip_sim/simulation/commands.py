# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands after validation: what a part shall do, with numbers that are finite and in range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.errors import CommandError, describe_choices
from manip_sim.simulation.control import MODES
from manip_sim.simulation.trajectory import Trajectory
from manip_sim.typing import FloatArray, IntArray


@dataclass(frozen=True)
class Goal:
    """
    New goals for some actuators of a part.

    :ivar mode: the control mode that the values are meant for
    :ivar indices: which of the part's actuators; of a gripper, which of its controller's joints
    :ivar values: at the joints, in SI units, shape of ``indices``
    :ivar clamped: how many numbers had to be brought into their range
    """

    part: str
    mode: str
    indices: IntArray
    values: FloatArray
    clamped: int = 0


@dataclass(frozen=True)
class GripperAction:
    """
    What a gripper shall do from now on.

    :ivar action: for ``GripperModel.format_action``, shape (dof,)
    :ivar clamped: how many numbers had to be brought into [-1, 1]
    """

    part: str
    action: FloatArray
    clamped: int = 0


@dataclass(frozen=True)
class TrajectoryPoints:
    """
    A motion that a part shall follow from its present state.

    :ivar indices: which of the part's actuators
    :ivar times_s: of the points [s], shape (n_points,)
    :ivar positions: shape (n_points, n)
    :ivar velocities: shape (n_points, n), or None
    :ivar accelerations: shape (n_points, n), or None
    :ivar clamped: how many positions had to be brought into their range
    """

    part: str
    indices: IntArray
    times_s: FloatArray
    positions: FloatArray
    velocities: FloatArray | None = None
    accelerations: FloatArray | None = None
    clamped: int = 0

    def from_state(self, position: FloatArray, velocity: FloatArray) -> Trajectory:
        """Return the motion that starts at a position and velocity of the part's actuators."""
        return Trajectory(position[self.indices], velocity[self.indices], self.times_s.tolist(),
                          self.positions, self.velocities, self.accelerations)


@dataclass(frozen=True)
class BaseTwist:
    """
    A velocity of a mobile base in its own frame.

    :ivar twist: along x [m/s], along y [m/s], about z [rad/s], shape (3,)
    :ivar clamped: how many numbers had to be brought into their range
    """

    part: str
    twist: FloatArray
    clamped: int = 0


Command = Goal | GripperAction | TrajectoryPoints | BaseTwist


def finite_numbers(values: ArrayLike, length: int, what: str) -> FloatArray:
    """
    Return numbers as an array.

    :param what: what they are, for the message
    :raises CommandError: if there are not ``length`` of them, or one is not finite
    """
    numbers = np.asarray(values, dtype=float)
    if numbers.shape != (length,):
        raise CommandError(f'{what} must have {length} numbers, got {numbers.size}')
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        raise CommandError(f'{what} must be finite, got {numbers[bad[0]]} at index {bad[0]}')
    return numbers


def clamp(values: FloatArray, ranges: FloatArray) -> tuple[FloatArray, int]:
    """
    Bring numbers into their ranges.

    :param ranges: lowest and highest value, shape (n, 2) for values of shape (..., n)
    :returns: the numbers in range, and how many were not
    """
    inside = np.clip(values, ranges[:, 0], ranges[:, 1])
    return inside, int(np.count_nonzero(inside != values))


def joint_indices(names: Sequence[str], available: Sequence[str | None], part: str) -> IntArray:
    """
    Find joints by name.

    :param names: the joints that are asked for
    :param available: the joints of the part that can be commanded
    :raises CommandError: if there are none, one is unknown, or one comes twice
    """
    if not names:
        raise CommandError(f'{part}: no joint is named')
    index_of = {name: index for index, name in enumerate(available) if name is not None}
    for name in names:
        if name not in index_of:
            raise CommandError(f"{part} has no joint '{name}' that can be commanded: "
                               f'{describe_choices(name, index_of)}')
    if len(set(names)) != len(names):
        raise CommandError(f'{part}: a joint is named twice in {", ".join(names)}')
    return np.array([index_of[name] for name in names], dtype=np.int64)


def field_of_mode(part: str, mode: str, count: int, position: ArrayLike, velocity: ArrayLike,
                  effort: ArrayLike) -> FloatArray:
    """
    Return the field of a joint command that a control mode uses.

    :param count: how many joints are named
    :raises CommandError: if another field is filled, or the field has not one finite number for
        each joint
    """
    fields = dict(zip(MODES, (position, velocity, effort)))
    for name, values in fields.items():
        if name != mode and np.size(values):
            raise CommandError(f'{part} is in {mode} mode, which does not use the field {name}: '
                               'leave it empty')
    return finite_numbers(fields[mode], count, f'{part}: {mode}')
