# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What was inferred of a robot's file, in the form of the YAML file that describes it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.files.robot_plan import RobotPlan


def described_plan(plan: RobotPlan, ranges: Mapping[str, FloatArray]) -> dict[str, Any]:
    """
    Return the description of a robot with all that was inferred, so that nothing is left to infer.

    :param ranges: of the joints, by name in the file [rad or m], shape (2,)
    :returns: the keys of a robot's YAML file beside the model
    """
    given = plan.description.model_dump(exclude_unset=True)
    arms = {side: _arm(plan, side) for side in plan.ends}
    return {**given, 'model': plan.file.name, 'arms': arms or 'none',
            'subsystems': {**dict(plan.subsystems), **given.get('subsystems', {})},
            'start': {
                joint: at if joint not in ranges else float(np.clip(at, *ranges[joint]))
                for joint, at in plan.start.items()}}


def _arm(plan: RobotPlan, side: str) -> dict[str, Any]:
    declared = plan.description.arm(side)
    given = {} if declared is None else declared.model_dump(exclude_unset=True)
    found = {**given, 'mount': given.get('mount', plan.arms[side].name)}
    hand = plan.hands.get(side)
    if hand is None:
        return {**found, 'hand': 'none'}
    own = given.get('hand')
    return {**found, 'hand': {
        **(own if isinstance(own, dict) else {}), 'body': hand.body,
        'grasp_point': hand.grasp_point.model_dump(), 'closing': hand.closing}}
