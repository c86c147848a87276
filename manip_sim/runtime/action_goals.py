# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Goals of ROS actions: commands that are watched until they have ended."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any

from manip_sim.control.commands import Command, Status
from manip_sim.control.ledger import Ledger
from manip_sim.errors import CommandError
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.simulation import Simulation

#: Why a goal lost joints or a gripper, if no other reason is known.
_NEWER = 'a newer command has taken over'


class Ending(Enum):
    """How a goal has ended, in the terms of ROS 2 actions."""

    SUCCEEDED = 'succeeded'
    ABORTED = 'aborted'
    CANCELED = 'canceled'


class GoalCode(IntEnum):
    """The ``error_code`` of control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class GoalError(CommandError):
    """
    The rejection of a goal.

    :ivar code: the reason
    """

    def __init__(self, code: GoalCode, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class Outcome:
    """
    How a goal has ended.

    :ivar ending: whether it has succeeded, was aborted or canceled
    :ivar code: the ``error_code`` for FollowJointTrajectory
    :ivar reason: in words
    """

    ending: Ending
    code: GoalCode
    reason: str


class ActionGoal(ABC):
    """
    A command that the simulation's thread watches; any thread may read its outcome and view.

    :param robot: the robot that is commanded
    :param command: the command, not yet applied
    :param ledger: that it will be in
    :ivar robot: the robot that is commanded
    :ivar command: the command
    :ivar outcome: how it has ended, or None; set once
    :ivar view: progress for feedback, or None; replaced, never changed in place
    """

    def __init__(self, robot: SimulatedRobot, command: Command, ledger: Ledger) -> None:
        self.robot = robot
        self._ledger = ledger
        self.command = command
        self.outcome: Outcome | None = None
        self.view: Any = None

    @property
    def busy_parts(self) -> frozenset[str]:
        """The atomic parts that the goal commands while it has not ended."""
        return self.command.parts if self.outcome is None else frozenset()

    def check(self, simulation: Simulation) -> None:
        """
        Check whether the goal has ended; to be called at the end of each control period.

        :param simulation: at that instant
        """
        handle = self.command.handle
        if self.outcome is not None:
            return
        self._look(simulation)
        if handle.status in (Status.ABORTED, Status.REPLACED):
            self.abort(handle.reason or _NEWER)
        elif simulation.diverged is not None:
            self.abort(simulation.diverged)
        elif handle.status is not Status.WAITING:
            rival = self._ledger.rival(self.command)
            if rival is None:
                self._judge(simulation)
            else:
                self.abort(rival.reason or _NEWER)

    def look(self, simulation: Simulation) -> None:
        """Replace :attr:`view` by the present instant, unless the goal has ended."""
        if self.outcome is None:
            self._look(simulation)

    def abort(self, reason: str, code: GoalCode = GoalCode.INVALID_GOAL) -> None:
        """End the goal without success; joints or fingers that are still its own come to rest."""
        self._give_up(Outcome(Ending.ABORTED, code, reason))

    def cancel(self) -> bool:
        """
        End the goal for its client; joints or fingers that are still its own come to rest.

        :returns: whether it had not ended before
        """
        active = self.outcome is None
        self._give_up(Outcome(Ending.CANCELED, GoalCode.SUCCESSFUL, 'canceled by the client'))
        return active

    def _give_up(self, outcome: Outcome) -> None:
        if self.outcome is None:
            self.robot.withdraw(self.command, outcome.reason)
            self.outcome = outcome

    def _succeed(self, reason: str) -> None:
        self.outcome = Outcome(Ending.SUCCEEDED, GoalCode.SUCCESSFUL, reason)

    @abstractmethod
    def _look(self, simulation: Simulation) -> None:
        """Observe the present instant, and replace :attr:`view`."""

    @abstractmethod
    def _judge(self, simulation: Simulation) -> None:
        """Compare the present state with the goal, and end the goal if it is decided."""
