# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tell what a model lacks because its files are missing or cannot be read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TYPE_CHECKING

from manip_sim.quoting import counted, quoted

if TYPE_CHECKING:  # It reads models that say what they lost.
    from manip_sim.models.robots import RobotModel
    from manip_sim.models.world import World

#: What a file holds in a clone of a repository whose large files were not fetched.
_POINTER = b'version https://git-lfs'


class LostShape(str):
    """A sentence about what a model lost with a missing file, which is logged as a warning."""

    __slots__ = ()


class MissingMeshError(Exception):
    """
    A mesh is missing or cannot be read.

    :param remedy: what to do, or empty
    :param cause: the same for all meshes that this remedies together
    """

    def __init__(self, why: str, remedy: str = '', cause: str = '') -> None:
        super().__init__(why)
        self.why, self.remedy, self.cause = why, remedy, cause


@dataclass(frozen=True)
class Lost:
    """
    A shape or texture that was left out.

    :ivar kind: ``visual shape``, ``collision shape``, ``texture`` or ``skin``
    :ivar mesh: name of its file
    :ivar element: what has it, such as ``link 'base'``
    """

    kind: str
    mesh: str
    element: str
    error: MissingMeshError


def check_fetched(mesh: Path) -> None:
    """
    Check that a file is there whole.

    :raises MissingMeshError: if it is not, or only says where Git's large file storage has it
    """
    if not mesh.exists():
        raise MissingMeshError(f'no such file: {mesh}', 'put it there, or correct its name',
                               'file')
    try:
        with mesh.open('rb') as stream:
            is_pointer = stream.read(len(_POINTER)) == _POINTER
    except OSError:
        return  # Whoever reads it tells why.
    if is_pointer:
        raise MissingMeshError(f'{mesh} was not fetched from Git LFS',
                               f"run 'git lfs pull' in {mesh.parent}", 'lfs')


def warnings_of(every: Iterable[Lost], file: Path) -> list[str]:
    """Return a sentence for each kind and cause."""
    groups: dict[tuple[str, str], list[Lost]] = {}
    for lost in every:
        groups.setdefault((lost.kind, lost.error.cause), []).append(lost)
    found = []
    # Lost collision shapes change what happens, so they come first.
    for (kind, _), group in sorted(groups.items(), key=lambda item: item[0][0]):
        first = group[0]
        untouched = '; nothing touches these links there' if kind == 'collision shape' else ''
        remedy = f'; {first.error.remedy}' if first.error.remedy else ''
        found.append(f'left out: {counted(len(group), kind)} of files that cannot be '
                     f'read, such as {quoted(first.mesh)} ({first.error.why}) of '
                     f'{first.element} in {file}{untouched}{remedy}')
    return found


def inferred_by_model(world: World, robot: RobotModel | None = None
                      ) -> Iterator[tuple[str, list[str]]]:
    """
    Yield the name of each model of a world, and the sentences on what was inferred of it.

    :param robot: whose models are meant; None: the whole world
    """
    robots = world.robots if robot is None else [robot]
    models: list[Any] = [*([world.arena, *world.objects] if robot is None else ()), *robots]
    for model in (*models, *(part for robot in robots for part in robot.models)):
        yield model.name, getattr(model, 'inferred', None) or []


def lost_shapes(world: World, robot: RobotModel | None = None) -> list[str]:
    """
    Return which shapes the models of a world lack because their files cannot be read.

    :param robot: whose models are meant; None: the whole world
    """
    return [f'{name}: {sentence}' for name, sentences in inferred_by_model(world, robot)
            for sentence in sentences if isinstance(sentence, LostShape)]
