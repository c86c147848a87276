# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Position, velocity and effort control of a part by MuJoCo's own actuators.

A mode is a set of gains, biases and control ranges of the actuators; once per control period the
goal is written into ``ctrl``. The physics loop runs no code of this module.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from manip_sim.errors import ModelError
from manip_sim.simulation.parts import Part
from manip_sim.typing import FloatArray

MODES = ('position', 'velocity', 'effort')

#: Lag of a position servo whose gains are derived [s]: damping over stiffness.
_LAG_S = 0.013
#: A velocity servo is this much stiffer than the damping of the position servo.
_VELOCITY_GAIN = 5.0
#: Span of an unlimited hinge that an abstract action of -1 to 1 stands for [rad].
_UNLIMITED = (-2.0 * np.pi, 2.0 * np.pi)
#: Span of the effort goals of a joint without a torque limit [N m or N].
_UNLIMITED_EFFORT = 1e3


class Servos:
    """
    The actuators of a part that drive joints, in one of the three modes.

    Torque limits hold in every mode. Stiffness and damping are those of the model where its
    actuators are position or velocity servos, and derived from the joint's inertia where they are
    motors.

    :param model: the compiled ``mujoco.MjModel``, whose actuators are set
    :param part: the part
    :raises ModelError: if an actuator of the part does not drive a joint
    """

    def __init__(self, model: Any, part: Part) -> None:
        self._model = model
        self._ids = part.actuator_ids
        _check_driven(part)
        joint_ids = np.array([model.joint(j).id for j in part.driven_joints], dtype=np.int64)
        self._qpos = model.jnt_qposadr[joint_ids].astype(np.int64)
        dofs = model.jnt_dofadr[joint_ids].astype(np.int64)
        self._gear = model.actuator_gear[self._ids, 0].copy()
        damping = np.asarray(model.dof_damping).reshape(model.nv, -1)[dofs, 0]
        self._damping = damping / self._gear**2
        self._kp, self._kv = _stiffness_and_damping(model, self._ids, dofs)
        self.limited = model.jnt_limited[joint_ids].astype(bool)
        self.ranges = {
            'position': self._position_range(joint_ids),
            'velocity': _symmetric(_velocity_limit(model, joint_ids, self._ids))}
        self._limit_torque(joint_ids)
        model.actuator_biastype[self._ids] = int(mujoco.mjtBias.mjBIAS_AFFINE)
        self.velocity_limit = self.ranges['velocity'][:, 1]
        self._lead = (self.ranges['effort'][:, 1] / self._gear**2
                      + self._kv * self.velocity_limit) / self._kp
        self.mode = 'position'

    def _limit_torque(self, joint_ids: Any) -> None:
        # At the joint: there the gravity compensation counts too, and the modes need the control
        # range, which is the torque limit of a motor, for their goals.
        limit = _effort_limit(self._model, joint_ids, self._ids)
        limited = np.isfinite(limit)
        self._model.jnt_actfrcrange[joint_ids[limited]] = _symmetric(limit[limited])
        self._model.jnt_actfrclimited[joint_ids[limited]] = 1
        limit[~limited] = _UNLIMITED_EFFORT
        self.ranges['effort'] = _symmetric(limit)

    def _position_range(self, joint_ids: Any) -> FloatArray:
        limits: FloatArray = self._model.jnt_range[joint_ids].copy()
        limits[~self.limited] = _UNLIMITED
        return limits

    def set_mode(self, mode: str) -> None:
        """Set gains, biases and control ranges for a mode of :data:`MODES`."""
        kp, kv = self._kp, self._kv
        zero = np.zeros_like(kp)
        gain, stiffness, damping = {
            'position': (kp, kp, kv),
            # What the joint's own damping takes is fed forward, so that the speed is met.
            'velocity': (_VELOCITY_GAIN * kv + self._damping, zero, _VELOCITY_GAIN * kv),
            'effort': (zero + 1.0, zero, zero)}[mode]
        model, ids = self._model, self._ids
        model.actuator_gainprm[ids, 0] = gain
        model.actuator_biasprm[ids, 0] = 0.0
        model.actuator_biasprm[ids, 1] = -stiffness
        model.actuator_biasprm[ids, 2] = -damping
        # Position goals of unlimited joints may be anywhere; MuJoCo would wrap nothing, but clip.
        unlimited = ~self.limited & (mode == 'position')
        model.actuator_ctrllimited[ids] = ~unlimited
        scaled = self.to_ctrl(self.ranges[mode].T, mode)
        model.actuator_ctrlrange[ids] = np.sort(scaled.T, axis=1)
        self.mode = mode

    def to_ctrl(self, goal: FloatArray, mode: str) -> FloatArray:
        """Convert a goal at the joints [rad, rad/s, N m or the same of a slide] to ``ctrl``."""
        ctrl: FloatArray = goal / self._gear if mode == 'effort' else goal * self._gear
        return ctrl

    def rest_goal(self, data: Any) -> FloatArray:
        """Return the goal that leaves the part where it is, shape (n_actuators,)."""
        if self.mode == 'position':
            here: FloatArray = data.qpos[self._qpos].copy()
            return here
        return np.zeros(len(self._ids))

    def approach(self, data: Any, last: FloatArray, goal: FloatArray, period_s: float
                 ) -> FloatArray:
        """
        Return the next goal on the way from the last one, no faster than the joints may move.

        It does not run ahead of a joint by more than gives the full torque at the velocity limit;
        else a joint that cannot keep up would exceed the limit when it catches up.

        :param last: what the actuators followed up to now, shape (n_actuators,)
        :param goal: where they shall come to, shape (n_actuators,)
        :param period_s: length of the control period [s]
        """
        if self.mode != 'position':
            return goal
        reach = self.velocity_limit * period_s
        following: FloatArray = last + np.clip(goal - last, -reach, reach)
        here, lead = data.qpos[self._qpos], self._lead + reach / 2.0
        return np.clip(following, here - lead, here + lead)

    def write(self, data: Any, goal: FloatArray) -> None:
        """Write a goal into ``data.ctrl``."""
        data.ctrl[self._ids] = self.to_ctrl(goal, self.mode)


