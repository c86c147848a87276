# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim render``: pictures, by processes in which MuJoCo renders without a screen."""

import json
import os
from pathlib import Path
import subprocess
import sys

import mujoco
import numpy as np
from PIL import Image, ImageChops, ImageStat
import pytest

from manip_sim.models import compose

SOURCE = Path(__file__).resolve().parents[2]
#: Runs commands, each a line of JSON, and tells their exit codes.
COMMANDS = """
import json, sys
from manip_sim.cli.main import main
for line in sys.stdin:
    print(main(json.loads(line)), flush=True)
"""


@pytest.fixture(scope='module')
def process(renderer, tmp_path_factory):
    """Return a process that runs one command after another, so that it starts only once."""
    process = subprocess.Popen([sys.executable, '-c', COMMANDS], text=True,
                               cwd=tmp_path_factory.mktemp('render'),
                               env={**os.environ, 'PYTHONPATH': str(SOURCE)},
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE)
    yield process
    assert process.communicate(timeout=300.0) == ('', '')


@pytest.fixture
def rendered(process, tmp_path):
    """Return a function that renders and returns the picture."""
    def render(*arguments, name='picture.png'):
        file = tmp_path / name
        process.stdin.write(json.dumps(['render', str(file), *arguments]) + '\n')
        process.stdin.flush()
        assert [process.stdout.readline() for _ in range(2)] == [f'{file}\n', '0\n']
        with Image.open(file) as picture:
            return picture.convert('RGB')
    return render


def dark(picture):
    """Return the share of pixels that are dark."""
    counts = picture.convert('L').histogram()
    return sum(counts[:60]) / sum(counts)


def difference(one, other):
    """Return the mean difference of two pictures, from 0 to 255."""
    return max(ImageStat.Stat(ImageChops.difference(one, other)).mean)


@pytest.mark.full
def test_a_robot_is_shown_from_two_sides(command, renderer):
    done = command('render', 'picture.png', '--size', '301x200')
    assert (done.returncode, done.stdout, done.stderr) == (0, 'picture.png\n', '')
    with Image.open('picture.png') as image:
        picture = image.convert('RGB')
    assert picture.size == (301, 200)
    left, right = picture.crop((0, 0, 150, 200)), picture.crop((151, 0, 301, 200))
    # The pedestal is black and is seen from both sides.
    assert dark(left) > 0.03 and dark(right) > 0.03
    assert difference(left, right) > 3.0
    # Neither half has an edge that nothing was drawn on.
    for x in (0, 150, 300):
        assert max(picture.getpixel((x, 20))) > 60


@pytest.mark.full
def test_one_side_fills_the_picture_and_turns_with_the_azimuth(rendered):
    front = rendered('--size', '200x200', '--azimuth', '180')
    side = rendered('--size', '200x200', '--azimuth', '90')
    above = rendered('--size', '200x200', '--azimuth', '180', '--elevation', '-80')
    assert front.size == (200, 200)
    assert difference(front, side) > 3.0 and difference(front, above) > 3.0
    sky = front.getpixel((5, 5))
    assert sky[2] > sky[0] + 20  # Blue; from above there is the floor only.
    assert abs(above.getpixel((5, 5))[2] - above.getpixel((5, 5))[0]) < 20


@pytest.mark.full
@pytest.mark.parametrize(('arguments', 'black'), [
    (('--gripper', 'Robotiq85Gripper'), 0.1), (('--base', 'RethinkMount'), 0.1),
    (('--arena', 'bins'), 0.0), (('--arena', 'empty'), 0.0)])
def test_a_part_is_shown_alone(arguments, black, rendered):
    picture = rendered('--robot', 'none', '--size', '200x120', *arguments)
    assert dark(picture) >= black
    assert ImageStat.Stat(picture).stddev[0] > 5.0


def test_arena_and_its_parameters_are_in_the_picture(rendered):
    options = ('--robot', 'none', '--arena', 'table', '--size', '200x120')
    for parameters, is_there in (((), True), (('--arena-param', 'cube=false'), False)):
        colours = rendered(*options, *parameters).getcolors(1 << 20)
        red = sum(count for count, (r, g, _) in colours if r > 100 and r > 2 * g)
        assert (red > 10) == is_there


