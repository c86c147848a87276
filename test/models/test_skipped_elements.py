# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots, objects and arenas of which files are missing load, and say what they lack."""

import os

import numpy as np
import pytest

from files_rig import write

from manip_sim.models import compose, load_robot, World
from manip_sim.models.arenas import create_arena
from manip_sim.models.asset_files import LostShape
from manip_sim.models.object_creation import create_object
from manip_sim.models.world import skipped_geoms
from manip_sim.simulation import Simulation

ARM = """<mujoco model="arm"><compiler meshdir="meshes" autolimits="true" {compiler}/>
  <asset><mesh name="shell" file="shell.stl"/><texture name="paint" type="2d" file="paint.png"/>
    <material name="paint" texture="paint"/>
    <hfield name="field" file="field.png" size="1 1 1 1"/></asset>
  <worldbody><body name="base"><geom size="0.05" material="paint"/>
    <body name="upper" pos="0 0 0.1"><joint name="lift" axis="0 1 0" range="-1 1"/>
      <geom name="upper" type="mesh" mesh="shell" {geom}/>{inside}
      <body name="lower" pos="0 0 0.4"><joint name="bend" axis="0 1 0" range="-1 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.02"/></body></body></body>
    {beside}</worldbody>{after}
  <actuator><position joint="lift" kp="500" kv="20"/><position joint="bend" kp="200" kv="9"/>
  </actuator></mujoco>"""


def arm(folder, compiler='', geom='', inside='', beside='', after=''):
    return write(folder / 'arm.xml', ARM.format(
        compiler=compiler, geom=geom, inside=inside, beside=beside, after=after))


def lost(model):
    return [sentence for sentence in model.inferred if isinstance(sentence, LostShape)]


@pytest.mark.parametrize('compiler', ['', 'inertiafromgeom="true"'])
def test_a_body_whose_mesh_is_missing_is_a_box_of_water_as_long_as_it_is(compiler, tmp_path):
    robot = load_robot(arm(tmp_path, compiler))
    body = robot.compile().body('robot0_upper')
    np.testing.assert_allclose(body.mass, 1000.0 * 0.4 * 0.1**2)
    np.testing.assert_allclose(body.ipos, [0.0, 0.0, 0.2])
    np.testing.assert_allclose(body.inertia, [body.mass[0] * 0.4**2 / 12.0] * 3)
    said = ' '.join(lost(robot))
    assert f"{tmp_path}/meshes/shell.stl) of body 'upper'" in said
    assert 'guessed: the mass of 1 body of' in said
    assert "'upper' 4 kg; put the meshes there, or give these bodies an <inertial>" in said


@pytest.mark.parametrize(('compiler', 'geom', 'inside', 'kg'), [
    ('', 'mass="3"', '', 3.0),
    ('', '', '<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>', 2.0),
    ('', '', '<geom type="box" size="0.05 0.05 0.05" density="500"/>', 0.5),
    ('settotalmass="4.5"', 'mass="0"', '<geom size="0.02"/>', None)])
def test_what_the_file_says_of_a_mass_holds(compiler, geom, inside, kg, tmp_path):
    robot = load_robot(arm(tmp_path, compiler, geom, inside))
    model = robot.compile()
    if kg is None:
        np.testing.assert_allclose(model.body('robot0_base').subtreemass, 4.5)
    else:
        np.testing.assert_allclose(model.body('robot0_upper').mass, kg)
    assert ('guessed' in ' '.join(lost(robot))) == (geom == 'mass="3"')


def test_such_a_robot_holds_its_pose(tmp_path):
    simulation = Simulation(compose(load_robot(arm(tmp_path))))
    start = simulation.robot.state().position
    simulation.advance(500)
    np.testing.assert_allclose(simulation.robot.state().position, start, atol=1e-2)


def test_textures_and_height_fields_may_be_missing_too(tmp_path):
    field = '<geom type="hfield" hfield="field"/>'
    robot = load_robot(arm(tmp_path, beside=field))
    said = ' '.join(lost(robot))
    for part in ("1 texture of files that cannot be read, such as 'paint'", 'paint.png',
                 'field.png) of body'):
        assert part in said
    assert robot.compile().ntex == 0


