# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Forces of the world on bodies, recorded in the steps of a control period, and on tools.

In each step MuJoCo keeps the external forces on each body in ``cfrc_ext``, in world axes, about
the centre of mass of its tree. The wrench on a tool is their mean, filtered and tared; the tare of
its noise is in :mod:`manip_sim.sensing.robot_sensing`.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any, ClassVar

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError
from manip_sim.physics.payload import Payload
from manip_sim.physics.physics import ENDED, Physics
from manip_sim.physics.uncollected_forces import has_fluid, UncollectedForces
from manip_sim.validation import positive_number

#: Number of steps that are kept before they are summed up.
_ROWS = 64
#: Smaller wrenches are rounding, as of internal forces that cancel, and become zero; and smaller
#: differences to the filtered wrench [N or N m].
_ROUNDING = 1e-9
ZERO = np.zeros(6)
ZERO.flags.writeable = False
#: Sensors for which a step computes ``cfrc_ext``.
_COLLECTING = tuple(int(getattr(mujoco.mjtSensor, f'mjSENS_{name}')) for name in (
    'ACCELEROMETER', 'FORCE', 'TORQUE', 'FRAMELINACC', 'FRAMEANGACC'))
_SITE = int(mujoco.mjtObj.mjOBJ_SITE)
_BETWEEN_BODIES = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))


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
        self.keep()
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
        return self.keep()

    def keep(self) -> FloatArray:
        """Compute and return the mean, which the records of the next period leave as it is."""
        if self._mean is None:
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

    def catch_up(self) -> None:
        """Take over the last period of those that compiled code has run by itself."""

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
        moment = np.stack([moved[:, first, second] - moved[:, second, first]
                           for first, second in ((1, 2), (2, 0), (0, 1))], axis=1)
        return np.concatenate([force, torque + moment], axis=1)


def subtree_size(model: mujoco.MjModel, root: int) -> int:
    """Return how many bodies a body has below it, itself included; they follow it."""
    last = root
    while last + 1 < model.nbody and root <= int(model.body_parentid[last + 1]):
        last += 1
    return last + 1 - root