def _check_driven(part: Part) -> None:
    for actuator, joint in zip(part.actuators, part.driven_joints):
        if joint is None:
            raise ModelError(f"actuator '{actuator}' of {part.name} must drive a joint, not a "
                             'tendon, a site or a body')


def _stiffness_and_damping(model: Any, ids: Any, dofs: Any) -> tuple[FloatArray, FloatArray]:
    kp = -model.actuator_biasprm[ids, 1].copy()
    kv = -model.actuator_biasprm[ids, 2].copy()
    affine = model.actuator_biastype[ids] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    position_servo = affine & (kp > 0.0)
    velocity_servo = affine & (kp == 0.0) & (kv > 0.0)
    # What the actuator sees of the joint through its gear.
    inertia = model.dof_M0[dofs] / model.actuator_gear[ids, 0]**2
    # Critical damping with the lag wanted: kv = 2 sqrt(kp M) and kv / kp = lag.
    derived_kp = 4.0 * inertia / _LAG_S**2
    kp = np.where(position_servo, kp, np.where(velocity_servo, kv / _LAG_S / 4.0, derived_kp))
    kv = np.where(position_servo & (kv > 0.0), kv,
                  np.where(velocity_servo, kv / _VELOCITY_GAIN,
                           2.0 * np.sqrt(np.maximum(kp * inertia, 0.0))))
    return kp, kv


def _symmetric(limit: FloatArray) -> FloatArray:
    return np.stack([-limit, limit], axis=1)


def _velocity_limit(model: Any, joint_ids: Any, ids: Any) -> FloatArray:
    limit = np.full(len(joint_ids), np.inf)
    if model.nuser_jnt:
        declared = model.jnt_user[joint_ids, 0]
        limit = np.where(declared > 0.0, declared, limit)
    velocity_servo = (model.actuator_biasprm[ids, 1] == 0.0) & (model.actuator_biasprm[ids, 2] < 0)
    of_servo = np.where(velocity_servo, model.actuator_ctrlrange[ids, 1]
                        / np.abs(model.actuator_gear[ids, 0]), np.inf)
    limit = np.minimum(limit, of_servo)
    return np.where(np.isfinite(limit), limit, np.pi)


def _effort_limit(model: Any, joint_ids: Any, ids: Any) -> FloatArray:
    gear = np.abs(model.actuator_gear[ids, 0])
    motor = (model.actuator_biasprm[ids, 1:3] == 0.0).all(axis=1)
    limits = np.stack([
        np.where(model.actuator_forcelimited[ids],
                 model.actuator_forcerange[ids, 1] * gear, np.inf),
        np.where(model.jnt_actfrclimited[joint_ids], model.jnt_actfrcrange[joint_ids, 1], np.inf),
        np.where(motor & (model.actuator_ctrllimited[ids] != 0),
                 model.actuator_ctrlrange[ids, 1] * model.actuator_gainprm[ids, 0] * gear,
                 np.inf)])
    limit: FloatArray = limits.min(axis=0)
    return limit
