# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim render``: a picture of a composition, or of a part alone."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from manip_sim.cli.output import check_folder, write_whole
from manip_sim.cli.rendering import (
    picture_of_part, picture_of_world, TWO_SIDES, TWO_SIDES_OF_ARENAS, View)
from manip_sim.errors import ManipSimError
from manip_sim.startup import import_mujoco

if TYPE_CHECKING:
    from PIL.Image import Image

_ENDINGS = ('.png', '.jpg', '.jpeg')


def run(options: argparse.Namespace) -> tuple[str, int]:
    file: Path = options.file
    if file.suffix.lower() not in _ENDINGS:
        raise ManipSimError(f'{file}: the name must end with .png or .jpg')
    check_folder(file)
    import_mujoco()
    picture = _picture(options)
    write_whole(file, picture.save)
    return str(file), 0


def _picture(options: argparse.Namespace) -> Image:
    from manip_sim.cli.composing_options import arena_from, compose_from
    from manip_sim.models import World
    from manip_sim.models.bases import create_base
    from manip_sim.models.grippers import create_gripper

    shows_arena = options.robot == 'none' and options.arena is not None
    views = TWO_SIDES_OF_ARENAS if shows_arena else TWO_SIDES
    if options.camera is not None:
        views = (View(camera=options.camera),)
    elif (options.azimuth, options.elevation) != (None, None):
        azimuth, elevation = options.azimuth, options.elevation
        views = (View(views[0].azimuth if azimuth is None else azimuth,
                      views[0].elevation if elevation is None else elevation),)
    if options.robot != 'none':
        world = compose_from(options).composition.world
        return picture_of_world(world, options.size, views)
    if options.gripper is not None:
        return picture_of_part(create_gripper(options.gripper), options.size, views)
    if options.base is not None:
        return picture_of_part(create_base(options.base), options.size, views)
    return picture_of_world(World([], arena_from(options)), options.size, views)
