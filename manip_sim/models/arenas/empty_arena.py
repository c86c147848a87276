# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An arena without furniture."""

from manip_sim.models.arenas.arena import Arena


class EmptyArena(Arena):
    """A floor without furniture."""

    arena_name = 'empty'
