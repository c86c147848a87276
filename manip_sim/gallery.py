# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of the robots, rendered without a screen: ``python3 -m manip_sim.gallery``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import os
from pathlib import Path
import sys
from typing import Any, TYPE_CHECKING

from manip_sim.errors import ManipSimError, UnknownNameError

if TYPE_CHECKING:
    from PIL.Image import Image

CONTACT_SHEET = 'contact_sheet.png'
MAX_BYTES = 150_000
_VIEW_SIZE = (400, 540)
_AZIMUTHS = (140.0, 40.0)
_ELEVATION = -12.0
_MARGIN = 1.05
_THUMBNAIL_SIZE = (360, 243)
_CAPTION_HEIGHT = 26
_COLUMNS = 3


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Render robots with their default gripper and base.

    :param arguments: the command line, by default that of the process
    :returns: exit code; 1 if a name is unknown or nothing can be rendered
    """
    options = _parser().parse_args(arguments)
    if sys.platform == 'linux':
        # MuJoCo looks at this when it is imported, hence the imports inside functions.
        os.environ.setdefault('MUJOCO_GL', 'egl')
    try:
        make_gallery(options.output, options.name)
    except ManipSimError as error:
        print(f'gallery: {error}', file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='python3 -m manip_sim.gallery',
        description='Render each robot with its default gripper and base from two sides, to '
                    f'NAME.png, and all pictures of the folder together to {CONTACT_SHEET}. '
                    'Needs pillow: pip install "manip_sim[gallery]".',
        epilog='On Linux pictures are rendered without a screen, by EGL; set the environment '
               'variable MUJOCO_GL to glfw or osmesa to choose another way.')
    parser.add_argument('name', nargs='*', metavar='NAME',
                        help='robots to render, such as Panda (default: all)')
    parser.add_argument('--output', type=Path, default=Path('docs/gallery'), metavar='FOLDER',
                        help='where to write the pictures (default: %(default)s)')
    return parser


def make_gallery(output: Path, names: Sequence[str] = ()) -> list[Path]:
    """
    Write a picture for each robot, and the contact sheet.

    :param output: folder, created if it is missing
    :param names: robots, by default all
    :returns: the files written
    :raises UnknownNameError: if there is no such robot
    :raises ManipSimError: if pillow is missing or nothing can be rendered
    """
    from manip_sim.models.robots import robot_names
    known = robot_names()
    for name in names:
        if name not in known:
            raise UnknownNameError('robot', name, known)
    _check_pillow()
    output.mkdir(parents=True, exist_ok=True)
    files = []
    for name in names or known:
        files.append(_save_small(render_robot(name), output / f'{name}.png'))
    pictures = [output / f'{name}.png' for name in known if (output / f'{name}.png').is_file()]
    files.append(_save_small(_contact_sheet(pictures), output / CONTACT_SHEET))
    return files


def render_robot(name: str) -> Image:
    """
    Render a robot with its default gripper and base from two sides, side by side.

    :raises ManipSimError: if nothing can be rendered
    """
    import mujoco
    import numpy as np
    from PIL import Image

    from manip_sim.models import compose

    world = compose(name)
    model = world.compile()
    data = mujoco.MjData(model)
    for joint, position in world.init_qpos().items():
        data.joint(joint).qpos = position
    mujoco.mj_forward(model, data)
    shown = mujoco.MjvOption()
    shown.geomgroup[3:] = 0
    shown.sitegroup[:] = 0
    corners = _visible_corners(model, data)
    views = []
    width, height = _VIEW_SIZE
    try:
        with mujoco.Renderer(model, height, width) as renderer:
            for azimuth in _AZIMUTHS:
                camera = _camera(corners, azimuth, model.vis.global_.fovy)
                renderer.update_scene(data, camera, shown)
                views.append(renderer.render().copy())
    except Exception as error:  # Each way to render has exceptions of its own.
        way = os.environ.get('MUJOCO_GL', 'the default')
        raise ManipSimError(f'cannot render with MUJOCO_GL={way}: {error}') from error
    return Image.fromarray(np.hstack(views))


def _visible_corners(model: Any, data: Any) -> Any:
    """Return the corners of the boxes round all visible shapes but the ground [m], (n, 3)."""
    import numpy as np
    signs = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, 8).T
    corners = []
    for geom in np.flatnonzero((model.geom_group < 3) & (model.geom_bodyid != 0)):
        middle, half = np.split(model.geom_aabb[geom], 2)
        corners.append(data.geom_xpos[geom]
                       + (middle + signs * half) @ data.geom_xmat[geom].reshape(3, 3).T)
    if not corners:
        raise ManipSimError('a robot without visible shapes (group 0 to 2) has no picture')
    return np.concatenate(corners)


def _camera(points: Any, azimuth: float, fovy: float) -> Any:
    """Return the camera that sees all points and stands as near as that allows."""
    import mujoco
    import numpy as np
    turn, tilt = np.radians(azimuth), np.radians(_ELEVATION)
    forward = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation = azimuth, _ELEVATION
    camera.lookat[:] = (points.min(axis=0) + points.max(axis=0)) / 2.0
    width, height = _VIEW_SIZE
    tangent = np.tan(np.radians(fovy / 2.0)) / _MARGIN
    seen = points - camera.lookat
    aside, above = np.abs(seen @ right), np.abs(seen @ np.cross(right, forward))
    camera.distance = np.max(np.maximum(aside * height / width, above) / tangent - seen @ forward)
    return camera


def _contact_sheet(pictures: Sequence[Path]) -> Image:
    from PIL import Image, ImageDraw
    width, height = _THUMBNAIL_SIZE
    row_height = height + _CAPTION_HEIGHT
    columns = min(_COLUMNS, len(pictures))
    rows = -(-len(pictures) // columns)
    sheet = Image.new('RGB', (columns * width, rows * row_height), 'white')
    draw = ImageDraw.Draw(sheet)
    for index, file in enumerate(pictures):
        x, y = index % columns * width, index // columns * row_height
        with Image.open(file) as picture:
            sheet.paste(picture.convert('RGB').resize(_THUMBNAIL_SIZE), (x, y))
        draw.text((x + 10, y + height + 6), file.stem, fill='black', font_size=16)
    return sheet


def _save_small(picture: Image, file: Path) -> Path:
    """Write a PNG file, with as many colours as fit into :data:`MAX_BYTES`."""
    from PIL.Image import Quantize
    for colours, method in ((256, Quantize.MEDIANCUT), (256, Quantize.MAXCOVERAGE),
                            (128, Quantize.MAXCOVERAGE), (64, Quantize.MAXCOVERAGE)):
        picture.quantize(colours, method).save(file, optimize=True)
        if file.stat().st_size < MAX_BYTES:
            break
    print(f'{file} ({file.stat().st_size // 1000} kB)', file=sys.stderr)
    return file


def _check_pillow() -> None:
    try:
        import PIL  # noqa: F401
    except ImportError:
        raise ManipSimError('needs pillow: pip install "manip_sim[gallery]"') from None


if __name__ == '__main__':
    sys.exit(main())
