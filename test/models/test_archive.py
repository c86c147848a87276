# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Worlds written to files load where the files of their parts are not."""

import io
import shutil
import struct
import zipfile
import zlib

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import Arena, compose
from manip_sim.models.archive import file_references, world_xml, write_archive
from manip_sim.models.world import World

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)


def tetrahedron(size):
    """Return a Wavefront file of a tetrahedron with edges along the axes [m]."""
    vertices = ''.join(f'v {x} {y} {z}\n' for x, y, z in size * CORNERS)
    return vertices + 'f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n'


def png(colour):
    """Return a PNG file of 2 x 2 pixels."""
    def chunk(kind, content):
        return (struct.pack('>I', len(content)) + kind + content
                + struct.pack('>I', zlib.crc32(kind + content)))
    rows = b''.join(b'\0' + bytes(colour) * 2 for _ in range(2))
    return (b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>IIBBBBB', 2, 2, 8, 2, 0, 0, 0))
            + chunk(b'IDAT', zlib.compress(rows)) + chunk(b'IEND', b''))


HFIELD = struct.pack('<ii4f', 2, 2, 0.0, 0.5, 0.5, 1.0)
CUBE = ' '.join(f'file{side}="{side}.png"' for side in (
    'right', 'left', 'up', 'down', 'front', 'back'))
ARM = f"""<mujoco><compiler angle="radian" meshdir="shapes" texturedir="pictures"/>
<asset><mesh name="part" file="part.obj"/><hfield name="h" file="h.bin" size="1 1 1 0.1"/>
<texture name="flat" type="2d" file="flat.png"/><texture name="cube" type="cube" {CUBE}/>
<material name="flat" texture="flat"/><material name="cube" texture="cube"/></asset>
<worldbody><body name="base"><geom type="mesh" mesh="part" material="flat"/>
<geom size="0.1" material="cube"/><body pos="0 0 1"><joint name="j" axis="0 1 0"/>
<geom size="0.1"/><body name="right_hand"/></body></body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>"""
HAND = """<mujoco><asset><mesh file="part.obj"/></asset>
<worldbody><body><geom type="mesh" mesh="part"/><body name="eef"/></body></worldbody></mujoco>"""


@pytest.fixture
def with_files(tmp_path, arm_class, gripper_class):
    """Return a world whose parts have files, and the folder that these are in."""
    folder = tmp_path / 'parts'
    for name, content in (
            ('arm/shapes/part.obj', tetrahedron(1.0)), ('arm/shapes/h.bin', HFIELD),
            ('arm/pictures/flat.png', png((255, 0, 0))), ('arm/arm.xml', ARM),
            ('hand/part.obj', tetrahedron(0.1)), ('hand/hand.xml', HAND),
            *((f'arm/pictures/{side}.png', png((10 * n, 0, 0))) for n, side in enumerate(
                ('right', 'left', 'up', 'down', 'front', 'back')))):
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content if isinstance(content, bytes) else content.encode())

    class Hand(gripper_class):
        init_qpos = None
        _important_geoms = {}

    robot = arm_class(folder / 'arm' / 'arm.xml')
    robot.add_gripper(Hand(folder / 'hand' / 'hand.xml'))
    return World([robot]), folder


def same_shapes(model, other):
    """Tell whether two models have the same meshes, textures and height fields."""
    return all(np.array_equal(getattr(model, name), getattr(other, name)) for name in (
        'mesh_vert', 'tex_data', 'hfield_data', 'geom_type', 'body_mass'))


def test_an_archive_loads_where_the_files_are_not(with_files, tmp_path):
    world, folder = with_files
    expected = world.compile()
    assert write_archive(world, tmp_path / 'world.mjz') == 10
    shutil.rmtree(folder)
    with (tmp_path / 'world.mjz').open('rb') as archive:
        assert same_shapes(mujoco.MjSpec.from_zip(archive).compile(), expected)
    # The arena has two textures without a file.
    assert expected.nmesh == 2 and expected.ntex == 4 and expected.nhfield == 1


