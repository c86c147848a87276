# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Models with mesh and texture files: found from any folder, composed, written and packed."""

import io
import os
from pathlib import Path
import re
import struct
import zipfile
import zlib

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import World
from manip_sim.models.archive import pack
from manip_sim.models.arenas import Arena, TableArena
from manip_sim.models.asset_files import resolve_files
from manip_sim.models.grippers import GripperModel
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.xml_model import XmlModel

MENAGERIE = Path(os.environ.get('MENAGERIE_ROOT') or 'no_menagerie')


def tetrahedron(edge_m):
    """Return the OBJ file of a body whose volume tells its edge."""
    return (f'v 0 0 0\nv {edge_m} 0 0\nv 0 {edge_m} 0\nv 0 0 {edge_m}\n'
            'f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n').encode()


def grey(value, size=4):
    """Return a square image of one value in the PNG format."""
    def chunk(kind, data):
        return (struct.pack('>I', len(data)) + kind + data
                + struct.pack('>I', zlib.crc32(kind + data)))
    rows = bytes([0] + [value] * size) * size
    header = struct.pack('>IIBBBBB', size, size, 8, 0, 0, 0, 0)
    return (b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', header)
            + chunk(b'IDAT', zlib.compress(rows)) + chunk(b'IEND', b''))


