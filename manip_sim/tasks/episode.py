# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An episode of a task in a simulation: its start, its control periods and its end."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.errors import ModelError
from manip_sim.models.initialization_noise import checked_seed
from manip_sim.simulation import Simulation
from manip_sim.tasks.expert import Policy
from manip_sim.tasks.pose_actions import PoseActions
from manip_sim.tasks.task import Task

#: Share of a timestep by which a control period may miss a whole number of them.
_ROUNDING = 1e-6


class Episode:
    """
    Episodes of a task, one after the other.

    :param task: what is done
    :param simulation: of the task's world
    :param period_s: length of a control period [s], a whole number of timesteps
    :raises ModelError: if it is not
    :ivar actions: what :meth:`step` takes
    :ivar periods: control periods since the last reset
    """

    def __init__(self, task: Task, simulation: Simulation, period_s: float = 0.05) -> None:
        self.task = task
        self.simulation = simulation
        steps = period_s / simulation.timestep_s
        self._steps = max(1, round(steps)) if np.isfinite(steps) else 0
        if not abs(steps - self._steps) <= _ROUNDING:  # NaN too.
            raise ModelError(f'a control period must be a whole number of timesteps of '
                             f'{simulation.timestep_s:g} s, got {period_s:g} s')
        self.period_s = period_s
        self.actions = PoseActions(simulation)
        self.periods = 0

    def reset(self, seed: int) -> None:
        """
        Begin the episode of a seed.

        :param seed: draws the start; the same for the same seed, in any process
        :raises ModelError: if it is no whole number from 0
        """
        start(self.task, self.simulation, seed)
        self.periods = 0

    def step(self, action: ArrayLike) -> None:
        """
        Apply an action and advance by one control period.

        :param action: as for :class:`PoseActions`
        :raises CommandError: if it cannot be used; then nothing changes
        :raises DivergenceError: if the physics diverges
        """
        self.actions.apply(action, self.period_s)
        self.advance()

    def advance(self) -> None:
        """
        Advance by one control period, with the commands that were applied to the robots.

        :raises DivergenceError: if the physics diverges
        """
        self.simulation.advance(self._steps)
        self.periods += 1
        self.task.end_period(self.simulation)

    def run(self, policy: Policy, seed: int) -> bool:
        """
        Run the episode of a seed, and return whether it succeeds.

        :param policy: gets the episode itself as its observation
        :param seed: as for :meth:`reset`
        :raises CommandError: if an action cannot be used
        :raises DivergenceError: if the physics diverges
        """
        self.reset(seed)
        policy.reset(seed)
        while not self.over:
            self.step(policy.act(self))
        return self.success

    @property
    def success(self) -> bool:
        """Whether the task is done at present."""
        return self.task.success(self.simulation)

    @property
    def reward(self) -> float:
        """The reward of the present instant."""
        return self.task.reward(self.simulation)

    @property
    def time_is_up(self) -> bool:
        """Whether the horizon of the task has been reached."""
        return self.periods * self.period_s > self.task.horizon_s - _ROUNDING

    @property
    def over(self) -> bool:
        """Whether the task is done, or its time is up."""
        return self.time_is_up or self.success

    @property
    def digest(self) -> str:
        """Of the present state, as ``Simulation.digest`` gives it."""
        return self.simulation.digest()


def start(task: Task, simulation: Simulation, seed: int) -> None:
    """
    Reset a simulation to the start that a seed draws.

    :param task: whose start it is
    :param simulation: of the world of the task
    :param seed: a whole number from 0
    :raises ModelError: if it is not
    """
    seed = checked_seed(seed)
    simulation.reset(seed)
    task.start(simulation, np.random.default_rng(seed))
    simulation.forward()
