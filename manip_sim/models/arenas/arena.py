# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What all arenas share: objects of their own, and the places of robots."""

from __future__ import annotations

from os import PathLike
from typing import Any, ClassVar

import mujoco

from manip_sim.arrays import FloatArray
from manip_sim.models.arena_parameters import ArenaParameter
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.object_model import ObjectModel
from manip_sim.models.registry import Registry
from manip_sim.models.robots.robot_model import RobotModel
from manip_sim.models.spec_edits import begin_like
from manip_sim.models.validation import finite_numbers
from manip_sim.resources import asset_path


class Arena(MujocoXMLModel):
    """
    What is around the robots; its names have no prefix.

    A subclass declares :attr:`arena_name`, its key in a robot's ``base_xpos_offset``, and
    :attr:`parameters`, those of its constructor. It is created by its name; one that inherits the
    name cannot be created by it.

    :param fname: path of an MJCF file; by default that in ``assets/arenas`` with the arena's name
    """

    arena_name: ClassVar[str]
    parameters: ClassVar[tuple[ArenaParameter, ...]] = ()

    def __init_subclass__(cls, registered: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if registered:
            ARENAS.register(cls)

    def __init__(self, fname: str | PathLike[str] | None = None) -> None:
        super().__init__(fname or asset_path('arenas', self.arena_name))
        self._objects: list[ObjectModel] = []

    @property
    def objects(self) -> list[ObjectModel]:
        """The objects that belong to this arena, which worlds attach after the robots; a copy."""
        return list(self._objects)

    @property
    def naming_prefix(self) -> str:
        """Empty: the names of an arena have no prefix."""
        return ''

    def robot_position(self, robot: RobotModel) -> FloatArray:
        """
        Return the place of a robot in ``world`` [m], shape (3,).

        :param robot: the robot to place
        """
        placement = robot.base_xpos_offset.get(self.arena_name, (0.0, 0.0, 0.0))
        return finite_numbers(
            placement(self.table_length_m) if callable(placement) else placement, 3,
            f"base_xpos_offset['{self.arena_name}'] of {robot.name}")

    @property
    def table_length_m(self) -> float:
        """Edge of the table along x [m], zero if there is none."""
        return 0.0

    def _lift_cameras(self, higher_m: float) -> None:
        """Raise the cameras by as much as the furniture is higher than in the file."""
        for camera in self._spec.cameras:
            camera.pos[2] += higher_m

    def empty_spec(self) -> mujoco.MjSpec:
        """Return a new spec with the options and visual settings of the arena and nothing else."""
        return begin_like(self._spec)

    def compose(self) -> mujoco.MjSpec:
        """Return a new spec of the arena with its objects."""
        spec = self._spec.copy()
        for item in self._objects:
            item.attach(spec)
        return spec


ARENAS: Registry[Arena] = Registry(
    'arena', Arena, takes=(), key=lambda cls: cls.__dict__.get('arena_name'))
