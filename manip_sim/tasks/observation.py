# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Observations of an episode: arrays by key, in SI units and frame ``world``, and images."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
import json
import threading
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar, Union
import weakref

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, SimulationEnded, UnknownNameError
from manip_sim.models.cameras import chosen_cameras, described_cameras
from manip_sim.models.world import World
from manip_sim.physics.efforts import ActuatorEfforts, compute
from manip_sim.rendering import OffscreenRenderer, Picture
from manip_sim.sensing.images import ImageNoise, MAX_PIXELS
from manip_sim.sensing.robot_sensing import RobotSensing
from manip_sim.simulation import Simulation
from manip_sim.simulation.snapshots import Snapshot, take_snapshot, VisibleWorld
from manip_sim.tasks.task import Task
from manip_sim.validation import check_kind, listed

#: Arrays by key.
Observation = dict[str, NDArray[Any]]
#: Before the name of a camera, the key of its image, of its depth and of its labels.
IMAGE, DEPTH, LABELS = 'image/', 'depth/', 'labels/'
_JOINTS = ('joint_position', 'joint_velocity', 'joint_effort')
#: Channels of an arm, by key.
_OF_ARMS = {'eef_pose': 'pose', 'eef_twist': 'twist', 'external_wrench': 'external_wrench'}
#: A camera of the model by its name, or the description of another one, also as YAML.
CameraLike = Union[str, Mapping[str, Any]]
T = TypeVar('T')
R = TypeVar('R')
_CLOSED = 'these pictures are closed'
#: Kinds of images: colours, depth along the view [m], and ids of bodies.
KINDS = ('rgb', 'depth', 'labels')
#: Thread and renderer of pictures that nobody closed. To free a renderer deletes the objects of
#: its numbers in the current context, so it waits until nothing is being rendered.
_LOST: list[tuple[int, OffscreenRenderer]] = []


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


