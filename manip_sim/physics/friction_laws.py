# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joint friction and torque limits that follow the velocity; which joints have them is given."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from manip_sim.errors import ModelError
from manip_sim.models.couplings import FrictionLaw
from manip_sim.physics.physics import Physics


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
