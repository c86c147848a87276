# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The grippers of the catalogue; their numbers are in ``assets/grippers``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.gripper_model import ActionRule, GripperModel
from manip_sim.models.mjcf import CatalogueModel, FromYaml


class _Speed:
    def __get__(self, gripper: object, owner: Any) -> float:
        return float(owner._action.get('speed', 0.0))


class CatalogueGripper(CatalogueModel, GripperModel, registered=False):
    """
    A gripper from ``assets/grippers``; ``part.yaml`` says what its actions mean.

    Keys of an action: ``numbers``, its length, by default one for each actuator; ``speed``, the
    change of the command in one call; ``closing``, the direction of the change by command;
    ``proportional``, whether the magnitude counts or the sign alone; ``steps``, whether actions
    are changes or commands; ``actuators``, how many follow each command; ``still``, commands of
    the last actuators, which stay.

    :param idn: number or word in the prefix ``gripper{idn}_``
    """

    _kind = 'grippers'
    _important_geoms = FromYaml('fingers', {})
    _start = FromYaml('start', {})
    _cups = FromYaml('cups', ())
    _action: Any = FromYaml('action', {'steps': False})
    _each_action = FromYaml('each_action', {})
    speed = _Speed()

    def __init__(self, idn: int | str = 0) -> None:
        self._important_geoms = {**GripperModel._important_geoms, **self._important_geoms}
        super().__init__(idn=idn)

    @property
    def dof(self) -> int:
        """Length of the actions that :meth:`format_action` takes."""
        return int(self._action.get('numbers', super().dof))

    @property
    def init_qpos(self) -> FloatArray | None:
        """Start of the joints in the order of the file [rad or m], shape (n,), a copy, or None."""
        if not self._joints:
            return None
        return np.array([self._start.get(joint, 0.0) for joint in self._joints])

    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Map an action to actuator commands; where it moves by steps, one call is one step.

        :param action: closes above 0, opens below; shape (dof,)
        :returns: commands in [-1, 1], in the order of :attr:`actuators`, shape (nu,), a copy
        :raises CommandError: if the length is wrong or a number is not finite
        """
        rule = self._rule
        commands = self._checked(action)[rule.numbers]
        if rule.steps.size:
            commands = self._integrate(rule.steps * (
                commands if rule.proportional[0] else np.sign(commands)))
        return np.where(rule.sources < 0, rule.still, np.append(commands, 0.0)[rule.sources])

    def start_at(self, command: ArrayLike) -> None:
        """
        Make :meth:`format_action` continue from an actuator command, where it moves by steps.

        :param command: commands in [-1, 1], one for each actuator; of several that follow the
            same number, the first counts
        """
        rule = self._rule
        if rule.steps.size:
            self.current_action = np.zeros(len(rule.steps))
            follows = np.flatnonzero(rule.sources >= 0)[::-1]
            self.current_action[rule.sources[follows]] = np.asarray(command)[follows]

    @property
    def action_rule(self) -> ActionRule | None:
        """The meaning of actions, unless a subclass or an attribute has given them another."""
        changed = any(name in vars(self) or getattr(type(self), name) is not getattr(
            CatalogueGripper, name) for name in ('format_action', 'start_at'))
        return None if changed else self._rule

    @property
    def _rule(self) -> ActionRule:
        law = self._action
        moves = law.get('steps', True)
        closing = np.array(law.get('closing', [1.0]), dtype=float)
        count = max(self.dof, len(closing)) if moves and self.dof else self.dof
        sources = np.repeat(np.arange(count), law.get('actuators', [1]))
        still = np.array(law.get('still', []), dtype=float)
        return ActionRule(
            np.arange(count) % max(self.dof, 1),
            np.broadcast_to(closing, count) * self.speed if moves else np.zeros(0),
            np.array([bool(law.get('proportional'))]),
            np.append(sources, np.full(len(still), -1)),
            np.append(np.zeros(len(sources)), still))


class FourierLeftHand(CatalogueGripper, folder='fourier_left_hand'):
    """Left hand of the GR-1, with eleven joints and six motors."""


class FourierRightHand(CatalogueGripper, folder='fourier_right_hand'):
    """Right hand of the GR-1, the mirror image of the left one."""


class JacoThreeFingerGripper(CatalogueGripper, folder='jaco_three_finger_gripper'):
    """Kinova hand that opens and closes."""


class JacoThreeFingerDexterousGripper(JacoThreeFingerGripper):
    """Kinova hand that opens and closes each finger."""

    _action = FromYaml('each_action', {})


class NullGripper(CatalogueGripper, folder='null_gripper'):
    """A grasp frame and a force-torque sensor, without mass and without shape."""


class PalGripper(CatalogueGripper, folder='pal_gripper'):
    """Two fingers of PAL Robotics, each with a motor of its own, 90 mm stroke."""


class PandaGripper(CatalogueGripper, folder='panda_gripper'):
    """Franka hand that opens and closes."""


class RethinkGripper(CatalogueGripper, folder='rethink_gripper'):
    """Rethink gripper that opens and closes."""


class Robotiq140Gripper(CatalogueGripper, folder='robotiq_140_gripper'):
    """Robotiq 2F-140 that opens and closes."""


class Robotiq85Gripper(CatalogueGripper, folder='robotiq_85_gripper'):
    """Robotiq 2F-85 that opens and closes."""


class RobotiqThreeFingerGripper(CatalogueGripper, folder='robotiq_three_finger_gripper'):
    """Robotiq gripper that opens and closes all fingers, fingers 1 and 2 side by side."""


class RobotiqThreeFingerDexterousGripper(RobotiqThreeFingerGripper):
    """Robotiq gripper whose three fingers and scissor move by steps, one by one."""

    _action = FromYaml('each_action', {})


class SO101Gripper(CatalogueGripper, folder='so101_gripper'):
    """Jaw of the SO-101 that closes on a fixed one."""


class VacuumGripper(CatalogueGripper, folder='vacuum_gripper'):
    """One suction cup of 40 mm on an OnRobot VGC10, which holds what its whole lip touches."""


class WipingGripper(CatalogueGripper, folder='wiping_gripper'):
    """Eraser with a touch sensor at each corner of its wiping surface."""
