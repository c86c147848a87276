# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An episode of a task in a simulation: its start, its control periods and its end."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.initialization_noise import checked_seed
from manip_sim.simulation import Simulation
from manip_sim.simulation.numbers import finite_numbers
from manip_sim.tasks.expert import Expert, Policy
from manip_sim.tasks.joint_actions import create_actions
from manip_sim.tasks.latency import Latency, LatencyLike, NO_LATENCY, whole_steps
from manip_sim.tasks.observation import Observation, Observer
from manip_sim.tasks.pictures import Pictures
from manip_sim.tasks.task import Task


class Episode:
    """
    Episodes of a task, one after the other.

    :param task: what is done
    :param simulation: of the task's world
    :param period_s: length of a control period [s], a whole number of timesteps
    :param action: what actions mean, one of :data:`ACTIONS`
    :param latency: of commands and states, in simulated time, whole numbers of timesteps
    :param pictures: renders the images of observations; None for no images
    :raises ModelError: if a duration cannot be used
    :raises UnknownNameError: if there is no such kind of actions
    :ivar kind: what actions mean
    :ivar latency: of commands and states
    :ivar actions: what :meth:`step` takes
    :ivar observer: what :attr:`observation` is made of
    :ivar periods: control periods since the last reset
    """

    def __init__(self, task: Task, simulation: Simulation, period_s: float = 0.05,
                 action: str = 'osc_pose', latency: LatencyLike = NO_LATENCY,
                 pictures: Pictures | None = None) -> None:
        self.task = task
        self.simulation = simulation
        self.period_s = period_s
        self.kind = action
        self.latency = late = Latency.of(latency)
        timestep_s = simulation.timestep_s
        self._steps = whole_steps(period_s, timestep_s, 'a control period')
        if self._steps < 1:
            raise ModelError(f'a control period must be above 0 s, got {period_s:g} s')
        # Whole periods, and steps into the next one.
        self._command_late = divmod(
            whole_steps(late.command_s, timestep_s, 'latency of a command'), self._steps)
        self._state_late = divmod(
            -whole_steps(late.state_s, timestep_s, 'latency of a state'), self._steps)
        self._offsets = sorted({self._command_late[1], self._state_late[1], self._steps} - {0})
        self.actions = create_actions(action, simulation)
        self.observer = Observer(task, simulation, pictures)
        self.periods = 0
        #: With the control period in which they take effect.
        self._commands: deque[tuple[int, FloatArray]] = deque()
        self._states: deque[Observation] = deque()

    def reset(self, seed: int) -> None:
        """
        Begin the episode of a seed.

        :param seed: draws the start; the same for the same seed, in any process
        :raises ModelError: if it is no whole number from 0
        """
        start(self.task, self.simulation, seed)
        self.begin()

    def begin(self) -> None:
        """Begin an episode with the present state of the simulation as its start."""
        self.periods = 0
        self._commands.clear()
        self._states.clear()
        if self._state_late != (0, 0):
            # A state that is older than the episode is that of its start.
            whole, rest = self._state_late
            self._states.extend([self.observer.read()] * (-whole if rest else 1 - whole))

    def step(self, action: ArrayLike) -> None:
        """
        Take an action and advance by one control period.

        :param action: as ``actions`` takes it
        :raises CommandError: if it cannot be used; then nothing changes
        :raises DivergenceError: if the physics diverges
        """
        self.take(action)
        self.advance()

    def take(self, action: ArrayLike) -> None:
        """
        Take an action for the next control period, or a later one by the latency of commands.

        :param action: as ``actions`` takes it
        :raises CommandError: if it cannot be used; then nothing changes
        """
        numbers = finite_numbers(action, self.actions.size, 'an action')
        self._commands.append((self.periods + self._command_late[0], numbers))

    def advance(self) -> None:
        """
        Advance by one control period, with what has been commanded.

        :raises DivergenceError: if the physics diverges
        """
        for steps in self.period():
            self.simulation.advance(steps)

    def period(self) -> Iterator[int]:
        """
        Run one control period as :meth:`advance`, but leave the physics to the caller.

        :returns: numbers of physics steps, each to be advanced before the next is asked for; they
            are the same in every period of all episodes with the same latency
        """
        done = 0
        for offset in self._offsets:
            self._do_what_is_due(done)
            yield offset - done
            done = offset
        self.periods += 1
        self.task.end_period(self.simulation)
        if self._states:
            if not self._state_late[1]:
                self._states.append(self.observer.read())
            if len(self._states) > 1:
                self._states.popleft()

    def _do_what_is_due(self, offset: int) -> None:
        """Apply commands and keep states, some physics steps after the begin of a period."""
        if offset == self._command_late[1]:
            while self._commands and self._commands[0][0] <= self.periods:
                self.actions.apply(self._commands.popleft()[1], self.period_s)
        if self._states and offset and offset == self._state_late[1]:
            self._states.append(self.observer.read())

    @property
    def observation(self) -> Observation:
        """What a policy observes at present, of an earlier instant where states have a latency."""
        if not self._states:
            return self.observer.read()
        return {key: value.copy() for key, value in self._states[0].items()}

    def run(self, policy: Policy, seed: int) -> bool:
        """
        Run the episode of a seed, and return whether it succeeds.

        :param policy: gets :attr:`observation`; an expert, which reads the simulation, gets None
        :param seed: as for :meth:`reset`
        :raises CommandError: if an action cannot be used
        :raises DivergenceError: if the physics diverges
        """
        self.reset(seed)
        policy.reset(seed)
        while not self.over:
            self.step(policy.act(None if isinstance(policy, Expert) else self.observation))
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
        return self.periods * self.period_s > self.task.horizon_s - 1e-6

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
