# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of all parts, rendered without a screen: ``python3 docs/draw_gallery.py``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
import sys
from typing import TYPE_CHECKING

from manip_sim.cli.output import write_whole
from manip_sim.cli.render import picture_of_part, picture_of_state, picture_of_world, View
from manip_sim.errors import ManipSimError, ModelError, UnknownNameError
from manip_sim.startup import import_mujoco

if TYPE_CHECKING:
    from PIL.Image import Image

    from manip_sim.simulation import Simulation

CONTACT_SHEET = 'contact_sheet.png'
MAX_BYTES = 150_000
#: Subfolders of the gallery's folder; robots are in that folder itself.
_FOLDERS = {'robots': '.', 'grippers': 'grippers', 'bases': 'bases', 'tasks': 'tasks'}
#: Sizes of the pictures of robots, and of grippers and bases [pixels].
_SIZE, _SMALL_SIZE = (800, 540), (600, 405)
_THUMBNAIL_SIZE = (360, 243)
_CAPTION_HEIGHT = 26
_COLUMNS = 3
#: Views of grippers, which look the same from the left and from the right, and of bases.
_FRONT_AND_SIDE, _FRONT_AND_BACK = (View(200.0), View(110.0)), (View(140.0), View(40.0))
#: View of tasks, the seed of the episode, and a height below the floor [m].
_ASIDE, _SEED, _BELOW_M = View(125.0, -25.0), 1, -0.5


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Render robots with default gripper, open, and base, grippers and bases alone, and tasks.

    :returns: exit code; 1 if a name is unknown or nothing can be rendered
    """
    options = _parser().parse_args(arguments)
    import_mujoco()
    try:
        make_gallery(options.output, options.name)
    except ManipSimError as error:
        print(f'draw_gallery: {error}', file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='python3 docs/draw_gallery.py',
        description='Render each robot with its default gripper, open, and base, each gripper and '
                    'each base from two sides, and each task with a Panda at its start and when '
                    'it is done, to NAME.png, grippers/NAME.png, bases/NAME.png and '
                    f'tasks/NAME.png, and all pictures of a folder together to its '
                    f'{CONTACT_SHEET}.',
        epilog='On Linux pictures are rendered without a screen, by EGL; set the environment '
               'variable MUJOCO_GL to glfw or osmesa to choose another way. One picture of any '
               "composition is made by 'manip_sim render'.")
    parser.add_argument('name', nargs='*', metavar='NAME',
                        help='what to render, such as Panda, PandaGripper or pick_cube (default: '
                        'all)')
    parser.add_argument('--output', type=Path, default=Path('docs/gallery'), metavar='FOLDER',
                        help='where to write the pictures (default: %(default)s)')
    return parser


def make_gallery(output: Path, names: Sequence[str] = ()) -> list[Path]:
    """
    Write a picture for each robot, gripper, base and task, and the contact sheets.

    :param output: folder, created if it is missing
    :param names: of robots, grippers, bases and tasks; if empty, all but grippers and bases
        without visible shapes
    :raises UnknownNameError: if there is no such robot, gripper, base or task
    :raises ManipSimError: if nothing can be rendered
    """
    known = _known_names()
    everything = [name for of_kind in known.values() for name in of_kind]
    for name in names:
        if name not in everything:
            raise UnknownNameError('robot, gripper, base or task', name, everything)
    files = []
    for kind, of_kind in known.items():
        wanted = [name for name in of_kind if not names or name in names]
        if not wanted:
            continue
        folder = output / _FOLDERS[kind]
        folder.mkdir(parents=True, exist_ok=True)
        for name, picture in _pictures(kind, wanted, optional=not names):
            files.append(_save_small(picture, folder / f'{name}.png'))
        made = [folder / f'{name}.png' for name in of_kind if (folder / f'{name}.png').is_file()]
        files.append(_save_small(_contact_sheet(made), folder / CONTACT_SHEET))
    return files


def _known_names() -> dict[str, list[str]]:
    from manip_sim.models.bases import base_names
    from manip_sim.models.grippers import gripper_names
    from manip_sim.models.robots import robot_names
    from manip_sim.tasks import task_names
    return {'robots': robot_names(), 'grippers': gripper_names(), 'bases': base_names(),
            'tasks': task_names()}


def _pictures(kind: str, names: Sequence[str], optional: bool) -> Iterator[tuple[str, Image]]:
    """Yield names and pictures; ``optional`` omits grippers and bases without visible shapes."""
    from manip_sim.models import compose
    from manip_sim.models.bases import create_base
    from manip_sim.models.grippers import create_gripper
    render: dict[str, Callable[[str], Image]] = {
        'robots': lambda name: picture_of_world(
            compose(name), _SIZE, in_studio=True, grippers_open=True),
        'grippers': lambda name: picture_of_part(
            create_gripper(name), _SMALL_SIZE, _FRONT_AND_SIDE, in_studio=True),
        'bases': lambda name: picture_of_part(
            create_base(name), _SMALL_SIZE, _FRONT_AND_BACK, in_studio=True),
        'tasks': _picture_of_task}
    for name in names:
        try:
            picture = render[kind](name)
        except ModelError:
            if kind == 'robots' or not optional:
                raise
        else:
            yield name, picture


def _picture_of_task(name: str) -> Image:
    """Render a task with a Panda at the start of an episode, and when the expert has done it."""
    from PIL import Image

    from manip_sim.simulation import Simulation
    from manip_sim.tasks import create_task, Episode
    task = create_task(name)
    episode = Episode(task, Simulation(task.world))
    episode.reset(_SEED)
    width, height = _SIZE
    picture = Image.new('RGB', _SIZE)
    picture.paste(_picture_of_instant(episode.simulation, (width // 2, height)))
    if not episode.run(task.expert(episode.simulation), _SEED):
        raise ModelError(f'the expert of {name} does not succeed with seed {_SEED}')
    picture.paste(_picture_of_instant(episode.simulation, (width // 2, height)), (width // 2, 0))
    return picture


def _picture_of_instant(simulation: Simulation, size: tuple[int, int]) -> Image:
    from manip_sim.simulation.snapshots import take_snapshot, VisibleWorld
    seen = VisibleWorld(simulation.plan)
    seen.show(take_snapshot(simulation))
    # What was wiped off is below the floor.
    seen.model.geom_group[seen.data.geom_xpos[:, 2] < _BELOW_M] = 5
    return picture_of_state(seen.model, seen.data, size, [_ASIDE], in_studio=True)


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

    def save(path: Path) -> None:
        for colours in (256, 128, 64):
            picture.quantize(colours, Quantize.MAXCOVERAGE, kmeans=4).save(path, optimize=True)
            if path.stat().st_size < MAX_BYTES:
                break

    write_whole(file, save)
    print(f'{file} ({file.stat().st_size // 1000} kB)', file=sys.stderr)
    return file


if __name__ == '__main__':
    sys.exit(main())
