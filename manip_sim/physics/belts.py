# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Surfaces that move, such as belts: how fast is the control of an actuator."""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.physics.physics import Physics


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
