# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The actuators of a gripper: ranges, speeds and forces in the units of their controls, and joints.

The setpoint of a position servo is in the units of its control; the servo comes to rest where the
length of its transmission matches it. Any other actuator, such as a motor, has only a control.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.records import FINGER, readable
from manip_sim.derived import Derived
from manip_sim.errors import CommandError, ModelError
from manip_sim.models.actuators import declared_velocity, position_servos
from manip_sim.models.couplings import JointCouplings
from manip_sim.physics.parts import Part
from manip_sim.physics.physics import Physics

#: A finger stands still if it would take longer than this to cross its range [s].
_STILL_S = 40.0
_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
#: A force that a servo exerts so many ranges away from its place of rest stands for no limit.
_NO_LIMIT_RANGES = 100.0
#: Ranges of two fingers that differ by less, as a share, are equal.
_EQUAL = 0.01
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class GripperActuators:
    """
    The actuators of a gripper, with their properties in arrays of shape (n, ...).

    :param physics: of the world
    :param part: the gripper
    :ivar ids: of the actuators
    :ivar is_servo: whether the actuator has a setpoint
    :ivar ranges: of setpoints, and of the controls of other actuators, shape (n, 2)
    :ivar speeds: of the setpoints, so that no joint and none that is coupled to it exceeds its
        velocity limit [1/s]; infinite where none is declared
    :ivar overtravel: how far a setpoint is below and above its place of rest at full force, zero
        where the force is not limited, or by an absurd number, or the activation is, shape (n, 2)
    :ivar is_pair: whether they are two servos of independent joints with equal ranges, as of two
        fingers that close on each other
    :ivar terms: by actuator, the joints that make up its length, with their coefficients; empty
        where the length is not a sum of joint positions
    :ivar couplings: among the joints of the gripper
    :raises ModelError: naming an actuator without a range, or another on a servo's joint or tendon
    """

    def __init__(self, physics: Physics, part: Part) -> None:
        self._physics, model, self._derived = physics, physics.model, Derived()
        self._part = part
        self.ids: IntArray = part.actuator_ids
        self._gain = model.actuator_gainprm[self.ids, 0].copy()
        self._bias = model.actuator_biasprm[self.ids, :2].copy()
        self.is_servo = position_servos(model, self.ids)
        dynamics = model.actuator_dyntype[self.ids]
        self._integrates = self.is_servo & (dynamics == int(mujoco.mjtDyn.mjDYN_INTEGRATOR))
        self._settles = self._integrates | (self.is_servo & np.isin(dynamics, _FILTERS))
        physics.on_change(self._find_joints)
        self._check_shared()
        self.ranges = np.array([self._range(i) for i in range(len(self.ids))]).reshape(-1, 2)
        self.speeds = np.array([self._speed(i) for i in range(len(self.ids))])
        self.overtravel = np.array([self._overtravel(i) for i in range(len(self.ids))]
                                   ).reshape(-1, 2)
        self.is_pair = self._is_pair()

    def _is_pair(self) -> bool:
        if len(self.ids) != 2 or [len(terms) for terms in self.terms] != [1, 1]:
            return False
        (first, _), (second, _) = (terms[0] for terms in self.terms)
        kinds, spans = self._physics.model.jnt_type, np.ptp(self.ranges, axis=1)
        coupled = second in self.couplings.group(first)
        return bool(self.is_servo.all() and not coupled and kinds[first] == kinds[second]
                    and abs(spans[0] - spans[1]) <= _EQUAL * spans[0]
                    and self.overtravel.any(axis=1).all())

    def fingers(self, tolerance: FloatArray) -> Any:
        """
        Return the actuators as the compiled law reads them, records of ``FINGER``, shape (n,).

        :param tolerance: setpoints that differ by less are the same, shape (n,)
        """
        fingers = self._derived.of.get('fingers')
        if fingers is None:
            fingers = self._derived.of['fingers'] = readable(self._make_fingers(tolerance))
        if self.is_pair:  # Only two fingers that press need their present limits of force.
            fingers['reach_below'], fingers['reach_above'] = self._reach().T
        return fingers

    def _make_fingers(self, tolerance: FloatArray) -> Any:
        fingers = np.zeros(len(self.ids), FINGER)
        for field, values in (
                ('id', self.ids), ('activation', self._act), ('is_servo', self.is_servo),
                ('integrates', self._integrates), ('speed', self.speeds), ('tolerance', tolerance),
                ('gain', np.where(self.is_servo, self._gain, 1.0)),
                ('offset', np.where(self.is_servo, self._bias[:, 0], 0.0)),
                ('per_length', np.where(self.is_servo, self._bias[:, 1], 0.0)),
                ('low', self.ranges[:, 0]), ('high', self.ranges[:, 1]),
                ('below', self.overtravel[:, 0]), ('above', self.overtravel[:, 1])):
            fingers[field] = values
        return fingers

    def _reach(self) -> FloatArray:
        """Return how far setpoints are beyond their servos' places at full force, shape (n, 2)."""
        model = self._physics.model
        limits = np.abs(model.actuator_forcerange[self.ids]) / self._gain[:, None]
        limited = model.actuator_forcelimited[self.ids].astype(bool)[:, None]
        return np.where(limited, np.minimum(self.overtravel, limits), self.overtravel)

    def _find_joints(self) -> None:
        model = self._physics.model
        # That of a restored state is a copy, which the part does not change.
        self.ids = self._part.actuator_ids
        self._act = model.actuator_actadr[self.ids]
        self._derived.of.clear()
        self.couplings = JointCouplings(model, [model.joint(j).id for j in self._part.joints])
        self.terms = [self._length_terms(i) for i in range(len(self.ids))]

    def name(self, index: int) -> str:
        """Return the name of an actuator."""
        return self._part.actuators[index]

    def rest(self, lengths: FloatArray) -> FloatArray:
        """
        Return the setpoints at which servos come to rest; zero for other actuators.

        :param lengths: of the transmissions [rad or m], shape (n,)
        """
        gain = np.where(self.is_servo, self._gain, 1.0)
        at_rest: FloatArray = -(self._bias[:, 0] + self._bias[:, 1] * lengths) / gain
        return np.where(self.is_servo, at_rest, 0.0)

    def place(self, data: mujoco.MjData) -> FloatArray:
        """Return the setpoints at which the servos would rest where they are, shape (n,)."""
        return self.rest(data.actuator_length[self.ids])

    def setpoints(self, data: mujoco.MjData) -> FloatArray:
        """Return the present setpoints, and the controls of other actuators, a copy."""
        present: FloatArray = data.ctrl[self.ids].copy()
        present[self._integrates] = data.act[self._act[self._integrates]]
        return present

    def hold(self, data: mujoco.MjData, setpoints: FloatArray) -> None:
        """Set setpoints and controls at once, as if they had been there for long."""
        data.act[self._act[self._settles]] = setpoints[self._settles]
        data.ctrl[self.ids] = np.where(self._integrates, 0.0, setpoints)

    def lengths_at(self, data: mujoco.MjData, positions: dict[int, float]) -> FloatArray:
        """
        Return the lengths of the transmissions with some joints at other positions.

        :param positions: by id of the joint [rad or m]; the other joints stay where they are
        :returns: shape (n,), NaN where none of the joints takes part
        """
        model, lengths = self._physics.model, np.full(len(self.ids), np.nan)
        for index, terms in enumerate(self.terms):
            if any(joint in positions for joint, _ in terms):
                lengths[index] = model.actuator_gear[self.ids[index], 0] * sum(
                    coefficient * positions.get(joint, data.qpos[model.jnt_qposadr[joint]])
                    for joint, coefficient in terms)
        return lengths

    def joint_range(self, joint: int) -> tuple[float, float]:
        """
        Return the range that a joint can move in [rad or m], infinite if it is unknown.

        :param joint: its id
        """
        model = self._physics.model
        low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
        for index, terms in enumerate(self.terms):
            if self.is_servo[index] and [other for other, _ in terms] == [joint]:
                lengths = -(self._bias[index, 0] + self._gain[index] * self.ranges[index]
                            ) / self._bias[index, 1]
                ends = lengths / (terms[0][1] * model.actuator_gear[self.ids[index], 0])
                low, high = max(low, ends.min()), min(high, ends.max())
        return float(low), float(high)

    def why_no_setpoint(self, index: int) -> str:
        """Return why an actuator has no setpoint, in words."""
        damping = self._physics.model.actuator_biasprm[self.ids[index], 2]
        control = 'a velocity' if damping < 0.0 and self._bias[index, 1] == 0.0 else 'a force'
        return f"actuator '{self.name(index)}' is no position servo, its control is {control}"

    def _length_terms(self, index: int) -> list[tuple[int, float]]:
        model, actuator = self._physics.model, int(self.ids[index])
        kind, target = int(model.actuator_trntype[actuator]), model.actuator_trnid[actuator, 0]
        if kind in _JOINT and int(model.jnt_type[target]) in _SCALAR:
            return [(int(target), 1.0)]
        if kind != _TENDON:
            return []
        first = int(model.tendon_adr[target])
        wraps = range(first, first + int(model.tendon_num[target]))
        if any(int(model.wrap_type[w]) != int(mujoco.mjtWrap.mjWRAP_JOINT) for w in wraps):
            return []
        return [(int(model.wrap_objid[w]), float(model.wrap_prm[w])) for w in wraps]

    def _check_shared(self) -> None:
        driven_by: dict[tuple[bool, int], int] = {}
        for index, actuator in enumerate(self.ids):
            kind = int(self._physics.model.actuator_trntype[actuator])
            if kind not in (*_JOINT, _TENDON):
                continue
            key = kind == _TENDON, int(self._physics.model.actuator_trnid[actuator, 0])
            first = driven_by.setdefault(key, index)
            if first != index and (self.is_servo[first] or self.is_servo[index]):
                model = self._physics.model
                noun, of_id = ('tendon', model.tendon) if key[0] else ('joint', model.joint)
                raise ModelError(
                    f"actuators '{self.name(first)}' and '{self.name(index)}' of "
                    f"{self._part.name} both drive {noun} '{of_id(key[1]).name}' and one of "
                    'them is a position servo, which the other one disturbs: keep only one')

    def _range(self, index: int) -> tuple[float, float]:
        model, actuator = self._physics.model, int(self.ids[index])
        low, high = (model.actuator_actrange[actuator] if self._integrates[index]
                     else model.actuator_ctrlrange[actuator])
        if low < high:
            return float(low), float(high)
        terms = self.terms[index]
        if self.is_servo[index] and len(terms) == 1 and model.jnt_limited[terms[0][0]]:
            joint, coefficient = terms[0]
            ends = (model.jnt_range[joint] * coefficient * model.actuator_gear[actuator, 0])
            at_ends = -(self._bias[index, 0] + self._bias[index, 1] * ends) / self._gain[index]
            return float(at_ends.min()), float(at_ends.max())
        raise ModelError(f"actuator '{self.name(index)}' of {self._part.name} needs a control "
                         'range, to which actions in [-1, 1] are mapped')

    def _speed(self, index: int) -> float:
        """Return the greatest speed of a setpoint at which no joint exceeds its limit."""
        model, actuator = self._physics.model, int(self.ids[index])
        if not self.is_servo[index]:
            return np.inf
        coefficient_of = dict(self.terms[index])
        fastest = np.inf
        for joint in coefficient_of:
            for ratios in self.couplings.ratios(joint):
                length_rate = abs(sum(coefficient_of.get(other, 0.0) * ratio
                                      for other, ratio in ratios.items()))
                limits = [float(declared_velocity(self._physics.model, other)) / abs(ratio)
                          for other, ratio in ratios.items() if ratio]
                fastest = min([fastest, *(limit * length_rate for limit in limits)])
        per_length = -self._bias[index, 1] / self._gain[index]
        return float(fastest * abs(model.actuator_gear[actuator, 0]) * per_length)

    def _overtravel(self, index: int) -> tuple[float, float]:
        model, actuator = self._physics.model, int(self.ids[index])
        limits = []
        if model.actuator_forcelimited[actuator]:
            limits.append(model.actuator_forcerange[actuator])
        joint = self.terms[index][0][0] if len(self.terms[index]) == 1 else None
        if joint is not None and model.jnt_actfrclimited[joint]:
            limits.append(np.sort(model.jnt_actfrcrange[joint]
                                  / model.actuator_gear[actuator, 0]))
        # MuJoCo keeps a limited activation in its range, so it cannot go beyond.
        if not limits or not self.is_servo[index] or model.actuator_actlimited[actuator]:
            return 0.0, 0.0
        low, high = np.max(limits, axis=0)[0], np.min(limits, axis=0)[1]
        below, above = (max(force, 0.0) / self._gain[index] for force in (-low, high))
        farthest = _NO_LIMIT_RANGES * np.ptp(self.ranges[index])
        return (float(below) if below < farthest else 0.0,
                float(above) if above < farthest else 0.0)


