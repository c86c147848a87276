# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Goals of actions: a command that is watched until it has ended, one way or the other."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any

from manip_sim.errors import CommandError
from manip_sim.simulation.commands import Command, CommandHandle, Status
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.simulation import Simulation

#: What took joints or a gripper from a goal, where nothing else is known of it.
_NEWER = 'a newer command has taken over'


class Ending(Enum):
    """How a goal has ended, as actions of ROS 2 know it."""

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
    A goal is rejected.

    :ivar code: why
    """

    def __init__(self, code: GoalCode, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class Outcome:
    """
    How a goal has ended.

    :ivar ending: whether it has succeeded, was aborted or canceled
    :ivar code: for FollowJointTrajectory
    :ivar reason: in words
    """

    ending: Ending
    code: GoalCode
    reason: str


class Goal(ABC):
    """
    A command that is watched; used in the simulation's thread only, but for what it tells.

    :param robot: that is commanded
    :param command: what it shall do
    :ivar robot: that is commanded
    :ivar command: what it shall do
    :ivar outcome: how it has ended, or None; the first word counts
    :ivar view: what can be told of the way so far, or None; never changed, only replaced
    """

    def __init__(self, robot: SimulatedRobot, command: Command) -> None:
        self.robot = robot
        self.command = command
        self.outcome: Outcome | None = None
        self.view: Any = None

    @property
    def busy_parts(self) -> frozenset[str]:
        """The atomic parts that the goal commands while it has not ended."""
        return self.command.parts if self.outcome is None else frozenset()

    def check(self, simulation: Simulation) -> None:
        """
        See whether the goal has ended; to be called at the end of each control period.

        :param simulation: at that instant
        """
        handle = self.command.handle
        if self.outcome is not None:
            return
        self._look(simulation)
        if simulation.diverged is not None:
            self.abort(simulation.diverged)
        elif handle.status is Status.WAITING:
            return
        elif handle.status in (Status.ABORTED, Status.REPLACED):
            self.abort(handle.reason or _NEWER)
        else:
            rival = self._rival()
            if rival is None:
                self._judge(simulation)
            else:
                self.abort(rival.reason or _NEWER)

    def abort(self, reason: str, code: GoalCode = GoalCode.INVALID_GOAL) -> None:
        """End the goal without success; what is still its own comes to rest."""
        self._give_up(Outcome(Ending.ABORTED, code, reason))

    def cancel(self) -> bool:
        """
        End the goal because its client wants so; what is still its own comes to rest.

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
        """Take note of an instant."""

    @abstractmethod
    def _rival(self) -> CommandHandle | None:
        """Return what took something from the command, or None."""

    @abstractmethod
    def _judge(self, simulation: Simulation) -> None:
        """Compare what happens to what shall happen, and end the goal if it is time."""
