# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Environments with the keys that LeRobot's evaluator reads; nothing of LeRobot is imported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from manip_sim.env.task_env import TaskEnv
from manip_sim.models.world import Robot
from manip_sim.tasks.observation import CameraLike, IMAGE, Observation
from manip_sim.validation import whole_number

#: Beginning of LeRobot's own options of a reset, which mean nothing here.
_OWN_OPTIONS = 'lerobot_'


class LeRobotEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """
    An environment of a task whose observations have LeRobot's names.

    ``agent_pos`` has the positions of all joints, then the poses of the end effectors;
    ``environment_state`` the poses of objects, then the goal; ``pixels`` the images by camera.
    LeRobot makes ``observation.state``, ``observation.environment_state`` and
    ``observation.images.<camera>`` of them, in the same order as ``manip_sim convert``.

    :param env: the environment
    """

    def __init__(self, env: TaskEnv) -> None:
        super().__init__(env)
        self.task, self.task_description = env.task, env.task_description
        self._max_episode_steps = env._max_episode_steps
        self.observation_space = _space(self._renamed(env.episode.observation))

    def _renamed(self, observation: Observation) -> dict[str, Any]:
        renamed: dict[str, Any] = {'agent_pos': np.concatenate([
            observation['joint_position'], observation['eef_pose'].ravel()])}
        surroundings = [observation[key].ravel() for key in ('object_pose', 'goal')
                        if key in observation]
        if surroundings:
            renamed['environment_state'] = np.concatenate(surroundings)
        images = {key.removeprefix(IMAGE): value for key, value in observation.items()
                  if key.startswith(IMAGE)}
        return {**renamed, 'pixels': images} if images else renamed

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
              ) -> tuple[dict[str, Any], dict[str, Any]]:
        """
        Begin an episode.

        :param seed: whose start it has; None draws one
        :param options: LeRobot's own are ignored
        :raises UnknownNameError: if there are other options
        """
        task_options = {key: value for key, value in (options or {}).items()
                        if not key.startswith(_OWN_OPTIONS)}
        observation, info = self.env.reset(seed=seed, options=task_options)
        return self._renamed(observation), info

    def step(self, action: NDArray[Any]) -> tuple[dict[str, Any], float, bool, bool,
                                                  dict[str, Any]]:
        """
        Take an action.

        :param action: as for ``TaskEnv``
        :raises CommandError: if it cannot be used; then nothing changes
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._renamed(observation), float(reward), terminated, truncated, info


def _space(observation: Mapping[str, Any]) -> gymnasium.spaces.Dict:
    return gymnasium.spaces.Dict({
        key: _space(value) if isinstance(value, dict) else
        gymnasium.spaces.Box(0, 255, value.shape, np.uint8) if value.dtype == np.uint8 else
        gymnasium.spaces.Box(-np.inf, np.inf, value.shape, np.float64)
        for key, value in observation.items()})


def create_env(task: str, keywords: Mapping[str, Any]) -> LeRobotEnv:
    """
    Return one environment.

    :param task: such as ``pick_cube``
    :param keywords: of ``TaskEnv``
    :raises ManipSimError: if something cannot be used, with what fits
    """
    return LeRobotEnv(TaskEnv(task, **keywords))


def make_env(n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None,
             task: str = 'pick_cube', robot: Robot = 'Panda',
             cameras: Sequence[CameraLike] = ('agentview',),
             image_size: tuple[int, int] | None = (128, 128), **keywords: Any
             ) -> dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]]:
    """
    Return environments as the entry point of an environment of LeRobot's EnvHub does.

    :param n_envs: number of environments
    :param use_async_envs: whether each is in a process of its own
    :param cfg: a configuration of LeRobot, whose ``task`` is taken if it has one
    :param task: such as ``pick_cube``
    :param robot: as this and what follows for ``TaskEnv``
    :param cameras: whose images are observed
    :param image_size: width and height of images [pixels]; None for the cameras' own
    :param keywords: others of ``TaskEnv``, such as ``control_hz``
    :returns: a vector environment, by task and 0
    :raises ManipSimError: if something cannot be used, with what fits
    """
    task = getattr(cfg, 'task', None) or task
    arguments = {'robot': robot, 'cameras': cameras, 'image_size': image_size,
                 'render_mode': 'rgb_array', **keywords}
    makers = [partial(create_env, task, arguments)] * whole_number(n_envs, 1, 'n_envs')
    mode = gymnasium.vector.AutoresetMode.SAME_STEP
    if use_async_envs and n_envs > 1:
        return {task: {0: gymnasium.vector.AsyncVectorEnv(
            makers, context='spawn', autoreset_mode=mode)}}
    return {task: {0: gymnasium.vector.SyncVectorEnv(makers, autoreset_mode=mode)}}
