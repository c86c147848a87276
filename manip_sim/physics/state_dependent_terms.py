# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Functions of the present state that MuJoCo takes as constants of a step.

They are dry friction and torque limits of joints, velocities of belts, and weight that robots with
a free root carry. Nothing of them is part of a saved state.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import ModelError
from manip_sim.models.actuators import FrictionLaw
from manip_sim.physics.physics import Physics

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class Belts:
    """
    The geoms with a surface velocity that have the name of an actuator, whose control scales it.

    In the file, ``surfacevel`` is that for a control of 1. It is a function of the present
    controls, so nothing here is part of a saved state. The first number in ``user`` of such an
    actuator is its control at the start.

    :param physics: of the world
    """

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        self._per_control: dict[str, FloatArray] = {}
        physics.on_change(self._find)

    def _find(self) -> None:
        model = self._physics.model
        known, self._per_control = self._per_control, {}
        actuators = {model.actuator(actuator).name: actuator for actuator in range(model.nu)}
        moving = np.flatnonzero(model.geom_surfacevel.any(axis=1)).tolist()
        moving += [model.geom(name).id for name in known
                   if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name) >= 0]
        self._geoms: list[int] = []
        self._actuators: list[int] = []
        for geom in sorted(set(moving)):
            name = str(model.geom(geom).name)
            if name in actuators:
                # A model that has replaced another one holds the velocity written last.
                velocity = known.get(name, model.geom_surfacevel[geom].copy())
                self._per_control[name] = velocity
                self._geoms.append(geom)
                self._actuators.append(actuators[name])
        self._velocities = np.array(list(self._per_control.values())).reshape(-1, 6)

    def begin(self, data: mujoco.MjData) -> None:
        """Set the controls of the start."""
        model = self._physics.model
        if model.nuser_actuator:
            data.ctrl[self._actuators] = model.actuator_user[self._actuators, 0]

    @property
    def acts(self) -> bool:
        """True if there is a surface that may move."""
        return bool(self._geoms)

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Let surfaces move as the present controls say; return whether any has changed."""
        if not self._geoms:
            return False
        velocities = data.ctrl[self._actuators][:, None] * self._velocities
        if (velocities == model.geom_surfacevel[self._geoms]).all():
            return False
        model.geom_surfacevel[self._geoms] = velocities
        return True


class FrictionLaws:
    """
    The laws of the joints of a world.

    Dry friction and torque limits in the model are functions of the velocities of the present
    state alone, so nothing of them is part of a saved state. Hess and Soom's form of the Stribeck
    curve has the same bits on every processor, which an exponential function has not.

    :param physics: of the world at the start, with the torque limits of its servos
    :param laws: by joint
    :raises ModelError: if a joint with a torque-speed curve has no torque limit
    """

    def __init__(self, physics: Physics, laws: Mapping[str, FrictionLaw]) -> None:
        self._physics, self._laws = physics, dict(laws)
        model = physics.model
        joints = np.array([model.joint(name).id for name in laws], dtype=np.int64)
        self._limits = model.jnt_actfrcrange[joints].copy()
        self._friction = model.dof_frictionloss[model.jnt_dofadr[joints]].copy()
        for name, joint, law in zip(laws, joints, laws.values()):
            if np.isfinite(law.no_load) and not model.jnt_actfrclimited[joint]:
                raise ModelError(f"joint '{name}' has no torque limit, so it can have no "
                                 'torque-speed curve')
        coulomb, static, stribeck, knee, no_load = np.array(
            [[law.coulomb, law.static, law.stribeck_velocity, law.knee, law.no_load]
             for law in laws.values()]).reshape(-1, 5).T
        self._stribeck = np.isfinite(stribeck)
        self._coulomb, self._excess, self._scale = coulomb, static - coulomb, stribeck
        self._curved = np.isfinite(no_load)
        self._knee = np.where(self._curved, knee, 0.0)
        self._no_load = np.where(self._curved, no_load, 1.0)
        physics.on_change(self._rebind)

    def _rebind(self) -> None:
        model = self._physics.model
        self._joints = np.array([model.joint(name).id for name in self._laws], dtype=np.int64)
        self._dofs = model.jnt_dofadr[self._joints]

    def refresh_joint_parameters(self) -> None:
        """Take over the dry friction of joints without a law of it, changed in the model."""
        self._friction = np.where(
            self._stribeck, self._friction, self._physics.model.dof_frictionloss[self._dofs])

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Change the model to what the present velocities give; the next step starts with it."""
        velocity = data.qvel[self._dofs]
        speed = np.abs(velocity)
        model.dof_frictionloss[self._dofs] = np.where(
            self._stribeck, self._coulomb + self._excess / (1.0 + (speed / self._scale)**2),
            self._friction)
        left = np.where(self._curved, np.clip(
            (self._no_load - speed) / (self._no_load - self._knee), 0.0, 1.0), 1.0)
        moves = np.stack([velocity < 0.0, velocity > 0.0], axis=1)
        model.jnt_actfrcrange[self._joints] = self._limits * np.where(moves, left[:, None], 1.0)


class FloatingBases:
    """
    The weight of compensated links, given back to the joints of free robots that carry it.

    :param physics: of the world
    :param roots: names of the root bodies of the robots
    :ivar roots: the same; robots that come or go have to change it before the model is replaced
    :ivar dofs: degrees of freedom with weight to give back, shape (k,)
    """

    dofs: IntArray

    def __init__(self, physics: Physics, roots: Iterable[str]) -> None:
        self._physics, self.roots = physics, tuple(roots)
        physics.on_change(self._rebind)

    def _rebind(self) -> None:
        model, roots = self._physics.model, self.roots
        free_trees = {int(model.body_rootid[body]) for body in model.jnt_bodyid[
            model.jnt_type == _FREE]} & {int(model.body(root).id) for root in roots}
        joint = model.dof_jntid
        self.dofs = np.flatnonzero(
            np.isin(model.body_rootid[model.dof_bodyid], list(free_trees))
            & (model.jnt_actgravcomp[joint] == 0))

    def apply(self) -> None:
        """Apply the weight as of the last ``mj_forward`` or step."""
        data = self._physics.data
        data.qfrc_applied[self.dofs] = -data.qfrc_gravcomp[self.dofs]
