# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The parts of a world: robots, grippers, bases, arenas and objects; nothing needs ROS."""

from __future__ import annotations

from functools import partial
from typing import Any, TYPE_CHECKING

from manip_sim.models.arenas import Arena, arena_names, arena_parameters, ARENAS, create_arena
from manip_sim.models.bases import BASES
from manip_sim.models.grippers import GRIPPERS
from manip_sim.models.object_creation import create_object, ObjectModel
from manip_sim.models.registry import Registry, set_model_path
from manip_sim.models.robots.robot_model import ROBOTS
from manip_sim.models.urdf_writer import urdf_of
from manip_sim.models.world import compose, compose_robot, World

if TYPE_CHECKING:
    from manip_sim.models.files import load_arena, load_base, load_gripper, load_robot

_LOADERS: dict[str, Registry[Any]] = {
    'load_arena': ARENAS, 'load_base': BASES, 'load_gripper': GRIPPERS, 'load_robot': ROBOTS}


def __getattr__(name: str) -> Any:
    # Imported on first use, because importing pydantic takes a while.
    if name in _LOADERS:
        from manip_sim.models import files
        return getattr(files, name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def _load(loader: str, *arguments: Any, **keywords: Any) -> Any:
    return __getattr__(loader)(*arguments, **keywords)


for _loader, _registry in _LOADERS.items():
    _registry.load_file = partial(_load, _loader)


__all__ = ['Arena', 'ObjectModel', 'World', 'arena_names', 'arena_parameters', 'compose',
           'compose_robot', 'create_arena', 'create_object', 'load_arena', 'load_base',
           'load_gripper', 'load_robot', 'set_model_path', 'urdf_of']
