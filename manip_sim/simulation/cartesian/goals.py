# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Turn Cartesian commands into targets, at the moment when they take effect."""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.algebra import product
from manip_sim.simulation.cartesian.commands import (
    CartesianCommand, CartesianPose, CartesianTwist, PoseAction)
from manip_sim.simulation.cartesian.frames import Frame, rotation_of_vector, WORLD
from manip_sim.simulation.cartesian.hands import Hand
from manip_sim.simulation.cartesian.targets import Target

#: How far an action of 1 moves and turns the goal [m], [rad]; robosuite's defaults for OSC_POSE.
_ACTION_STEP, _ACTION_TURN = 0.05, 0.5


def target_of(command: CartesianCommand, hand: Hand, model: mujoco.MjModel, data: mujoco.MjData,
              before: Target | None, until_s: float) -> Target:
    """
    Return the target of a command.

    :param hand: the hand that the target is for
    :param model: the ``mujoco.MjModel``
    :param data: the ``mujoco.MjData`` after ``mj_forward``
    :param before: the target that a stream of twists has moved until now, or None
    :param until_s: simulation time when a twist ends [s]
    """
    if isinstance(command, CartesianPose):
        origin, turned = command.frame.pose(data)
        anchor = Frame(WORLD, 0) if _moves(hand, command.frame, model) else command.frame
        return Target.at(anchor, origin + product(turned, command.position),
                         product(turned, command.rotation), data)
    position, rotation = hand.tip.pose(data)
    if isinstance(command, PoseAction):
        _, axes = hand.origin.pose(data)
        turn = rotation_of_vector(product(axes, _ACTION_TURN * command.action[3:]))
        return Target.at(hand.origin, position + product(axes, _ACTION_STEP * command.action[:3]),
                         product(turn, rotation), data)
    assert isinstance(command, CartesianTwist)
    if before is not None:
        position, rotation = before.goal(data)
    target = Target.at(hand.origin, position, rotation, data)
    target.axes, target.twist, target.until_s = command.frame, command.twist, until_s
    return target


def _moves(hand: Hand, frame: Frame, model: mujoco.MjModel) -> bool:
    """Return whether an arm moves a frame."""
    own = set(model.jnt_bodyid[np.isin(model.jnt_qposadr, hand.qpos)].tolist())
    body = frame.body
    while body and body not in own:
        body = int(model.body_parentid[body])
    return body != 0
