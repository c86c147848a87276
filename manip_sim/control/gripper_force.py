# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Limit the force of a gripper's actuators for one command, and remove the limit again."""

from __future__ import annotations

import numpy as np

from manip_sim.control.gripper_actuators import GripperActuators
from manip_sim.physics.physics import Physics


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
