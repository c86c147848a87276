# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Two bins side by side."""

from __future__ import annotations

from manip_sim.models.arena_parameters import ArenaParameter, check_arguments
from manip_sim.models.arenas.arena import Arena

#: Height of the bins' floors above the floor in their file [m].
_BIN_HEIGHT_M = 0.82


class BinsArena(Arena):
    """
    An open bin, ``bin1``, and one with four compartments, ``bin2``, side by side.

    :param bin_height_m: height of the bins' floors above the floor [m]
    :param friction: sliding friction of floors and walls
    :raises ModelError: naming parameter and limits
    """

    arena_name = 'bins'
    parameters = (
        ArenaParameter('bin_height', _BIN_HEIGHT_M, "height of the bins' floors above the floor",
                       'm', 0.1, 2.0, 'bin_height_m'),
        ArenaParameter('friction', 1.0, 'sliding friction of floors and walls', '', 0.0, 10.0))

    def __init__(self, bin_height_m: float = _BIN_HEIGHT_M, *, friction: float = 1.0) -> None:
        check_arguments(self.parameters, self.arena_name, bin_height_m=bin_height_m,
                        friction=friction)
        super().__init__()
        higher = bin_height_m - _BIN_HEIGHT_M
        self._lift_cameras(higher)
        for bin_ in (self._spec.body('bin1'), self._spec.body('bin2')):
            bin_.pos[2] += higher
            for geom in bin_.geoms:
                if geom.name.endswith('_visual'):
                    geom.pos[2] -= higher / 2.0
                    geom.size[1] += higher / 2.0
                else:
                    geom.friction[0] = friction
        self._record()
