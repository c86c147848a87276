# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Kinds of actions of an episode: poses of end effectors, or goals of joints in SI units."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, product, rotation_vector
from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_commands import PoseAction
from manip_sim.control.cartesian.kinematic_chains import find_chains, KinematicChain
from manip_sim.control.commands import Command, GripperAction
from manip_sim.control.modes import MODES
from manip_sim.errors import UnknownNameError
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.validation import finite_command_numbers

#: Kinds of actions: robosuite's OSC_POSE, or a goal for each joint.
ACTIONS = ('osc_pose', 'joint_position', 'joint_velocity', 'joint_effort')
#: Way [m] and angle [rad] of the goal of an end effector for an action of 1.
STEP_M, TURN_RAD = 0.05, 0.5
#: The six numbers of an end effector: along and about the axes.
_AXES = ('x', 'y', 'z', 'rx', 'ry', 'rz')
#: Unit of the number of a gripper: from open to closed is 2.
_STROKE = 'half stroke'
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True)
class ArmAction:
    """
    The part of an action that is for one arm.

    :ivar arm: ``right`` or ``left``
    :ivar names: what its goals are
    :ivar goals: where they are
    :ivar gripper: where the number of the gripper is; empty if nothing in it moves
    :ivar fingers: part and actuators of the gripper
    :ivar joints: parts and joints of the arm
    """

    robot: SimulatedRobot
    arm: str
    chain: KinematicChain
    names: Sequence[str]
    goals: slice
    gripper: slice
    fingers: tuple[frozenset[str], IntArray]
    joints: tuple[frozenset[str], IntArray]

    @property
    def dof(self) -> int:
        """Length of an action of the gripper."""
        return self.robot.grippers[f'{self.arm}/gripper'].dof

    def close(self, number: FloatArray) -> GripperAction:
        """
        Return the command for the gripper.

        :param number: in [-1, 1], shape (1,)
        """
        parts, indices = self.fingers
        return GripperAction(robot=self.robot.robot_model, parts=parts, indices=indices,
                             action=np.repeat(number, self.dof))


