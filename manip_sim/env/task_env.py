# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A task as an environment of gymnasium."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import inspect
import os
import sys
import time
from types import MappingProxyType
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip_sim.errors import DivergenceError, UnknownNameError
from manip_sim.models.composing import compose, DEFAULT, Gripper, Grippers, Robot
from manip_sim.tasks import Episode, Setting, Task
from manip_sim.tasks.late_answers import AnswerTimeLike, NO_ANSWER_TIME
from manip_sim.tasks.latency import LatencyLike, NO_LATENCY
from manip_sim.tasks.observation import Observation
from manip_sim.tasks.pictures import CameraLike, Pictures
from manip_sim.validation import whole_number

#: Seeds that are drawn are below this.
SEEDS = 2**31
#: Lowest and highest numbers of observations by their type: images, depth, labels, all others.
_BOUNDS = {'uint8': (0, 255), 'float32': (0.0, np.inf), 'int32': (-1, np.iinfo(np.int32).max),
           'float64': (-np.inf, np.inf)}
#: A window needs a screen.
_SCREEN = sys.platform != 'linux' or any(os.environ.get(name) for name in (
    'DISPLAY', 'WAYLAND_DISPLAY'))


class TaskEnv(gymnasium.Env[Observation, NDArray[Any]]):
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
        if render_mode is not None and render_mode not in self.metadata['render_modes']:
            raise UnknownNameError('render_mode', render_mode, self.metadata['render_modes'])
        check_keywords(composition, TaskEnv)
        setting = Setting(task, robot, gripper, action, control_hz, latency, tuple(cameras),
                          image_size, composition, noise, answer_time,
                          image_kinds)
        self.episode = setting.create_episode()
        self.task, self.task_description = self.episode.task.name, self.episode.task.instruction
        self._max_episode_steps = self.episode.most_periods
        self._answers = setting.create_answers(self.episode)
        self._asked_s = 0.0
        self.metadata = {**self.metadata, 'render_fps': control_hz}
        self.render_mode = render_mode
        self._view = render_camera, render_size
        self._film: Pictures | None = None
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
        if self.render_mode == 'rgb_array':
            if self._film is None:
                self._film = Pictures(self.episode.simulation, dict([self._view]))
            return self._film.take(self.episode.simulation)[self._view[0]].rgb
        return None

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
        for pictures in (self._film, self.episode.observer.pictures):
            if pictures is not None:
                pictures.close()
        if self._window is not None:
            self._window.close()
        self._film = self._window = None


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