class Pictures:
    """
    Renders cameras of simulations of one world, with an OpenGL context of its own.

    :param simulation: of the world; all whose pictures are taken must have its plan
    :param views: width and height of the images by camera [pixels]
    :param kinds: of images, among :data:`KINDS`
    :raises UnknownNameError: if the camera is unknown
    :raises ManipSimError: if nothing can be rendered
    """

    def __init__(self, simulation: Simulation, views: Mapping[str, tuple[int, int]],
                 kinds: Sequence[str] = ('rgb',)) -> None:
        self._views = dict(views)
        self._kinds = [kind in kinds for kind in KINDS]
        self._world = VisibleWorld(simulation.plan)
        for camera in views:
            if camera not in self._world.cameras:
                raise UnknownNameError('camera', camera, self._world.cameras)
        width, height = np.max(list(views.values()), axis=0).tolist()
        _free_lost()
        renderer = OffscreenRenderer(self._world.model, width, height)
        self._renderer: OffscreenRenderer | None = renderer
        self._lose = weakref.finalize(self, _LOST.append, (threading.get_ident(), renderer))
        self._lose.atexit = False

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras."""
        return list(self._views)

    def take(self, simulation: Simulation, scenes: Mapping[str, Snapshot] = MappingProxyType({})
             ) -> dict[str, Picture]:
        """
        Return what each camera shows.

        :param scenes: what cameras show in place of the present instant, by camera
        :raises SimulationEnded: after :meth:`close`
        """
        if self._renderer is None:
            raise SimulationEnded(_CLOSED)
        _free_lost()
        pictures: dict[str, Picture] = {}
        present, shown = take_snapshot(simulation), None
        for camera, (width, height) in self._views.items():
            if scenes.get(camera, present) is not shown:
                shown = scenes.get(camera, present)
                self._world.show(shown)
            pictures[camera] = self._renderer.render(
                self._world.data, camera, width, height, *self._kinds)
        return pictures

    def each(self, render: Callable[[Pictures, T], R], items: Sequence[T]) -> list[R]:
        """Render for several items, as :meth:`PictureThreads.each` does."""
        return [render(self, item) for item in items]

    def close(self) -> None:
        """Free the OpenGL resources; nothing happens the second time."""
        if self._renderer is not None:
            self._lose.detach()
            self._renderer.close()
            self._renderer = None


class PictureThreads:
    """
    Renders in several threads at once, each with :class:`Pictures` of its own: the same pixels.

    :param create: makes the pictures of a thread, in that thread
    :param count: number of threads
    :raises ManipSimError: if nothing can be rendered
    """

    def __init__(self, create: Callable[[], Pictures], count: int) -> None:
        self._threads = [ThreadPoolExecutor(1, 'manip_sim_pictures') for _ in range(count)]
        self._own: list[Pictures] = []
        try:
            for thread in self._threads:
                self._own.append(thread.submit(create).result())
        except BaseException:
            self.close()
            raise

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras."""
        return self._own[0].cameras

    def each(self, render: Callable[[Pictures, T], R], items: Sequence[T]) -> list[R]:
        """
        Render for several items; a thread takes every n-th of them.

        :param render: gets the pictures of the thread and an item
        :returns: what it returns, in the order of the items
        :raises SimulationEnded: after :meth:`close`
        """
        if not self._own:
            raise SimulationEnded(_CLOSED)
        count = len(self._threads)
        work = [thread.submit(pictures.each, render, items[begin::count])
                for begin, (thread, pictures) in enumerate(zip(self._threads, self._own))]
        wait(work)
        shares = [share.result() for share in work]
        return [shares[number % count][number // count] for number in range(len(items))]

    def close(self) -> None:
        """Free the OpenGL resources and end the threads; nothing happens the second time."""
        for thread, pictures in zip(self._threads, self._own):
            with suppress(RuntimeError):  # As the interpreter ends, its threads have ended.
                thread.submit(pictures.close).result()
        self._own = []
        for thread in self._threads:
            thread.shutdown()


def _free_lost() -> None:
    """Free the lost renderers of this thread; another context is current afterwards."""
    for lost in [lost for lost in _LOST if lost[0] == threading.get_ident()]:
        _LOST.remove(lost)
        lost[1].close()


def descriptions(cameras: Iterable[CameraLike]) -> list[dict[str, Any]]:
    """
    Return the descriptions among some cameras, as ``compose`` takes them.

    :raises ModelError: if one is not YAML
    """
    return described_cameras(_texts(cameras))


def views_of(cameras: Iterable[CameraLike], world: World, simulation: Simulation,
             image_size: tuple[int, int] | None = None) -> dict[str, tuple[int, int]]:
    """
    Return width and height of the images [pixels], by camera.

    :param world: composed with those descriptions
    :param image_size: width and height of all images; None for the sizes of the cameras, as the
        node has them
    :raises UnknownNameError: if the camera is unknown
    :raises ModelError: if a camera is chosen twice, or its name or the size cannot be used
    """
    if image_size is not None and not (
            isinstance(image_size, Sequence) and len(image_size) == 2 and all(
                isinstance(edge, int) and 1 <= edge <= MAX_PIXELS for edge in image_size)):
        raise ModelError(f'image_size must be width and height from 1 to {MAX_PIXELS} pixels, got '
                         f'{image_size!r:.60}')
    chosen = chosen_cameras(_texts(cameras), world.cameras, simulation.model)
    return {name: image_size or (images.width, images.height) for name, images in chosen.items()}


def checked_kinds(kinds: Sequence[str]) -> tuple[str, ...]:
    """
    Return kinds of images, in the order of :data:`KINDS`.

    :raises UnknownNameError: if one is not known
    :raises ModelError: if there is none, or one twice
    """
    kinds = kinds if isinstance(kinds, str) else listed(kinds, 'image_kinds')
    for kind in [kinds] if isinstance(kinds, str) else kinds:
        if not isinstance(kind, str) or kind not in KINDS:
            raise UnknownNameError('kind of images', kind, KINDS)
    if isinstance(kinds, str) or not kinds or len(set(kinds)) < len(kinds):
        raise ModelError(f'image_kinds must be one or several of {", ".join(KINDS)}, each once, '
                         f'in a list, got {kinds!r:.60}')
    return tuple(kind for kind in KINDS if kind in kinds)


def _texts(cameras: Iterable[CameraLike]) -> list[str]:
    for camera in cameras:
        check_kind(camera, (str, Mapping), 'each of the cameras', 'a name or a description')
    return [camera if isinstance(camera, str) else json.dumps(dict(camera), default=_plain)
            for camera in cameras]


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)
