# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Observations of an episode: arrays by key, in SI units and in frame ``world``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.sensing.images import ImageNoise
from manip_sim.simulation import Simulation
from manip_sim.tasks.pictures import Pictures
from manip_sim.tasks.task import Task

#: Arrays by key.
Observation = dict[str, NDArray[Any]]
#: Before the name of a camera, the key of its image.
IMAGE = 'image/'


class Observer:
    """
    Reads observations from a simulation.

    The keys are ``joint_position`` [rad or m], ``joint_velocity`` [rad/s or m/s] and
    ``joint_effort`` [N m or N] of all joints, each of shape (n,); by arm with a gripper, by robot,
    ``eef_pose`` (position of ``grip_site`` [m] and quaternion x, y, z, w in ``world``, shape
    (arms, 7)), ``eef_twist`` ([m/s] and [rad/s] in the axes of ``world``, shape (arms, 6)) and
    ``external_wrench`` ([N] and [N m] in ``ft_frame``, shape (arms, 6)); ``object_pose`` (as
    ``eef_pose``, shape (objects, 7)) if there are free bodies; ``goal``, as the task has it; and
    ``image/CAMERA``, rgb, shape (height, width, 3), for each camera.

    :param pictures: renders the images of cameras; None for no images
    """

    def __init__(self, task: Task, simulation: Simulation, pictures: Pictures | None = None
                 ) -> None:
        self._simulation = simulation
        self.pictures = pictures
        self._readers: dict[str, Callable[[], NDArray[Any]]] = {
            'joint_position': lambda: self._joints(0), 'joint_velocity': lambda: self._joints(1),
            'joint_effort': lambda: self._joints(2), 'eef_pose': lambda: self._ends('pose'),
            'eef_twist': lambda: self._ends('twist'),
            'external_wrench': lambda: self._ends('external_wrench')}
        if simulation.entities.free_names:
            self._readers['object_pose'] = self._objects
        if task.goal(simulation).size:
            self._readers['goal'] = lambda: task.goal(simulation)

    @property
    def names(self) -> Mapping[str, list[str]]:
        """Names along the first axis of an array, by key; not of goals and images."""
        robots = self._simulation.robots.values()
        joints = [name for robot in robots for name in robot.joint_names]
        arms = [f'{robot.name}/{arm}' for robot in robots for arm in robot.end_effectors]
        return {key: joints if key.startswith('joint') else
                self._simulation.entities.free_names if key == 'object_pose' else arms
                for key in self._readers if key != 'goal'}

    def read(self) -> Observation:
        """Return the observation of the present instant, copies."""
        found = {key: read() for key, read in self._readers.items()}
        if self.pictures is not None:
            for camera, image in self.pictures.take(self._simulation).items():
                found[f'{IMAGE}{camera}'] = self._measured(camera, image)
        return found

    def _measured(self, camera: str, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return an image with the noise that the node gives it."""
        model = self._simulation.model
        sensing = self._simulation.instruments.sensing_of(
            int(model.cam_bodyid[model.camera(camera).id]))
        pixel = sensing.settings['noise.pixel']
        return ImageNoise(camera, sensing.seed, sensing.count, pixel, 0.0).on_colours(image)

    def _joints(self, row: int) -> NDArray[Any]:
        return np.concatenate([robot.measured().reshape(3, -1)[row]
                               for robot in self._simulation.robots.values()])

    def _ends(self, what: str) -> NDArray[Any]:
        return np.stack([robot.sensing.measured(f'{arm}/{what}')
                         for robot in self._simulation.robots.values()
                         for arm in robot.end_effectors])

    def _objects(self) -> NDArray[Any]:
        entities, data = self._simulation.entities, self._simulation.data
        return np.stack([entities.pose(data, name) for name in entities.free_names])
