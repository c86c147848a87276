# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Environments of the tasks for LeRobot's commands: ``--env.type=manip_sim``; it needs LeRobot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from manip_sim.env.lerobot_env import make_env

#: Key and type of each kind of observation in LeRobot, by ours.
_KINDS = {'agent_pos': (OBS_STATE, FeatureType.STATE),
          'environment_state': (OBS_ENV_STATE, FeatureType.ENV)}


@EnvConfig.register_subclass('manip_sim')
@dataclass
class ManipSimEnvConfig(EnvConfig):
    """
    Environments of a task, as ``make_env`` makes them.

    :ivar task: such as ``pick_cube``
    :ivar fps: actions per second of simulated time [Hz]
    :ivar robot: such as ``Panda``
    :ivar action: what actions mean, one of ``manip_sim.tasks.ACTIONS``
    :ivar cameras: whose images are observed
    :ivar image_size: width and height of images [pixels]
    """

    task: str | None = 'pick_cube'
    fps: int = 20
    robot: str = 'Panda'
    action: str = 'osc_pose'
    cameras: list[str] = field(default_factory=lambda: ['agentview'])
    image_size: tuple[int, int] = (128, 128)

    def __post_init__(self) -> None:
        ((envs,),) = (by_number.values() for by_number in self.create_envs(1).values())
        size = envs.single_action_space.shape
        self.features = {ACTION: PolicyFeature(type=FeatureType.ACTION, shape=size)}
        self.features_map = {ACTION: ACTION}
        for key, name, kind, shape in _observed(envs.single_observation_space):
            self.features[key] = PolicyFeature(type=kind, shape=shape)
            self.features_map[key] = name
        envs.close()

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """None: environments are not made by ``gymnasium.make``."""
        return {}

    def create_envs(self, n_envs: int, use_async_envs: bool = False
                    ) -> Mapping[str, Mapping[int, gymnasium.vector.VectorEnv[Any, Any, Any]]]:
        """
        Return a vector environment by task and 0.

        :param n_envs: number of environments in it
        :param use_async_envs: whether each is in a process of its own
        :raises ManipSimError: if something cannot be used, with what fits
        """
        return make_env(
            n_envs, use_async_envs and n_envs > 1, task=self.task or 'pick_cube',
            robot=self.robot, action=self.action, control_hz=float(self.fps),
            cameras=self.cameras, image_size=self.image_size if self.cameras else None)


def _observed(space: Any) -> Iterator[tuple[str, str, Any, tuple[int, ...]]]:
    """Yield the key, LeRobot's key, type and shape of each observation."""
    for key, part in space.items():
        if isinstance(part, gymnasium.spaces.Dict):
            for camera, image in part.items():
                yield (f'{key}/{camera}', f'{OBS_IMAGES}.{camera}', FeatureType.VISUAL,
                       tuple(image.shape or ()))
        else:
            yield key, *_KINDS[key], tuple(part.shape or ())
