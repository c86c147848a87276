# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The effort that actuators exerted at their joints in the last physics step.

An actuator acts at a joint that it drives, through a fixed tendon too. Thrusters on sites and
adhesion drive no joint. Spatial tendons and slider-cranks drive those joints that have no other
drive: where they move a joint that has one, as a winch does, they are loads.

An implicit integrator solves ``(M + dt kv) a = tau``: the damping ``kv`` of a servo acts with the
velocity at the end of a step, but MuJoCo's ``qfrc_actuator`` has the velocity at its beginning.
The effort that moved the joint is ``qfrc_actuator - kv (v1 - v0)``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import functools
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.derived import Derived
from manip_sim.physics.physics import Physics
from manip_sim.physics.uncollected_forces import is_spatial

_SITE, _BODY, _CRANK, _TENDON = (int(getattr(mujoco.mjtTrn, f'mjTRN_{name}')) for name in (
    'SITE', 'BODY', 'SLIDERCRANK', 'TENDON'))
_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
#: Integrators that treat the damping of actuators implicitly.
_IMPLICIT = (int(mujoco.mjtIntegrator.mjINT_IMPLICIT),
             int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST))

#: Two masses of 1 kg whose servos are at the limit of the actuator's force, and of the joint's.
_SATURATED = """
<mujoco>
  <option integrator="implicitfast" timestep="0.1" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="a" type="slide"/><geom size="0.1" mass="1" contype="0"/></body>
    <body><joint name="b" type="slide" actuatorfrcrange="-1 1"/>
      <geom size="0.1" mass="1" contype="0"/></body>
  </worldbody>
  <actuator>
    <velocity joint="a" kv="10" forcerange="-1 1"/><velocity joint="b" kv="10"/>
  </actuator>
</mujoco>"""


@functools.cache
def _explicit_at_limits() -> tuple[bool, bool]:
    """
    Return whether MuJoCo integrates servos explicitly at the force limits of actuator and joint.

    That depends on its release.
    """
    model = mujoco.MjModel.from_xml_string(_SATURATED)
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_step(model, data)
    at_actuator, at_joint = np.isclose(data.qvel, 0.1).tolist()
    return at_actuator, at_joint


class _World(NamedTuple):
    """
    Quantities beside the last step that efforts depend on, as views of the model and the data.

    :ivar sizes: numbers of degrees of freedom, actuators and joints
    :ivar places: actuator and degree of freedom of each moment; None if they change
    :ivar moments: ``actuator_moment``
    :ivar bias_types: ``actuator_biastype``
    :ivar options: of the model
    :ivar limits: of joints, whether there are, first degrees of freedom, and ranges
    """

    sizes: tuple[int, int, int]
    places: tuple[IntArray, IntArray] | None
    moments: FloatArray
    bias_types: IntArray
    options: mujoco.MjOption
    limits: tuple[BoolArray, IntArray, FloatArray]

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData) -> _World:
        """Return that of a world, after ``mj_forward``."""
        actuators, dofs, moments = _entries(data)
        whole = len(moments) == len(data.actuator_moment)  # Else rows have room left.
        return cls((model.nv, model.nu, model.njnt), (actuators, dofs.copy()) if whole else None,
                   data.actuator_moment, model.actuator_biastype, model.opt,
                   (model.jnt_actfrclimited, model.jnt_dofadr, model.jnt_actfrcrange))