def height_field(*heights):
    return struct.pack(f'<ii{len(heights)}f', 2, len(heights) // 2, *heights)


def skin():
    """Return the file of a skin of one triangle that hangs on the body ``base``."""
    return (struct.pack('<iiii', 3, 0, 1, 1) + struct.pack('<9f', 0, 0, 0, 1, 0, 0, 0, 1, 0)
            + struct.pack('<3i', 0, 1, 2) + b'base'.ljust(40, b'\0')
            + struct.pack('<7f', 0, 0, 0, 1, 0, 0, 0) + struct.pack('<i', 3)
            + struct.pack('<3i', 0, 1, 2) + struct.pack('<3f', 1, 1, 1))


def volumes_m3(model):
    """Return the volumes of all meshes by name, from their points."""
    volumes = {}
    for mesh in range(model.nmesh):
        begin, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        points = model.mesh_vert[begin:begin + count]
        volumes[model.mesh(mesh).name] = abs(np.linalg.det(points[1:4] - points[0])) / 6.0
    return volumes


def edges_m(model):
    return {name: round(float((6.0 * volume)**(1 / 3)), 4)
            for name, volume in volumes_m3(model).items()}


@pytest.fixture
def part(tmp_path):
    """Return a function that writes a model and its files into a folder and returns its path."""
    def make(folder, head, body='', name='part.xml', **files):
        root = tmp_path / folder
        for file, content in files.items():
            path = root / file.replace('__', '/').replace('_obj', '.obj').replace('_png', '.png')
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(
            f'<mujoco>{head}<worldbody><body name="base"><geom size="0.1"/>{body}'
            '<body name="right_hand"/></body></worldbody></mujoco>')
        return file
    return make


@pytest.fixture
def loads(tmp_path):
    """Return a function that loads a world in every way that its writings load."""
    def models(world):
        packed = world.to_archive()
        names = zipfile.ZipFile(io.BytesIO(packed)).namelist()
        contents = {name: zipfile.ZipFile(io.BytesIO(packed)).read(name) for name in names}
        folder = tmp_path / 'elsewhere'
        zipfile.ZipFile(io.BytesIO(packed)).extractall(folder)
        xml = contents.pop('model.xml').decode()
        assert not re.search(r'file\w*="[^"]*(/[^"]*/|\.\.|\\)', xml), 'more than a folder'
        assert not re.search(r'(mesh|texture|asset)dir', xml)
        return {'composed': world.compile(),
                'XML': mujoco.MjModel.from_xml_string(world.to_xml()),
                'zip': mujoco.MjSpec.from_zip(io.BytesIO(packed)).compile(),
                'unpacked': mujoco.MjModel.from_xml_path(str(folder / 'model.xml')),
                'from memory': mujoco.MjModel.from_xml_string(xml, contents)}
    return models


def names_in(world):
    return zipfile.ZipFile(io.BytesIO(world.to_archive())).namelist()


MESH = '<geom type="mesh" mesh="a"/>'


@pytest.mark.parametrize(('head', 'file'), [
    ('<asset><mesh name="a" file="a.obj"/></asset>', 'a_obj'),
    ('<asset><mesh file="a.obj"/></asset>', 'a_obj'),
    ('<asset><mesh name="a" file="sub/b.obj"/></asset>', 'sub__b_obj'),
    ('<compiler meshdir="meshes"/><asset><mesh file="a.obj"/></asset>', 'meshes__a_obj'),
    ('<compiler meshdir="meshes/"/><asset><mesh file="sub/a.obj"/></asset>', 'meshes__sub__a_obj'),
    ('<compiler assetdir="all"/><asset><mesh file="a.obj"/></asset>', 'all__a_obj'),
    ('<compiler meshdir="../shared"/><asset><mesh file="a.obj"/></asset>', '..__shared__a_obj'),
    ('<compiler strippath="true"/><asset><mesh file="gone/a.obj"/></asset>', 'a_obj')])
def test_a_mesh_is_found_where_the_file_says_and_travels_along(head, file, part, arm_class,
                                                               loads):
    robot = arm_class(part('robot', head, MESH, **{file: tetrahedron(0.25)}))
    for way, model in loads(World([robot])).items():
        assert edges_m(model) == {'robot0_a': 0.25}, way


def test_files_of_equal_name_and_other_content_are_kept_apart(part, arm_class, loads):
    head = '<compiler meshdir="m"/><asset><mesh name="a" file="a.obj"/></asset>'
    robots = [arm_class(part(f'robot{i}', head, MESH, m__a_obj=tetrahedron(0.1 * (i + 1))), i)
              for i in range(3)]
    world = World(robots)
    for way, model in loads(world).items():
        assert edges_m(model) == {f'robot{i}_a': round(0.1 * (i + 1), 4) for i in range(3)}, way
    assert names_in(world) == ['model.xml', 'assets/a.obj', 'assets/a_2.obj', 'assets/a_3.obj']


def test_names_that_differ_by_case_only_are_kept_apart(part, arm_class, loads):
    world = World([arm_class(part(
        'robot', '<asset><mesh name="a" file="m.obj"/><mesh name="b" file="M.OBJ"/></asset>',
        MESH, m_obj=tetrahedron(0.1), **{'M.OBJ': tetrahedron(0.2)}))])
    for way, model in loads(world).items():
        assert edges_m(model) == {'robot0_a': 0.1, 'robot0_b': 0.2}, way


def test_equal_files_are_packed_once(part, arm_class, loads):
    head = '<asset><mesh name="a" file="a.obj"/><mesh name="b" file="b.obj"/></asset>'
    file = part('robot', head, MESH, a_obj=tetrahedron(0.1), b_obj=tetrahedron(0.1))
    world = World([arm_class(file, idn) for idn in (0, 1)])
    assert names_in(world) == ['model.xml', 'assets/a.obj']
    for model in loads(world).values():
        assert set(edges_m(model).values()) == {0.1} and model.nmesh == 4


def test_the_suffix_says_what_equal_contents_are():
    xml = ('<mujoco><asset><mesh file="a.STL"/><mesh file="b.obj"/><mesh file="c.stl"/>'
           '<texture fileup="a b.png"/></asset></mujoco>')
    held = dict.fromkeys(('a.STL', 'b.obj', 'c.stl', 'a b.png'), b'equal')
    with zipfile.ZipFile(io.BytesIO(pack(xml, held))) as packed:
        assert sorted(packed.namelist()) == [
            'assets/a.stl', 'assets/a_b.png', 'assets/b.obj', 'model.xml']
        text = packed.read('model.xml').decode()
    assert re.findall(r'file\w*="(.*?)"', text) == [
        'assets/a.stl', 'assets/b.obj', 'assets/a.stl', 'assets/a_b.png']


def test_robot_gripper_and_arena_have_folders_of_their_own(
        part, arm_class, gripper_class, loads):
    robot = arm_class(part('robot', '<compiler meshdir="x"/><asset><mesh file="a.obj"/></asset>',
                           MESH, x__a_obj=tetrahedron(0.1)))
    gripper = gripper_class(part(
        'hand', '<compiler meshdir="y"/><asset><mesh file="a.obj"/></asset>',
        MESH + '<body name="eef"/><body><joint name="j" range="0 1"/>'
        '<geom name="finger" size="0.1"/></body>', y__a_obj=tetrahedron(0.2)))
    gripper_class.init_qpos = [0.0]
    robot.add_gripper(gripper)
    arena = TableArena()
    file = part('arena', '', a_obj=tetrahedron(0.3))
    mesh = arena.spec.add_mesh(name='a', file=str(file.parent / 'a.obj'))
    arena.spec.body('table').add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name)
    for way, model in loads(World([robot], arena)).items():
        assert edges_m(model) == {'robot0_a': 0.1, 'gripper0_a': 0.2, 'a': 0.3}, way