def test_a_camera_of_the_robot_sees_the_table_below_the_gripper(rendered):
    options = ('--camera', 'robot0_eye_in_hand', '--size', '160x120')
    table = rendered('--arena', 'table', *options, name='hand.jpg')
    r, g, b = table.getpixel((80, 30))
    assert r > g > b  # Wood, where the floor is grey.
    assert difference(table, rendered(*options)) > 10.0


@pytest.mark.parametrize(('arguments', 'what'), [
    (('picture.gif',), 'picture.gif: the name must end with .png or .jpg'),
    (('lost/picture.png',), 'no such folder: lost'),
    (('picture.png', '--robot', 'Pnda'), "unknown value 'Pnda'"),
    (('picture.png', '--robot', 'none', '--gripper', 'Pnda'), "unknown gripper 'Pnda'"),
    (('picture.png', '--robot', 'none', '--gripper', 'none'), "unknown gripper 'none'"),
    (('picture.png', '--robot', 'none', '--base', 'NullMount'),
     'NullMount0 has no visible shapes (group 0 to 2), so no picture'),
    (('picture.png', '--camera', 'eye'),
     "unknown camera 'eye': available: frontview, birdview, agentview, sideview, robot0_")])
def test_what_cannot_be_rendered_is_one_line(arguments, what, rejected):
    assert what in rejected('render', *arguments)
    assert not Path('picture.png').exists()


def test_a_robot_that_is_not_visible_has_no_picture(mjcf, rejected):
    file = mjcf('<body name="base"><geom size="0.05" group="3"/><body name="link" pos="0 0 1">'
                '<joint name="joint"/><geom size="0.02" group="3"/></body></body>',
                '<actuator><motor name="motor" joint="joint"/></actuator>')
    assert 'without visible shapes (group 0 to 2) there is no picture' in rejected(
        'render', 'picture.png', '--robot', str(file))
    assert not Path('picture.png').exists()


def test_an_unknown_way_to_render_is_one_line(command, tmp_path):
    done = command('render', tmp_path / 'a.png', MUJOCO_GL='nonsense')
    assert done.returncode == 1
    assert done.stderr == ('manip_sim: cannot render with MUJOCO_GL=nonsense: it must be one of '
                           'egl, osmesa, glfw, glx\n')


def test_a_world_that_cannot_be_controlled_has_a_picture_too(one_joint_arm):
    from manip_sim.cli.render import _start_of
    from manip_sim.models.world import World
    two = '<motor name="m" joint="joint1"/><motor name="n" joint="joint1"/>'
    model, data = _start_of(World([one_joint_arm(two)]))
    assert model.joint('robot0_joint1').id == 0 and data.time == 0.0


def test_grippers_are_open_where_that_is_asked_for():
    from manip_sim.cli.render import _start_of
    world = compose('Panda')
    width = [sum(data.joint(f'gripper0_right_finger_joint{n}').qpos[0] * sign
                 for n, sign in ((1, 1.0), (2, -1.0)))
             for _, data in (_start_of(world), _start_of(world, grippers_open=True))]
    assert width[1] == pytest.approx(0.08, abs=0.001)
    assert width[0] < 0.05


@pytest.mark.full
def test_the_ground_of_the_studio_has_no_material():
    from manip_sim.cli.render import prepare_studio
    model = compose('Panda', arena='table').compile()
    ground = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == 0
              and int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_PLANE)]
    others = np.delete(model.geom_matid.copy(), ground)
    assert (model.geom_matid[ground] >= 0).all()
    prepare_studio(model)
    assert (model.geom_matid[ground] == -1).all()
    np.testing.assert_array_equal(np.delete(model.geom_matid, ground), others)


@pytest.mark.full
@pytest.mark.parametrize('azimuth', [0.0, 30.0, -135.0])
def test_the_lights_of_the_studio_turn_with_the_view_and_shine_down(azimuth):
    from manip_sim.cli.render import light_studio
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom size="0.1"/></worldbody></mujoco>')
    directions = []
    for turn in (0.0, azimuth):
        scene = mujoco.MjvScene(model, maxgeom=10)
        light_studio(scene, turn)
        directions.append(np.array([light.dir for light in scene.lights[:scene.nlight]]))
    straight, turned = directions
    assert np.linalg.norm(turned, axis=1) == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_allclose(turned[:, 2], straight[:, 2], atol=1e-5)
    assert turned[:, 2].max() < 0.0
    cos, sin = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    np.testing.assert_allclose(
        turned[:, :2], straight[:, :2] @ [[cos, sin], [-sin, cos]], atol=1e-5)