def test_contact_pairs_and_sensors_of_what_is_missing_are_left_out(tmp_path):
    after = """<contact><pair geom1="upper" geom2="tip"/></contact><sensor>
      <distance geom1="upper" geom2="tip" cutoff="1"/>
      <jointpos name="at" joint="lift"/></sensor>"""
    inside = '<geom name="tip" size="0.01" pos="0 0 0.3"/>'
    robot = load_robot(arm(tmp_path, inside=inside, after=after))
    assert (robot.compile().npair, robot.sensors) == (0, ['robot0_at'])


def test_a_free_object_beside_the_robot_does_not_block_it(tmp_path):
    pear = '<body name="pear" pos="1 0 0"><freejoint/><geom type="mesh" mesh="shell"/></body>'
    robot = load_robot(arm(tmp_path, inside='<geom size="0.02"/>', beside=pear))
    assert robot.joints == ['robot0_lift', 'robot0_bend']
    assert "left out: 1 body of the world body ('pear')" in robot.inferred


def test_objects_and_arenas_load_without_missing_meshes_and_the_world_tells_it(tmp_path):
    room = write(tmp_path / 'room.xml', """<mujoco><compiler meshdir="m"/>
      <asset><mesh name="picture" file="picture.obj"/></asset><worldbody>
      <geom type="plane" size="3 3 0.1"/><body name="wall" pos="2 0 1">
      <geom type="box" size="0.05 2 1"/><geom type="mesh" mesh="picture" contype="0"
      conaffinity="0" mass="0"/></body></worldbody></mujoco>""")
    mug = write(tmp_path / 'mug.xml', """<mujoco><asset><mesh name="mug" file="mug.obj"/></asset>
      <worldbody><body name="mug"><geom type="mesh" mesh="mug"/></body></worldbody></mujoco>""")
    arena, item = create_arena(str(room)), create_object(mug)
    assert f"'picture' (no such file: {tmp_path}/m/picture.obj) of body 'wall'" in lost(arena)[0]
    assert "'mug' 0.0625 kg" in lost(item)[1]
    world = World([load_robot(arm(tmp_path))], arena=arena, objects=[item])
    assert {sentence.partition(':')[0] for sentence in skipped_geoms(world)} >= {'room', 'mug'}
    world.compile()


def test_an_included_file_that_names_a_missing_mesh_is_told_with_its_path(tmp_path, monkeypatch):
    (tmp_path / 'robots' / 'parts').mkdir(parents=True)
    write(tmp_path / 'robots' / 'parts' / 'part.xml',
          '<mujoco><asset><mesh name="hull" file="meshes/hull.stl"/></asset></mujoco>')
    text = ARM.format(compiler='', geom='', after='', beside='',
                      inside='<geom type="mesh" mesh="hull"/>')
    write(tmp_path / 'robots' / 'arm.xml',
          text.replace('<asset>', '<include file="parts/part.xml"/><asset>', 1))
    monkeypatch.chdir(tmp_path)
    said = ' '.join(lost(load_robot('robots/arm.xml')))
    assert f'no such file: {os.getcwd()}/robots/' in said
    assert 'robots/robots' not in said and said.count('/parts/parts') == 0


@pytest.mark.parametrize(('tie', 'stays'), [('', False), (
    '<equality><connect body1="upper" body2="drawer1" anchor="0 0 0"/></equality>', True)])
def test_furniture_with_joints_beside_a_floating_robot_is_left_out(tie, stays, tmp_path):
    drawers = ''.join(f'<body name="drawer{number}" pos="0 0 {number}"><joint name="d{number}" '
                      'type="slide" axis="1 0 0"/><geom size="0.1"/></body>' for number in (1, 2))
    text = ARM.format(compiler='', geom='', inside='', after=tie, beside=(
        f'<body name="cabinet" pos="2 0 0"><geom size="0.2"/>{drawers}</body>'))
    file = write(tmp_path / 'arm.xml', text.replace(
        '<body name="base">', '<body name="base" pos="0 0 0.1"><freejoint/>'))
    if stays:  # Then it is not clear what the robot is.
        with pytest.raises(ValueError, match='exactly one root body, found 2'):
            load_robot(file)
    else:
        assert load_robot(file).joints == ['robot0_lift', 'robot0_bend']