def test_textures_and_height_fields_travel_along(part, arm_class, loads):
    robot = arm_class(part(
        'robot', """<compiler meshdir="m" texturedir="t"/><asset>
          <texture name="flat" type="2d" file="g.png"/>
          <texture name="box" type="cube" fileright="r.png" fileleft="g.png" fileup="g.png"
            filedown="g.png" filefront="g.png" fileback="g.png"/>
          <hfield name="hills" size="1 1 1 1" file="h.bin"/></asset>""",
        t__g_png=grey(50), t__r_png=grey(200),
        **{'m/h.bin': height_field(0.0, 0.5, 0.25, 1.0)}))
    for way, model in loads(World([robot])).items():
        assert (model.ntex, model.nhfield) == (4, 1), way  # The arena has two.
        flat, box = (model.texture(f'robot0_{name}') for name in ('flat', 'box'))
        assert model.tex_data[int(flat.adr[0])] == 50, way
        assert model.tex_data[int(box.adr[0])] == 200, way
        np.testing.assert_allclose(model.hfield_data, [0.0, 0.5, 0.25, 1.0], err_msg=way)


def test_the_skin_of_an_arena_travels_along(part, panda, loads):
    class Hall(Arena):
        arena_name = 'hall'

    file = part('hall', '<deformable><skin name="skin" file="s.skn"/></deformable>',
                **{'s.skn': skin()})
    for way, model in loads(World([panda], Hall(file))).items():
        assert model.nskinvert == 3, way
        assert model.body(int(model.skin_bonebodyid[0])).name == 'base', way


def test_a_model_that_attaches_others_keeps_their_folders(part, arm_class, loads, tmp_path):
    part('robot/tools', '<compiler meshdir="m"/><asset><mesh name="x" file="a.obj"/>'
                        '<mesh name="y" file="only.obj"/></asset>',
         '<geom type="mesh" mesh="x"/>', name='tool.xml', m__a_obj=tetrahedron(0.2),
         m__only_obj=tetrahedron(0.3))
    file = part('robot', '<compiler meshdir="m"/><asset><mesh file="a.obj"/>'
                         '<model name="tool" file="tools/tool.xml"/></asset>',
                MESH + '<attach model="tool" body="base" prefix="k_"/>', m__a_obj=tetrahedron(0.1))
    for way, model in loads(World([arm_class(file)])).items():
        assert edges_m(model) == {'robot0_a': 0.1, 'robot0_k_x': 0.2, 'robot0_k_y': 0.3}, way


def test_a_mesh_that_is_added_in_python_travels_along(part, arm_class, loads):
    robot = arm_class(part('robot', '<compiler meshdir="m"/>', m__later_obj=tetrahedron(0.1)))
    robot.spec.add_mesh(name='a', file='later.obj')
    robot.spec.assets = {'held.obj': tetrahedron(0.2)}
    robot.spec.add_mesh(name='b', file='held.obj')
    for name in 'ab':
        robot.spec.body('base').add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
    world = World([robot])
    assert edges_m(world.compile()) == {'robot0_a': 0.1, 'robot0_b': 0.2}
    model = mujoco.MjSpec.from_zip(io.BytesIO(world.to_archive())).compile()
    assert edges_m(model) == {'robot0_a': 0.1, 'robot0_b': 0.2}


@pytest.mark.parametrize('is_new', [False, True])
def test_files_are_named_by_absolute_paths_whatever_is_before_them(is_new, tmp_path):
    spec = mujoco.MjSpec()
    (tmp_path / 'model.xml').write_text('<mujoco/>')
    for name in 'ab':
        (tmp_path / f'{name}.obj').write_bytes(tetrahedron(0.1))
    before = [tmp_path / 'a.obj', 'b.obj']
    if is_new:
        spec.assets = {'held.obj': tetrahedron(0.2)}
        before.insert(0, 'held.obj')
    for file in before:
        spec.add_mesh(name=Path(file).stem, file=str(file))
    resolve_files(spec, tmp_path / 'model.xml',
                  XmlModel(tmp_path / 'model.xml') if is_new else None)
    assert [mesh.file for mesh in spec.meshes][-2:] == [
        str(tmp_path / 'a.obj'), str(tmp_path / 'b.obj')]


def test_an_archive_is_the_same_each_time(part, arm_class):
    world = World([arm_class(part('robot', '<asset><mesh file="a.obj"/></asset>', MESH,
                                  a_obj=tetrahedron(0.1)))])
    assert world.to_archive() == world.to_archive()
    assert world.to_xml_and_archive() == (world.to_xml(), world.to_archive())


