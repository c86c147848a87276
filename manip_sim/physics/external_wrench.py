# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Wrench that the world exerts on a tool: the mean over a control period, filtered and tared.

The tare of its noise is in :mod:`manip_sim.sensing.robot_sensing`.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError
from manip_sim.physics.body_forces import BodyForces, subtree_size, ZERO
from manip_sim.physics.payload import Payload
from manip_sim.physics.physics import Physics
from manip_sim.physics.uncollected_forces import has_fluid, UncollectedForces
from manip_sim.validation import positive_number

_SITE = int(mujoco.mjtObj.mjOBJ_SITE)
#: Smaller differences to the filtered wrench are rounding [N or N m].
_ROUNDING = 1e-9
_BETWEEN_BODIES = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))


class ExternalWrench(BodyForces):
    """
    The wrench of the world on a tool, as an integrating force/torque sensor reads it.

    In each step MuJoCo keeps the external forces on each body in ``cfrc_ext``, in world axes,
    about the centre of mass of the tree; :class:`UncollectedForces` has the others. Their sum over
    the bodies of the tool is the negated reading of the sensor minus gravity and inertia of the
    tool. Weight and inertia of a declared payload, by its motion as a part of the tool, are taken
    away too.

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
        """
        Take the mean of the record of a control period; steps without record are zero.

        :param data: the ``mujoco.MjData``, after ``mj_forward``
        :param steps: physics steps of the period
        :param period_s: its length [s]
        """
        super().end_period(data, steps, period_s)
        if self.payload.mass:
            self._momentum = self._present_momentum(data)
        if self._filtered is not None:
            lag = self._in_frame(data) - self._filtered
            weight = self.weight(period_s)
            self._filtered = self._filtered + (
                lag if np.abs(lag).max() < _ROUNDING else weight * lag)

    def interrupt(self, steps: int) -> None:
        """
        Take the mean of the record so far in a control period, which goes on; no filter.

        :param steps: physics steps since the period began
        """
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
        return self._filtered is not None or self.payload.mass > 0.0

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
