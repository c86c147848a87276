# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Observations of an episode: arrays by key, in SI units and in frame ``world``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.physics.efforts import ActuatorEfforts, compute
from manip_sim.sensing.images import ImageNoise
from manip_sim.sensing.robot_sensing import RobotSensing
from manip_sim.simulation import Simulation
from manip_sim.simulation.snapshots import Snapshot, take_snapshot
from manip_sim.tasks.pictures import Pictures, PictureThreads
from manip_sim.tasks.task import Task

#: Arrays by key.
Observation = dict[str, NDArray[Any]]
#: Before the name of a camera, the key of its image, of its depth and of its labels.
IMAGE, DEPTH, LABELS = 'image/', 'depth/', 'labels/'
_JOINTS = ('joint_position', 'joint_velocity', 'joint_effort')
#: Channels of an arm, by key.
_OF_ARMS = {'eef_pose': 'pose', 'eef_twist': 'twist', 'external_wrench': 'external_wrench'}


class _Scene(NamedTuple):
    """Surroundings of the robots at an instant: arrays by key, and pictures of cameras."""

    surroundings: Observation
    snapshot: Snapshot


class Observer:
    """
    Reads observations from a simulation.

    The keys are ``joint_position`` [rad or m], ``joint_velocity`` [rad/s or m/s] and
    ``joint_effort`` [N m or N] of all joints, each of shape (n,); by arm with a gripper, by robot,
    ``eef_pose`` (position of ``grip_site`` [m] and quaternion x, y, z, w in ``world``, shape
    (arms, 7)), ``eef_twist`` ([m/s] and [rad/s] in the axes of ``world``, shape (arms, 6)) and
    ``external_wrench`` ([N] and [N m] in ``ft_frame``, shape (arms, 6)); ``object_pose`` (as
    ``eef_pose``, shape (objects, 7)) if there are free bodies; ``goal``, as the task has it; and
    ``image/CAMERA``, rgb, shape (height, width, 3), for each camera. As the pictures have it,
    there are ``depth/CAMERA``, along the view [m], +Inf where there is nothing, and
    ``labels/CAMERA``, ids of bodies, -1 where there is none, each of shape (height, width).

    All is as old as the latency of states of the robots: images as that of the robot that carries
    the camera, objects and the goal as that of the robot of the task. As with the images of the
    node, everything but states of robots is of the present instant after a saved state was
    restored, until measurements from then on have arrived.

    :param pictures: renders the images of cameras; None for no images
    """

    def __init__(self, task: Task, simulation: Simulation,
                 pictures: Pictures | PictureThreads | None = None) -> None:
        self._simulation = simulation
        self.pictures = pictures
        #: Observations to be seen later, by steps from the reset to their instant.
        self._scenes: dict[int, _Scene] = {}
        self._sensing = simulation.robots[task.robot.name_in_world].sensing
        for robot in simulation.robots.values():
            robot.sensing.record_too(self._remember)
        #: Exact readers, of the present instant.
        self._surroundings: dict[str, Callable[[], NDArray[Any]]] = {}
        if simulation.entities.free_names:
            self._surroundings['object_pose'] = self._objects
        if task.goal(simulation).size:
            self._surroundings['goal'] = lambda: task.goal(simulation)

    @property
    def names(self) -> Mapping[str, list[str]]:
        """Names along the first axis of an array, by key; not of goals and images."""
        robots = self._simulation.robots.values()
        joints = [name for robot in robots for name in robot.joint_names]
        arms = [f'{robot.name}/{arm}' for robot in robots for arm in robot.end_effectors]
        return {key: joints if key in _JOINTS else
                self._simulation.entities.free_names if key == 'object_pose' else arms
                for key in (*_JOINTS, *_OF_ARMS, *self._surroundings) if key != 'goal'}

    def read(self) -> Observation:
        """Return the observation of the present instant, copies."""
        return {key: rows[0] for key, rows in observe([self]).items()}

    @property
    def efforts(self) -> ActuatorEfforts:
        """The efforts of the actuators of the simulation."""
        return self._simulation.efforts

    def end_period(self) -> None:
        """Observe what a task has changed at the end of a control period."""
        if self._sensing.count in self._scenes:
            self._remember()

    def surroundings(self) -> Observation:
        """Return objects and the goal as they are seen at present, not to be changed."""
        seen = self._scene(self._sensing)
        return self._look() if seen is None else seen.surroundings

    def _look(self) -> Observation:
        return {key: read() for key, read in self._surroundings.items()}

    def _remember(self) -> None:
        """Keep the present scene, and forget the scenes that nobody sees any more."""
        now = self._sensing.count
        oldest = min(robot.sensing.instant for robot in self._simulation.robots.values())
        self._scenes = {count: scene for count, scene in self._scenes.items()
                        if oldest <= count < now}
        self._scenes[now] = _Scene(self._look(), take_snapshot(self._simulation))

    def _scene(self, sensing: RobotSensing) -> _Scene | None:
        """Return the scene at the latency of a robot; None for the present instant."""
        instant = sensing.instant
        return None if instant == sensing.count else self._scenes.get(instant)

    def images(self, pictures: Pictures) -> Observation:
        """
        Return the images of all cameras.

        :param pictures: of this thread, which render them
        """
        model, scenes, noise = self._simulation.model, {}, {}
        for camera in pictures.cameras:
            sensing = self._simulation.instruments.sensing_of(
                int(model.cam_bodyid[model.camera(camera).id]))
            seen, count = self._scene(sensing), sensing.count
            if seen is not None:
                scenes[camera], count = seen.snapshot, sensing.instant
            # The noise that the node gives it.
            noise[camera] = ImageNoise(
                camera, sensing.seed, count, sensing.settings['noise.pixel'],
                sensing.settings['noise.depth'])
        images: Observation = {}
        for camera, picture in pictures.take(self._simulation, scenes).items():
            if picture.rgb is not None:
                images[f'{IMAGE}{camera}'] = noise[camera].on_colours(picture.rgb)
            if picture.depth is not None:
                images[f'{DEPTH}{camera}'] = noise[camera].on_depth(picture.depth)
            if picture.labels is not None:
                images[f'{LABELS}{camera}'] = picture.labels
        return images

    def joints(self) -> FloatArray:
        """Return positions, velocities and efforts of all joints, shape (3, n)."""
        rows = [robot.measured().reshape(3, -1) for robot in self._simulation.robots.values()]
        return rows[0] if len(rows) == 1 else np.concatenate(rows, axis=1)

    def arms(self, channel: str) -> list[FloatArray]:
        """Return the measurement of a channel for each arm with a gripper."""
        return [robot.sensing.measured(f'{arm}/{channel}')
                for robot in self._simulation.robots.values() for arm in robot.end_effectors]

    def _objects(self) -> NDArray[Any]:
        entities, data = self._simulation.entities, self._simulation.data
        return np.array([entities.pose(data, name) for name in entities.free_names])


def observe(observers: Sequence[Observer]) -> Observation:
    """
    Return the observations of several simulations of one world, at the present instant of each.

    :param observers: of the simulations, with the same pictures
    :returns: the arrays of all with a leading axis, copies
    """
    compute(observer.efforts for observer in observers)
    joints = np.stack([observer.joints() for observer in observers], axis=1)
    observation = dict(zip(_JOINTS, joints))
    for key, channel in _OF_ARMS.items():
        rows = [row for observer in observers for row in observer.arms(channel)]
        observation[key] = np.stack(rows).reshape(len(observers), -1, len(rows[0]))
    others = [[observer.surroundings() for observer in observers]]
    if (pictures := observers[0].pictures) is not None:
        others.append(pictures.each(lambda views, observer: observer.images(views), observers))
    return observation | {key: np.stack([item[key] for item in seen]) for seen in others
                          for key in seen[0]}