class ExternalWrench(BodyForces):
    """
    The wrench of the world on a tool, as an integrating force/torque sensor reads it.

    The sum of external forces, those of :class:`UncollectedForces` included, over the bodies of
    the tool is the negated reading of the sensor minus gravity and inertia of the tool. Weight and
    inertia of a declared payload, by its motion as a part of the tool, are taken away too.

    :param physics: of the world
    :param sensor: name of a sensor of its frame
    :ivar site: id of that frame
    :ivar payload: of the arm
    """

    remembered = (*BodyForces.remembered, '_tare', '_cutoff_hz', '_filtered', 'payload',
                  '_momentum')

    def __init__(self, physics: Physics, sensor: str) -> None:
        super().__init__(physics)
        self._sensor = sensor
        self._tare = ZERO
        self._cutoff_hz = 0.0
        self._filtered: FloatArray | None = None
        self.payload = Payload()
        #: Momentum and angular momentum of the payload when the last period ended, in the world.
        self._momentum = ZERO
        physics.on_change(self._find_tool)

    def _find_bodies(self) -> slice:
        model = self._physics.model
        self.site = int(model.sensor(self._sensor).objid[0])
        body = int(model.site_bodyid[self.site])
        #: The tool: bodies are in depth-first order.
        bodies = slice(body, body + subtree_size(model, body))
        self.uncollected = UncollectedForces.of(model, bodies)
        return bodies

    def record(self) -> None:
        """Record the forces of the last step, if they are not zero."""
        model, uncollected = self._physics.model, self.uncollected
        if not uncollected.is_empty or has_fluid(model.opt):
            self._sum = self._sum + uncollected.wrench(model, self._physics.data)
        super().record()

    def _summed(self, rows: FloatArray, centres: FloatArray) -> FloatArray:
        wrenches = np.add.reduce(rows, axis=1)
        torque, force = np.add.reduce(wrenches).reshape(2, 3)
        (_, xy, xz), (yx, _, yz), (zx, zy, _) = np.einsum(
            'ni,nj->ij', centres, wrenches[:, 3:]).tolist()
        return np.array([*force, *(torque + [yz - zy, zx - xz, xy - yx])])

    def end_period(self, data: mujoco.MjData, steps: int, period_s: float) -> None:
        """Take the mean of the record of a control period, and filter it."""
        super().end_period(data, steps, period_s)
        if self.payload.mass:
            self._momentum = self._present_momentum(data)
        if self._filtered is not None:
            lag = self._in_frame(data) - self._filtered
            weight = self.weight(period_s)
            self._filtered = self._filtered + (
                lag if np.abs(lag).max() < _ROUNDING else weight * lag)

    def interrupt(self, steps: int) -> None:
        """Take the mean of the record so far in a control period, without the payload's part."""
        super().interrupt(steps)
        if self.payload.mass:
            self._take_payload_away(steps)

    def _place_of_payload(self, data: mujoco.MjData) -> FloatArray:
        """Return the place of the centre of mass from the sensor, in the axes of the world [m]."""
        lever = np.empty(3)
        mujoco.mju_mulMatVec(lever, data.site_xmat[self.site].reshape(3, 3),
                             np.array(self.payload.center_of_mass))
        return lever

    def _present_momentum(self, data: mujoco.MjData) -> FloatArray:
        """Return momentum and angular momentum about the centre of mass of the payload, (6,)."""
        twist, speed, turn, momentum = np.empty(6), np.empty(3), np.empty(3), np.empty(6)
        mujoco.mj_objectVelocity(self._physics.model, data, _SITE, self.site, twist, 0)
        mujoco.mju_cross(speed, twist[:3], self._place_of_payload(data))
        momentum[:3] = self.payload.mass * (twist[3:] + speed)
        axes = data.site_xmat[self.site].reshape(3, 3)
        mujoco.mju_mulMatTVec(turn, axes, twist[:3])
        mujoco.mju_mulMatVec(speed, self.payload.inertia_matrix, turn)
        mujoco.mju_mulMatVec(momentum[3:], axes, speed)
        return momentum

    def _take_payload_away(self, steps: int) -> None:
        """Take the forces of the payload from the recorded ones, by its change of momentum."""
        model, data, moment = self._physics.model, self._physics.data, np.empty(3)
        change = (self._present_momentum(data) - self._momentum) / (
            steps * float(model.opt.timestep))
        change[:3] -= self.payload.mass * model.opt.gravity
        mujoco.mju_cross(moment, data.site_xpos[self.site] + self._place_of_payload(data),
                         change[:3])
        change[3:] += moment
        self._sum = self._sum + steps * change

    def weight(self, period_s: float) -> float:
        """
        Return the weight of a new mean in the filter; 1 if there is none.

        :param period_s: length of a control period [s]
        """
        if not self._cutoff_hz:
            return 1.0
        return -math.expm1(-2.0 * math.pi * self._cutoff_hz * period_s)

    def restart(self, data: mujoco.MjData) -> None:
        """Take the forces of the last ``mj_forward`` for the mean, and forget the past."""
        self._filtered = None
        self._momentum = self._present_momentum(data) if self.payload.mass else ZERO
        super().restart(data)
        self.set_cutoff(self._cutoff_hz, data)

    def reset(self, data: mujoco.MjData) -> None:
        """Forget the tare and the past."""
        self._tare = ZERO
        super().reset(data)

    def set_payload(self, payload: Payload) -> None:
        """Take away the forces of another payload, from the next control period on."""
        if payload != self.payload:
            self._physics.interrupt()
            self.payload = payload
            self._momentum = (
                self._present_momentum(self._physics.data) if payload.mass else ZERO)

    @property
    def goes_on(self) -> bool:
        """True if each period changes it, whether anything touches the tool or not."""
        return self._filtered is not None

    def catch_up(self) -> None:
        """
        Take over the last period of those that compiled code has run by itself.

        Nothing has touched the tool, so only a payload has changed its forces, by its momentum at
        the beginning and at the end; where it was touched in the end, Python ends the period.
        """
        steps, _, periods, became, _ = self._physics.standing.tolist()
        if not (self.payload.mass and steps and periods):
            return
        model, begin = self._physics.model, self._physics.places_at_begin()
        mujoco.mj_comPos(model, begin)
        mujoco.mj_comVel(model, begin)
        self._momentum = self._present_momentum(begin)
        if became != ENDED:
            self.begin_period()
            self.end_period(self._physics.data, steps, 0.0)

    @property
    def mean(self) -> FloatArray:
        """Mean force and torque about the origin in world axes in the last control period."""
        self.catch_up()
        return super().mean

    @property
    def is_quiet(self) -> bool:
        """True if nothing was recorded in the last period, or :meth:`catch_up` finds it anew."""
        return self.payload.mass > 0.0 or super().is_quiet

    def read(self, data: mujoco.MjData) -> FloatArray:
        """
        Return the mean over the last control period, filtered and tared, in ``ft_frame``.

        :param data: the ``mujoco.MjData``
        :returns: force [N] and torque about the origin of the frame [N m], shape (6,), a copy
        """
        return self._untared(data) - self._tare

    def tare(self, data: mujoco.MjData) -> None:
        """Let the present wrench read zero."""
        self._tare = self._untared(data)

    @property
    def cutoff_hz(self) -> float:
        """Of the low-pass [Hz]; 0 for no filter."""
        return self._cutoff_hz

    def set_cutoff(self, cutoff_hz: float, data: mujoco.MjData) -> None:
        """
        Filter the means by a low-pass of first order from now on, which starts at the last mean.

        :param cutoff_hz: where it halves the power, of simulated time [Hz]; 0 for no filter
        :raises CommandError: if it is negative or not finite
        """
        cutoff_hz = positive_number(
            cutoff_hz, 'the cutoff of a wrench', CommandError, or_zero=True)
        self._physics.interrupt()
        self._cutoff_hz = cutoff_hz
        if cutoff_hz == 0.0:
            self._filtered = None
        elif self._filtered is None:
            self._filtered = self._in_frame(data)

    def _untared(self, data: mujoco.MjData) -> FloatArray:
        return self._in_frame(data) if self._filtered is None else self._filtered

    def _in_frame(self, data: mujoco.MjData) -> FloatArray:
        mean = self.mean
        if mean is ZERO:
            return np.zeros(6)
        force, torque = mean[:3], mean[3:]
        moment, wrench = np.empty(3), np.empty(6)
        mujoco.mju_cross(moment, data.site_xpos[self.site], force)
        to_world = data.site_xmat[self.site].reshape(3, 3)
        # By MuJoCo, with the same bits on every processor.
        mujoco.mju_mulMatTVec(wrench[:3], to_world, force)
        mujoco.mju_mulMatTVec(wrench[3:], to_world, torque - moment)
        return wrench


