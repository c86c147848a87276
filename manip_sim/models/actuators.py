# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Actuators of joints, and joints that move together: kinds, gains, limits, couplings.

A position servo with integrator dynamics follows its activation instead of its control: ``act`` is
the setpoint and ``ctrl`` the velocity of the setpoint, which MuJoCo integrates in each step.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.errors import ModelError

#: Types of joints with one degree of freedom.
SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
#: Types of transmissions to one joint.
JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
#: Lag of a position servo whose gains are derived [s]: damping over stiffness.
_LAG_S = 0.013
#: Velocity limit of a joint that declares none [rad/s or m/s].
_DEFAULT_VELOCITY = np.pi
_WRAP, _EQUALITY = mujoco.mjtWrap, mujoco.mjtEq
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_SITE = (int(mujoco.mjtTrn.mjTRN_SITE), int(mujoco.mjtTrn.mjTRN_SLIDERCRANK))
#: Number of positions in a joint's range at which velocity ratios are computed.
_PLACES = 5
_STEP = 1e-6


def is_position_servo(actuator: Any) -> bool:
    """
    Return whether an actuator pulls its transmission towards a length that the control sets.

    :param actuator: of a ``mujoco.MjSpec``
    """
    return bool(int(actuator.gaintype) == int(mujoco.mjtGain.mjGAIN_FIXED)
                and int(actuator.biastype) == int(mujoco.mjtBias.mjBIAS_AFFINE)
                and actuator.gainprm[0] > 0.0 and actuator.biasprm[1] < 0.0)


def position_servos(model: mujoco.MjModel, actuators: ArrayLike) -> BoolArray:
    """
    Return which actuators of a compiled model are position servos, as :func:`is_position_servo`.

    :param actuators: their ids, of any shape
    :returns: of that shape
    """
    ids = np.asarray(actuators, dtype=int)
    return np.asarray((model.actuator_gaintype[ids] == int(mujoco.mjtGain.mjGAIN_FIXED))
                      & (model.actuator_biastype[ids] == int(mujoco.mjtBias.mjBIAS_AFFINE))
                      & (model.actuator_gainprm[ids, 0] > 0.0)
                      & (model.actuator_biasprm[ids, 1] < 0.0))


def position_servos_without_dynamics(spec: mujoco.MjSpec, names: Iterable[str]) -> list[str]:
    """
    Return the names of the position servos without activation dynamics.

    :param spec: a ``mujoco.MjSpec``
    :param names: of actuators
    """
    none = int(mujoco.mjtDyn.mjDYN_NONE)
    return [name for name in names if is_position_servo(spec.actuator(name))
            and int(spec.actuator(name).dyntype) == none]


def add_setpoint_activation(spec: mujoco.MjSpec, names: Iterable[str]) -> None:
    """
    Give actuators an activation that holds their setpoint.

    The control range becomes the activation range too, which is not enforced. If it is inherited
    from a joint, MuJoCo's compiler fills in the activation range.

    :param spec: the ``mujoco.MjSpec``, changed in place
    :param names: of the actuators
    :raises ModelError: if a plugin computes the force of one of them
    """
    for name in names:
        actuator = spec.actuator(name)
        if actuator.plugin.active:
            raise ModelError(f"the force of actuator '{name}' comes from a plugin, so its joint "
                             'cannot have control modes: make it a motor or a servo')
        if not actuator.inheritrange:
            actuator.actrange = actuator.ctrlrange.copy()
        if is_position_servo(actuator):
            actuator.ctrllimited = 0  # The range is one of positions, not of velocities.
        actuator.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
        actuator.dynprm[0] = 1.0
        actuator.actlimited = 0


def check_single(actuators: Sequence[str], joints: Sequence[str]) -> None:
    """
    Check that each joint has only one actuator.

    :param joints: the joint that each of the actuators drives
    :raises ModelError: naming the joint and two of its actuators
    """
    driver: dict[str, str] = {}
    for actuator, joint in zip(actuators, joints):
        if joint in driver:
            raise ModelError(f"joint '{joint}' is driven by two actuators, '{driver[joint]}' and "
                             f"'{actuator}': give it one")
        driver[joint] = actuator


def check_kinds(model: mujoco.MjModel, actuators: Sequence[str]) -> None:
    """
    Check that actuators can be made servos.

    :raises ModelError: naming one that is neither motor nor servo
    """
    biases = [int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)]
    for name in actuators:
        index = model.actuator(name).id
        if (int(model.actuator_gaintype[index]) != int(mujoco.mjtGain.mjGAIN_FIXED)
                or int(model.actuator_biastype[index]) not in biases):
            raise ModelError(f"actuator '{name}' must be a motor, or a position or velocity servo:"
                             ' its gain must be fixed and its bias none or affine')