class Actions(ABC):
    """
    Meaning of the numbers of an action, and their effect.

    For each arm with a gripper, by robot and arm, these are its goals, then one number for its
    gripper in [-1, 1], +1 closes; a gripper in which nothing moves has none.

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
                names, part = self._names_of(robot, arm), f'{arm}/gripper'
                goals = slice(self.size, self.size + len(names))
                gripper = slice(goals.stop, goals.stop + (robot.grippers[part].dof > 0))
                indices = robot.joints.indices_of(arm)
                self.arms.append(ArmAction(
                    robot, arm, chain, names, goals, gripper,
                    (frozenset([part]), robot.grippers[part].indices),
                    (robot.joints.parts_of(indices), indices)))
                self.size = gripper.stop

    @abstractmethod
    def _names_of(self, robot: SimulatedRobot, arm: str) -> Sequence[str]:
        """Return what the goals of an arm are."""

    @abstractmethod
    def _command(self, item: ArmAction, goals: FloatArray, inside: FloatArray) -> Command:
        """Return the command of an arm, of numbers, and of the same within [-1, 1]."""

    @property
    def names(self) -> list[str]:
        """Names of the numbers of an action, in order."""
        return [name for item in self.arms for name in (
            *item.names, *[f'{item.robot.name}/{item.arm}/gripper'] * (
                item.gripper.stop - item.gripper.start))]

    @abstractmethod
    def _units_of(self, item: ArmAction) -> Sequence[str]:
        """Return the units of the goals of an arm."""

    @property
    def units(self) -> list[str]:
        """Units of the numbers of an action, in order; ``0.05 m`` if 1 is 0.05 m."""
        return [unit for item in self.arms for unit in (
            *self._units_of(item), *[_STROKE] * (item.gripper.stop - item.gripper.start))]

    @property
    def bounds(self) -> FloatArray:
        """Lowest and highest value of each number, shape (size, 2)."""
        return np.tile([-1.0, 1.0], (self.size, 1))

    def checked(self, action: ArrayLike, noun: str = 'an action') -> FloatArray:
        """
        Return an action as numbers, a copy.

        :param action: shape (size,)
        :param noun: it is, for the message
        :raises CommandError: if the length is wrong or a number is not finite
        """
        return finite_command_numbers(action, self.size, noun)

    def apply(self, action: FloatArray, period_s: float, delay_steps: int = 0) -> None:
        """
        Let an action take effect with the next control period.

        :param action: as :meth:`checked` returns it; numbers beyond the bounds are clamped
        :param period_s: length of the control period [s]
        :param delay_steps: timesteps after which it takes effect
        """
        inside = np.minimum(np.maximum(action, -1.0), 1.0)
        for item in self.arms:
            commands = [self._command(item, action[item.goals], inside[item.goals])]
            if item.gripper.start < item.gripper.stop:
                commands.append(item.close(inside[item.gripper]))
            item.robot.apply(*commands, period_s=period_s, delay_steps=delay_steps)


class PoseActions(Actions):
    """
    Actions in [-1, 1] for the end effectors of arms.

    The goals of each are x, y, z and a rotation vector, as for ``parse_cartesian.action``.

    :param simulation: whose robots they move
    """

    def _names_of(self, robot: SimulatedRobot, arm: str) -> Sequence[str]:
        return [f'{robot.name}/{arm}/{axis}' for axis in _AXES]

    def _units_of(self, item: ArmAction) -> Sequence[str]:
        return [*[f'{STEP_M:g} m'] * 3, *[f'{TURN_RAD:g} rad'] * 3]

    def _command(self, item: ArmAction, goals: FloatArray, inside: FloatArray) -> Command:
        # All worlds were checked and clamped at once: parsers would take 54 us and more, not 37,
        # of 680 us of an environment's step.
        parts, indices = item.joints
        return PoseAction(robot=item.robot.robot_model, parts=parts, indices=indices,
                          arm=item.arm, action=inside)

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
        turn = product(axes.T, rotation_vector(product(rotation, turned.T))) / TURN_RAD
        return np.concatenate([_shortened(way, min(1.0, longest_m / STEP_M)),
                               _shortened(turn, 1.0)])


def _shortened(vector: FloatArray, longest: float) -> FloatArray:
    """Return a vector, shortened to a limit if it is longer."""
    size = length(vector)
    return vector if size <= longest else vector * (longest / size)


class JointActions(Actions):
    """
    Actions in SI units for the joints of arms.

    :param simulation: whose robots they move; the control mode of their arms is changed
    :param mode: ``position`` [rad], ``velocity`` [rad/s] or ``effort`` [N m]
    """

    def __init__(self, simulation: Simulation, mode: str) -> None:
        super().__init__(simulation)
        self.mode = mode
        for item in self.arms:
            item.robot.set_control_mode(item.arm, mode)
            # As in a node, whose timeout would follow the mode: states hold that it was set.
            item.robot.set_command_timeout(item.arm, 0.0)

    def _names_of(self, robot: SimulatedRobot, arm: str) -> Sequence[str]:
        return [robot.joints.names[index] for index in robot.joints.indices_of(arm)]

    def _units_of(self, item: ArmAction) -> Sequence[str]:
        model = self._simulation.model
        return [MODES[self.mode].units[int(model.joint(name).type[0]) == _SLIDE]
                for name in item.names]

    def _command(self, item: ArmAction, goals: FloatArray, inside: FloatArray) -> Command:
        command, = item.robot.parse.joint_command(
            item.names, **{self.mode: goals}, part=item.arm)
        return command

    @property
    def bounds(self) -> FloatArray:
        """Ranges of the joints in the mode, and [-1, 1] for grippers, shape (size, 2)."""
        bounds = super().bounds
        for item in self.arms:
            bounds[item.goals] = item.robot.limits(item.arm)
        return bounds


def create_actions(kind: str, simulation: Simulation) -> Actions:
    """
    Return what actions of a kind do, and set the control modes of arms that they need.

    :param kind: one of :data:`ACTIONS`
    :raises UnknownNameError: if the kind is unknown
    """
    if kind not in ACTIONS:
        raise UnknownNameError('action', kind, ACTIONS)
    if kind == 'osc_pose':
        return PoseActions(simulation)
    return JointActions(simulation, kind.removeprefix('joint_'))
