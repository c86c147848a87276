# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Actions of the episodes of many worlds, given to all of them at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from manip_sim.tasks.episode_actions import Actions, JointActions
from manip_sim.tasks.late_answers import LateAnswers
from manip_sim.worlds import Worlds


class BatchedActions:
    """
    The way of due actions to the worlds of episodes.

    :param worlds: of the episodes
    :param actions: of the first one
    :param period_s: length of a control period [s]
    """

    def __init__(self, worlds: Worlds, actions: Actions, period_s: float) -> None:
        self._worlds, self._actions, self._period_s = worlds, actions, period_s

    def begin_period(self, answers: Sequence[LateAnswers], indices: Sequence[int]) -> None:
        """
        Let due actions take effect within the next control period.

        :param answers: of all episodes
        :param indices: of the episodes that begin one
        :raises CommandError: if one cannot be carried out
        """
        numbers = np.zeros((len(answers), self._actions.size))
        where = np.zeros(len(answers), dtype=bool)
        for index in indices:
            due = answers[index].take_due()
            if len(due) == 1 and due[0][0] == 0:
                numbers[index], where[index] = due[0][1], True
            else:
                answers[index].apply(due)
        if where.any():
            self._apply(numbers, where)

    def _apply(self, numbers: NDArray[np.float64], where: NDArray[np.bool_]) -> None:
        """Let an action take effect in each of some worlds, as :meth:`Actions.apply` does."""
        inside = np.clip(numbers, -1.0, 1.0)
        for item in self._actions.arms:
            robot = self._worlds.robots[item.robot.name]
            if isinstance(self._actions, JointActions):
                robot.command.joint_command(
                    item.names, part=item.arm, where=where, period_s=self._period_s,
                    **{self._actions.mode: numbers[:, item.goals]})
            else:
                robot.command_cartesian.action(
                    item.arm, inside[:, item.goals], where=where, period_s=self._period_s)
            if item.gripper.start < item.gripper.stop:
                robot.command.action(
                    f'{item.arm}/gripper', np.repeat(inside[:, item.gripper], item.dof, axis=1),
                    where=where, period_s=self._period_s)
