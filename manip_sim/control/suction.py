# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Suction cups, whose vacuum is lost as soon as a part of the lip touches nothing.

Dex-Net 3.0 (Mahler et al. 2018) too models a cup by eight points of its lip, all of which have to
touch: a pump of some litres a minute cannot keep a vacuum against a gap.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.physics.physics import Physics


class SuctionCups:
    """
    The suction cups of a gripper; their vacuum is the activation of their actuators.

    :param physics: of the world
    :param actuators: names of all actuators of the gripper
    :param cups: names of those that pull what a cup touches, each of a body whose shapes are a lip
    :ivar indices: of the cups among the actuators, shape (n,)
    """

    def __init__(self, physics: Physics, actuators: Sequence[str], cups: Sequence[str]) -> None:
        self._physics, self.names = physics, tuple(cups)
        self.indices: IntArray = np.array([actuators.index(cup) for cup in cups], dtype=np.int64)
        physics.on_change(self._find)

    def _find(self) -> None:
        model = self._physics.model
        ids = [int(model.actuator(name).id) for name in self.names]
        self._actuators: IntArray = np.array(ids, dtype=np.int64)
        self._activations: IntArray = model.actuator_actadr[ids].astype(np.int64)
        collides = (model.geom_contype | model.geom_conaffinity) != 0
        self._lips = [np.flatnonzero((model.geom_bodyid == body) & collides)
                      for body in model.actuator_trnid[ids, 0]]

    def draw(self, controls: FloatArray) -> bool:
        """
        Return whether a cup is to hold something.

        :param controls: of all actuators of the gripper
        """
        return bool((controls[self.indices] > 0.0).any())

    def held(self, data: mujoco.MjData) -> list[int]:
        """Return the id of the body that the whole lip of each cup touches, -1 where it leaks."""
        pairs = data.contact.geom
        return [self._held(pairs, lip) for lip in self._lips]

    def _held(self, pairs: IntArray, lip: IntArray) -> int:
        on_lip = np.isin(pairs, lip)
        touching = on_lip.any(axis=1) & (pairs >= 0).all(axis=1)
        points, others = pairs[touching][on_lip[touching]], pairs[touching][~on_lip[touching]]
        bodies = self._physics.model.geom_bodyid[others]
        return next((int(body) for body in np.unique(bodies)
                     if len(np.unique(points[bodies == body])) == len(lip)), -1)

    def vacuum(self, data: mujoco.MjData) -> FloatArray:
        """Return the vacuum in the cups, in the unit of their controls, shape (n,), a copy."""
        return np.array(data.act[self._activations])

    @property
    def full(self) -> FloatArray:
        """The full vacuum, in the unit of the controls, shape (n,), a copy."""
        return np.array(self._physics.model.actuator_ctrlrange[self._actuators, 1])

    def forces(self, data: mujoco.MjData) -> FloatArray:
        """Return the forces with which the cups pull [N], shape (n,), a copy."""
        return np.array(data.actuator_force[self._actuators])

    def controls(self, fraction: float, most_force: float) -> FloatArray:
        """
        Return the controls for a fraction of the full vacuum, shape (n,).

        :param fraction: in [0, 1]; 0 lets air in
        :param most_force: of each cup [N]; 0 for no other limit
        """
        model, control = self._physics.model, fraction * self.full
        if most_force:
            control = np.minimum(control, most_force / model.actuator_gainprm[self._actuators, 0])
        return np.where(control > 0.0, control, model.actuator_ctrlrange[self._actuators, 0])

    def lead(self, controls: FloatArray, lowest: FloatArray, data: mujoco.MjData) -> None:
        """
        Let air into the cups that leak: their vacuum is gone, and does not build up.

        :param controls: of all actuators of the gripper, changed in place
        :param lowest: of these controls
        """
        leaks = np.array(self.held(data)) < 0
        data.act[self._activations[leaks]] = 0.0
        controls[self.indices[leaks]] = lowest[self.indices[leaks]]