class ActuatorEfforts:
    """
    The efforts of all actuators at the degrees of freedom, in the step before the present instant.

    Velocity gains of actuators other than ``affine`` biases, as of muscles, are not considered.

    :param physics: of the world, after ``mj_forward``; :attr:`values` have to be read before
        another model replaces that of the last step
    :ivar stale: whether a step has been recorded since they were computed, shape (1,)
    :ivar rules: whether the integrator of the model is implicit, and whether servos are integrated
        explicitly at the force limits of actuators, and of joints, shape (3,)
    """

    #: Of the step that has passed; nothing in the next one depends on it.
    remembered = ('_values', 'stale', '_loaded', '_last')
    undigested = remembered

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        # Now: a callback of MuJoCo that is set later would see its steps.
        self.rules: BoolArray = np.array([False, *_explicit_at_limits()])
        self._values: FloatArray = np.zeros(0)
        self.stale: BoolArray = np.zeros(1, dtype=bool)
        self._loaded: FloatArray | float
        self._derived = Derived()
        physics.on_change(self._find_views)

    def _find_views(self) -> None:
        model, data, before = self._physics.model, self._physics.data, self.values.copy()
        # Views, which need not be fetched each time; a mode or a grasp changes the last three.
        self._views = (data.qfrc_actuator, data.qvel, data.actuator_force, data.actuator_velocity,
                       model.actuator_biasprm[:, 2], model.actuator_forcerange.reshape(-1),
                       model.actuator_forcelimited)
        #: Inputs of the last step: as at its beginning, but the velocity at its end.
        self._last = np.concatenate(self._views)
        self._derived.of.clear()
        self._loads = _loads(model)
        self._loaded = self._of_loads()
        self.restart()
        old, new = self._physics.kept_dofs
        self.values[new] = before[old]

    def restart(self, dofs: IntArray | None = None) -> None:
        """
        Return to an instant without a step before it; after ``mj_forward``.

        :param dofs: of these degrees of freedom; None: of all
        """
        present = self._physics.data.qfrc_actuator - self._of_loads()
        if dofs is None:
            if len(self._values) != len(present):
                self._values = np.empty(len(present))
            self._values[:] = present
            self.stale[0] = False
        else:
            self.values[dofs] = present[dofs]

    def record(self) -> None:
        """Remember the last step; between ``mj_step`` and the next ``mj_forward``."""
        np.concatenate(self._views, out=self._last)
        self._loaded, self.stale[0] = self._of_loads(), True

    @property
    def room(self) -> FloatArray | None:
        """Room for a record that others make; None where that takes more than copies of arrays."""
        return self._last if self._loads is None else None

    @property
    def kept(self) -> FloatArray:
        """Room for the efforts, which others compute after such a record, shape (nv,)."""
        return self._values

    def refresh_rules(self) -> None:
        """Take over the integrator of the model."""
        self.rules[0] = int(self._world.options.integrator) in _IMPLICIT

    def set_aside(self) -> tuple[Any, ...]:
        """Return what :meth:`record` changes."""
        return self.values.copy(), self._last.copy(), self._loaded

    def take_back(self, content: tuple[Any, ...]) -> None:
        """Go on with what :meth:`set_aside` has returned."""
        self._values[:], self._last[:], self._loaded = content
        self.stale[0] = False

    def _of_loads(self) -> FloatArray | float:
        """Return what actuators exert at joints that they do not drive [N m or N], or 0."""
        if self._loads is None:
            return 0.0
        data = self._physics.data
        actuators, dofs, moment = _entries(data)
        exerted = np.where(self._loads[actuators, dofs], moment * data.actuator_force[actuators],
                           0.0)
        return np.asarray(np.bincount(dofs, exerted, len(data.qvel)), float)

    @property
    def values(self) -> FloatArray:
        """
        The efforts [N m or N], shape (nv,).

        They are computed at once, while the moments of the present instant are those of the step.
        """
        self.keep()
        return self._values

    def keep(self) -> None:
        """Compute the efforts of the last step unless they are there, before the next one."""
        if self.stale[0]:
            compute([self])

    @property
    def _world(self) -> _World:
        world: _World | None = self._derived.of.get('world')
        if world is None:
            world = self._derived.of['world'] = _World.of(self._physics.model, self._physics.data)
        return world

    def _moments(self) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
        """Return the entries of moments, and the moments again, 0 for loads."""
        world = self._world
        actuators, dofs, moment = (
            (*world.places, world.moments) if world.places else _entries(self._physics.data))
        drives = moment if self._loads is None else np.where(
            self._loads[actuators, dofs], 0.0, moment)
        return actuators, dofs, moment, drives


def compute(efforts: Iterable[ActuatorEfforts]) -> None:
    """
    Compute the efforts of several worlds together, which costs less than one by one.

    :param efforts: of each world; where they are not due, nothing happens
    """
    alike: dict[tuple[int, int, int], list[ActuatorEfforts]] = {}
    for item in efforts:
        if item.stale[0]:
            alike.setdefault(item._world.sizes, []).append(item)
    for (nv, nu, njnt), some in alike.items():
        for item, acted in zip(some, _acted(some, nv, nu, njnt)):
            item._values[:] = acted - item._loaded
            item.stale[0] = False