class GripperJoints:
    """
    The joints of a gripper that take position commands, and the joints coupled to them.

    :param physics: of the world
    :param part: the name of the gripper's part, for errors
    :param actuators: of the gripper
    :ivar names: of the joints that a position command may name
    """

    def __init__(self, physics: Physics, part: str, actuators: GripperActuators) -> None:
        self._physics = physics
        self._part = part
        self._actuators = actuators
        physics.on_change(self._find)
        self.names: tuple[str, ...] = tuple(self._name(joint) for joint in self._ids)

    def _find(self) -> None:
        actuators = self._actuators
        self._ids = list(dict.fromkeys(
            joint for terms, servo in zip(actuators.terms, actuators.is_servo) if servo
            for joint, _ in terms))

    def _name(self, joint: int) -> str:
        return str(self._physics.model.joint(joint).name)

    def _id(self, name: str) -> int:
        return int(self._physics.model.joint(name).id)

    def ranges(self, names: Sequence[str]) -> FloatArray:
        """Return the ranges of joints [rad or m], infinite where there is none, shape (n, 2)."""
        joints = [self._physics.model.joint(name) for name in names]
        return np.array([j.range if j.limited[0] else (-np.inf, np.inf) for j in joints])

    def reach(self, name: str) -> tuple[float, float]:
        """Return the range that a joint can move in [rad or m], infinite if it is unknown."""
        return self._actuators.joint_range(self._id(name))

    def followers(self, name: str) -> frozenset[str]:
        """Return the joints that follow a commanded joint because they are coupled to it."""
        group = self._actuators.couplings.group(self._id(name))
        return frozenset(self._name(other) for other in group) - {name}

    def actuators_of(self, names: Sequence[str]) -> IntArray:
        """Return the indices of the actuators that move these joints or joints coupled to them."""
        moved = set(names).union(*(self.followers(name) for name in names))
        return np.array([index for index, terms in enumerate(self._actuators.terms)
                         if moved & {self._name(joint) for joint, _ in terms}], dtype=np.int64)

    def check_take_positions(self, names: Sequence[str]) -> None:
        """
        Check that no joint is driven only by actuators that take no position.

        :raises CommandError: naming such an actuator
        """
        for index, terms in enumerate(self._actuators.terms):
            driven = {self._name(joint) for joint, _ in terms}
            for name in names:
                if name in driven and name not in self.names:
                    raise CommandError(f"{self._part}: joint '{name}' takes no position, "
                                       f'{self._actuators.why_no_setpoint(index)}: use actions')

    def with_followers(self, positions: Mapping[str, float]) -> dict[int, float]:
        """
        Return the positions of joints and of those that are coupled to them, by the joint's id.

        :param positions: by name [rad or m]
        """
        following = self._actuators.couplings.follow(
            {self._id(name): position for name, position in positions.items()})
        return {joint: value for joint, value in following.items() if joint in self._ids}

    def are_still(self, data: mujoco.MjData) -> bool:
        """Return whether all of them have stopped, or nearly so."""
        low, high = self.ranges(self.names).T
        span = np.where(np.isfinite(high - low), high - low, 1.0)
        speed = np.array([data.joint(name).qvel[0] for name in self.names])
        return bool((np.abs(speed) < span / _STILL_S).all())


