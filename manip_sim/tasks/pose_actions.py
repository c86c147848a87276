# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The action of all arms of a world in one array: robosuite's OSC_POSE, with grippers."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, product
from manip_sim.arrays import FloatArray
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.simulation.cartesian.hands import find_hands, Hand
from manip_sim.simulation.numbers import finite_numbers

#: How far an action of 1 moves [m] and turns [rad] the goal of a hand.
STEP_M, TURN_RAD = 0.05, 0.5
#: The six numbers of a hand: along and about the axes.
_AXES = ('x', 'y', 'z', 'rx', 'ry', 'rz')


@dataclass(frozen=True)
class ArmAction:
    """
    The part of an action that is for one arm.

    :ivar arm: ``right`` or ``left``
    :ivar pose: where the six numbers of the hand are
    :ivar gripper: where the number of the gripper is; empty if nothing in it moves
    """

    robot: SimulatedRobot
    arm: str
    hand: Hand
    pose: slice
    gripper: slice


class PoseActions:
    """
    Actions in [-1, 1] for all arms with grippers, by robot and arm.

    For each arm these are x, y, z and a rotation vector, as for ``parse_cartesian.action``, then
    one number for its gripper, +1 closes; a gripper in which nothing moves has none.

    :param simulation: whose robots they move
    :ivar arms: the arms, in the order of the action
    :ivar size: length of an action
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.arms: list[ArmAction] = []
        self.size = 0
        for robot in simulation.robots.values():
            hands = find_hands(simulation.model, robot.robot_model, robot.parts,
                               robot.end_effectors)
            for arm, hand in hands.items():
                pose = slice(self.size, self.size + 6)
                gripper = slice(pose.stop, pose.stop + (robot.grippers[f'{arm}/gripper'].dof > 0))
                self.arms.append(ArmAction(robot, arm, hand, pose, gripper))
                self.size = gripper.stop

    @property
    def names(self) -> list[str]:
        """What each number is, in the order of an action."""
        return [name for item in self.arms for name in (
            *(f'{item.robot.name}/{item.arm}/{axis}' for axis in _AXES),
            *[gripper_name(item)] * (item.gripper.stop - item.gripper.start))]

    @property
    def bounds(self) -> FloatArray:
        """Lowest and highest value of each number, shape (size, 2)."""
        return np.tile([-1.0, 1.0], (self.size, 1))

    def apply(self, action: ArrayLike, period_s: float) -> None:
        """
        Let an action take effect with the next control period.

        :param action: in [-1, 1], shape (size,); numbers beyond are clamped
        :param period_s: length of the control period [s]
        :raises CommandError: if the length is wrong or a number is not finite; then nothing
            changes
        """
        numbers = finite_numbers(action, self.size, 'an action')
        for item in self.arms:
            item.robot.apply(item.robot.parse_cartesian.action(item.arm, numbers[item.pose]),
                             period_s=period_s)
            close(item, numbers[item.gripper], period_s)

    def towards(self, item: ArmAction, position: FloatArray, rotation: FloatArray,
                longest_m: float = STEP_M) -> FloatArray:
        """
        Return the six numbers that bring a hand to a pose, or as far as one action can.

        :param item: the arm
        :param position: of ``grip_site`` in ``world`` [m], shape (3,)
        :param rotation: of ``grip_site`` in ``world``, shape (3, 3)
        :param longest_m: how far ahead of the hand its goal may be [m]
        """
        data = self._simulation.data
        here, turned = item.hand.tip.pose(data)
        _, axes = item.hand.origin.pose(data)
        way = product(axes.T, position - here) / STEP_M
        turn = product(axes.T, _rotation_vector(product(rotation, turned.T))) / TURN_RAD
        return np.concatenate([_shortened(way, min(1.0, longest_m / STEP_M)),
                               _shortened(turn, 1.0)])


def gripper_name(item: ArmAction) -> str:
    """Return what the number for the gripper of an arm is called."""
    return f'{item.robot.name}/{item.arm}/gripper'


def close(item: ArmAction, closing: FloatArray, period_s: float) -> None:
    """
    Command the gripper of an arm.

    :param closing: from -1, open, to +1, shape (1,); empty if nothing in the gripper moves
    """
    if len(closing):
        part = f'{item.arm}/gripper'
        action = np.repeat(closing, item.robot.grippers[part].dof)
        item.robot.apply(item.robot.parse.action(part, action), period_s=period_s)


def _rotation_vector(rotation: FloatArray) -> FloatArray:
    quat, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(rotation).reshape(9))
    mujoco.mju_quat2Vel(vector, quat, 1.0)
    return vector


def _shortened(vector: FloatArray, longest: float) -> FloatArray:
    """Return a vector, or one in its direction that is no longer than a limit."""
    size = length(vector)
    return vector if size <= longest else vector * (longest / size)
