# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
MuJoCo's own actuators as servos of joints: gains, limits, and what they write into ``data``.

The activation of an actuator holds its setpoint; ``ctrl`` is the rate at which the setpoint
changes. So setpoints are linear within an interval.

``implicitfast`` treats damping implicitly and stiffness explicitly: a joint of inertia ``M`` with
passive damping ``D`` is stable if ``h^2 kp / 2 < 2 M + h (kv + D)``, the condition that both
eigenvalues of a step ``h`` are in the unit circle. At a force limit MuJoCo treats the servo
explicitly, and the joint may oscillate between both limits for ever, with a period of two steps,
unless ``h^2 kp / 2 + h kv < 2 M + h D``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.law.records import readable, SERVO
from manip_sim.derived import Derived
from manip_sim.errors import ModelError
from manip_sim.models.actuators import (
    check_kinds, check_single, effort_range, stiffness_and_damping, velocity_limit)
from manip_sim.physics.physics import Physics, places_of_inertia

#: Share of the stable range of gains that lowered gains use.
_SHARE = 0.75
#: Upper bound of damping x timestep / inertia of gains that are upper bounds themselves.
_EXPLICIT_DAMPING = 1.5
#: Highest damping ratio that a servo keeps when its gains are lowered to that bound.
_SOFT_RATIO = 3.0
#: Share of the torque beyond weight and damping that a jump of the goal may use.
_TORQUE_SHARE = 0.6
#: Shortest time in which a step reaches the velocity limit, of joints or of an end effector [s].
SPEED_UP_S = 0.1
#: Number of poses in which the inertia is computed, and the share of them that may be heavier.
_POSES = 64
_QUANTILE = 0.15
#: Position range that actions span for a joint without a range [rad or m].
_UNLIMITED = (-2.0 * np.pi, 2.0 * np.pi)
#: Largest effort of a joint without an effort limit [N m or N].
_UNLIMITED_EFFORT = 1e3
#: Share of the torque beyond the weight that the joint's damping may use.
_DAMPING_SHARE = 0.9
_Gains = tuple[FloatArray, FloatArray]


