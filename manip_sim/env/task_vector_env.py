# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Many episodes of a task at once as a vector environment of gymnasium, on ``Worlds``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
import time
from types import MappingProxyType
from typing import Any

import gymnasium
from gymnasium.vector.utils import batch_space
import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip_sim.env.task_env import (
    action_space, check_keywords, check_options, observation_space, SEEDS)
from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.models.composing import DEFAULT, Gripper, Grippers, Robot
from manip_sim.tasks import Episode, Setting, Task
from manip_sim.tasks.late_answers import AnswerTimeLike, NO_ANSWER_TIME
from manip_sim.tasks.latency import LatencyLike, NO_LATENCY
from manip_sim.tasks.observation import Observation
from manip_sim.tasks.pictures import CameraLike, Pictures
from manip_sim.validation import whole_number
from manip_sim.worlds import Worlds

_Result = tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]


class TaskVectorEnv(gymnasium.vector.VectorEnv[Observation, NDArray[Any], NDArray[Any]]):
    """
    Episodes of a task, many at once in this process; each as :class:`TaskEnv` has it, to the bit.

    ``reset(seed=n)`` begins the episodes of the seeds n, n + 1, ...; a list has one seed for each.
    An environment whose episode has ended begins the next one in the next ``step``, which ignores
    its action (gymnasium's ``AutoresetMode.NEXT_STEP``).

    :param task: its name, or an instance
    :param num_envs: number of episodes at once
    :param threads: that compute the physics; None for one per processor
    :param robot: as this and what follows for :class:`TaskEnv`
    :param gripper: as for ``compose``
    :param action: ``osc_pose``, ``joint_position``, ``joint_velocity`` or ``joint_effort``
    :param control_hz: actions per second of simulated time [Hz]
    :param latency: of commands [s], or a mapping with ``command`` and ``state``
    :param cameras: whose images are observed
    :param image_size: width and height of images [pixels]; None for those of the cameras
    :param render_mode: ``rgb_array``, or None
    :param render_camera: what ``rgb_array`` shows
    :param render_size: its width and height [pixels]
    :param noise: of what is observed, by the names of the node's parameters, such as
        ``noise.joint_position``
    :param answer_time: how long the policy thinks in simulated time [s]; ``measured`` is the wall
        time between two steps, for all of them
    :param chunk: number of actions that :meth:`step` takes at once of each, shape (num_envs,
        chunk, n)
    :param composition: what else ``compose`` takes
    :raises ManipSimError: if something cannot be used, with what fits
    :ivar worlds: the worlds, one for each episode
    :ivar task: name of the task
    :ivar task_description: what to do, as one would say it
    """

    metadata: dict[str, Any] = {
        'render_modes': ['rgb_array'], 'render_fps': 20,
        'autoreset_mode': gymnasium.vector.AutoresetMode.NEXT_STEP}

    def __init__(self, task: str | Task, num_envs: int = 1, robot: Robot = 'Panda',
                 gripper: Gripper | Grippers = DEFAULT, action: str = 'osc_pose',
                 control_hz: float = 20.0, latency: LatencyLike = NO_LATENCY,
                 cameras: Sequence[CameraLike] = (), image_size: tuple[int, int] | None = None,
                 render_mode: str | None = None, render_camera: str = 'frontview',
                 render_size: tuple[int, int] = (480, 360), threads: int | None = None,
                 noise: Mapping[str, float] = MappingProxyType({}),
                 answer_time: AnswerTimeLike = NO_ANSWER_TIME, chunk: int | None = None,
                 **composition: Any) -> None:
        if render_mode is not None and render_mode not in self.metadata['render_modes']:
            raise UnknownNameError('render_mode', render_mode, self.metadata['render_modes'])
        check_keywords(composition, TaskVectorEnv)
        setting = Setting(task, robot, gripper, action, control_hz, latency, tuple(cameras),
                          image_size, composition, noise, answer_time)
        made = setting.create_task()
        self.worlds = Worlds(made.world, whole_number(num_envs, 1, 'num_envs'), threads)
        pictures = setting.create_pictures(self.worlds.simulations[0], made)
        self._episodes = [setting.create_episode(made, simulation, pictures)
                          for simulation in self.worlds.simulations]
        self._answers = [setting.create_answers(episode) for episode in self._episodes]
        self._asked_s = 0.0
        self.task, self.task_description = made.name, made.instruction
        self._max_episode_steps = self._episodes[0].most_periods
        self.num_envs = len(self._episodes)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, 'render_fps': control_hz}
        self._view = render_camera, render_size
        self._film: Pictures | None = None
        self._randoms = [np.random.default_rng() for _ in self._episodes]
        #: Of each environment: whether it has begun, and whether the next step resets it.
        self._begun = np.zeros(self.num_envs, dtype=bool)
        self._ended = np.zeros(self.num_envs, dtype=bool)
        first = self._episodes[0]
        self.single_action_space = action_space(first, chunk)
        self.single_observation_space = observation_space(first.observation)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    @property
    def episodes(self) -> tuple[Episode, ...]:
        """The episodes, each with its simulation."""
        return tuple(self._episodes)

    def reset(self, *, seed: int | Sequence[int | None] | None = None,
              options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """
        Begin an episode in each environment.

        :param seed: of the first one, the others follow; or one for each; None draws them
        :param options: none are known
        :raises UnknownNameError: if there are options
        :raises ModelError: if there is not one seed for each environment
        """
        check_options(options)
        seeds = ([None] * self.num_envs if seed is None else
                 [seed + i for i in range(self.num_envs)] if isinstance(seed, (int, np.integer))
                 else list(seed))
        if len(seeds) != self.num_envs:
            raise ModelError(f'expected {self.num_envs} seeds, one for each environment, got '
                             f'{len(seeds)}')
        infos: dict[str, Any] = {}
        for index, own in enumerate(seeds):
            infos = self._add_info(infos, self._begin(index, own), index)
        observation = self._observation()
        self._asked_s = time.perf_counter()
        return observation, infos

    def _begin(self, index: int, seed: int | None) -> dict[str, Any]:
        if seed is not None:
            self._randoms[index], _ = gymnasium.utils.seeding.np_random(seed)
        own = int(self._randoms[index].integers(SEEDS)) if seed is None else int(seed)
        episode = self._episodes[index]
        episode.reset(own)
        self._answers[index].reset(own)
        self._begun[index], self._ended[index] = True, False
        success = episode.success
        return {'seed': own, 'success': success, 'is_success': success, 'digest': episode.digest}

    def step(self, actions: ArrayLike) -> _Result:
        """
        Take an action in each environment and advance by one control period.

        With an answer time or chunks, each advances until its policy is asked again.

        :param actions: shape (num_envs, n), or (num_envs, chunk, n); numbers beyond the space are
            clamped
        :raises gymnasium.error.ResetNeeded: if no episode has begun
        :raises CommandError: if an action cannot be used, naming its row; then nothing changes
        """
        if not self._begun.all():
            raise gymnasium.error.ResetNeeded('call reset() before step()')
        acting = ~self._ended
        self._take(actions, acting)
        rewards, infos = self._advance(acting), dict[str, Any]()
        terminated, truncated = (np.zeros(self.num_envs, dtype=bool) for _ in range(2))
        for index, episode in enumerate(self._episodes):
            if not acting[index]:
                info = self._begin(index, None)
            else:
                diverged = episode.simulation.diverged
                terminated[index] = diverged is None and episode.success
                truncated[index] = diverged is not None or episode.time_is_up
                info = {} if diverged is None else {'diverged': diverged}
                info['success'] = info['is_success'] = episode.success
                self._ended[index] = terminated[index] or truncated[index]
                if self._ended[index]:
                    info['digest'] = episode.digest
            infos = self._add_info(infos, info, index)
        observation = self._observation()
        self._asked_s = time.perf_counter()
        return observation, rewards, terminated, truncated, infos

    def _advance(self, acting: NDArray[np.bool_]) -> NDArray[Any]:
        """Run some worlds until their policies are asked, and return the sums of rewards."""
        rewards, running = np.zeros(self.num_envs), acting.copy()
        while running.any():
            self._run_period(running)
            for index in np.flatnonzero(running):
                episode = self._episodes[index]
                if episode.simulation.diverged is not None:
                    rewards[index], running[index] = 0.0, False
                    continue
                rewards[index] += episode.reward
                running[index] = not (self._answers[index].asks or episode.over)
        return rewards

    def _run_period(self, running: NDArray[np.bool_]) -> None:
        """Run a control period in some worlds, which all divide it alike."""
        indices = np.flatnonzero(running)
        for index in indices:
            self._answers[index].begin_period()
        for steps, *_ in zip_longest(*(self._episodes[index].period() for index in indices)):
            self.worlds.advance(steps, where=running)  # It runs all of them to their ends.

    def _take(self, actions: ArrayLike, acting: NDArray[np.bool_]) -> None:
        try:
            numbers = np.asarray(actions, dtype=float)
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
        for index in np.flatnonzero(acting):
            self._answers[index].answer(numbers[index], took_s)

    def _observation(self) -> Observation:
        each = [episode.observation for episode in self._episodes]
        return {key: np.stack([one[key] for one in each]) for key in each[0]}

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """
        Return an attribute, such as ``task``, once for each environment.

        :param name: of the attribute
        :raises AttributeError: if there is none
        """
        return (getattr(self, name),) * self.num_envs

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """
        Return what a method, such as ``digest``, says of each environment; or an attribute.

        :param name: of the method or attribute
        :param args: of the method
        :param kwargs: of the method
        :raises AttributeError: if there is none
        """
        found = getattr(self, name)
        return tuple(found(*args, **kwargs)) if callable(found) else self.get_attr(name)

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
        if self._film is None:
            self._film = Pictures(self.worlds.simulations[0], dict([self._view]))
        return tuple(self._film.take(simulation)[self._view[0]]
                     for simulation in self.worlds.simulations)

    def close_extras(self, **kwargs: Any) -> None:
        """
        End the threads, and free what rendering needs.

        :param kwargs: not used
        """
        self.worlds.close()
        for pictures in (self._film, self._episodes[0].observer.pictures):
            if pictures is not None:
                pictures.close()
