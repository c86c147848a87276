# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Watch the goals of actions in the simulation's thread, and report those that have ended."""

from __future__ import annotations

from collections.abc import Callable
import threading

from manip_sim.errors import SimulationEnded
from manip_sim.runtime.action_goals import Ending, ActionGoal
from manip_sim.runtime.simulation_thread import SimulationThread
from manip_sim.simulation import Simulation


class GoalTracker:
    """
    Goals that have not ended.

    In lock-step each counts as the command of its parts until it has ended, so that a client that
    waits for the result does not have to command them too.

    :param thread: runs the simulation; any number of trackers may observe it
    :param simulation: is used in its thread only
    :param ended: is called in the simulation's thread, with each goal that has ended
    :ivar goals: those that have not ended, oldest first
    """

    def __init__(self, thread: SimulationThread, simulation: Simulation,
                 ended: Callable[[ActionGoal], None]) -> None:
        self._thread, self._simulation = thread, simulation
        self._ended = ended
        self._lock = threading.Lock()
        self.goals: tuple[ActionGoal, ...] = ()
        thread.observe(self.observe, look=lambda: bool(self.goals))
        thread.changes.commands.keep_busy(self.busy_parts)

    def busy_parts(self, robot: str) -> frozenset[str]:
        """Return the atomic parts of a robot that goals command."""
        return frozenset().union(*(goal.busy_parts for goal in self.goals
                                   if goal.robot.name == robot))

    def start(self, goal: ActionGoal) -> None:
        """Submit the command of a goal and watch it from now on."""
        with self._lock:
            self.goals = (*self.goals, goal)
        self._thread.observers.look_again()
        self._thread.submit([goal.command], robot=goal.robot.name)

    def cancel(self, goal: ActionGoal) -> bool:
        """
        End a goal at the request of its client.

        :returns: whether this ended it; False if it or the simulation had ended before
        """
        def cancel() -> bool:
            goal.look(self._simulation)
            cancelled = goal.cancel()
            self._sweep()
            return cancelled
        try:
            return self._thread.call(cancel)
        except SimulationEnded:
            return False

    def abort_all(self, reason: str, robot: str | None = None) -> None:
        """
        Abort all goals.

        :param robot: only those of this robot, given by its name; None: of all
        """
        def abort() -> None:
            for goal in self.goals:
                if robot in (None, goal.robot.name):
                    goal.look(self._simulation)
                    goal.abort(reason)
            self._sweep()
        self._thread.call(abort)

    def observe(self, simulation: Simulation) -> None:
        """Check which goals have ended; called in the simulation's thread."""
        if self.goals:
            for goal in self.goals:
                goal.check(simulation)
            self._sweep()

    def _sweep(self) -> None:
        with self._lock:
            ended = [goal for goal in self.goals if goal.outcome is not None]
            if ended:
                self.goals = tuple(goal for goal in self.goals if goal.outcome is None)
        for goal in ended:
            if goal.outcome is not None and goal.outcome.ending is not Ending.SUCCEEDED:
                self._thread.changes.journal.withdrawn(
                    goal.robot.name, goal.command, goal.outcome.reason)
            self._ended(goal)