def test_a_file_that_is_gone_is_told(part, arm_class):
    file = part('robot', '<asset><mesh file="a.obj"/></asset>', MESH, a_obj=tetrahedron(0.1))
    world = World([arm_class(file)])
    (file.parent / 'a.obj').unlink()
    with pytest.raises(ModelError, match=r'a\.obj'):
        world.to_archive()


def test_a_world_of_primitives_is_one_file(panda):
    world = World([panda], TableArena(cube=True))
    assert names_in(world) == ['model.xml']
    model = mujoco.MjSpec.from_zip(io.BytesIO(world.to_archive())).compile()
    assert (model.nq, model.nu) == (world.compile().nq, world.compile().nu)


@pytest.mark.parametrize('compiler', [
    '<compiler inertiagrouprange="3 4"/>', '<compiler boundmass="7" boundinertia="0.2"/>',
    '<compiler inertiafromgeom="true"/>', '<compiler balanceinertia="true"/>'])
def test_masses_are_written_as_the_rules_of_each_part_made_them(compiler, part, arm_class, loads):
    body = """<geom size="0.3" group="3" pos="0.1 0 0"/><geom size="0.2"/>
      <body name="l"><joint/><geom size="0.05" group="4" type="box" mass="0.5"/>
        <geom size="0.01"/></body>
      <body name="m"><inertial pos="0 0 0" mass="2" diaginertia="0.1 0.2 0.25"/>
        <geom size="0.1"/></body>"""
    body = body.replace('type="box" ', '')
    models = loads(World([arm_class(part('robot', compiler, body))]))
    composed = models.pop('composed')
    for way, model in models.items():
        np.testing.assert_allclose(model.body_mass, composed.body_mass, rtol=1e-5, err_msg=way)
        np.testing.assert_allclose(model.body_inertia, composed.body_inertia, rtol=1e-5,
                                   err_msg=way)


URDF = """<robot name="r"><link name="base"/>
  <link name="link"><collision><geometry><mesh filename="{}"/></geometry></collision></link>
  <joint name="j" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize(('name', 'place'), [
    ('package://arm_description/meshes/a.obj', 'arm_description/meshes'),
    ('model://arm_description/meshes/a.obj', 'arm_description/meshes'),
    ('package://other_package/a.obj', 'other_package'),
    ('file://{tmp_path}/far/a.obj', 'far'),
    ('meshes/a.obj', 'arm_description/urdf/meshes'),
    ('anything/a.obj', 'arm_description/urdf')])
def test_meshes_of_a_urdf_are_found_as_ros_packages_lay_them_out(name, place, tmp_path):
    (tmp_path / place).mkdir(parents=True)
    (tmp_path / place / 'a.obj').write_bytes(tetrahedron(0.25))
    file = tmp_path / 'arm_description' / 'urdf' / 'arm.urdf'
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(URDF.format(name.format(tmp_path=tmp_path)))
    assert list(edges_m(MujocoXMLModel(file).compile()).values()) == [0.25]


@pytest.mark.skipif(not (MENAGERIE / 'kuka_iiwa_14').is_dir(),
                    reason='MENAGERIE_ROOT names no checkout of MuJoCo Menagerie with an iiwa 14')
def test_two_arms_and_hands_of_menagerie_are_packed(arm_class, loads):
    class Allegro(GripperModel):
        init_qpos = None

        def _prepare_spec(self, spec):
            spec.body('palm').add_body(name='eef')
            super()._prepare_spec(spec)

        def format_action(self, action):
            return self._checked(action)

    arm_class._eef_name = {'right': 'link7'}
    robots = [arm_class(MENAGERIE / 'kuka_iiwa_14' / 'iiwa14.xml', idn) for idn in (0, 1)]
    for idn, robot in enumerate(robots):
        robot.add_gripper(Allegro(MENAGERIE / 'wonik_allegro' / 'right_hand.xml', f'of{idn}'))
    models = loads(World(robots))
    composed = models.pop('composed')
    assert (composed.nq, composed.nmesh) == (46, 48)
    for way, model in models.items():
        for field in ('body_mass', 'body_inertia', 'body_pos', 'geom_pos', 'mesh_vert',
                      'jnt_range', 'geom_contype', 'actuator_gainprm'):
            np.testing.assert_allclose(getattr(model, field), getattr(composed, field), rtol=1e-5,
                                       atol=1e-9, err_msg=f'{way}: {field}')
    files = [name for name in names_in(World(robots)) if name != 'model.xml']
    assert len(files) == len(set(files)) == 24