def stiffness_and_damping(model: mujoco.MjModel, ids: IntArray, dofs: IntArray
                          ) -> tuple[FloatArray, FloatArray]:
    """
    Return the gains of actuators as servos, from the model, or derived from the inertia.

    :param ids: of the actuators
    :param dofs: of the joints that they drive
    :returns: kp and kv at the actuators, each of shape (n,)
    """
    kp = -model.actuator_biasprm[ids, 1].copy()
    kv = -model.actuator_biasprm[ids, 2].copy()
    affine = model.actuator_biastype[ids] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    position_servo = position_servos(model, ids)
    velocity_servo = affine & (kp == 0.0) & (kv > 0.0)
    # The inertia of the joint as the actuator sees it through its gear.
    inertia = model.dof_M0[dofs] / model.actuator_gear[ids, 0]**2
    # Critical damping, kv = 2 sqrt(kp M), with the lag wanted, kv / kp, or the kv of the model.
    derived_kp = 4.0 * inertia / _LAG_S**2
    damped_kp = np.minimum(kv**2 / (4.0 * inertia), derived_kp)
    kp = np.where(position_servo, kp, np.where(velocity_servo, damped_kp, derived_kp))
    kv = np.where((position_servo | velocity_servo) & (kv > 0.0), kv,
                  2.0 * np.sqrt(np.maximum(kp * inertia, 0.0)))
    return kp, kv


def velocity_limit(model: mujoco.MjModel, joint_ids: IntArray, ids: IntArray) -> FloatArray:
    """Return velocity limits [rad/s or m/s], (n,): declared, of a velocity servo, or a default."""
    limit = np.minimum(declared_velocity(model, joint_ids), velocity_of_servos(model, ids))
    return np.where(np.isfinite(limit), limit, _DEFAULT_VELOCITY)


def effort_range(model: mujoco.MjModel, joint_ids: IntArray, ids: IntArray) -> FloatArray:
    """Return the effort range of joints [N m or N], infinite without a limit, shape (n, 2)."""
    gear = model.actuator_gear[ids, :1]
    motor = (model.actuator_biasprm[ids, 1:3] == 0.0).all(axis=1)
    gain = np.where(motor, model.actuator_gainprm[ids, 0], 0.0)[:, None]
    motor_limited = motor & (model.actuator_ctrllimited[ids] != 0)
    ranges = [
        np.where(model.actuator_forcelimited[ids, None] != 0,
                 model.actuator_forcerange[ids] * gear, (-np.inf, np.inf)),
        np.where(model.jnt_actfrclimited[joint_ids, None] != 0,
                 model.jnt_actfrcrange[joint_ids], (-np.inf, np.inf)),
        np.where(motor_limited[:, None], model.actuator_ctrlrange[ids] * gain * gear,
                 (-np.inf, np.inf))]
    # A negative gear reverses a range.
    ordered = np.sort(np.stack(ranges), axis=2)
    return np.stack([ordered[..., 0].max(axis=0), ordered[..., 1].min(axis=0)], axis=1)


@dataclass(frozen=True)
class FrictionLaw:
    """
    Dependence of friction and torque limit of a joint on its velocity; none if infinite.

    Friction is ``coulomb + (static - coulomb) / (1 + (v / stribeck_velocity)^2)`` (D. P. Hess and
    A. Soom, Journal of Tribology 112(1), 1990). The torque limit in the direction of motion falls
    linearly from all of it at ``knee`` to nothing at ``no_load``.

    :ivar coulomb: dry friction at speed [N m or N]
    :ivar static: dry friction at rest [N m or N]
    :ivar stribeck_velocity: at which half of the difference is left [rad/s or m/s]
    :ivar knee: [rad/s or m/s]
    :ivar no_load: [rad/s or m/s]
    """

    coulomb: float = 0.0
    static: float = 0.0
    stribeck_velocity: float = math.inf
    knee: float = math.inf
    no_load: float = math.inf

    @property
    def acts(self) -> bool:
        """True if anything depends on the velocity."""
        return math.isfinite(self.stribeck_velocity) or math.isfinite(self.no_load)


def declared_velocity(model: mujoco.MjModel, joints: ArrayLike) -> FloatArray:
    """
    Return the velocity limits of joints, from ``user[0]``, infinite where none is declared.

    :param joints: ids of joints, of any shape
    :returns: limits [rad/s or m/s], of that shape
    """
    joints = np.asarray(joints, dtype=int)
    if not model.nuser_jnt:
        return np.full(joints.shape, np.inf)
    declared = model.jnt_user[joints, 0]
    return np.where(declared > 0.0, declared, np.inf)


