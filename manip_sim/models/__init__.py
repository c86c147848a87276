# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The parts of a world: robots, grippers, bases, arenas and objects; nothing needs ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING

from manip_sim.models.arenas import Arena, arena_names, arena_parameters, create_arena
from manip_sim.models.composing import compose, compose_robot
from manip_sim.models.object_creation import create_object, ObjectModel
from manip_sim.models.sources import set_model_path
from manip_sim.models.world import World

if TYPE_CHECKING:
    from manip_sim.models.files import load_arena, load_base, load_gripper, load_robot

_OF_FILES = ('load_arena', 'load_base', 'load_gripper', 'load_robot')


def __getattr__(name: str) -> object:
    # Imported on first use, because importing pydantic takes a while.
    if name in _OF_FILES:
        from manip_sim.models import files
        return getattr(files, name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


__all__ = ['Arena', 'ObjectModel', 'World', 'arena_names', 'arena_parameters', 'compose',
           'compose_robot', 'create_arena', 'create_object', 'load_arena', 'load_base',
           'load_gripper', 'load_robot', 'set_model_path']
