# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An arena from a file, or from another arena and parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.arenas import Arena, create_arena, EmptyArena
from manip_sim.models.files.model_file import keyframes_of
from manip_sim.models.files.part_descriptions import ArenaDescription
from manip_sim.models.loading import compile_spec, load_spec, name_unnamed_elements
from manip_sim.models.object_creation import (
    check_object_names, create_described, FixtureModel, load_objects, ObjectModel)
from manip_sim.models.placements import check_placed, read_placements
from manip_sim.models.robots.robot_model import RobotModel
from manip_sim.quoting import pluralize, quoted

_YAML = ('.yaml', '.yml')


class FileArena(Arena, registered=False):
    """
    The environment of the robots.

    :param file: MJCF; or a YAML file whose description names another arena, or only parts
    :param description: what the YAML file says
    :param where: the file that the description was read from, for messages
    :raises ModelError: if something cannot be read, or does not fit together
    :ivar inferred: the inferences and omissions, in sentences
    """

    def __init__(self, file: Path, description: ArenaDescription, where: str) -> None:
        self._description = description
        self._other: Arena | None = None
        self.inferred: list[str] = []
        for key, kind in (('xacro_args', 'xacro'), ('meshes', 'URDF')):
            if getattr(description, key):
                raise ModelError(f"{where}: '{key}' is for robots, grippers and bases in {kind}; "
                                 'an arena is MJCF')
        if file.suffix.lower() in _YAML:
            self._other = (EmptyArena() if description.arena is None else
                           create_arena(description.arena, **description.parameters))
            self.inferred += getattr(self._other, 'inferred', [])
        elif description.arena is not None or description.parameters:
            raise ModelError(f"{where}: give 'model', or 'arena' with its 'parameters', not both")
        super().__init__(file)
        self.arena_name = file.stem  # type: ignore[misc]
        if self._other is not None:
            self._objects += self._other.objects
            self.placements += self._other.placements
        self._add_parts(Path(where).parent, where)

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.file.stem

    def _read(self) -> Any:
        if self._other is not None:
            self._keyframes = self._other._keyframes
            return self._other._spec.copy()
        spec = load_spec(self.file, self.inferred)
        name_unnamed_elements(spec)
        keys = list(spec.keys)
        if keys:
            self._keyframes = keyframes_of(compile_spec(spec, str(self.file)))
        for key in keys:
            spec.delete(key)
        unnamed = len(keys) - len(self._keyframes)
        if unnamed:
            self.inferred.append(f'left out: {pluralize(unnamed, "keyframe")} without a name')
        return spec

    def _add_parts(self, folder: Path, where: str) -> None:
        """Add the fixtures, objects and placements of the description."""
        for values in self._description.fixtures:
            fixture = create_described(values, FixtureModel, _named('fixture', values, where),
                                       folder)
            self.add_fixture(fixture)
            self.inferred += [f"'{fixture.name}': {said}" for said in fixture.inferred]
        for entry in self._description.objects:
            for item in (load_objects(folder / entry) if isinstance(entry, str) else [
                    create_described(entry, ObjectModel, _named('object', entry, where), folder)]):
                self.add_object(item)
        check_object_names(self._objects)
        self.placements += read_placements(self._description.placements, where)
        check_placed(self.placements, self._objects)

    @property
    def table_length_m(self) -> float:
        """Edge of the table along x [m], zero if there is none."""
        return 0.0 if self._other is None else self._other.table_length_m

    def robot_position(self, robot: RobotModel) -> FloatArray:
        """
        Return the place of a robot in ``world`` [m], shape (3,).

        :param robot: the robot to place
        """
        declared = robot.placement_in(self.arena_name)
        if declared is not None and not callable(declared):
            return np.array(declared)
        if self._description.robot_position is not None:
            return np.array(self._description.robot_position)
        return np.zeros(3) if self._other is None else self._other.robot_position(robot)


def _named(kind: str, values: dict[str, Any], where: str) -> str:
    name = values.get('name')
    return f'{where}: {kind} {"without a name" if name is None else quoted(name)}'