def _rows(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return arrays of one shape with a leading axis; of a single one, a view."""
    if len(arrays) == 1:
        return arrays[0][None]
    return np.concatenate(arrays).reshape(len(arrays), *arrays[0].shape)


def _acted(efforts: Sequence[ActuatorEfforts], nv: int, nu: int, njnt: int) -> FloatArray:
    """Return what acted in worlds with arrays of equal shapes, loads included, (count, nv)."""
    count, worlds = len(efforts), [item._world for item in efforts]
    last = _rows([item._last for item in efforts])
    acted, of_actuators = last[:, :nv], last[:, 2 * nv:]
    at_actuator, at_joint = _explicit_at_limits()
    damped = _rows([world.bias_types for world in worlds]) == _AFFINE
    if at_actuator:
        force, limits = of_actuators[:, :nu], of_actuators[:, 3 * nu:5 * nu]
        damped &= ((force > limits[:, ::2]) & (force < limits[:, 1::2])) | (
            of_actuators[:, 5 * nu:] == 0.0)
    for row, world in zip(damped, worlds):
        if int(world.options.integrator) not in _IMPLICIT:
            row[:] = False
    actuators, dofs, moment, drives = _entries_together(efforts, nv, nu)
    speed = np.bincount(actuators, moment * last[:, nv:2 * nv].ravel()[dofs], count * nu)
    change = speed.reshape(count, nu) - of_actuators[:, nu:2 * nu]
    missing = np.where(damped, of_actuators[:, 2 * nu:3 * nu] * change, 0.0).ravel()
    missing = np.bincount(dofs, drives * missing[actuators], count * nv)
    if at_joint:
        limited, first, ranges = map(_rows, zip(*[world.limits for world in worlds]))
        joints = limited.ravel().nonzero()[0]
        if joints.size:
            places = first.ravel()[joints] + joints // njnt * nv
            low, high = ranges.reshape(-1, 2)[joints].T
            at_limit = acted.ravel()[places]
            missing[places[(at_limit <= low) | (at_limit >= high)]] = 0.0
    return np.asarray(acted + missing.reshape(count, nv))


def _entries_together(efforts: Sequence[ActuatorEfforts], nv: int, nu: int
                      ) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """
    Return the entries of moments of all worlds, with numbers as if they were one world.

    The last are the moments, 0 where an actuator is a load.
    """
    moments = [item._moments() for item in efforts]
    if len(moments) == 1:
        return moments[0]
    actuators, dofs, moment, drives = map(np.concatenate, zip(*moments))
    number = np.repeat(np.arange(len(moments)), [len(entries) for entries, *_ in moments])
    return actuators + number * nu, dofs + number * nv, moment, drives


def _entries(data: mujoco.MjData) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the nonzero moments of actuators: actuator, dof, moment of each."""
    moment, dofs, counts = data.actuator_moment, data.moment_colind, data.moment_rownnz
    actuators = np.repeat(np.arange(len(counts)), counts)
    if len(actuators) < len(moment):  # Rows of sites, cranks and adhesion have room left.
        first = np.cumsum(counts) - counts
        held = np.repeat(data.moment_rowadr - first, counts) + np.arange(len(actuators))
        moment, dofs = moment[held], dofs[held]
    return actuators, dofs, moment


def _loads(model: mujoco.MjModel) -> BoolArray | None:
    """Return at which joints each actuator is a load, shape (actuators, nv), or None."""
    kinds = model.actuator_trntype
    lines = np.array([
        kind == _CRANK or kind == _TENDON and is_spatial(model, number) for kind, number in zip(
            kinds.tolist(), model.actuator_trnid[:, 0].tolist())], dtype=bool)
    anywhere = np.isin(kinds, (_SITE, _BODY))
    if not (lines.any() or anywhere.any()):
        return None
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    actuators, dofs, _ = _entries(data)
    driven = np.zeros(model.nv, dtype=bool)
    driven[dofs[~(lines | anywhere)[actuators]]] = True
    return np.asarray(anywhere[:, None] | (lines[:, None] & driven))
