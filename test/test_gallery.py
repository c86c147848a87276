# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The gallery as a user runs it, in a process of its own."""

import os
from pathlib import Path
import subprocess
import sys

from PIL import Image, ImageChops
import pytest

pytestmark = pytest.mark.full

SOURCE = Path(__file__).resolve().parent.parent


def run_gallery(*arguments, **environment):
    """Run ``python3 docs/draw_gallery.py`` and return the finished process."""
    return subprocess.run(
        [sys.executable, str(SOURCE / 'docs' / 'draw_gallery.py'), *map(str, arguments)],
        text=True, capture_output=True,
        env={**os.environ, 'PYTHONPATH': str(SOURCE), **environment},
        timeout=120)


@pytest.fixture(scope='module')
def gallery(tmp_path_factory, renderer):
    """Return the folder with pictures of a robot, a gripper and two bases."""
    folder = tmp_path_factory.mktemp('gallery')
    done = run_gallery('--output', folder, 'Panda', 'PandaGripper', 'RethinkMount',
                       'RethinkMinimalMount', 'insert_peg')
    assert (done.returncode, done.stdout) == (0, ''), done.stderr
    return folder


def test_help_names_the_folder():
    done = run_gallery('--help')
    assert done.returncode == 0
    assert 'docs/gallery' in done.stdout


def test_an_unknown_robot_is_one_line_with_the_nearest_name(tmp_path):
    done = run_gallery('--output', tmp_path / 'gallery', 'Pnda')
    assert done.returncode == 1
    assert done.stdout == ''
    assert done.stderr.count('\n') == 1
    assert "unknown robot, gripper, base or task 'Pnda': did you mean 'Panda'" in done.stderr
    assert not (tmp_path / 'gallery').exists()


def test_grippers_and_bases_have_folders_and_contact_sheets_of_their_own(gallery):
    files = {str(file.relative_to(gallery)) for file in gallery.rglob('*') if file.is_file()}
    assert files == {
        'Panda.png', 'contact_sheet.png',
        'grippers/PandaGripper.png', 'grippers/contact_sheet.png',
        'bases/RethinkMount.png', 'bases/RethinkMinimalMount.png', 'bases/contact_sheet.png',
        'tasks/insert_peg.png', 'tasks/contact_sheet.png'}


def test_a_part_without_shapes_is_told_where_it_is_asked_for(tmp_path):
    done = run_gallery('--output', tmp_path, 'NullMount')
    assert done.returncode == 1 and done.stderr.count('\n') == 1
    assert 'NullMount0 has no visible shapes' in done.stderr


def test_every_part_with_shapes_is_in_the_gallery_of_the_documentation():
    from manip_sim.models.bases import base_names, create_base
    from manip_sim.models.grippers import create_gripper, gripper_names
    from manip_sim.models.robots import robot_names
    from manip_sim.tasks.task import TASKS
    shown = {str(file.relative_to(SOURCE / 'docs' / 'gallery').with_suffix(''))
             for file in (SOURCE / 'docs' / 'gallery').rglob('*.png')
             if file.name != 'contact_sheet.png'}
    with_shapes = [(folder, name) for folder, names, create in (
        ('grippers', gripper_names(), create_gripper), ('bases', base_names(), create_base))
        for name in names if any(geom.group < 3 for geom in create(name).spec.geoms)]
    assert shown == {*robot_names(), *(f'{folder}/{name}' for folder, name in with_shapes),
                     # The documentation's own task is registered where its page has run.
                     *(f'tasks/{name}' for name in TASKS.names()
                       if TASKS.get(name).__module__.startswith('manip_sim.'))}


def test_a_robot_is_rendered_small_and_in_colour(gallery):
    for name in ('Panda.png', 'contact_sheet.png'):
        assert (gallery / name).stat().st_size < 150_000
    picture = Image.open(gallery / 'Panda.png').convert('RGB')
    assert picture.size == (800, 540)
    # The arm is white, the pedestal black; a picture of nothing has neither.
    left = picture.crop((0, 0, 400, 540)).getcolors(1 << 20)
    assert sum(count for count, colour in left if min(colour) > 215) > 2000
    assert sum(count for count, colour in left if max(colour) < 70) > 2000


@pytest.mark.parametrize(('name', 'width', 'height'), [
    ('Panda', 400, 540), ('bases/RethinkMinimalMount', 300, 405)])
def test_what_is_shown_fills_both_views_before_a_backdrop_of_one_colour(name, width, height,
                                                                        gallery):
    picture = Image.open(gallery / f'{name}.png').convert('RGB')
    assert picture.size == (2 * width, height)
    sizes = []
    for left in (0, width):
        view = picture.crop((left, 0, left + width, height))
        backdrop = view.getpixel((0, 0))
        # No tiles, no horizon, no haze.
        assert {view.getpixel((x, y)) for x in (0, width - 1) for y in range(height)} == {backdrop}
        shown = ImageChops.difference(view, Image.new('RGB', view.size, backdrop)).getbbox()
        sizes.append((shown[2] - shown[0], shown[3] - shown[1]))
        assert max(sizes[-1][0] / width, sizes[-1][1] / height) > 0.9
    assert all(abs(one - other) < 0.03 * height for one, other in zip(*sizes))


def test_robots_are_shown_with_open_hands(monkeypatch):
    monkeypatch.syspath_prepend(SOURCE / 'docs')
    from draw_gallery import _pictures
    shown = []
    monkeypatch.setattr('manip_sim.cli.render.picture_of_state',
                        lambda model, data, *_: shown.append(data))
    list(_pictures('robots', ['Jaco', 'Panda'], optional=False))
    jaco, panda = shown
    # The Jaco's hand starts at 0.5 rad, which is nearly closed.
    assert all(jaco.joint(f'gripper0_right_joint_{finger}').qpos > 1.4
               for finger in ('thumb', 'index', 'pinky'))
    assert panda.joint('gripper0_right_finger_joint1').qpos > 0.039
