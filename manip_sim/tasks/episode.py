# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
An episode of a task in a simulation: its start, its control periods and its end.

Its setting is what users give; its interface says which numbers a policy gets and gives. Answers
of a policy may come late: the simulation goes on while the policy thinks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import functools
import logging
import math
import multiprocessing
from types import MappingProxyType
from typing import Any, Union

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, ModelError
from manip_sim.models.faults import FaultPlan
from manip_sim.models.randomization import checked_seed, Randomization
from manip_sim.models.world import DEFAULT, Gripper, Grippers, Robot
from manip_sim.quoting import format_value
from manip_sim.sensing.robot_sensing import Delay, ROUNDING
from manip_sim.simulation import Simulation
from manip_sim.simulation.episode_start import Sample
from manip_sim.tasks.episode_actions import create_actions
from manip_sim.tasks.expert import Expert, Policy
from manip_sim.tasks.latency import (
    AnswerTime, AnswerTimeLike, Latency, LatencyLike, NO_ANSWER_TIME, NO_LATENCY)
from manip_sim.tasks.observation import (
    CameraLike, checked_kinds, descriptions, IMAGE, Observation, Observer, Pictures,
    PictureThreads, views_of)
from manip_sim.tasks.task import create_task, Task
from manip_sim.validation import fitting_timestep, listed, mapping, nearest_rates, steps_of

#: Of what :func:`interface_of` returns.
INTERFACE_FORMAT = 1
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
_POSE = (('x', 'm'), ('y', 'm'), ('z', 'm'), ('qx', ''), ('qy', ''), ('qz', ''), ('qw', ''))
#: By key, names and units of the numbers of a row.
_COLUMNS = {
    'eef_pose': _POSE, 'object_pose': _POSE,
    'eef_twist': (*((f'v{axis}', 'm/s') for axis in 'xyz'),
                  *((f'w{axis}', 'rad/s') for axis in 'xyz')),
    'external_wrench': (*((f'f{axis}', 'N') for axis in 'xyz'),
                        *((f't{axis}', 'N m') for axis in 'xyz'))}
#: By key, the units of hinges and of slide joints.
_OF_JOINTS = {'joint_position': ('rad', 'm'), 'joint_velocity': ('rad/s', 'm/s'),
              'joint_effort': ('N m', 'N')}
#: Most actions of a chunk; more are a mistake in the axes.
_LONGEST_CHUNK = 10_000


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
    if before:
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


