# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A task as an environment of gymnasium, and as many environments at once in this process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import inspect
import os
import sys
import time
from types import MappingProxyType
from typing import Any

import gymnasium
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip_sim.errors import (
    CommandError, describe_choices, DivergenceError, ModelError, UnknownNameError)
from manip_sim.models.randomization import checked_seed
from manip_sim.models.world import compose, DEFAULT, Gripper, Grippers, Robot
from manip_sim.quoting import format_value, quoted
from manip_sim.tasks import Episode, LateAnswers, Setting, Task
from manip_sim.tasks.episode_actions import Actions, JointActions
from manip_sim.tasks.latency import AnswerTimeLike, LatencyLike, NO_ANSWER_TIME, NO_LATENCY
from manip_sim.tasks.observation import CameraLike, Observation, observe, Pictures
from manip_sim.validation import whole_number
from manip_sim.worlds import Worlds

#: Seeds that are drawn are below this.
SEEDS = 2**31
#: Lowest and highest numbers of observations by their type: images, depth, labels, all others.
_BOUNDS = {'uint8': (0, 255), 'float32': (0.0, np.inf), 'int32': (-1, np.iinfo(np.int32).max),
           'float64': (-np.inf, np.inf)}
#: A window needs a screen.
_SCREEN = sys.platform != 'linux' or any(os.environ.get(name) for name in (
    'DISPLAY', 'WAYLAND_DISPLAY'))
#: The option of a reset that tells which environments begin again.
_MASK = 'reset_mask'
#: Attributes that all environments have in common.
_SHARED = ('task', 'task_description', '_max_episode_steps', 'metadata', 'render_mode', 'spec')
_Result = tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]


class _TaskEpisodes:
    """One environment or many: how their episodes are asked for, shown and described."""

    metadata: dict[str, Any]

    def _prepare(self, setting: Setting, render_mode: str | None, view: tuple[str, tuple[int, int]]
                 ) -> None:
        """
        Check and keep what the constructors have in common.

        :param view: camera, and width and height [pixels], of what is shown
        """
        if not isinstance(render_mode, (str, type(None))) or (
                render_mode not in (None, *self.metadata['render_modes'])):
            raise UnknownNameError('render_mode', render_mode, self.metadata['render_modes'])
        check_keywords(setting.composition, type(self))
        self.metadata = {**self.metadata, 'render_fps': setting.control_hz}
        self.render_mode = render_mode
        self._view = view
        self._film: Pictures | None = None
        #: Instant at which the policy got the last observation, of ``time.perf_counter`` [s].
        self._asked_s = 0.0

    def _describe(self, episode: Episode) -> None:
        self.task, self.task_description = episode.task.name, episode.task.instruction
        self._max_episode_steps = episode.most_periods

    def _picture(self, episode: Episode) -> Any:
        """Return an image of an episode; None if the mode is not ``rgb_array``."""
        if self.render_mode != 'rgb_array':
            return None
        if self._film is None:
            self._film = Pictures(episode.simulation, dict([self._view]))
        return self._film.take(episode.simulation)[self._view[0]].rgb

    def _close_pictures(self, episode: Episode) -> None:
        for pictures in (self._film, episode.observer.pictures):
            if pictures is not None:
                pictures.close()
        self._film = None