class Servos:
    """
    The actuators that drive joints, each as a servo or as a source of effort.

    Effort limits apply to both. Stiffness and damping are those of the model if its actuators are
    position or velocity servos, and otherwise derived from the joint's inertia.

    :param physics: of the world at the start, prepared by ``add_setpoint_activation``; actuators
        and joint force limits of its model are changed
    :param actuators: their names
    :param joints: the joint that each of them drives
    :param gains_are_highest: whether gains of the model are upper bounds, to be lowered to what
        suits the timestep, and not those wanted, which are lowered only where they are not stable
    :ivar lowered: a sentence for each servo whose wanted gains were lowered
    :ivar qpos: addresses of the joints in ``qpos``, shape (n,)
    :ivar dofs: addresses of the joints in ``qvel``, shape (n,)
    :ivar limited: whether each joint has a range, shape (n,)
    :ivar turn: 2 pi for joints without a range that turn, 0 for others [rad], shape (n,)
    :ivar ranges: lowest and highest position, velocity and effort by their names, at the joints
        in SI units, shape (n, 2)
    :ivar cruising_velocity: of steps and streams: the velocity limit, or what the torque can keep
        up against the joint's damping [rad/s or m/s], shape (n,)
    :ivar acceleration_limit: after a jump of the goal [rad/s^2 or m/s^2], shape (n,)
    :ivar passive_damping: of the joints themselves [N m s/rad or N s/m], shape (n,)
    :ivar integrals: leads of integral terms over setpoints [rad or m], shape (n,)
    :ivar any_integrates: whether an integral term may go on
    :raises ModelError: if two actuators drive one joint, or one is neither motor nor servo
    """

    remembered = ('_stiffness', '_damping', 'passive_damping', '_drag', '_gives_effort',
                  '_sources', '_feedforward', '_damped', '_integral_gains', '_integrates',
                  'integrals', 'any_integrates')
    #: Places of results, and what follows from the rest.
    undigested = ('_sources', 'any_integrates')

    def __init__(self, physics: Physics, actuators: Sequence[str], joints: Sequence[str],
                 gains_are_highest: bool = False) -> None:
        model, data = physics.model, physics.data
        check_single(actuators, joints)
        check_kinds(model, actuators)
        self._physics, self._derived = physics, Derived()
        self._actuators, self._joints = tuple(actuators), tuple(joints)
        self._find_places()
        ids, joint_ids = self._ids, np.array([model.joint(j).id for j in joints], dtype=np.int64)
        self._gear: FloatArray = model.actuator_gear[ids, 0].copy()
        stiffness, damping = stiffness_and_damping(model, ids, self.dofs)
        self._stiffness, self._damping = stiffness * self._gear**2, damping * self._gear**2
        passive = self._damping_of_model()
        self.passive_damping: FloatArray = passive.copy()
        self._highest = gains_are_highest
        self.lowered: tuple[str, ...] = ()
        efforts = effort_range(model, joint_ids, ids)
        has_limit: BoolArray = np.asarray(np.isfinite(efforts).all(axis=1))
        self._stabilize(has_limit)
        self._gains_of_model = self._stiffness.copy(), self._damping.copy()
        #: Effort per velocity that lets a joint move as fast as its setpoint.
        self._drag = self._damping + passive
        self.limited: BoolArray = model.jnt_limited[joint_ids].astype(bool)
        turns = model.jnt_type[joint_ids] == int(mujoco.mjtJoint.mjJNT_HINGE)
        self.turn: FloatArray = np.where(turns & ~self.limited, 2.0 * np.pi, 0.0)
        velocity = velocity_limit(model, joint_ids, ids)
        self.ranges: dict[str, FloatArray] = {
            'position': np.where(self.limited[:, None], model.jnt_range[joint_ids], _UNLIMITED),
            'velocity': np.stack([-velocity, velocity], axis=1),
            'effort': np.where(np.isfinite(efforts), efforts,
                               (-_UNLIMITED_EFFORT, _UNLIMITED_EFFORT))}
        # The limit is set at the joint, where it includes the gravity compensation.
        model.jnt_actfrcrange[joint_ids[has_limit]] = efforts[has_limit]
        model.jnt_actfrclimited[joint_ids[has_limit]] = 1
        torque = np.abs(self.ranges['effort']).max(axis=1)
        # The torque that the weight leaves has to overcome the joint's own damping.
        spare = np.maximum(torque - np.abs(data.qfrc_bias[self.dofs]), 0.2 * torque)
        self.cruising_velocity = np.minimum(
            velocity, _DAMPING_SHARE * spare / np.maximum(passive, 1e-9))
        self.acceleration_limit = _acceleration_limits(
            model, data, joint_ids, torque, (self._drag - self._damping) * self.cruising_velocity,
            self.velocity_limit, self.position_clamp())
        self._gives_effort = np.zeros(len(ids), dtype=bool)
        self._sources = 0
        #: Of impedance commands: effort beside that of the servo, zero for none, and velocity
        #: with respect to which it damps, NaN for that of its setpoint.
        self._feedforward, self._damped = np.zeros(len(ids)), np.full(len(ids), np.nan)
        #: Of integral terms: rates [1/s], and whether the mode of each joint has one.
        self._integral_gains, self._integrates = np.zeros(len(ids)), np.ones(len(ids), dtype=bool)
        self.integrals: FloatArray = np.zeros(len(ids))
        self.any_integrates = False
        physics.on_change(self._find_places)
        model.actuator_biastype[ids] = int(mujoco.mjtBias.mjBIAS_AFFINE)
        model.actuator_gaintype[ids] = int(mujoco.mjtGain.mjGAIN_FIXED)
        model.actuator_ctrllimited[ids] = 0
        self._compensated = model.body_gravcomp[model.jnt_bodyid[joint_ids]] > 0.0
        self._set_gains(np.arange(len(ids)))

    def _find_places(self) -> None:
        model = self._physics.model
        ids = self._ids = np.array([model.actuator(a).id for a in self._actuators], dtype=np.int64)
        joint_ids = np.array([model.joint(j).id for j in self._joints], dtype=np.int64)
        self.qpos: IntArray = model.jnt_qposadr[joint_ids].astype(np.int64)
        self.dofs: IntArray = model.jnt_dofadr[joint_ids].astype(np.int64)
        self._activation = model.actuator_actadr[ids].astype(np.int64)
        self._derived.of.clear()

    def refresh_joint_parameters(self) -> None:
        """Take over damping and dry friction of the joints, which were changed in the model."""
        self.passive_damping[:] = self._damping_of_model()
        self._drag = self._damping + self.passive_damping
        self._derived.of.clear()

    def _damping_of_model(self) -> FloatArray:
        model = self._physics.model
        return np.asarray(np.asarray(model.dof_damping).reshape(model.nv, -1)[self.dofs, 0])

    def _stabilize(self, limited: BoolArray) -> None:
        """Lower gains that are too high for the timestep."""
        model, before = self._physics.model, (self._stiffness, self._damping)
        inertia, step_s = self._inertia(np.arange(len(self._ids))), float(model.opt.timestep)
        if self._highest:
            self._stiffness, self._damping = _highest_gains(*before, inertia, step_s)
            return
        self._stiffness, self._damping = stable_gains(
            *before, inertia, self.passive_damping, limited, step_s)
        old, new = np.array(before).T, np.array([self._stiffness, self._damping]).T
        self.lowered = tuple(
            _describe_changes(self._joints[index], tuple(old[index]), tuple(new[index]),
                              bool(limited[index]), step_s)
            for index in np.flatnonzero((old != new).any(axis=1)).tolist())

    def _inertia(self, indices: IntArray) -> FloatArray:
        """Return the inertia of joints while the others are free, their lowest."""
        inverse = self._physics.model.dof_invweight0[self.dofs[indices]]
        return np.asarray(1.0 / np.maximum(inverse, 1e-12))

    @property
    def velocity_limit(self) -> FloatArray:
        """Greatest velocity of each joint [rad/s or m/s], shape (n,)."""
        return np.asarray(self.ranges['velocity'][:, 1])

    def position_clamp(self) -> FloatArray:
        """Return the ranges of position setpoints, infinite for unlimited joints, (n, 2)."""
        clamp = self.ranges['position'].copy()
        clamp[~self.limited] = (-np.inf, np.inf)
        return clamp

    def give_effort(self, indices: IntArray, gives: bool) -> None:
        """Make some actuators sources of effort, or servos again."""
        changed = indices[self._gives_effort[indices] != gives]
        if changed.size:
            self._gives_effort[changed] = gives
            self._sources = int(np.count_nonzero(self._gives_effort))
            self._set_gains(changed)

    def any_gives_effort_of(self, indices: IntArray) -> bool:
        """Tell whether any of some actuators is a source of effort."""
        return self._sources > 0 and (self._sources == len(self._ids) or bool(
            np.count_nonzero(self._gives_effort[indices])))

    def gives_effort(self, indices: IntArray) -> BoolArray:
        """Return which of some actuators are sources of effort, shape of ``indices``."""
        return np.asarray(self._gives_effort[indices])

    def set_gains(self, indices: IntArray, gains: tuple[ArrayLike, ArrayLike] | None) -> bool:
        """
        Change stiffness and damping of servos, whose forces change until :meth:`start`.

        Gains that are too high for the timestep and the inertia of a joint are lowered.

        :param gains: [N m/rad or N/m] and [N m s/rad or N s/m], each a number or of the shape of
            ``indices``; None for those of the model
        :returns: whether any has changed
        :raises ModelError: if they have another shape, or are not positive and finite
        """
        if gains is None:
            stiffness, damping = (of_model[indices] for of_model in self._gains_of_model)
        else:
            stiffness, damping = _checked(gains, len(indices))
            stiffness, damping = _bounded_gains(
                stiffness, damping, self._inertia(indices),
                float(self._physics.model.opt.timestep))
        if (stiffness == self._stiffness[indices]).all() and (
                damping == self._damping[indices]).all():
            return False
        self._stiffness[indices], self._damping[indices] = stiffness, damping
        self._drag[indices] = damping + self.passive_damping[indices]
        self._set_gains(indices)
        return True

    def impede(self, indices: IntArray, velocity: FloatArray, effort: FloatArray,
               stiffness: FloatArray, damping: FloatArray) -> bool:
        """
        Change what servos do beside following setpoints; NaN leaves a number as it is.

        Gains that are too high for the timestep and the inertia of a joint are lowered. What the
        servos exert changes with :meth:`start`.

        :param velocity: with respect to which they damp [rad/s or m/s], shape of ``indices``
        :param effort: to be added [N m or N]
        :param stiffness: [N m/rad or N/m]
        :param damping: [N m s/rad or N s/m]
        :returns: whether anything has changed
        """
        before = self._feedforward[indices], self._damped[indices]
        self._feedforward[indices] = np.where(np.isnan(effort), before[0], effort)
        self._damped[indices] = np.where(np.isnan(velocity), before[1], velocity)
        given = np.isfinite(stiffness) | np.isfinite(damping)
        own = indices[given]
        changed = own.size > 0 and self.set_gains(own, (
            np.where(np.isnan(stiffness[given]), self._stiffness[own], stiffness[given]),
            np.where(np.isnan(damping[given]), self._damping[own], damping[given])))
        if not (np.array_equal(before[0], self._feedforward[indices])
                and np.array_equal(before[1], self._damped[indices], equal_nan=True)):
            self._derived.of.pop('records', None)
            changed = True
        return changed

    def forget_commands(self, indices: IntArray) -> bool:
        """Add no effort any more, and damp with respect to setpoints; return whether any did."""
        if not (self._feedforward[indices].any() or np.isfinite(self._damped[indices]).any()):
            return False
        self._feedforward[indices], self._damped[indices] = 0.0, np.nan
        self._derived.of.pop('records', None)
        return True

    def set_integral_gain(self, indices: IntArray, gain: float) -> bool:
        """
        Change the rate at which servos take away errors that remain [1/s]; 0 for not at all.

        :param indices: of the joints
        :returns: whether it is another one
        """
        if (self._integral_gains[indices] == gain).all():
            return False
        self._integral_gains[indices] = gain
        if not gain:
            self.integrals[indices] = 0.0
        self._refresh_integrals()
        return True

    def _refresh_integrals(self) -> None:
        self.any_integrates = bool((self._integral_gains * self._integrates).any())
        self._derived.of.pop('records', None)

    def integral_gain(self, index: int) -> float:
        """Return the rate of the integral term of a joint [1/s]."""
        return float(self._integral_gains[index])

    def integrate(self, indices: IntArray, integrates: bool) -> None:
        """Begin anew with the integral terms of joints, if their mode has such."""
        self.integrals[indices] = 0.0
        if (self._integrates[indices] != integrates).any():
            self._integrates[indices] = integrates
            self._refresh_integrals()

    def _set_gains(self, indices: IntArray) -> None:
        model, ids, effort = self._physics.model, self._ids[indices], self._gives_effort[indices]
        stiffness = self._stiffness[indices] / self._gear[indices]**2
        damping = self._damping[indices] / self._gear[indices]**2
        model.actuator_gainprm[ids, 0] = np.where(effort, 1.0, stiffness)
        model.actuator_biasprm[ids, 0] = 0.0
        model.actuator_biasprm[ids, 1] = np.where(effort, 0.0, -stiffness)
        model.actuator_biasprm[ids, 2] = np.where(effort, 0.0, -damping)
        self._derived.of.clear()

    def start(self, data: mujoco.MjData, joints: Any, loads: Any, indices: IntArray | None = None
              ) -> None:
        """
        Let servos take over a motion at once, with the force that it needs.

        :param joints: records of the motion, shape (n,)
        :param loads: payloads, see :class:`~manip_sim.control.law.loads.Loads`
        :param indices: which of them do; None: all
        """
        from manip_sim.control.law.servo_rates import (  # It imports numba.
            find_efforts_beside, find_rates)
        servos, goals = np.flatnonzero(~self._gives_effort), np.zeros(len(self._ids))
        if indices is not None:
            servos = np.intersect1d(servos, indices)
        beside = np.empty(len(goals))
        find_efforts_beside(
            self._physics.arrays, self.records, joints, loads, self.integrals, beside)
        find_rates(self._physics.arrays, self.records, self.places, joints, beside, 1.0, goals,
                   np.empty(len(goals)))
        data.act[self._activation[servos]] = goals[servos]
        data.ctrl[self._ids[servos]] = 0.0

    def behind(self, acceleration: FloatArray) -> tuple[FloatArray, FloatArray]:
        """
        Return how far joints are behind their setpoints that accelerate for long.

        The damping acts with the velocity at the end of a step, which the setpoint has not yet.

        :param acceleration: [rad/s^2 or m/s^2], shape (n,)
        :returns: position [rad or m] and velocity [rad/s or m/s], each of shape (n,)
        """
        velocity = self._physics.model.opt.timestep / 2.0 * acceleration
        return np.asarray(self._drag / self._stiffness * velocity), np.asarray(velocity)

    def hold(self, data: mujoco.MjData, position: FloatArray) -> None:
        """Set the setpoints of all servos at rest [rad or m], shape (n,)."""
        self.integrals[:] = 0.0
        data.act[self._activation] = position * self._gear
        data.ctrl[self._ids] = 0.0

    @property
    def step_s(self) -> float:
        """Length of a physics step [s]."""
        return float(self._physics.model.opt.timestep)

    @property
    def records(self) -> Any:
        """The servos as the compiled law reads them, shape (n,)."""
        gives, records = self._derived.of.get('records', (None, None))
        if gives is not self._gives_effort:  # Neither is that of a restored state.
            records = self._make_records()
            self._derived.of['records'] = self._gives_effort, records
        return records

    def _make_records(self) -> Any:
        model, records = self._physics.model, np.zeros(len(self._ids), SERVO)
        forces = np.sort(model.actuator_forcerange[self._ids] * self._gear[:, None], axis=1)
        limited = model.actuator_forcelimited[self._ids].astype(bool)
        for field, values in (
                ('qpos', self.qpos), ('dof', self.dofs), ('activation', self._activation),
                ('control', self._ids), ('gear', self._gear), ('stiffness', self._stiffness),
                ('drag', self._drag), ('low', self.ranges['effort'][:, 0]),
                ('high', self.ranges['effort'][:, 1]),
                ('least', np.where(limited, forces[:, 0], -np.inf)),
                ('most', np.where(limited, forces[:, 1], np.inf)),
                ('friction', model.dof_frictionloss[self.dofs]),
                ('damping', self._damping), ('velocity', self._damped),
                ('effort', self._feedforward),
                ('integral', self._integral_gains * self._integrates),
                ('compensated', self._compensated),
                ('gives', self._gives_effort), ('leads', self._feedforward != 0.0),
                ('damps', np.isfinite(self._damped))):
            records[field] = values
        return readable(records)

    @property
    def places(self) -> IntArray:
        """Indices of the inertia of the joints in ``M``, -1 where it is zero, shape (n, n)."""
        return self._derived.made_of(places_of_inertia, self._physics.model, self.dofs)


