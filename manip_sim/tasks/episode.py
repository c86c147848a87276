# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An episode of a task in a simulation: its start, its control periods and its end."""

from __future__ import annotations

from collections.abc import Mapping
import math
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.errors import CommandError, ModelError
from manip_sim.models.placements import checked_seed
from manip_sim.simulation import Simulation
from manip_sim.simulation.episode_start import Sample
from manip_sim.tasks.episode_actions import create_actions
from manip_sim.tasks.expert import Expert, Policy
from manip_sim.tasks.latency import Latency, LatencyLike, NO_LATENCY
from manip_sim.tasks.observation import Observation, Observer
from manip_sim.tasks.pictures import Pictures, PictureThreads
from manip_sim.tasks.task import Task
from manip_sim.validation import fitting_timestep, nearest_rates, steps_of


class Episode:
    """
    Episodes of a task, one after the other.

    :param task: the task to do
    :param simulation: of the task's world
    :param period_s: length of a control period [s], a whole number of timesteps
    :param action: what actions mean, one of :data:`ACTIONS`
    :param latency: of commands and states, in simulated time, whole numbers of timesteps
    :param pictures: renders the images of observations; None for no images
    :param noise: of all robots, by the names of ``manip_sim.sensing.sensor_noise.QUANTITIES``
    :raises ModelError: if a duration cannot be used
    :raises CommandError: if a number of noise is out of range
    :raises UnknownNameError: if the kind of actions is unknown
    :ivar kind: what actions mean
    :ivar latency: of commands and states
    :ivar noise: of all robots, by name
    :ivar settings: of the sensing of all robots: the noise and the latency
    :ivar actions: what :meth:`step` takes
    :ivar observer: what :attr:`observation` is made of
    :ivar periods: control periods since the last reset
    """

    def __init__(self, task: Task, simulation: Simulation, period_s: float = 0.05,
                 action: str = 'osc_pose', latency: LatencyLike = NO_LATENCY,
                 pictures: Pictures | PictureThreads | None = None,
                 noise: Mapping[str, float] = MappingProxyType({})) -> None:
        self.task = task
        self.simulation = simulation
        self.kind = action
        self.latency = late = Latency.of(latency)
        timestep_s = simulation.timestep_s
        self._steps = _steps(period_s, timestep_s)
        exact_s = self._steps * timestep_s
        # Timesteps of whole nanoseconds cannot make up 1/30 s.
        self.period_s = exact_s if abs(exact_s - period_s) > 1e-12 else period_s
        late.check(timestep_s)
        self.noise = dict(noise)
        for name in self.noise.keys() & {'latency.image', 'latency.image_jitter'}:
            raise CommandError(f"{name} cannot be used here: give latency={{'state': ...}}, which "
                               'is that of images too')
        for quantity in late.quantities:
            for way, names in (('noise', self.noise),
                               ('the randomization', simulation.randomized.drawn)):
                if any(f'/{name}'.endswith((f'/{quantity}', f'.{quantity}')) for name in names):
                    raise ModelError(f'both latency= and {way} set {quantity}: give one of them')
        self.settings = {**self.noise, **late.quantities}
        for robot in simulation.robots.values():
            for quantity, value in self.settings.items():
                robot.sensing.set(quantity, value)
        self.actions = create_actions(action, simulation)
        self.observer = Observer(task, simulation, pictures)
        self.periods = 0

    @property
    def steps(self) -> int:
        """Number of timesteps of a control period."""
        return self._steps

    def reset(self, seed: int, drawn: Sample | None = None) -> None:
        """
        Begin the episode of a seed.

        :param seed: draws the start; the same for the same seed, in any process
        :param drawn: as for :func:`start`
        :raises ModelError: if it is not a whole number from 0
        """
        start(self.task, self.simulation, seed, drawn)
        self.periods = 0

    def begin(self) -> None:
        """Begin an episode with the present state of the simulation as its start."""
        self.periods = 0
        # A state that is older than the episode is that of its start.
        for robot in self.simulation.robots.values():
            robot.sensing.restart()

    def step(self, action: ArrayLike) -> None:
        """
        Take an action and advance by one control period.

        :param action: as ``actions`` takes it
        :raises CommandError: if it cannot be used; then nothing changes
        :raises DivergenceError: if the physics diverges
        """
        self.take(action)
        self.advance()

    def take(self, action: ArrayLike, delay_steps: int = 0) -> None:
        """
        Take an action for the next control period, or a later one by the latency of commands.

        :param action: as ``actions`` takes it
        :param delay_steps: timesteps after which it takes effect, before the latency is added
        :raises CommandError: if it cannot be used; then nothing changes
        """
        self.actions.apply(self.actions.checked(action), self.period_s, delay_steps)

    def advance(self) -> None:
        """
        Advance by one control period, with the present commands.

        :raises DivergenceError: if the physics diverges
        """
        self.simulation.advance(self._steps)
        self.end_period()

    def end_period(self) -> None:
        """End a control period that the simulation has run."""
        self.periods += 1
        self.task.end_period(self.simulation)
        self.observer.end_period()

    @property
    def observation(self) -> Observation:
        """The present observation of a policy, of an earlier instant if states have a latency."""
        return self.observer.read()

    @property
    def observes_exactly(self) -> bool:
        """True if observations have neither noise nor latency."""
        return not any(
            robot.sensing.settings.measures or robot.sensing.settings.measures_images
            for robot in self.simulation.robots.values())

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
        """True if the task is done at present."""
        return bool(self.task.success(self.simulation))

    @property
    def reward(self) -> float:
        """The reward of the present instant."""
        return float(self.task.reward(self.simulation))

    @property
    def most_periods(self) -> int:
        """Number of control periods after which the time is up."""
        return math.floor((self.task.horizon_s - 1e-6) / self.period_s) + 1

    @property
    def time_is_up(self) -> bool:
        """True if the horizon of the task has been reached."""
        return self.periods >= self.most_periods

    @property
    def over(self) -> bool:
        """True if the task is done, or its time is up."""
        return self.time_is_up or self.success

    @property
    def digest(self) -> str:
        """Of the present state, as ``Simulation.digest`` gives it."""
        return self.simulation.digest()


