# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Forces of the world on bodies, recorded in the steps of a control period.

In each step MuJoCo keeps the external forces on each body in ``cfrc_ext``, in world axes, about
the centre of mass of its tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.physics.physics import Physics
from manip_sim.physics.uncollected_forces import UncollectedForces

#: Number of steps that are kept before they are summed up.
_ROWS = 64
#: Smaller wrenches are rounding, as of internal forces that cancel, and become zero [N or N m].
_ROUNDING = 1e-9
ZERO = np.zeros(6)
ZERO.flags.writeable = False
#: Sensors for which a step computes ``cfrc_ext``.
_COLLECTING = tuple(int(getattr(mujoco.mjtSensor, f'mjSENS_{name}')) for name in (
    'ACCELEROMETER', 'FORCE', 'TORQUE', 'FRAMELINACC', 'FRAMEANGACC'))


class BodyForces:
    """
    The forces on consecutive bodies, which are all of one tree.

    :param physics: of the world
    :ivar bodies: ids of the bodies
    :ivar forces: on the bodies in the last step, a view
    :ivar no_forces: the same where there is nothing to record, as bytes
    :ivar uncollected: the forces that are not in :attr:`forces`
    :ivar is_only_touched: whether contacts, or a fluid, alone exert forces on the bodies
    """

    #: Of the period that has passed; nothing in the next one depends on it.
    remembered: ClassVar[tuple[str, ...]] = ('_sum', '_rows', '_centres', '_steps', '_mean')
    undigested: ClassVar[tuple[str, ...]] = remembered

    uncollected: UncollectedForces

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        #: No force, in the shape of a sum.
        self._zero = ZERO
        #: Sum over the steps that are no longer in the rows.
        self._sum = self._zero
        #: Forces on the bodies in each step, and the centre of mass of the tree, as bytes.
        self._rows: list[bytes] = []
        self._centres: list[bytes] = []
        self._steps = 1
        #: Force and torque about the origin in world axes; None until somebody needs them.
        self._mean: FloatArray | None = self._zero

    def _find_bodies(self) -> slice:
        """Return the bodies in the present model, and find their uncollected forces."""
        raise NotImplementedError

    def _find_tool(self) -> None:
        model, data = self._physics.model, self._physics.data
        if self._mean is None:
            self._compute_mean()
        self.bodies = self._find_bodies()
        self.forces = data.cfrc_ext[self.bodies]
        self._centre = data.subtree_com[model.body_rootid[self.bodies.start]]
        self._no_rows = bytes(self.forces.nbytes)
        self.is_only_touched = self.uncollected.is_empty and not self.uncollected.adhesions
        # Adhesion pulls before there is a contact force, and those with flexes are not among them.
        self.no_forces = self._no_rows
        if self.uncollected.adhesions or self.uncollected.flexes is not None:
            self.no_forces = b''

    def begin_period(self) -> None:
        """Begin a control period in which each step may be recorded."""
        self._sum = self._zero
        if self._rows:
            self._rows, self._centres = [], []

    def record(self) -> None:
        """Record the forces of the last step, if they are not zero."""
        forces = self.forces.tobytes()
        if forces != self._no_rows:
            self._add(forces, self._centre.tobytes())

    def _add(self, forces: bytes, centre: bytes) -> None:
        self._rows.append(forces)
        self._centres.append(centre)
        if len(self._rows) == _ROWS:
            self._sum_up()

    def record_rows(self, rows: FloatArray, centres: FloatArray) -> None:
        """
        Record the forces of several steps.

        :param rows: forces that are not zero, shape (k, m, 6)
        :param centres: where the centre of mass of the tree was [m], shape (k, 3)
        """
        for forces, centre in zip(rows, centres):
            self._add(forces.tobytes(), centre.tobytes())

    def _sum_up(self) -> None:
        count = len(self._rows)
        rows = np.frombuffer(b''.join(self._rows)).reshape(count, -1, 6)
        centres = np.frombuffer(b''.join(self._centres)).reshape(count, 3)
        self._sum = self._sum + self._summed(rows, centres)
        self._rows, self._centres = [], []

    def _summed(self, rows: FloatArray, centres: FloatArray) -> FloatArray:
        """
        Return the sum of the forces of several steps, about the origin in world axes.

        :param rows: torque [N m] and force [N] about the centres, shape (k, m, 6)
        :param centres: of the tree in each step [m], shape (k, 3)
        """
        raise NotImplementedError

    def end_period(self, data: mujoco.MjData, steps: int, period_s: float) -> None:
        """
        Take the mean of the record of a control period; steps without record are zero.

        :param data: the ``mujoco.MjData``, after ``mj_forward``
        :param steps: physics steps of the period
        :param period_s: its length [s]
        """
        self.interrupt(steps)

    def interrupt(self, steps: int) -> None:
        """
        Take the mean of the record so far in a control period, which goes on.

        :param steps: physics steps since the period began
        """
        self._mean, self._steps = None, steps

    def set_aside(self) -> tuple[Any, ...]:
        """Return what :meth:`interrupt` and :attr:`mean` change."""
        return self._sum, self._rows, self._centres, self._mean, self._steps

    def take_back(self, content: tuple[Any, ...]) -> None:
        """Go on with what :meth:`set_aside` has returned."""
        self._sum, self._rows, self._centres, self._mean, self._steps = content

    @property
    def mean(self) -> FloatArray:
        """Mean force and torque about the origin in world axes in the last control period."""
        return self._compute_mean() if self._mean is None else self._mean

    def _compute_mean(self) -> FloatArray:
        if self._rows:
            self._sum_up()
        mean = self._sum / self._steps
        self._mean = mean if np.abs(mean).max(initial=0.0) > _ROUNDING else self._zero
        return self._mean

    def restart(self, data: mujoco.MjData) -> None:
        """Take the forces of the last ``mj_forward`` for the mean, and forget the past."""
        self.begin_period()
        self.record()
        self.end_period(data, 1, 0.0)

    def reset(self, data: mujoco.MjData) -> None:
        """Forget the past."""
        self.restart(data)

    @property
    def goes_on(self) -> bool:
        """True if each period changes it, whether anything touches the bodies or not."""
        return False

    @property
    def is_quiet(self) -> bool:
        """True if nothing was recorded in the last period."""
        return self._sum is self._zero and not self._rows


