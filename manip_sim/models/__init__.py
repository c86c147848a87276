# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Models say what exists: MuJoCo and numpy only, no ROS and no stepping."""

from __future__ import annotations

from manip_sim.models.arenas import Arena, arena_names, arena_parameters, create_arena
from manip_sim.models.composing import compose, compose_robot
from manip_sim.models.objects import create_object, ObjectModel
from manip_sim.models.world import World

__all__ = ['Arena', 'ObjectModel', 'World', 'arena_names', 'arena_parameters', 'compose',
           'compose_robot', 'create_arena', 'create_object']