class ForceLimit:
    """
    The force limits of a gripper's actuators in the model.

    :param physics: of the world; ``actuator_forcerange`` of its model is changed
    :param actuators: of the gripper
    """

    remembered = ('_effort',)

    def __init__(self, physics: Physics, actuators: GripperActuators) -> None:
        self._physics = physics
        self._actuators = actuators
        ids, model = actuators.ids, physics.model
        self._limited = model.actuator_forcelimited[ids].copy()
        self._ranges = model.actuator_forcerange[ids].copy()
        # The range of an actuator without a force limit may be empty.
        self._widest = np.where(self._limited[:, None] != 0, self._ranges, [-np.inf, np.inf])
        self._per_effort = np.array([
            model.actuator_gear[actuator, 0] * (terms[0][1] if terms else 1.0)
            for actuator, terms in zip(ids, actuators.terms)])
        self._effort = 0.0

    def set(self, effort: float) -> None:
        """
        Limit the force of each actuator so that it gives its first joint no more than an effort.

        :param effort: [N or N m]; 0 for the actuators' own limits
        """
        if effort == self._effort:
            return
        self._effort, ids, model = effort, self._actuators.ids, self._physics.model
        if effort:
            most = (effort / np.abs(self._per_effort))[:, None]
            model.actuator_forcerange[ids] = np.clip(self._widest, -most, most)
            model.actuator_forcelimited[ids] = 1
        else:
            model.actuator_forcerange[ids] = self._ranges
            model.actuator_forcelimited[ids] = self._limited