def velocity_of_servos(model: mujoco.MjModel, actuators: ArrayLike) -> FloatArray:
    """
    Return the highest velocities that velocity servos take, infinite for other actuators.

    :param actuators: their ids, of any shape
    :returns: at the joints [rad/s or m/s], of that shape
    """
    ids = np.asarray(actuators, dtype=int)
    limited = ((model.actuator_biasprm[ids, 1] == 0.0) & (model.actuator_biasprm[ids, 2] < 0.0)
               & (model.actuator_ctrllimited[ids] != 0))
    highest = np.abs(model.actuator_ctrlrange[ids]).min(axis=-1)
    return np.where(limited, highest / np.abs(model.actuator_gear[ids, 0]), np.inf)


class JointCouplings:
    """
    The joint equalities among some joints: one joint is a polynomial of another one.

    :param model: the compiled ``mujoco.MjModel``; constraints that are active at its start count
    :param joints: ids of scalar joints
    """

    def __init__(self, model: mujoco.MjModel, joints: Iterable[int]) -> None:
        ids = set(joints)
        self._zeros = {j: float(model.qpos0[model.jnt_qposadr[j]]) for j in ids}
        self._ranges = {j: model.jnt_range[j].copy() for j in ids if model.jnt_limited[j]}
        self._neighbours: dict[int, list[tuple[int, FloatArray, bool]]] = {j: [] for j in ids}
        is_joint = model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)
        for equality in np.flatnonzero(is_joint & (model.eq_active0 != 0)):
            follower, leader = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
            if follower in ids and leader in ids:
                polynomial = model.eq_data[equality, :5].copy()
                self._neighbours[leader].append((follower, polynomial, False))
                self._neighbours[follower].append((leader, polynomial, True))

    def group(self, joint: int) -> frozenset[int]:
        """Return a joint and the joints that move with it."""
        group, waiting = {joint}, [joint]
        while waiting:
            for other, _, _ in self._neighbours[waiting.pop()]:
                if other not in group:
                    group.add(other)
                    waiting.append(other)
        return frozenset(group)

    def follow(self, positions: Mapping[int, float]) -> dict[int, float]:
        """
        Return the positions of joints that are coupled to others.

        :param positions: of some joints, by id [rad or m]; of two that are coupled to the same
            one, the first one counts
        :returns: the positions given, and the positions of other joints that follow from them
        """
        known = dict(positions)
        waiting = list(known)
        while waiting:
            joint = waiting.pop(0)
            for other, polynomial, inverse in self._neighbours[joint]:
                if other in known:
                    continue
                offset = known[joint] - self._zeros[joint]
                value = (self._solve(polynomial, offset, other) if inverse
                         else _value(polynomial, offset))
                if value is not None:
                    known[other] = value + self._zeros[other]
                    waiting.append(other)
        return known

    def ratios(self, joint: int) -> list[dict[int, float]]:
        """Return the velocities of coupled joints per that of one, at positions in its range."""
        low, high = self._ranges.get(joint, (self._zeros[joint], self._zeros[joint]))
        ratios = []
        for place in np.linspace(low + _STEP, high - _STEP, _PLACES):
            before = self.follow({joint: place - _STEP})
            after = self.follow({joint: place + _STEP})
            ratios.append({other: (after[other] - before[other]) / (2.0 * _STEP)
                          for other in before if other in after})
        return ratios

    def _solve(self, polynomial: FloatArray, value: float, joint: int) -> float | None:
        """Return the offset nearest to zero at which a polynomial has a value, or None."""
        if not polynomial[2:].any():
            return (value - polynomial[0]) / polynomial[1] if polynomial[1] else None
        roots = np.roots([*polynomial[:0:-1], polynomial[0] - value])
        real = roots.real[np.abs(roots.imag) < _STEP]
        if joint in self._ranges:
            low, high = self._ranges[joint] - self._zeros[joint]
            real = real[(real > low - _STEP) & (real < high + _STEP)]
        return float(real[np.argmin(np.abs(real))]) if len(real) else None


def _value(polynomial: FloatArray, offset: float) -> float:
    """Return the value of a polynomial by Horner's rule; ``np.polyval`` takes far longer."""
    value = 0.0
    for coefficient in polynomial[::-1].tolist():
        value = value * offset + coefficient
    return value


def actuated_joints(model: mujoco.MjModel, actuator: int) -> list[int]:
    """
    Return the joints that an actuator acts on, through any transmission.

    :param model: a compiled ``mujoco.MjModel``
    :param actuator: id of the actuator
    """
    kind = int(model.actuator_trntype[actuator])
    target, reference = model.actuator_trnid[actuator].tolist()
    if kind in JOINT_TRANSMISSIONS:
        return [target]
    if kind == _TENDON:
        return _tendon_joints(model, target)
    if kind in _SITE:
        bodies = [int(model.site_bodyid[site]) if site >= 0 else 0 for site in (target, reference)]
        return joints_between(model, *bodies)
    return []


