# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What an episode's actions mean: poses of end effectors, or goals of joints in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, product
from manip_sim.arrays import FloatArray
from manip_sim.clamping import finite_numbers
from manip_sim.control.cartesian.kinematic_chains import find_chains, KinematicChain
from manip_sim.errors import UnknownNameError
from manip_sim.simulation import SimulatedRobot, Simulation

#: What an action may be: robosuite's OSC_POSE, or a goal for each joint.
ACTIONS = ('osc_pose', 'joint_position', 'joint_velocity', 'joint_effort')
#: How far an action of 1 moves [m] and turns [rad] the goal of an end effector.
STEP_M, TURN_RAD = 0.05, 0.5
#: The six numbers of an end effector: along and about the axes.
_AXES = ('x', 'y', 'z', 'rx', 'ry', 'rz')


@dataclass(frozen=True)
class ArmAction:
    """
    The part of an action that is for one arm.

    :ivar arm: ``right`` or ``left``
    :ivar pose: where the six numbers of the end effector are
    :ivar gripper: where the number of the gripper is; empty if nothing in it moves
    """

    robot: SimulatedRobot
    arm: str
    chain: KinematicChain
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
            chains = find_chains(simulation.model, robot.robot_model, robot.parts,
                                 robot.end_effectors)
            for arm, chain in chains.items():
                pose = slice(self.size, self.size + 6)
                gripper = slice(pose.stop, pose.stop + (robot.grippers[f'{arm}/gripper'].dof > 0))
                self.arms.append(ArmAction(robot, arm, chain, pose, gripper))
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
        Return the six numbers that bring an end effector to a pose, or as far as one action can.

        :param item: the arm
        :param position: of ``grip_site`` in ``world`` [m], shape (3,)
        :param rotation: of ``grip_site`` in ``world``, shape (3, 3)
        :param longest_m: how far ahead of the end effector its goal may be [m]
        """
        data = self._simulation.data
        here, turned = item.chain.tip.pose(data)
        _, axes = item.chain.origin.pose(data)
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