def test_an_unpacked_archive_is_a_folder_with_a_model(with_files, tmp_path):
    world, folder = with_files
    expected = world.compile()
    write_archive(world, tmp_path / 'world.zip')
    shutil.rmtree(folder)
    with zipfile.ZipFile(tmp_path / 'world.zip') as archive:
        archive.extractall(tmp_path / 'unpacked')
    assert same_shapes(
        mujoco.MjModel.from_xml_path(str(tmp_path / 'unpacked' / 'model.xml')), expected)


def test_equal_worlds_make_equal_archives(with_files):
    world, _ = with_files
    first, second = io.BytesIO(), io.BytesIO()
    write_archive(world, first)
    write_archive(world, second)
    assert first.getvalue() == second.getvalue()


def test_xml_loads_from_any_folder_of_the_machine(with_files, tmp_path):
    world, _ = with_files
    file = tmp_path / 'elsewhere' / 'world.xml'
    file.parent.mkdir()
    file.write_text(world_xml(world))
    assert same_shapes(mujoco.MjModel.from_xml_path(str(file)), world.compile())


def test_a_world_without_files_is_written_as_it_is():
    world = compose('Panda', arena='table')
    assert world_xml(world) == world.to_xml()
    archive = io.BytesIO()
    assert write_archive(world, archive) == 0
    model = mujoco.MjSpec.from_zip(archive).compile()
    assert model.nbody == world.compile().nbody


def test_references_name_element_and_path_also_of_a_file_that_is_missing(with_files):
    world, folder = with_files
    (folder / 'hand' / 'part.obj').unlink()
    gripper = world.robots[0].grippers['right']
    reference, = file_references(gripper.spec, gripper.naming_prefix)
    assert (reference.kind, reference.attribute) == ('mesh', 'file')
    assert reference.name == 'gripper0_part'
    assert reference.path == folder / 'hand' / 'part.obj'


def test_a_path_that_the_model_strips_is_not_part_of_the_reference(mjcf, tmp_path):
    (tmp_path / 'part.obj').write_text(tetrahedron(1.0))
    file = mjcf('<geom type="mesh" mesh="part"/>', '<compiler strippath="true"/>'
                '<asset><mesh file="/lost/folder/part.obj"/></asset>')
    spec = mujoco.MjSpec.from_file(str(file))
    assert [r.path for r in file_references(spec)] == [tmp_path / 'part.obj']
    spec.compile()


def test_a_file_that_vanished_is_told(with_files, monkeypatch):
    world, folder = with_files
    xml = world.to_xml()
    monkeypatch.setattr(world, 'to_xml', lambda: xml)
    (folder / 'arm' / 'shapes' / 'h.bin').unlink()
    with pytest.raises(ModelError, match=r'cannot read .*h\.bin: No such file or directory'):
        write_archive(world, io.BytesIO())


def test_a_file_with_an_absolute_path_needs_no_folder(mjcf, arm_class, tmp_path):
    mesh = tmp_path / 'part.obj'
    mesh.write_text(tetrahedron(1.0))
    worldbody = """<body><geom type="mesh" mesh="part"/><body pos="0 0 1"><joint/>
        <geom size="0.1"/><body name="right_hand"/></body></body>"""
    robot = arm_class(mjcf(worldbody, f'<asset><mesh file="{mesh}"/></asset>'))
    assert str(mesh) in world_xml(World([robot]))


def test_an_arena_may_have_files_in_a_folder_of_its_own(tmp_path, mjcf):
    (tmp_path / 'stones').mkdir()
    (tmp_path / 'stones' / 'stone.obj').write_text(tetrahedron(0.3))
    file = mjcf('<geom type="mesh" mesh="stone"/>', '<compiler meshdir="stones"/>'
                '<asset><mesh file="stone.obj"/></asset>')

    class Quarry(Arena):
        arena_name = 'quarry'

        def __init__(self):
            super().__init__(file)

    world = World([], Quarry())
    assert write_archive(world, tmp_path / 'world.zip') == 1
    (tmp_path / 'stones' / 'stone.obj').unlink()
    with zipfile.ZipFile(tmp_path / 'world.zip') as archive:
        archive.extractall(tmp_path / 'unpacked')
    model = mujoco.MjModel.from_xml_path(str(tmp_path / 'unpacked' / 'model.xml'))
    assert model.nmesh == 1