class TouchWatch:
    """
    Returns whether anything but contacts may exert a force on one of the tools.

    :param model: the compiled ``mujoco.MjModel``
    :param data: its ``mujoco.MjData``
    :param tools: the records of all tools; the last one of a body counts
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData,
                 tools: Sequence[BodyForces]) -> None:
        self._data = data
        of_body = np.zeros(model.nbody, dtype=np.int64)
        for number, tool in enumerate(tools, start=1):
            of_body[tool.bodies] = number
        pushes = (data.xfrc_applied[tool.bodies] for tool in tools)
        self._pushes = [(push, bytes(push.nbytes)) for push in pushes]
        self._ties = _ties(model, of_body)
        self._pulled, self._options = any(tool.uncollected.pulls for tool in tools), model.opt

    @property
    def pushed(self) -> bool:
        """True if forces other than contacts may act on a tool."""
        for push, none in self._pushes:
            if push.tobytes() != none:
                return True
        return (self._pulled or has_fluid(self._options)
                or self._ties.size > 0 and bool(self._data.eq_active[self._ties].any()))

    @property
    def may_go_on(self) -> bool:
        """True if nothing but contacts and pushes by others can exert a force on a tool."""
        return not (self._pulled or has_fluid(self._options) or self._ties.size)


def _ties(model: mujoco.MjModel, tool_of_body: np.ndarray) -> np.ndarray:
    """Return the equalities that connect a tool with something else."""
    ties = []
    for number in np.flatnonzero(np.isin(model.eq_type, _BETWEEN_BODIES)).tolist():
        ends = [model.eq_obj1id[number], model.eq_obj2id[number]]
        if int(model.eq_objtype[number]) == int(mujoco.mjtObj.mjOBJ_SITE):
            ends = [model.site_bodyid[end] for end in ends]
        if tool_of_body[ends[0]] != tool_of_body[ends[1]]:
            ties.append(number)
    return np.array(ties, dtype=np.int64)
