# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An arena from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.arenas import Arena
from manip_sim.models.files.model_file import keyframes_of
from manip_sim.models.files.part_descriptions import ArenaDescription
from manip_sim.models.loading import compile_spec, load_spec, name_unnamed_elements
from manip_sim.models.robots.robot_model import RobotModel


class FileArena(Arena, registered=False):
    """
    What is around the robots.

    :param file: MJCF
    :param description: what the YAML file says
    :ivar inferred: what was left out, in sentences
    """

    def __init__(self, file: Path, description: ArenaDescription) -> None:
        self._description = description
        self.inferred: list[str] = []
        super().__init__(file)
        self.arena_name = file.stem  # type: ignore[misc]

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.file.stem

    def _read(self) -> Any:
        spec = load_spec(self.file)
        name_unnamed_elements(spec)
        keys = list(spec.keys)
        if keys:
            self._keyframes = keyframes_of(compile_spec(spec, str(self.file)))
        for key in keys:
            spec.delete(key)
        unnamed = len(keys) - len(self._keyframes)
        if unnamed:
            self.inferred.append(f'left out: {unnamed} keyframes without a name')
        return spec

    def robot_position(self, robot: RobotModel) -> FloatArray:
        """
        Return the place of a robot in ``world`` [m], shape (3,).

        :param robot: the robot to place
        """
        declared = robot.base_xpos_offset.get(self.arena_name)
        if declared is not None and not callable(declared):
            return np.array(declared)
        return np.array(self._description.robot_position)
