# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Images of a world's cameras, rendered when they are asked for, in the thread that asks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
import json
import threading
from types import MappingProxyType
from typing import Any, TypeVar, Union
import weakref

import numpy as np

from manip_sim.errors import ModelError, SimulationEnded, UnknownNameError
from manip_sim.models.cameras import chosen_cameras, described_cameras
from manip_sim.models.world import World
from manip_sim.rendering.offscreen import OffscreenRenderer, Picture
from manip_sim.sensing.images import MAX_PIXELS
from manip_sim.simulation import Simulation
from manip_sim.simulation.snapshots import Snapshot, take_snapshot, VisibleWorld

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
    if image_size is not None and not (len(image_size) == 2 and all(
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
    for kind in [kinds] if isinstance(kinds, str) else kinds:
        if kind not in KINDS:
            raise UnknownNameError('kind of images', kind, KINDS)
    if isinstance(kinds, str) or not kinds or len(set(kinds)) < len(kinds):
        raise ModelError(f'image_kinds must be one or several of {", ".join(KINDS)}, each once, '
                         f'in a list, got {kinds!r:.60}')
    return tuple(kind for kind in KINDS if kind in kinds)


def _texts(cameras: Iterable[CameraLike]) -> list[str]:
    return [camera if isinstance(camera, str) else json.dumps(dict(camera)) for camera in cameras]
