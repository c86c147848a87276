# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What an episode's actions mean: poses of hands, or goals of joints in SI units."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import UnknownNameError
from manip_sim.simulation import Simulation
from manip_sim.simulation.numbers import finite_numbers
from manip_sim.tasks.pose_actions import ArmAction, close, gripper_name, PoseActions

#: What an action may be: robosuite's OSC_POSE, or a goal for each joint.
ACTIONS = ('osc_pose', 'joint_position', 'joint_velocity', 'joint_effort')


class Actions(Protocol):
    """
    What the numbers of an action are, and how they take effect.

    :ivar size: length of an action
    """

    size: int

    @property
    def names(self) -> list[str]:
        """What each number is."""

    @property
    def bounds(self) -> FloatArray:
        """Lowest and highest value of each number, shape (size, 2)."""

    def apply(self, action: ArrayLike, period_s: float) -> None:
        """
        Let an action take effect with the next control period.

        :param action: shape (size,); numbers beyond the bounds are clamped
        :param period_s: length of the control period [s]
        :raises CommandError: if the length is wrong or a number is not finite; then nothing
            changes
        """


def create_actions(kind: str, simulation: Simulation) -> Actions:
    """
    Return what actions of a kind do, and set the control modes of arms that they need.

    :param kind: one of :data:`ACTIONS`
    :raises UnknownNameError: if there is no such kind
    """
    if kind not in ACTIONS:
        raise UnknownNameError('action', kind, ACTIONS)
    if kind == 'osc_pose':
        return PoseActions(simulation)
    return JointActions(simulation, kind.removeprefix('joint_'))


class JointActions:
    """
    Actions in SI units for the joints of all arms with grippers, by robot and arm.

    For each arm these are the goals of its joints, then one number for its gripper in [-1, 1],
    +1 closes; a gripper in which nothing moves has none.

    :param simulation: whose robots they move; the control mode of their arms is changed
    :param mode: ``position`` [rad], ``velocity`` [rad/s] or ``effort`` [N m]
    :ivar arms: of each arm, the names of its joints, and where their goals and the gripper's are
    """

    def __init__(self, simulation: Simulation, mode: str) -> None:
        self.mode = mode
        self.arms: list[tuple[ArmAction, list[str], slice, slice]] = []
        self.size = 0
        for item in PoseActions(simulation).arms:
            item.robot.set_control_mode(item.arm, mode)
            joints = item.robot.joints
            names = [joints.names[index] for index in joints.indices_of(item.arm)]
            goals = slice(self.size, self.size + len(names))
            gripper = slice(goals.stop, goals.stop + item.gripper.stop - item.gripper.start)
            self.arms.append((item, names, goals, gripper))
            self.size = gripper.stop

    @property
    def names(self) -> list[str]:
        """Names of the joints, and those of the grippers' parts, in the order of an action."""
        return [name for item, names, _, gripper in self.arms for name in (
            *names, *[gripper_name(item)] * (gripper.stop - gripper.start))]

    @property
    def bounds(self) -> FloatArray:
        """Ranges of the joints in the mode, and [-1, 1] for grippers, shape (size, 2)."""
        found = np.tile([-1.0, 1.0], (self.size, 1))
        for item, _, goals, _ in self.arms:
            found[goals] = item.robot.limits(item.arm)
        return found

    def apply(self, action: ArrayLike, period_s: float) -> None:
        """Let an action take effect with the next control period."""
        numbers = finite_numbers(action, self.size, 'an action')
        for item, names, goals, gripper in self.arms:
            item.robot.apply(*item.robot.parse.joint_command(
                names, **{self.mode: numbers[goals]}, part=item.arm), period_s=period_s)
            close(item, numbers[gripper], period_s)