def _tendon_joints(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Return the joints that a fixed tendon lists, or between whose links a spatial one runs."""
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    fixed = [int(model.wrap_objid[wrap]) for wrap in wraps
             if int(model.wrap_type[wrap]) == int(_WRAP.mjWRAP_JOINT)]
    if fixed:
        return fixed
    joints: dict[int, None] = {}
    for body, next_body in pairwise(_wrapped_body(model, wrap) for wrap in wraps):
        if body is not None and next_body is not None:
            joints.update(dict.fromkeys(joints_between(model, body, next_body)))
    return list(joints)


def _wrapped_body(model: mujoco.MjModel, wrap: int) -> int | None:
    """Return the body of a point that a tendon runs through, None for a pulley."""
    kind, element = int(model.wrap_type[wrap]), int(model.wrap_objid[wrap])
    if kind == int(_WRAP.mjWRAP_SITE):
        return int(model.site_bodyid[element])
    if kind in (int(_WRAP.mjWRAP_SPHERE), int(_WRAP.mjWRAP_CYLINDER)):
        return int(model.geom_bodyid[element])
    return None


def moved_joints(model: mujoco.MjModel) -> set[int]:
    """
    Return the joints that something moves or holds.

    That is an actuator, a spring, a constraint that fixes the joint, or a coupling (an equality of
    joints or tendons, or a loop that a connect or weld constraint closes) to such a joint.

    :param model: a compiled ``mujoco.MjModel``
    """
    moved = {joint for actuator in range(model.nu) for joint in actuated_joints(model, actuator)}
    # A stiffness is one number or several, depending on the version of MuJoCo.
    moved.update(j for j in range(model.njnt) if np.any(model.jnt_stiffness[j]))
    for tendon in range(model.ntendon):
        if np.any(model.tendon_stiffness[tendon]):
            moved.update(_tendon_joints(model, tendon))
    groups = [set(group) for group in _coupled(model)]
    moved.update(*_fixed(model))
    while True:
        reached = [group for group in groups if group & moved and not group <= moved]
        if not reached:
            return moved
        moved.update(*reached)


def _equalities(model: mujoco.MjModel, *kinds: Any) -> Iterator[tuple[int, int, int]]:
    types = [int(kind) for kind in kinds]
    for equality in np.flatnonzero(model.eq_active0).tolist():
        if int(model.eq_type[equality]) in types:
            yield equality, int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])


def _coupled(model: mujoco.MjModel) -> Iterator[Iterable[int]]:
    for _, first, second in _equalities(model, _EQUALITY.mjEQ_JOINT):
        yield first, *(() if second < 0 else (second,))
    for _, first, second in _equalities(model, _EQUALITY.mjEQ_TENDON):
        yield [*_tendon_joints(model, first),
               *(_tendon_joints(model, second) if second >= 0 else ())]
    for equality, first, second in _equalities(model, _EQUALITY.mjEQ_CONNECT, _EQUALITY.mjEQ_WELD):
        yield joints_between(model, *_tied_bodies(model, equality, first, second))


def _fixed(model: mujoco.MjModel) -> Iterator[Iterable[int]]:
    """Yield the joints that a constraint holds alone, or by a weld to world or a mocap body."""
    for _, first, second in _equalities(model, _EQUALITY.mjEQ_JOINT):
        if second < 0:
            yield (first,)
    for equality, first, second in _equalities(model, _EQUALITY.mjEQ_WELD):
        bodies = _tied_bodies(model, equality, first, second)
        if any(not int(model.body_weldid[body]) or int(model.body_mocapid[body]) >= 0
               for body in bodies):
            yield joints_between(model, *bodies)


def _tied_bodies(model: mujoco.MjModel, equality: int, first: int, second: int) -> tuple[int, int]:
    if int(model.eq_objtype[equality]) == int(mujoco.mjtObj.mjOBJ_SITE):
        return int(model.site_bodyid[first]), int(model.site_bodyid[second])
    return first, second


def joints_between(model: mujoco.MjModel, first: int, second: int) -> list[int]:
    """Return the joints that move one body relative to another."""
    apart = _ancestry(model, first) ^ _ancestry(model, second)
    return [joint for joint in range(model.njnt) if int(model.jnt_bodyid[joint]) in apart]


def _ancestry(model: mujoco.MjModel, body: int) -> set[int]:
    bodies = set()
    while body:
        bodies.add(body)
        body = int(model.body_parentid[body])
    return bodies