class TaskEnv(_TaskEpisodes, gymnasium.Env[Observation, NDArray[Any]]):
    """
    Episodes of a task, in this process.

    ``reset(seed=...)`` begins the episode of that seed, the same as in ``manip_sim run``; without
    a seed one is drawn from ``np_random``. ``terminated`` is success, ``truncated`` the end of the
    task's time. ``info`` has ``success``, also as ``is_success``, and ``seed``, and ``digest`` of
    the state at the start and at the end of an episode. An episode in which the physics diverges
    is truncated, with ``info['diverged']``.

    :param task: its name, or an instance
    :param robot: as for ``compose``
    :param gripper: as for ``compose``
    :param action: ``osc_pose``, ``joint_position``, ``joint_velocity`` or ``joint_effort``
    :param control_hz: actions per second of simulated time [Hz]
    :param latency: of commands [s], or a mapping with ``command`` and ``state``
    :param cameras: whose images are observed
    :param image_size: width and height of images [pixels]; None for the cameras' own
    :param render_mode: ``rgb_array``, or ``human`` where there is a screen
    :param render_camera: what ``rgb_array`` shows
    :param render_size: its width and height [pixels]
    :param noise: of observations, by the names of the node's parameters, such as
        ``noise.joint_position``
    :param answer_time: how long the policy thinks in simulated time [s], as for
        ``manip_sim.tasks.AnswerTime.of``: a step lasts until the policy is asked again, and its
        reward is summed over its control periods; ``measured`` is the wall time between two steps
    :param chunk: number of actions that :meth:`step` takes at once, shape (chunk, n); None for one
        action, shape (n,)
    :param image_kinds: observed images of cameras: ``rgb``, ``depth`` and ``labels``
    :param composition: further arguments of ``compose``, such as ``timestep_s``
    :raises ManipSimError: if something cannot be used, with what fits
    :ivar episode: the episode, with its simulation
    :ivar task: name of the task
    :ivar task_description: what to do, as one would say it
    """

    metadata: dict[str, Any] = {
        'render_modes': ['rgb_array', *['human'] * _SCREEN], 'render_fps': 20}

    def __init__(self, task: str | Task, robot: Robot = 'Panda',
                 gripper: Gripper | Grippers = DEFAULT, action: str = 'osc_pose',
                 control_hz: float = 20.0, latency: LatencyLike = NO_LATENCY,
                 cameras: tuple[CameraLike, ...] | list[CameraLike] = (),
                 image_size: tuple[int, int] | None = None, render_mode: str | None = None,
                 render_camera: str = 'frontview', render_size: tuple[int, int] = (480, 360),
                 noise: Mapping[str, float] = MappingProxyType({}),
                 answer_time: AnswerTimeLike = NO_ANSWER_TIME, chunk: int | None = None,
                 image_kinds: Sequence[str] = ('rgb',),
                 **composition: Any) -> None:
        setting = Setting(task, robot, gripper, action, control_hz, latency, cameras,
                          image_size, composition, noise, answer_time, image_kinds)
        self._prepare(setting, render_mode, (render_camera, render_size))
        self.episode = setting.create_episode()
        self._describe(self.episode)
        self._answers = setting.create_answers(self.episode)
        self._window: Any = None
        self._begun = False
        self.action_space = action_space(self.episode, chunk)
        self.observation_space = observation_space(self.episode.observation)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[Observation, dict[str, Any]]:
        """
        Begin an episode.

        :param seed: whose start it has; None draws one
        :param options: none are known
        :raises UnknownNameError: if there are options
        """
        check_options(options)
        super().reset(seed=seed)
        start_seed = int(self.np_random.integers(SEEDS)) if seed is None else seed
        self.episode.reset(start_seed)
        self._answers.reset(start_seed)
        self._begun = True
        self._show()
        observation = self.episode.observation
        self._asked_s = time.perf_counter()
        return observation, {'seed': start_seed, **self._info(self.episode.success, True)}

    def step(self, action: ArrayLike
             ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """
        Take an action and advance by one control period, or until the policy is asked again.

        :param action: of :attr:`action_space`; numbers beyond it are clamped
        :raises gymnasium.error.ResetNeeded: if no episode has begun
        :raises CommandError: if the action cannot be used; then nothing changes
        """
        if not self._begun:
            raise gymnasium.error.ResetNeeded('call reset() before step()')
        self._answers.answer(action, time.perf_counter() - self._asked_s)
        reward = 0.0
        try:
            while True:
                self._answers.advance()
                self._show()
                reward += self.episode.reward
                success, truncated = self.episode.success, self.episode.time_is_up
                if self._answers.asks or success or truncated:
                    break
        except DivergenceError as error:
            return (self.episode.observation, 0.0, False, True,
                    {'diverged': str(error), **self._info(self.episode.success, True)})
        observation, info = self.episode.observation, self._info(success, success or truncated)
        self._asked_s = time.perf_counter()
        return observation, reward, success, truncated, info

    def _info(self, success: bool, with_digest: bool) -> dict[str, Any]:
        digest = {'digest': self.episode.digest} if with_digest else {}
        return {'success': success, 'is_success': success, **digest}

    def digest(self) -> str:
        """Return the digest of the present state, as ``Simulation.digest`` gives it."""
        return self.episode.digest

    def render(self) -> Any:
        """
        Return an image of shape (height, width, 3) in ``rgb_array``; None in ``human``.

        :raises ManipSimError: if nothing can be rendered
        """
        return self._picture(self.episode)

    def _show(self) -> None:
        """Show the present instant in MuJoCo's viewer, if the mode is ``human``."""
        if self.render_mode != 'human':
            return
        simulation = self.episode.simulation
        if self._window is None:
            from mujoco import viewer  # It needs a screen.
            self._window = viewer.launch_passive(simulation.model, simulation.data)
        if self._window.is_running():
            self._window.sync()

    def close(self) -> None:
        """Free what rendering needs; nothing happens the second time."""
        self._close_pictures(self.episode)
        if self._window is not None:
            self._window.close()
        self._window = None


def check_keywords(composition: Mapping[str, Any], environment: type) -> None:
    """
    Check keywords of an environment that are not its own.

    :param composition: the keywords
    :param environment: its class, with keywords of its own
    :raises UnknownNameError: if ``compose`` does not take one, or it is the arena, which is that
        of the task; naming the nearest ones
    """
    names = dict.fromkeys(parameter.name for function in (environment, compose)
                          for parameter in inspect.signature(function).parameters.values()
                          if parameter.kind is not parameter.VAR_KEYWORD)
    del names['arena']
    for key in composition:
        if key not in names:
            raise UnknownNameError('keyword', key, names)


def check_options(options: Mapping[str, Any] | None, known: Sequence[str] = ()) -> None:
    """
    Check the options of a reset.

    :raises UnknownNameError: if there are others than the known ones
    """
    for key in options or {}:
        if key not in known:
            raise UnknownNameError('option of reset', key, known)


def action_space(episode: Episode, chunk: int | None = None) -> gymnasium.spaces.Box:
    """
    Return the space of an episode's actions, in their units.

    :param chunk: number of actions at once; None for one, without an axis for it
    :raises ModelError: if it is not a whole number above 0
    """
    low, high = episode.actions.bounds.T
    if chunk is not None:
        rows = whole_number(chunk, 1, 'chunk'), 1
        low, high = np.tile(low, rows), np.tile(high, rows)
    return gymnasium.spaces.Box(low, high, dtype=np.float64)


def observation_space(observation: Observation) -> gymnasium.Space[Observation]:
    """Return the space of observations."""
    return gymnasium.spaces.Dict({  # type: ignore[return-value]
        key: gymnasium.spaces.Box(*_BOUNDS[value.dtype.name], value.shape, value.dtype.type)
        for key, value in observation.items()})


class TaskVectorEnv(
        _TaskEpisodes, gymnasium.vector.VectorEnv[Observation, NDArray[Any], NDArray[Any]]):
    """
    Episodes of a task, many at once in this process; each as :class:`TaskEnv` has it, to the bit.

    ``reset(seed=n)`` begins the episodes of the seeds n, n + 1, ...; a list has one seed for each.
    An environment whose episode has ended begins the next one as gymnasium's ``AutoresetMode``
    says: in the next ``step``, which ignores its action (``NEXT_STEP``), in the same one, whose
    ``infos`` have ``final_obs`` and ``final_info`` (``SAME_STEP``), or only in a ``reset``
    (``DISABLED``).

    :param task: its name, or an instance
    :param num_envs: number of episodes at once
    :param threads: that compute the physics, and render; None for one per processor
    :param robot: as this and what follows for :class:`TaskEnv`
    :param gripper: as for ``compose``
    :param action: ``osc_pose``, ``joint_position``, ``joint_velocity`` or ``joint_effort``
    :param control_hz: actions per second of simulated time [Hz]
    :param latency: of commands [s], or a mapping with ``command`` and ``state``
    :param cameras: whose images are observed
    :param image_size: width and height of images [pixels]; None for the cameras' own
    :param render_mode: ``rgb_array``, or None
    :param render_camera: what ``rgb_array`` shows
    :param render_size: its width and height [pixels]
    :param noise: of observations, by the names of the node's parameters, such as
        ``noise.joint_position``
    :param answer_time: how long the policy thinks in simulated time [s]; ``measured`` is the wall
        time between two steps, for all of them
    :param chunk: number of actions that :meth:`step` takes at once of each, shape (num_envs,
        chunk, n)
    :param image_kinds: observed images of cameras: ``rgb``, ``depth`` and ``labels``
    :param autoreset_mode: one of ``gymnasium.vector.AutoresetMode``, or its value: ``NextStep``,
        ``SameStep`` or ``Disabled``
    :param composition: further arguments of ``compose``
    :raises ManipSimError: if something cannot be used, with what fits
    :ivar worlds: the worlds, one for each episode
    :ivar autoreset_mode: when the next episode begins
    :ivar task: name of the task
    :ivar task_description: what to do, as one would say it
    """

    metadata: dict[str, Any] = {
        'render_modes': ['rgb_array'], 'render_fps': 20,
        'autoreset_mode': AutoresetMode.NEXT_STEP}

    def __init__(self, task: str | Task, num_envs: int = 1, robot: Robot = 'Panda',
                 gripper: Gripper | Grippers = DEFAULT, action: str = 'osc_pose',
                 control_hz: float = 20.0, latency: LatencyLike = NO_LATENCY,
                 cameras: Sequence[CameraLike] = (), image_size: tuple[int, int] | None = None,
                 render_mode: str | None = None, render_camera: str = 'frontview',
                 render_size: tuple[int, int] = (480, 360), threads: int | None = None,
                 noise: Mapping[str, float] = MappingProxyType({}),
                 answer_time: AnswerTimeLike = NO_ANSWER_TIME, chunk: int | None = None,
                 image_kinds: Sequence[str] = ('rgb',),
                 autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
                 **composition: Any) -> None:
        setting = Setting(task, robot, gripper, action, control_hz, latency, cameras,
                          image_size, composition, noise, answer_time, image_kinds)
        self._prepare(setting, render_mode, (render_camera, render_size))
        self.autoreset_mode = _mode(autoreset_mode)
        self.metadata['autoreset_mode'] = self.autoreset_mode
        made = setting.create_task()
        self.worlds = Worlds(made.world, whole_number(num_envs, 1, 'num_envs'), threads)
        pictures = setting.create_pictures(
            self.worlds.simulations[0], made, min(self.worlds.threads, len(self.worlds)))
        self._episodes = [setting.create_episode(made, simulation, pictures)
                          for simulation in self.worlds.simulations]
        episode = self._episodes[0]
        self._describe(episode)
        self._actions = _BatchedActions(self.worlds, episode.actions, episode.period_s)
        self._answers = [setting.create_answers(episode) for episode in self._episodes]
        self.num_envs = len(self._episodes)
        self._randoms = [np.random.default_rng() for _ in self._episodes]
        #: Of each environment: whether it has begun, and whether its episode has ended.
        self._begun = np.zeros(self.num_envs, dtype=bool)
        self._ended = np.zeros(self.num_envs, dtype=bool)
        self._given: dict[str, Sequence[Any]] = {}
        self.single_action_space = action_space(episode, chunk)
        first = episode.observation
        #: The last observation of each environment, by key.
        self._observed = {key: np.zeros((self.num_envs, *value.shape), value.dtype)
                          for key, value in first.items()}
        self.single_observation_space = observation_space(first)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    @property
    def episodes(self) -> tuple[Episode, ...]:
        """The episodes, each with its simulation."""
        return tuple(self._episodes)

    def reset(self, *, seed: int | Sequence[int | None] | None = None,
              options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """
        Begin an episode in each environment, or in some of them.

        :param seed: of the first one, the others follow; or one for each; None draws them
        :param options: ``reset_mask``: which environments begin again, booleans of shape
            (num_envs,); the others go on, and their observations are the last ones
        :raises gymnasium.error.ResetNeeded: if one that has not begun yet is left out
        :raises UnknownNameError: if there are other options
        :raises ModelError: if there is not one seed for each environment, or the mask has another
            shape or type, or chooses none; then nothing changes
        """
        check_options(options, (_MASK,))
        mask, seeds = self._mask(options), self._seeds(seed)
        chosen = np.flatnonzero(mask).tolist()
        for index in chosen:
            if seeds[index] is not None:
                checked_seed(seeds[index])
        infos: dict[str, Any] = {}
        for index in chosen:
            infos = self._add_info(infos, self._begin(index, seeds[index]), index)
        observation = self._observe(mask)
        self._asked_s = time.perf_counter()
        return observation, infos

    def _mask(self, options: Mapping[str, Any] | None) -> NDArray[np.bool_]:
        """Return which environments are to begin."""
        if _MASK not in (options or {}):
            return np.ones(self.num_envs, dtype=bool)
        value = (options or {})[_MASK]
        mask = value if isinstance(value, np.ndarray) else None
        if mask is None or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise ModelError(
                f'{_MASK} must be an array of booleans of shape ({self.num_envs},), got ' + (
                    format_value(value) if mask is None else
                    f'{mask.dtype} of shape {mask.shape}'))
        if not mask.any():
            raise ModelError(f'{_MASK} chooses no environment')
        if not (self._begun | mask).all():
            raise gymnasium.error.ResetNeeded(
                f'call reset() without {_MASK} first: not all environments have begun')
        return mask

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        """Return a seed for each environment, or None."""
        seeds: list[int | None] = (
            [None] * self.num_envs if seed is None else
            [seed + i for i in range(self.num_envs)] if isinstance(seed, (int, np.integer)) else
            list(seed))
        if len(seeds) != self.num_envs:
            raise ModelError(f'expected {self.num_envs} seeds, one for each environment, got '
                             f'{len(seeds)}')
        return seeds

    def _begin(self, index: int, seed: int | None) -> dict[str, Any]:
        if seed is not None:
            self._randoms[index], _ = gymnasium.utils.seeding.np_random(int(seed))
        start_seed = int(self._randoms[index].integers(SEEDS)) if seed is None else int(seed)
        episode = self._episodes[index]
        episode.reset(start_seed)
        self._answers[index].reset(start_seed)
        self._begun[index], self._ended[index] = True, False
        success = episode.success
        return {'seed': start_seed, 'success': success, 'is_success': success,
                'digest': episode.digest}

    def step(self, actions: ArrayLike) -> _Result:
        """
        Take an action in each environment and advance by one control period.

        With an answer time or chunks, each advances until its policy is asked again.

        :param actions: shape (num_envs, n), or (num_envs, chunk, n); numbers beyond the space are
            clamped
        :raises gymnasium.error.ResetNeeded: if no episode has begun, or one has ended and
            ``autoreset_mode`` is ``DISABLED``
        :raises CommandError: if an action cannot be used, naming its row; then nothing changes
        """
        self._check_begun()
        acting = ~self._ended
        self._take(actions, acting)
        rewards, success = self._advance(acting)
        diverged = acting & self.worlds.diverged
        terminated = success & ~diverged
        truncated = diverged | acting & self._time_is_up()
        self._ended = terminated | truncated
        infos: dict[str, Any] = {}
        for name in ('success', 'is_success'):
            infos |= {name: success.copy(), f'_{name}': acting.copy()}
        for index in np.flatnonzero(self._ended).tolist():
            infos = self._end(index, bool(success[index]), infos)
        for index in np.flatnonzero(~acting).tolist():
            infos = self._add_info(infos, self._begin(index, None), index)
        observation = self._observe(np.ones(self.num_envs, dtype=bool))
        self._asked_s = time.perf_counter()
        return observation, rewards, terminated, truncated, infos

    def _end(self, index: int, success: bool, infos: dict[str, Any]) -> dict[str, Any]:
        """Add the end of an episode to the infos, and begin the next one if it is time."""
        episode = self._episodes[index]
        reason = episode.simulation.diverged
        info = {**({} if reason is None else {'diverged': reason}), 'success': success,
                'is_success': success, 'digest': episode.digest}
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            final = {'final_obs': episode.observation, 'final_info': info}
            infos, info = self._add_info(infos, final, index), self._begin(index, None)
        return self._add_info(infos, info, index)

    def _check_begun(self) -> None:
        """Check that each environment is in an episode, or begins the next one by itself."""
        if not self._begun.all():
            raise gymnasium.error.ResetNeeded('call reset() before step()')
        if self.autoreset_mode == AutoresetMode.DISABLED and self._ended.any():
            raise gymnasium.error.ResetNeeded(
                f'the episode of environment {int(np.argmax(self._ended))} has ended: call '
                f"reset(options={{'{_MASK}': terminated | truncated}})")

    def _time_is_up(self) -> NDArray[np.bool_]:
        """Return in which environments the horizon of the task has been reached."""
        periods = np.array([episode.periods for episode in self._episodes])
        return np.asarray(periods >= self._episodes[0].most_periods)

    def _advance(self, acting: NDArray[np.bool_]
                 ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """
        Run some worlds until their policies are asked or their episodes end.

        :returns: the sums of their rewards, and whether they succeed at the end
        """
        rewards, success, running = np.zeros(self.num_envs), np.zeros_like(acting), acting.copy()
        while running.any():
            indices = np.flatnonzero(running).tolist()
            self._actions.begin_period(self._answers, indices)
            self.worlds.advance(self._episodes[0].steps, where=running)
            for index in indices:
                episode = self._episodes[index]
                episode.end_period()
                success[index] = episode.success
                if episode.simulation.diverged is not None:
                    rewards[index], running[index] = 0.0, False
                    continue
                rewards[index] += episode.reward
                running[index] = not self._answers[index].asks
            running &= ~success & ~self._time_is_up()
        return rewards, success

    def _take(self, actions: ArrayLike, acting: NDArray[np.bool_]) -> None:
        try:
            numbers = np.array(actions, dtype=float)
        except (TypeError, ValueError) as error:
            raise CommandError(f'actions must be numbers, got {actions!r:.60}') from error
        shape = self.action_space.shape
        if numbers.shape != shape:
            raise CommandError(f'actions must have the shape {shape}, got {numbers.shape}')
        axes = tuple(range(1, numbers.ndim))
        for index in np.flatnonzero(~np.isfinite(numbers).all(axis=axes) & acting)[:1]:
            raise CommandError(f'the action of environment {index} must be finite, got '
                               f'{numbers[index].tolist()!r:.120}')
        took_s = time.perf_counter() - self._asked_s
        chunks = numbers.reshape(self.num_envs, -1, shape[-1])
        for index in np.flatnonzero(acting):
            self._answers[index].take(chunks[index], took_s)

    def _observe(self, mask: NDArray[np.bool_]) -> Observation:
        """Observe some environments, and return the last observation of each, copies."""
        chosen = np.flatnonzero(mask)
        for key, rows in observe([self._episodes[i].observer for i in chosen]).items():
            self._observed[key][chosen] = rows
        return {key: value.copy() for key, value in self._observed.items()}

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """
        Call a method of each environment, or return an attribute.

        :param name: such as ``digest``, ``render``, ``episode``, ``task`` or ``np_random``
        :param args: of the method
        :param kwargs: of the method
        :returns: what there is in each environment
        :raises AttributeError: if the method or attribute is unknown
        """
        return tuple(value(*args, **kwargs) if callable(value) else value
                     for value in self._attributes(name))

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """
        Return what :meth:`call` does without arguments.

        :param name: of an attribute or method
        """
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """
        Set an attribute of each environment, which :meth:`get_attr` returns from then on.

        :param name: of ``np_random``, from which seeds are drawn, or of anything that the
            environments do not read
        :param values: a list or tuple with one for each environment, or one for all
        :raises AttributeError: if the attribute cannot be changed
        :raises ValueError: if there is not one value for each environment
        """
        each = values if isinstance(values, (list, tuple)) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ModelError(f'expected {self.num_envs} values of {quoted(name)}, one for each '
                             f'environment, got {len(each)}')
        if name == 'np_random':
            self._randoms = list(each)
        elif name in self._own() or name in _SHARED[2:]:
            raise AttributeError(f'{quoted(name)} of environments cannot be changed')
        else:
            self._given[name] = tuple(each)

    def _own(self) -> dict[str, Callable[[int], Any]]:
        """Return what gives the attributes that differ between environments, by name."""
        return {'episode': lambda index: self._episodes[index],
                'np_random': lambda index: self._randoms[index],
                'action_space': lambda _: self.single_action_space,
                'observation_space': lambda _: self.single_observation_space,
                'digest': lambda index: lambda: self._episodes[index].digest,
                'render': lambda index: lambda: self._picture(self._episodes[index])}

    def _attributes(self, name: str) -> Sequence[Any]:
        getters = self._own()
        if name in self._given:
            return self._given[name]
        if name in getters:
            return [getters[name](index) for index in range(self.num_envs)]
        if name in _SHARED:
            return [getattr(self, name)] * self.num_envs
        raise AttributeError(f'environments have no {quoted(name)}: ' + describe_choices(
            name, [*getters, *_SHARED, *self._given]))

    def digest(self) -> list[str]:
        """Return the digest of each present state, as ``Simulation.digest`` gives it."""
        return self.worlds.digest()

    def render(self) -> tuple[Any, ...] | None:
        """
        Return an image of each environment in ``rgb_array``, of shape (height, width, 3).

        :raises ManipSimError: if nothing can be rendered
        """
        if self.render_mode is None:
            return None
        return self.call('render')

    def close_extras(self, **kwargs: Any) -> None:
        """
        End the threads, and free what rendering needs.

        :param kwargs: not used
        """
        self.worlds.close()
        self._close_pictures(self._episodes[0])


def _mode(mode: str | AutoresetMode) -> AutoresetMode:
    """Return a mode; UnknownNameError if it is none."""
    try:
        return AutoresetMode(mode)
    except ValueError:
        raise UnknownNameError('autoreset_mode', mode, [
            mode.value for mode in AutoresetMode]) from None


class _BatchedActions:
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
        is_due = np.zeros(len(answers), dtype=bool)
        for index in indices:
            due = answers[index].take_due()
            if len(due) == 1 and due[0][0] == 0:
                numbers[index], is_due[index] = due[0][1], True
            else:
                answers[index].apply(due)
        if is_due.any():
            self._apply(numbers, is_due)

    def _apply(self, numbers: NDArray[np.float64], is_due: NDArray[np.bool_]) -> None:
        """Let an action take effect in each of some worlds, as :meth:`Actions.apply` does."""
        inside = np.clip(numbers, -1.0, 1.0)
        for item in self._actions.arms:
            robot = self._worlds.robots[item.robot.name]
            if isinstance(self._actions, JointActions):
                robot.command.joint_command(
                    item.names, part=item.arm, where=is_due, period_s=self._period_s,
                    **{self._actions.mode: numbers[:, item.goals]})
            else:
                robot.command_cartesian.action(
                    item.arm, inside[:, item.goals], where=is_due, period_s=self._period_s)
            if item.gripper.start < item.gripper.stop:
                robot.command.action(
                    f'{item.arm}/gripper', np.repeat(inside[:, item.gripper], item.dof, axis=1),
                    where=is_due, period_s=self._period_s)