class RobotForces(BodyForces):
    """
    The forces on each body that joints of a robot move, grippers included.

    Forces that MuJoCo does not collect, such as adhesion, are not among them.

    :param physics: of the world
    :param joints: names of the joints
    """

    def __init__(self, physics: Physics, joints: Sequence[str]) -> None:
        super().__init__(physics)
        self._joints = tuple(joints)
        physics.on_change(self._find_tool)

    def _find_bodies(self) -> slice:
        model = self._physics.model
        self.uncollected = UncollectedForces.of(model, slice(0, 0))
        #: True while steps collect forces.
        self._is_collected = bool(np.isin(model.sensor_type, _COLLECTING).any())
        moved = {int(model.joint(name).bodyid[0]) for name in self._joints}
        if not moved:
            return slice(0, 0)
        return slice(min(moved), max(body + subtree_size(model, body) for body in moved))

    def _find_tool(self) -> None:
        super()._find_tool()
        if self._zero.shape != self.forces.shape:
            self._sum = self._mean = self._zero = np.zeros(self.forces.shape)
        if not self._is_collected:
            self.is_only_touched, self.no_forces = False, b''

    def record(self) -> None:
        """Record the forces of the last step, if they are not zero."""
        if not self._is_collected:
            mujoco.mj_rnePostConstraint(self._physics.model, self._physics.data)
        super().record()

    def _summed(self, rows: FloatArray, centres: FloatArray) -> FloatArray:
        torque, force = np.add.reduce(rows).reshape(-1, 2, 3).transpose(1, 0, 2)
        moved = np.einsum('ki,kmj->mij', centres, rows[..., 3:])
        moment = np.stack([moved[:, one, two] - moved[:, two, one]
                           for one, two in ((1, 2), (2, 0), (0, 1))], axis=1)
        return np.concatenate([force, torque + moment], axis=1)

    @property
    def mean(self) -> FloatArray:
        """Mean force and torque about the origin of ``world`` on each body, shape (m, 6)."""
        return super().mean


def subtree_size(model: mujoco.MjModel, root: int) -> int:
    """Return how many bodies a body has below it, itself included; they follow it."""
    last = root
    while last + 1 < model.nbody and root <= int(model.body_parentid[last + 1]):
        last += 1
    return last + 1 - root
