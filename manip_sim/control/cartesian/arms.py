# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The joints of arms as the compiled law reads them."""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.law.arm_records import Arm, CHAIN
from manip_sim.control.law.joint_records import readable
from manip_sim.control.servos import Servos
from manip_sim.derived import Derived
from manip_sim.physics.physics import Physics, places_of_inertia
from manip_sim.physics.robot_frames import Frame


class Arms:
    """
    The joints of the arms of a robot, which are looked up once.

    :param physics: of the world
    :param servos: of all driven joints
    """

    def __init__(self, physics: Physics, servos: Servos) -> None:
        self._physics, self._servos, self._derived = physics, servos, Derived()
        self._low, self._high = servos.position_clamp().T
        physics.on_change(self.refresh_joint_parameters)  # They may have other addresses.

    def refresh_joint_parameters(self) -> None:
        """Take over addresses and damping of the joints, which were changed."""
        self._derived.of.clear()

    def arm(self, tip: Frame | None, indices: IntArray) -> Arm:
        """
        Return the joints of an arm as the compiled law reads them.

        :param tip: frame of the end effector; None if there is none, which no joint moves then
        :param indices: of the joints, shape (n,)
        """
        key = tip and tip.name, indices.tobytes()
        cached: tuple[FloatArray, Arm] | None = self._derived.of.get(key)
        if cached is None or cached[0] is not self._servos.passive_damping:
            # That of a restored state is another one.
            cached = self._derived.of[key] = (
                self._servos.passive_damping, self._make_arm(tip, indices))
        return cached[1]

    def _make_arm(self, tip: Frame | None, indices: IntArray) -> Arm:
        servos, model, dofs = self._servos, self._physics.model, self._servos.dofs[indices]
        efforts, joints = servos.ranges['effort'][indices], np.zeros(len(indices), CHAIN)
        moves = np.zeros(len(dofs), bool) if tip is None else _moving(model, tip.body)[dofs]
        for field, values in (
                ('joint', indices), ('qpos', servos.qpos[indices]), ('dof', dofs),
                ('moves', moves), ('low', self._low[indices]),
                ('high', self._high[indices]), ('velocity_limit', servos.velocity_limit[indices]),
                ('cruising_velocity', servos.cruising_velocity[indices]),
                ('acceleration_limit', servos.acceleration_limit[indices]),
                ('weakest', efforts[:, 0]), ('strongest', efforts[:, 1]),
                ('damping', servos.passive_damping[indices]), ('turn', servos.turn[indices])):
            joints[field] = values
        return Arm(readable(joints), places_of_inertia(model, dofs),
                   0 if tip is None else int(model.body_rootid[tip.body]))


def _moving(model: mujoco.MjModel, body: int) -> BoolArray:
    """Return which degrees of freedom move a body, shape (nv,)."""
    bodies = {body}
    while body:
        body = int(model.body_parentid[body])
        bodies.add(body)
    return np.isin(model.dof_bodyid, list(bodies))