class LateAnswers:
    """
    The way of a policy's answers to an episode, whose time goes on while the policy thinks.

    The policy observes at the beginning of a control period, whenever :attr:`asks`. Its answer
    takes effect as much later as it thinks, exact to the timestep; until then nothing is
    commanded. Of a chunk, the first action takes effect then, and the others follow at the rate
    of chunks. If the policy is asked ahead, the actions of the last chunk go on meanwhile, and as
    many of the new one are left out, as they are for times that are over.

    :param episode: that the actions are for
    :param time: of the answers
    :raises ModelError: if the rate of chunks does not fit the timestep
    """

    def __init__(self, episode: Episode, time: AnswerTime) -> None:
        self._episode = episode
        self._sensing = episode.simulation.robots[episode.task.robot.name_in_world].sensing
        self._time = time
        self._timestep_s = timestep_s = episode.simulation.timestep_s
        spacing_s = episode.period_s if time.chunk_hz is None else 1.0 / time.chunk_hz
        spacing = steps_of(spacing_s, timestep_s)
        if spacing is None:
            raise ModelError(f'chunk_hz must be that of a whole number of timesteps of '
                             f'{timestep_s:g} s, got {time.chunk_hz:g} Hz')
        self._spacing = spacing
        self._delay = Delay('answer_time', timestep_s)
        self._delay.mean_s, self._delay.jitter_s = time.mean_s, time.jitter_s
        self.reset(0)

    def reset(self, seed: int) -> None:
        """
        Begin an episode, after its own reset.

        :param seed: draws the times
        """
        self._delay.set_seed(seed)
        #: Actions by when they take effect, in steps since the reset.
        self._waiting: list[tuple[int, FloatArray]] = []
        #: When the last answer arrives, and when there is nothing left of it.
        self._arrival = self._end = self._count

    @property
    def _count(self) -> int:
        """Steps since the reset."""
        return self._sensing.count

    @property
    def asks(self) -> bool:
        """True if the policy is to be asked at the present instant."""
        left = -(-(self._end - self._count) // self._spacing)
        return self._count >= self._arrival and left <= self._time.ask_ahead

    def answer(self, answer: ArrayLike, took_s: float = 0.0) -> None:
        """
        Take an answer to the present observation.

        :param answer: an action, or a chunk of actions, shape (n,) or (actions, n)
        :param took_s: wall time that the policy took [s]
        :raises CommandError: if it cannot be used; then nothing changes
        """
        self.take(self._actions(answer), took_s)

    def take(self, actions: Sequence[FloatArray], took_s: float) -> None:
        """
        Take an answer as :meth:`answer` does.

        :param actions: as ``Actions.checked`` returns them, one or more
        :param took_s: wall time that the policy took [s]
        """
        now, spacing = self._count, self._spacing
        thinks = (math.ceil(took_s / self._timestep_s - ROUNDING) if self._time.measured
                  else self._delay.steps(now))
        self._arrival = now + thinks
        self._waiting = [(due, action) for due, action in self._waiting if due < self._arrival]
        # Without actions left, the grid of the new ones begins with the observation.
        grid = self._waiting[-1][0] + spacing if self._waiting else now
        actions = actions[min(len(self._waiting), len(actions) - 1):]
        first = max(self._arrival, grid)
        second = grid + ((first - grid) // spacing + 1) * spacing
        times = [first, *(second + i * spacing for i in range(len(actions) - 1))]
        self._end = second + (len(actions) - 1) * spacing
        self._waiting += zip(times, actions)

    def _actions(self, answer: ArrayLike) -> list[FloatArray]:
        actions, numbers = self._episode.actions, np.asarray(answer)
        if numbers.ndim < 2:
            return [actions.checked(answer)]
        if numbers.ndim > 2 or not 0 < len(numbers) <= _LONGEST_CHUNK:
            raise CommandError(
                f'a chunk of actions must have the shape (actions, {actions.size}), with up to '
                f'{_LONGEST_CHUNK} actions, got {numbers.shape}')
        return [actions.checked(action, f'action {index} of a chunk')
                for index, action in enumerate(numbers)]

    def begin_period(self) -> list[tuple[int, FloatArray]]:
        """
        Let due actions take effect within the next control period.

        :returns: the actions, and in how many steps they take effect
        :raises CommandError: if one cannot be carried out
        """
        due = self.take_due()
        self.apply(due)
        return due

    def take_due(self) -> list[tuple[int, FloatArray]]:
        """Return the actions due within the next control period, as :meth:`begin_period` does."""
        begin = self._count
        end = begin + self._episode.steps
        due = [(time - begin, action) for time, action in self._waiting if time < end]
        self._waiting = self._waiting[len(due):]
        return due

    def apply(self, due: Sequence[tuple[int, FloatArray]]) -> None:
        """
        Let actions take effect within the next control period.

        :param due: as :meth:`take_due` has returned them
        :raises CommandError: if one cannot be carried out
        """
        for steps, action in due:
            self._episode.actions.apply(action, self._episode.period_s, steps)

    def advance(self) -> list[tuple[int, FloatArray]]:
        """
        Advance by one control period, with the actions due in it.

        :returns: as :meth:`begin_period`
        :raises CommandError: if an action cannot be carried out
        :raises DivergenceError: if the physics diverges
        """
        due = self.begin_period()
        self._episode.advance()
        return due


@dataclass(frozen=True)
class Setting:
    """
    Parts of which episodes are made.

    :ivar task: its name, or an instance
    :ivar robot: as for ``compose``; a task that is an instance has its own
    :ivar gripper: as for ``compose``
    :ivar action: what actions mean, one of ``manip_sim.tasks.ACTIONS``
    :ivar control_hz: actions per second of simulated time [Hz]
    :ivar latency: of commands and states, in simulated time [s], see :class:`Latency`
    :ivar cameras: whose images are observed: names, or descriptions as for ``compose``
    :ivar image_size: width and height of images [pixels]; None for the cameras' sizes
    :ivar noise: of all robots, by the names of the node's parameters, such as
        ``noise.joint_position``
    :ivar image_kinds: of the cameras: ``rgb``, ``depth`` and ``labels``
    :ivar composition: what else ``compose`` takes, such as ``timestep_s``
    :ivar answer_time: how long the policy thinks, see :class:`AnswerTime`
    """

    task: Union[str, Task]
    robot: Robot = 'Panda'
    gripper: Union[Gripper, Grippers] = DEFAULT
    action: str = 'osc_pose'
    control_hz: float = 20.0
    latency: LatencyLike = NO_LATENCY
    cameras: Sequence[CameraLike] = ()
    image_size: tuple[int, int] | None = None
    composition: Mapping[str, Any] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    answer_time: AnswerTimeLike = NO_ANSWER_TIME
    image_kinds: Sequence[str] = ('rgb',)

    def __post_init__(self) -> None:
        rate = self.control_hz
        if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not (
                0.0 < rate < math.inf):
            raise ModelError(f'control_hz must be above 0 Hz, got {format_value(rate)}')
        object.__setattr__(self, 'cameras', tuple(listed(self.cameras, 'cameras')))
        object.__setattr__(self, 'noise', dict(mapping(
            self.noise, 'noise', "{'joint_position': 0.001}")))
        object.__setattr__(self, 'latency', Latency.of(self.latency))
        object.__setattr__(self, 'answer_time', AnswerTime.of(self.answer_time))
        object.__setattr__(self, 'image_kinds', checked_kinds(self.image_kinds))

    @property
    def plain_composition(self) -> dict[str, Any]:
        """The composition with the content of files that are not only named."""
        composition = dict(self.composition)
        if composition.get('randomization') is not None:
            composition['randomization'] = Randomization(composition['randomization']).given
        if 'faults' in composition:
            composition['faults'] = FaultPlan(composition['faults']).given
        return composition

    def create_task(self) -> Task:
        """
        Return the task.

        If no timestep is given, it has the longest up to its own that fits ``control_hz``; a
        warning is logged then, once for each process that is not a worker of another one.

        :raises UnknownNameError: if the task or part is unknown
        :raises ModelError: if the robot cannot do it, naming those that can
        """
        if isinstance(self.task, Task):
            return self.task
        cameras = [*self.composition.get('cameras', ()), *descriptions(self.cameras)]
        composition = {**self.composition, 'cameras': cameras}
        task = create_task(self.task, self.robot, self.gripper, **composition)
        period_s, timestep_s = 1.0 / self.control_hz, task.world.timestep_s
        if steps_of(period_s, timestep_s) or 'timestep_s' in composition or not (
                fitted_s := fitting_timestep(period_s, timestep_s)):
            return task
        if multiprocessing.parent_process() is None:
            _log_timestep(self.control_hz, timestep_s, fitted_s)
        return create_task(self.task, self.robot, self.gripper,
                           **{**composition, 'timestep_s': fitted_s})

    def create_episode(self, task: Task | None = None, simulation: Simulation | None = None,
                       pictures: Pictures | PictureThreads | None = None) -> Episode:
        """
        Return an episode that has to be reset.

        :param task: as :meth:`create_task` returns it; None creates it
        :param simulation: of the task's world; None creates it
        :param pictures: of the cameras; None creates them
        :raises ManipSimError: if something cannot be used
        """
        task = self.create_task() if task is None else task
        simulation = Simulation(task.world) if simulation is None else simulation
        return Episode(task, simulation, 1.0 / self.control_hz, self.action, self.latency,
                       self.create_pictures(simulation, task) if pictures is None else pictures,
                       self.noise)

    def create_answers(self, episode: Episode) -> LateAnswers:
        """
        Return the way of the policy's answers to an episode.

        :param episode: of this setting
        :raises ModelError: if the rate of chunks does not fit the timestep
        """
        return LateAnswers(episode, AnswerTime.of(self.answer_time))

    def create_pictures(self, simulation: Simulation, task: Task, threads: int = 1
                        ) -> Pictures | PictureThreads | None:
        """
        Return what renders the images of the cameras; None if there are none.

        :param simulation: of the task's world
        :param task: as :meth:`create_task` returns it
        :param threads: that render at once
        :raises ManipSimError: if a camera cannot be chosen, or nothing can be rendered
        """
        views = views_of(self.cameras, task.world, simulation, self.image_size)
        if not views:
            return None
        create = functools.partial(Pictures, simulation, views, self.image_kinds)
        return create() if threads == 1 else PictureThreads(create, threads)


@functools.cache
def _log_timestep(rate_hz: float, timestep_s: float, fitted_s: float) -> None:
    logging.getLogger(__name__).warning(
        'control rate of %g Hz: the timestep is %.9g s instead of %g s, so that a control period '
        'is %d whole timesteps', rate_hz, fitted_s, timestep_s,
        steps_of(1.0 / rate_hz, fitted_s))


def interface_of(episode: Episode) -> dict[str, Any]:
    """
    Return what a policy gets and gives in an episode, as JSON can hold it.

    ``control_hz`` is the number of actions in a second. ``action`` has ``kind``, ``names``,
    ``units`` and ``bounds`` of the numbers in their order; the unit ``0.05 m`` means that 1 is
    0.05 m. ``observation`` has by key ``shape`` and ``dtype`` of an array, ``names`` along its
    first axis, ``columns`` along its second axis, and ``units`` along its last axis.

    :param episode: any
    """
    actions, names = episode.actions, episode.observer.names
    observed: dict[str, Any] = {}
    for key, value in episode.observation.items():
        entry = observed[key] = {'shape': list(value.shape), 'dtype': str(value.dtype)}
        if key in names:
            entry['names'] = list(names[key])
        if key in _COLUMNS:
            entry['columns'], entry['units'] = map(list, zip(*_COLUMNS[key]))
        elif key in _OF_JOINTS:
            model = episode.simulation.model
            entry['units'] = [
                _OF_JOINTS[key][int(model.joint(name).type[0]) == _SLIDE] for name in names[key]]
        elif key.startswith(IMAGE):
            entry['columns'], entry['units'] = ['y', 'x'], ['red', 'green', 'blue']
    return {'format': INTERFACE_FORMAT, 'control_hz': 1.0 / episode.period_s,
            'action': {'kind': episode.kind, 'names': actions.names, 'units': actions.units,
                       'bounds': actions.bounds.tolist()},
            'observation': observed}