def _checked(gains: tuple[ArrayLike, ArrayLike], count: int) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping, each of shape (count,)."""
    try:
        stiffness, damping = (np.broadcast_to(np.asarray(of, dtype=float), count) for of in gains)
    except (TypeError, ValueError) as error:
        raise ModelError(f'stiffness and damping must be a number or {count} numbers each, '
                         f'got {gains}') from error
    for of, what in ((stiffness, 'stiffness'), (damping, 'damping')):
        if not (np.isfinite(of).all() and (of > 0.0).all()):
            raise ModelError(f'the {what} of servos must be positive and finite, got {of}')
    return stiffness, damping


def stable_gains(stiffness: FloatArray, damping: FloatArray, inertia: FloatArray,
                 passive: FloatArray, limited: BoolArray, timestep_s: float) -> _Gains:
    """
    Return gains as they are where they are stable, and lower ones elsewhere.

    A servo with a force limit loses damping first, down to its critical damping, so that it stays
    as stiff as it can.

    :param stiffness: kp at the joints [N m/rad or N/m], shape (n,)
    :param damping: kv at the joints [N m s/rad or N s/m], shape (n,)
    :param inertia: lowest inertia of each joint [kg m^2 or kg], shape (n,)
    :param passive: damping of the joints themselves [N m s/rad or N s/m], shape (n,)
    :param limited: whether each servo has a force limit, shape (n,)
    :param timestep_s: length of a step [s]
    :returns: kp and kv, each of shape (n,)
    """
    spring, most = timestep_s**2 * stiffness / 2.0, 2.0 * inertia + timestep_s * passive
    implicit = most + timestep_s * damping
    too_stiff = ~limited & (spring > implicit)
    free = np.where(too_stiff, 2.0 * _SHARE * implicit / timestep_s**2, stiffness)
    at_limit = limited & (spring + timestep_s * damping > most)
    # The stiffest with h^2 kp / 2 + h kv = s most and this damping ratio, by x = h sqrt(kp).
    ratio = np.minimum(damping / (2.0 * np.sqrt(np.maximum(stiffness * inertia, 1e-300))), 1.0)
    slope, room = 2.0 * ratio * np.sqrt(inertia), _SHARE * most
    stiffest = ((np.sqrt(slope**2 + 2.0 * room) - slope) / timestep_s)**2
    lower = np.minimum(stiffness, stiffest)
    return (np.where(at_limit, lower, free),
            np.where(at_limit, np.minimum(damping, room / timestep_s - timestep_s * lower / 2.0),
                     damping))


def _highest_gains(stiffness: FloatArray, damping: FloatArray, inertia: FloatArray,
                   timestep_s: float) -> _Gains:
    """
    Return the gains for upper bounds, as the catalogue has them; arguments as before.

    :returns: kp and kv, each of shape (n,)
    """
    factor = np.minimum(1.0, _EXPLICIT_DAMPING / np.maximum(
        timestep_s * damping / inertia, 1e-12))
    damping = damping * factor
    # A servo that was overdamped would become too soft if it kept its damping ratio.
    enough = (damping / (2.0 * _SOFT_RATIO))**2 / inertia
    return np.maximum(stiffness * factor**2, np.minimum(stiffness, enough)), damping


def _bounded_gains(stiffness: FloatArray, damping: FloatArray, inertia: FloatArray,
                   timestep_s: float) -> _Gains:
    """
    Return the gains of a control mode, lowered to what any servo may have; arguments as before.

    :returns: kp and kv, each of shape (n,)
    """
    most = _EXPLICIT_DAMPING * inertia / timestep_s
    # At the highest stiffness, the highest damping is critical.
    return (np.minimum(stiffness, most * _EXPLICIT_DAMPING / (4.0 * timestep_s)),
            np.minimum(damping, most))


def _describe_changes(joint: str, before: tuple[float, float], after: tuple[float, float],
                      limited: bool, timestep_s: float) -> str:
    """Return the sentence that reports lowered gains of a joint: kp and kv before and after."""
    parts = [f'{gain} {old:.4g} to {new:.4g}' for gain, old, new in zip(
        ('stiffness', 'damping'), before, after) if new != old]
    where = ' at its force limit' if limited else ''
    return (f"servo of joint '{joint}': {' and '.join(parts)}, as the gains of its file are not "
            f'stable{where} with a timestep of {timestep_s * 1e3:g} ms')


def _acceleration_limits(model: mujoco.MjModel, data: mujoco.MjData, joint_ids: IntArray,
                         torque: FloatArray, drag: FloatArray, velocity_limit: FloatArray,
                         position_clamp: FloatArray) -> FloatArray:
    """
    Return the acceleration limits of joints: declared in the model, or derived.

    :param data: at the start; joints that are not named keep their positions
    :param joint_ids: of the joints, shape (n,)
    :param torque: greatest effort of each joint [N m or N], shape (n,)
    :param drag: effort that its own damping takes up at speed [N m or N], shape (n,)
    :param velocity_limit: [rad/s or m/s], shape (n,)
    :param position_clamp: lowest and highest position [rad or m], shape (n, 2)
    :returns: [rad/s^2 or m/s^2], shape (n,)
    """
    if model.nuser_jnt > 1:
        declared = model.jnt_user[joint_ids, 1]
    else:
        declared = np.zeros(len(joint_ids))
    if (declared > 0.0).all():
        return np.array(declared)
    qpos, dofs, kind = (field[joint_ids] for field in (
        model.jnt_qposadr, model.jnt_dofadr, model.jnt_type))
    carries = model.jnt_actgravcomp[joint_ids]
    random = np.random.default_rng(0)
    scratch = mujoco.MjData(model)
    low, high = np.clip(position_clamp, -np.pi, np.pi).T
    possible = []
    for pose in range(_POSES):
        scratch.qpos[:] = data.qpos
        if pose:
            scratch.qpos[qpos] = random.uniform(low, high)
        _compute_inertia_and_weight(model, scratch)
        # All joints of a kind may accelerate at once.
        coupled = (_inertia(model, scratch, dofs) * (kind[:, None] == kind)).sum(axis=1)
        weight = np.abs(scratch.qfrc_gravcomp[dofs]) * carries
        possible.append(np.maximum(torque - weight - drag, 0.2 * torque) / coupled)
    usual = np.quantile(possible, _QUANTILE, axis=0)
    derived = np.minimum(_TORQUE_SHARE * usual, velocity_limit / SPEED_UP_S)
    return np.asarray(np.where(declared > 0.0, declared, derived))


def _inertia(model: mujoco.MjModel, data: mujoco.MjData, dofs: IntArray) -> FloatArray:
    """Return the magnitudes of the joints' block of the inertia matrix, shape (n, n)."""
    inertia = np.zeros((model.nv, model.nv))
    rows, columns = np.repeat(np.arange(model.nv), model.M_rownnz), model.M_colind
    inertia[rows, columns] = inertia[columns, rows] = np.abs(data.M)
    return inertia[np.ix_(dofs, dofs)]


def _compute_inertia_and_weight(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Compute of ``mj_forward`` only the inertia matrix and ``qfrc_gravcomp``."""
    for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_makeM,
                    mujoco.mj_passive):
        compute(model, data)