def start(task: Task, simulation: Simulation, seed: int, drawn: Sample | None = None) -> None:
    """
    Reset a simulation to the start that a seed draws.

    :param task: whose start it is
    :param simulation: of the world of the task
    :param seed: a whole number from 0
    :param drawn: by name, in place of what ``randomization`` would draw; None lets it draw
    :raises ModelError: if the seed is not a whole number, or something cannot be drawn
    """
    seed = checked_seed(seed)
    simulation.reset(seed, drawn)
    randomized = simulation.randomized
    before = randomized.free_poses(simulation.data)
    task.start(simulation, np.random.default_rng(seed))
    if before.size:
        randomized.place_again(simulation.data, before, drawn is not None)
    simulation.forward()
    for robot in simulation.robots.values():
        robot.sensing.restart()


def _steps(period_s: float, timestep_s: float) -> int:
    """Return the number of timesteps of a control period; ModelError if it is not whole."""
    if not 0.0 < period_s < math.inf:
        raise ModelError('a control period must be a whole number of timesteps above 0 s, got '
                         f'{period_s:g} s')
    steps = steps_of(period_s, timestep_s)
    if steps is None:
        rates = ', '.join(f'{rate:.10g}' for rate in nearest_rates(1.0 / period_s, timestep_s))
        fitted_s = fitting_timestep(period_s, timestep_s)
        raise ModelError(
            f'a control period must be a whole number of timesteps of {timestep_s:g} s, got '
            f'{period_s:g} s; the nearest rates are {rates} Hz'
            + (f'; or use timestep_s={fitted_s:.9g}' if fitted_s else ''))
    return steps
