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

import functools
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.physics.physics import Physics
from manip_sim.physics.uncollected_forces import is_spatial

_SITE, _BODY, _CRANK, _TENDON = (int(getattr(mujoco.mjtTrn, f'mjTRN_{name}')) for name in (
    'SITE', 'BODY', 'SLIDERCRANK', 'TENDON'))
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


class ActuatorEfforts:
    """
    The efforts of all actuators at the degrees of freedom, in the step before the present instant.

    Velocity gains of actuators other than ``affine`` biases, as of muscles, are not considered.

    :param physics: of the world, after ``mj_forward``; :attr:`values` have to be read before
        another model replaces that of the last step
    """

    #: Of the step that has passed; nothing in the next one depends on it.
    not_in_digest = ('_last', '_parts', '_values', '_loads', '_loaded')

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        self._explicit_at_limits = _explicit_at_limits()
        self._values: FloatArray | None = np.zeros(0)
        self._loaded: FloatArray | float = 0.0
        physics.on_change(self._find_views)

    def _find_views(self) -> None:
        model, data, before = self._physics.model, self._physics.data, self.values
        # Views, which need not be fetched each time; a mode or a grasp changes the last three.
        self._views = (data.qfrc_actuator, data.qvel, data.actuator_force, data.actuator_velocity,
                       model.actuator_biasprm[:, 2], model.actuator_forcerange.reshape(-1),
                       model.actuator_forcelimited)
        #: Those of the last step: as at its beginning, but the velocity at its end.
        self._last = np.concatenate(self._views)
        nv, nu = model.nv, model.nu
        of_actuators = self._last[2 * nv:]
        #: Parts of the same: the last four are damping, the two force limits and if they are used.
        self._parts = (self._last[:nv], self._last[nv:2 * nv], of_actuators[:nu],
                       of_actuators[nu:2 * nu], of_actuators[2 * nu:3 * nu],
                       of_actuators[3 * nu:5 * nu:2], of_actuators[3 * nu + 1:5 * nu:2],
                       of_actuators[5 * nu:])
        self._loads = _loads(model)
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
            self._values = present.copy()
        else:
            self.values[dofs] = present[dofs]

    def record(self) -> None:
        """Remember the last step; between ``mj_step`` and the next ``mj_forward``."""
        np.concatenate(self._views, out=self._last)
        self._loaded, self._values = self._of_loads(), None

    @property
    def room(self) -> FloatArray | None:
        """Room for a record that others make; None where that takes more than copies of arrays."""
        return self._last if self._loads is None else None

    def take_record(self) -> None:
        """Take over what others have recorded into :attr:`room`."""
        self._loaded, self._values = 0.0, None

    def set_aside(self) -> tuple[Any, ...]:
        """Return what :meth:`record` changes."""
        return self.values, self._last.copy(), self._loaded

    def take_back(self, content: tuple[Any, ...]) -> None:
        """Go on with what :meth:`set_aside` has returned."""
        self._values, self._last[:], self._loaded = content

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
        """The efforts [N m or N], shape (nv,)."""
        if self._values is None:
            self._values = self._acted()
        return self._values

    def _acted(self) -> FloatArray:
        model, data = self._physics.model, self._physics.data
        acted, end, force, velocity, damping, lowest, highest, limited = self._parts
        if int(model.opt.integrator) not in _IMPLICIT:
            return np.array(acted - self._loaded)
        at_actuator, at_joint = self._explicit_at_limits
        explicit = at_actuator & (limited != 0) & ((force <= lowest) | (force >= highest))
        affine = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
        actuators, dofs, moment = _entries(data)
        change = np.bincount(actuators, moment * end[dofs], len(force)) - velocity
        missing = np.where(affine & ~explicit, damping * change, 0.0)
        missing = moment * missing[actuators]
        if self._loads is not None:
            missing[self._loads[actuators, dofs]] = 0.0
        missing = np.bincount(dofs, missing, model.nv)
        if at_joint:
            joints = np.flatnonzero(model.jnt_actfrclimited)
            own, (low, high) = model.jnt_dofadr[joints], model.jnt_actfrcrange[joints].T
            missing[own[(acted[own] <= low) | (acted[own] >= high)]] = 0.0
        return np.asarray(acted + missing - self._loaded)


def _entries(data: mujoco.MjData) -> tuple[IntArray, IntArray, FloatArray]:
    """Return what is not zero in the moments of actuators: actuator, dof, moment of each."""
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
