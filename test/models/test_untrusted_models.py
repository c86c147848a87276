# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Models of somebody who is not trusted: which files they can name, and what they may cost."""

import contextlib
import io
import os
import re
import struct
import zlib

import mujoco
import numpy as np
from opened_files import OpenedFiles
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import untrusted_models, user_files, World
from manip_sim.models.object_creation import create_object, object_from_model
from manip_sim.models.untrusted_models import load_self_contained
from manip_sim.models.user_files import AllowedRoots, CachedFiles, Files, InMemoryFile, read_file

pytestmark = pytest.mark.full

SECRET = 'secret'
BODY = '<body name="o"><freejoint/><geom size="0.05" mass="0.1"/>{}</body>'
#: Elements that name a file, so that MuJoCo opens it; by element and attribute.
NAMES_A_FILE = {
    ('include', 'file'): '<include file="{}"/>',
    ('model', 'file'): '<asset><model name="m" file="{}" content_type="text/xml"/></asset>',
    ('mesh', 'file'): '<asset><mesh name="m" file="{}.obj"/></asset>',
    ('hfield', 'file'): '<asset><hfield name="h" size="1 1 1 1" file="{}"/></asset>',
    ('skin', 'file'): '<asset><skin name="s" file="{}.skn"/></asset>',
    ('flexcomp', 'file'): '<worldbody><flexcomp name="f" type="mesh" file="{}.obj"/></worldbody>',
    ('texture', 'file'): '<asset><texture type="2d" name="t" file="{}" '
                         'content_type="image/ktx"/></asset>',
    **{('texture', f'file{side}'): '<asset><texture type="cube" name="t" '
                                   f'file{side}="{{}}" content_type="image/png"/></asset>'
       for side in ('right', 'left', 'up', 'down', 'front', 'back')}}
#: Attributes that say how or where files are read, but name none.
ABOUT_FILES = {
    ('compiler', 'meshdir'), ('compiler', 'texturedir'), ('compiler', 'assetdir'),
    ('compiler', 'strippath'),
    *((tag, 'content_type') for tag in ('mesh', 'hfield', 'texture', 'model'))}
#: URDF has no schema in MuJoCo; these are those of the description of the format.
URDF = {
    'mesh': '<visual><geometry><mesh filename="{}"/></geometry></visual>',
    'collision': '<collision><geometry><mesh filename="{}"/></geometry></collision>',
    'texture': '<visual><geometry><sphere radius="1"/></geometry><material name="m">'
               '<texture filename="{}"/></material></visual>'}


def schema():
    """Return the attributes of each element of MJCF, by the path of its tags."""
    found, path, indents = {}, [], []
    for line in mujoco.mj_printSchema(False, False).splitlines():
        element = re.match(r'( *)(\S+) \(.\)\s*(.*)', line)
        if element is None:
            found[tuple(path)] += line.split()
            continue
        indent, tag = len(element[1]), element[2].replace('(world)body', 'worldbody')
        while indents and indents[-1] >= indent:
            indents.pop()
            path.pop()
        indents.append(indent)
        path.append(tag)
        found[tuple(path)] = element[3].split()
    # What is not printed: the include, and bodies in the body of the world.
    found['mujoco', 'include'] = ['file']
    found['mujoco', 'worldbody', 'body'] = found['mujoco', 'worldbody']
    return found


def stl(triangles):
    faces = np.zeros(len(triangles), [('normal', '<f4', 3), ('corners', '<f4', (3, 3)),
                                      ('attribute', '<u2')])
    faces['corners'] = triangles
    return bytes(80) + struct.pack('<I', len(faces)) + faces.tobytes()


def tetrahedron(size=0.1):
    corners = size * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    return stl(corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]])


def png(width=2, height=2, told=None):
    def chunk(kind, data):
        return struct.pack('>I', len(data)) + kind + data + struct.pack(
            '>I', zlib.crc32(kind + data))
    head = struct.pack('>IIBBBBB', *(told or (width, height)), 8, 2, 0, 0, 0)
    rows = zlib.compress((b'\0' + bytes(3 * width)) * height)
    return (b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', head) + chunk(b'IDAT', rows)
            + chunk(b'IEND', b''))


def mjcf(sections='', body='', geom=''):
    return f'<mujoco>{sections}<worldbody>{BODY.format(body + geom)}</worldbody></mujoco>'


@pytest.fixture
def secret(tmp_path):
    """Return a file outside the folder that may be read, and what tells that it was opened."""
    (tmp_path / 'private').mkdir()
    file = tmp_path / 'private' / SECRET
    file.write_text('-----BEGIN PRIVATE KEY-----\n')
    opened = OpenedFiles(file.parent)
    yield file, opened
    opened.close()


@pytest.fixture
def below(tmp_path):
    """Return a folder, and the files that may be read: those below it."""
    folder = tmp_path / 'roots'
    folder.mkdir()
    return folder, AllowedRoots([folder], 'spawn_roots')


@pytest.fixture
def tried_here(monkeypatch):
    """Compile in this process, where nothing else keeps MuJoCo from opening files."""
    monkeypatch.setattr(untrusted_models, 'run_limited', lambda *_: None)


def doors(text, below):
    """Yield what takes a model from a stranger: as a text, and as a file that may be read."""
    folder, files = below
    sent = InMemoryFile(text, 'resource_string')
    (folder / 'object.xml').write_text(text)
    yield lambda: load_self_contained(sent.file, sent)
    yield lambda: load_self_contained(folder / 'object.xml', files)


def nothing_is_opened(text, below, opened):
    for door in doors(text, below):
        try:
            object_from_model(door(), 'o')
        except ModelError as error:
            assert '\n' not in str(error)
        assert opened.take() == set(), text


# ---------------------------------------------------------------------- which files


def test_every_attribute_of_mjcf_that_looks_like_a_file_is_known():
    found = {(path[-1], name) for path, names in schema().items() for name in names
             if re.search('file|path|uri|url|content_type|(mesh|texture|asset)dir', name)}
    assert found == set(NAMES_A_FILE) | ABOUT_FILES
    assert len(schema()) > 100 and sum(map(len, schema().values())) > 1500


@pytest.mark.parametrize('name', NAMES_A_FILE, ids='-'.join)
def test_mujoco_itself_opens_what_each_of_these_names(name, secret):
    file, opened = secret
    for suffix in ('obj', 'skn'):
        file.with_name(f'{SECRET}.{suffix}').write_bytes(file.read_bytes())
    opened.take()
    with contextlib.suppress(ValueError):
        mujoco.MjSpec.from_string(f'<mujoco>{NAMES_A_FILE[name].format(file)}</mujoco>').compile()
    assert opened.take()


@pytest.mark.parametrize('path', [
    '{}', 'file://{}', '../private/secret', './/../private/./secret', 'link', 'folder/secret',
    'package://roots/link', 'package://private/secret', 'link.stl', 'link.png'])
@pytest.mark.parametrize('name', NAMES_A_FILE, ids='-'.join)
def test_no_element_of_mjcf_reads_a_file_outside(name, path, secret, below, tried_here):
    file, opened = secret
    for link in ('link', 'link.stl', 'link.png'):
        (below[0] / link).symlink_to(file)
    (below[0] / 'folder').symlink_to(file.parent)
    section = NAMES_A_FILE[name].format(path.format(file))
    nothing_is_opened(mjcf(section), below, opened)
    for folder in ('assetdir', 'meshdir', 'texturedir'):
        text = mjcf(f'<compiler {folder}="{file.parent}"/>' + NAMES_A_FILE[name].format(SECRET))
        nothing_is_opened(text, below, opened)


@pytest.mark.parametrize('shape', URDF)
def test_no_element_of_urdf_reads_a_file_outside(shape, secret, below, tried_here):
    file, opened = secret
    for path in (file, f'file://{file}', f'package://{file}', '../private/secret'):
        nothing_is_opened(f'<robot name="r"><link name="l">{URDF[shape].format(path)}</link>'
                          '</robot>', below, opened)
        for folder in ('meshdir', 'texturedir', 'assetdir'):
            nothing_is_opened(
                f'<robot name="r"><mujoco><compiler {folder}="{file.parent}" strippath="true"/>'
                f'</mujoco><link name="l">{URDF[shape].format(SECRET)}</link></robot>', below,
                opened)


def test_no_attribute_at_all_reads_a_file_outside(secret, below, tried_here):
    file, opened = secret
    for (_, name), path in {(path[-1], name): path for path, names in schema().items()
                            for name in names}.items():
        element = f'<{path[-1]} {name}="{file}"/>'
        for tag in reversed(path[1:-1]):
            element = f'<{tag}>{element}</{tag}>'
        text = InMemoryFile(mjcf(element), 'text')
        with contextlib.suppress(ModelError):
            object_from_model(load_self_contained(text.file, text), 'o')
    assert opened.take() == set()


def test_a_text_names_no_file_even_where_files_may_be_read(below):
    (below[0] / 'm.stl').write_bytes(tetrahedron())
    text = InMemoryFile(mjcf(f'<asset><mesh name="m" file="{below[0]}/m.stl"/></asset>'), 'text')
    with pytest.raises(ModelError, match=r"^text names the mesh file '.*/m.stl': a text must not"):
        load_self_contained(text.file, text)
    with pytest.raises(ModelError, match="^object 'o': text names the MJCF file '/m.xml': a"):
        create_object({'name': 'o', 'file': '/m.xml'}, InMemoryFile('', 'text'))


# ---------------------------------------------------------------------- what may be read


def test_a_model_below_the_folders_brings_all_that_it_names(below):
    folder, files = below
    (folder / 'parts').mkdir()
    (folder / 'parts' / 'tin can.STL').write_bytes(tetrahedron())
    (folder / 'skin.png').write_bytes(png())
    (folder / 'include.xml').write_text(
        '<any><texture name="t" type="2d" file="skin.png" content_type="model/stl"/>'
        '<material name="m" texture="t"/></any>')
    (folder / 'lid.xml').write_text(
        '<mujoco><compiler meshdir="parts"/><asset><mesh name="n" file="tin can.STL"/></asset>'
        '<worldbody><body name="lid"><geom type="mesh" mesh="n"/></body></worldbody></mujoco>')
    (folder / 'can.xml').write_text(mjcf(
        '<compiler meshdir="parts"/><asset><include file="include.xml"/>'
        '<mesh name="m" file="tin can.STL"/><model name="lid" file="lid.xml"/></asset>',
        body='<attach model="lid" body="lid" prefix="lid_"/>',
        geom='<geom type="mesh" mesh="m" material="m"/>'))
    held = load_self_contained(folder / 'can.xml', files)
    assert set(held.assets.values()) == {tetrahedron(), png()}
    item = object_from_model(held, 'can')
    # The suffix says what a file is, not the one who names it.
    (folder / 'include.xml').write_text(
        (folder / 'include.xml').read_text().replace('model/stl', 'image/png'))
    trusted = create_object({'name': 'can', 'file': str(folder / 'can.xml')})
    world = World([], objects=[item])
    model, same = world.compile(), World([], objects=[trusted]).compile()
    assert (model.nmesh, model.ntex) == (same.nmesh, same.ntex) == (2, 3)
    np.testing.assert_array_equal(model.geom_pos, same.geom_pos)
    np.testing.assert_array_equal(model.body_mass, same.body_mass)
    # Nothing is read again: neither for the archive, nor by MuJoCo.
    for file in folder.rglob('*.*'):
        file.unlink()
    packed = mujoco.MjSpec.from_zip(io.BytesIO(world.to_archive())).compile()
    assert (packed.nmesh, packed.ntex) == (2, 3)


def test_the_six_images_of_a_cube_are_held(below):
    sides = ('right', 'left', 'up', 'down', 'front', 'back')
    for number, side in enumerate(sides):
        (below[0] / f'{side}.png').write_bytes(png(number + 1, number + 1))
    (below[0] / 'o.xml').write_text(mjcf('<asset><texture name="t" type="cube" ' + ' '.join(
        f'file{side}="{side}.png"' for side in sides) + '/></asset>'))
    assert len(load_self_contained(below[0] / 'o.xml', below[1]).assets) == 6


def test_a_mesh_of_a_urdf_is_held_wherever_its_package_is(below):
    (below[0] / 'cans' / 'meshes').mkdir(parents=True)
    (below[0] / 'cans' / 'meshes' / 'm.stl').write_bytes(tetrahedron())
    (below[0] / 'cans' / 'can.xml').write_text(
        '<robot name="r"><link name="l"><visual><geometry>'
        '<mesh filename="package://cans/meshes/m.stl"/></geometry></visual></link></robot>')
    held = load_self_contained(below[0] / 'cans' / 'can.xml', below[1])
    assert list(held.assets.values()) == [tetrahedron()]


def test_a_list_of_objects_may_name_files_below_the_folders_only(secret, below):
    folder, files = below
    file, opened = secret
    file.with_name('can.xml').write_text(mjcf())
    (folder / 'can.xml').write_text(mjcf())
    for path, fits in (('can.xml', True), (f'{file.parent}/can.xml', False),
                       ('../private/can.xml', False)):
        (folder / 'list.yaml').write_text(f'objects: [{{name: can, file: {path}}}]')
        opened.take()
        if fits:
            assert create_object(folder / 'list.yaml', files).name == 'can'
        else:
            with pytest.raises(ModelError, match='only files below spawn_roots may be'):
                create_object(folder / 'list.yaml', files)
        assert opened.take() == set()


def test_what_is_outside_is_told_alike_whether_it_is_there_or_not(secret, below):
    file, _ = secret

    def told(path):
        with pytest.raises(ModelError) as error:
            below[1].read(path, 'MJCF file')
        return str(error.value).replace(path.name, 'NAME')
    assert told(file) == told(file.with_name('nothing'))


def test_a_link_that_is_changed_after_the_check_is_noticed(secret, below, monkeypatch):
    file, _ = secret
    (below[0] / 'object.xml').write_text('harmless')
    plain = os.open

    def change_then_open(path, *arguments, **named):
        if str(path).endswith('object.xml'):
            path.unlink()
            path.symlink_to(file)
        return plain(path, *arguments, **named)
    monkeypatch.setattr(os, 'open', change_then_open)
    with pytest.raises(ModelError, match='it has been moved'):
        below[1].read(below[0] / 'object.xml', 'MJCF file')


@pytest.mark.parametrize('read', [read_file, lambda *arguments: Files().read(*arguments)])
def test_a_file_that_becomes_a_pipe_does_not_stop_the_reader(read, tmp_path, monkeypatch):
    file, plain = tmp_path / 'm.xml', os.open
    file.write_text('harmless')

    def change_then_open(path, *arguments, **named):
        if path == file:
            file.unlink()
            os.mkfifo(file)
        return plain(path, *arguments, **named)
    monkeypatch.setattr(os, 'open', change_then_open)
    with pytest.raises(ModelError, match='it is a device or a pipe'):
        read(file, 'MJCF file')


def test_a_folder_that_is_missing_is_told():
    with pytest.raises(ModelError, match='^no such folder in spawn_roots: /nowhere$'):
        AllowedRoots(['/nowhere'], 'spawn_roots')


# ---------------------------------------------------------------------- what files hold


def mesh_of(kind, name):
    return mjcf(f'<asset><{kind} name="m" file="{name}"/></asset>', geom=(
        '<geom type="mesh" mesh="m"/>' if kind == 'mesh' else ''))


def sphere(faces):
    """Return an STL of random points on a sphere, all of them on its convex hull."""
    points = np.random.default_rng(1).normal(size=(faces, 3, 3))
    return stl(points / np.linalg.norm(points, axis=-1, keepdims=True))


CUBE_OBJ = b'# a cube\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n'


@pytest.mark.parametrize(('kind', 'name', 'content'), [
    ('mesh', 'a.stl', tetrahedron()), ('mesh', 'a.obj', CUBE_OBJ), ('texture', 'a.png', png()),
    ('mesh', 'a.STL', sphere(1000)), ('texture', 'a.png', png(1024, 1024))])
def test_a_file_of_a_known_type_passes(kind, name, content, below):
    (below[0] / name).write_bytes(content)
    (below[0] / 'o.xml').write_text(mesh_of(kind, name))
    object_from_model(load_self_contained(below[0] / 'o.xml', below[1]))


@pytest.mark.parametrize(('kind', 'name'), [
    ('mesh', 'a.png'), ('texture', 'a.stl'), ('mesh', 'a'), ('texture', 'a.ktx')])
def test_a_file_of_another_type_is_rejected(kind, name, below):
    (below[0] / name).write_bytes(b'')
    (below[0] / 'o.xml').write_text(mesh_of(kind, name))
    with pytest.raises(ModelError, match=f'{kind} file .*{name} has a type that cannot be spawned;'
                                         ' these types can: .obj, .stl, .png$'):
        load_self_contained(below[0] / 'o.xml', below[1])


@pytest.mark.parametrize(('kind', 'name', 'content'), [
    ('mesh', 'a.stl', b'solid cube'), ('mesh', 'a.stl', b''), ('mesh', 'a.stl', bytes(84)),
    ('mesh', 'a.stl', tetrahedron()[:-1]), ('mesh', 'a.stl', sphere(100_000)),
    ('mesh', 'a.stl', bytes(80) + b'\xff' * 4 + bytes(200)),
    ('mesh', 'a.obj', b'v 0 0 0\n-----BEGIN'), ('mesh', 'a.obj', b'f 1 2 3\n' * 100_001),
    ('mesh', 'a.obj', b'v 0 0 \xff'),
    ('texture', 'a.png', b'-----BEGIN PRIVATE KEY-----'), ('texture', 'a.png', png()[:20]),
    ('texture', 'a.png', png(told=(65535, 65535))), ('texture', 'a.png', png(told=(4096, 4097)))],
    ids=lambda value: value[:20] if isinstance(value, bytes) else value)
def test_a_file_that_is_not_what_it_says_or_too_much_ends_in_one_line(
        kind, name, content, below, monkeypatch):
    monkeypatch.setattr(untrusted_models, 'MAX_CPU_S', 1)
    (below[0] / name).write_bytes(content)
    (below[0] / 'o.xml').write_text(mesh_of(kind, name))
    with pytest.raises(ModelError, match='^[^\n]*(does not compile|cannot be|to load)[^\n]*$'):
        object_from_model(load_self_contained(below[0] / 'o.xml', below[1]))


def test_an_image_of_many_pixels_is_not_unpacked_here(below):
    (below[0] / 'a.png').write_bytes(png(9000, 9000))
    (below[0] / 'o.xml').write_text(mesh_of('texture', 'a.png'))
    with pytest.raises(ModelError, match='243 MB, and at most|takes more than'):
        object_from_model(load_self_contained(below[0] / 'o.xml', below[1]))


def test_files_together_are_bounded(below, monkeypatch):
    monkeypatch.setattr(user_files, '_MAX_FILE_BYTES', len(tetrahedron()))
    text = InMemoryFile(mjcf(), 'text')
    kept = CachedFiles(below[1])
    for name in 'abc':
        (below[0] / f'{name}.stl').write_bytes(tetrahedron(0.1 + ord(name)))
    for name in 'ab':
        kept.read(below[0] / f'{name}.stl', 'mesh file')
    assert kept.read(below[0] / 'a.stl', 'mesh file') == tetrahedron(0.1 + ord('a'))
    with pytest.raises(ModelError, match='and 0 MB of files$'):
        kept.read(below[0] / 'c.stl', 'mesh file')
    assert load_self_contained(text.file, text).is_light
    monkeypatch.setattr(user_files, '_MAX_FILE_BYTES', len(tetrahedron()) - 1)
    with pytest.raises(ModelError, match='a.stl: it has more than 0 MB'):
        below[1].read(below[0] / 'a.stl', 'mesh file')


# ---------------------------------------------------------------------- what models ask for


def text_model(text):
    sent = InMemoryFile(text, 'text')
    return load_self_contained(sent.file, sent)


@pytest.mark.parametrize(('text', 'problem'), [
    (mjcf(geom='<geom size="1"/>' * 60_000), 'with 60000 tags'),
    (mjcf(body=f'<!-- {"x" * 3_000_000} -->'), 'a request may read at most 200 texts of 3 MB'),
    (mjcf('<extension><plugin plugin="mujoco.sdf.bolt"/></extension>'), 'cannot have plugins'),
    ('<!DOCTYPE mujoco [<!ENTITY a SYSTEM "/etc/passwd">]><mujoco>&a;</mujoco>', 'the entity'),
    (mjcf('<asset><model name="m"/></asset>'), '<model> needs a file'),
    ('<sdf/>', 'is not a model'), ('<mujoco', 'is not well-formed XML')])
def test_a_model_that_asks_for_too_much_is_rejected(text, problem):
    with pytest.raises(ModelError, match=f'^[^\n]*{re.escape(problem)}[^\n]*$'):
        text_model(text)


@pytest.mark.parametrize(('text', 'problem'), [
    (mjcf(geom='<geom size="1"/>' * 1000), '1004 .* shapes and so on in .* at most 1000 in'),
    (mjcf(body='<body><geom size="1"/>' * 900 + '</body>' * 900), 'nesting is too deep'),
    (mjcf(body='<body>' * 2000 + '</body>' * 2000), 'elements that are nested too deeply'),
    (mjcf(body='<replicate count="1001"><geom size="1"/></replicate>'), 'at most 1000 in'),
    (mjcf(body='<replicate count="1000000000"><geom size="1"/></replicate>'), ''),
    (mjcf('<asset><texture name="t" type="2d" builtin="flat" width="99999" height="99999"/>'
          '</asset>'), ''),
    (mjcf('<asset><texture name="t" type="2d" builtin="flat" width="9000" height="9000"/>'
          '</asset>'), 'in 243 MB, and at most 1000 in 200 MB'),
    (mjcf('<asset><hfield name="h" nrow="9999" ncol="9999" size="1 1 1 1"/></asset>'), ''),
    (mjcf('<custom><numeric name="n" size="2000000000"/></custom>'), ''),
    (mjcf(body='<flexcomp name="f" type="grid" count="60 60 60" spacing="1 1 1" dim="3"/>'), '')])
def test_a_model_that_becomes_too_much_is_rejected_in_another_process(text, problem, monkeypatch):
    if not problem:  # Some do not end.
        monkeypatch.setattr(untrusted_models, 'MAX_CPU_S', 1)
    with pytest.raises(ModelError, match=f'^text[^\n]*{problem}[^\n]*$'):
        text_model(text).load()


@pytest.mark.parametrize('kind', ['geom', 'body', 'joint', 'site', 'camera'])
def test_user_data_that_a_whole_world_would_have_is_rejected(kind):
    # A megabyte in each element of the world for half a megabyte of text.
    held = text_model(mjcf(body='<body><geom size="1"/>{}</body>'.format(
        {'geom': '<geom size="1" user="{}"/>', 'body': '<body user="{}"/>',
         'joint': '<joint user="{}"/>', 'site': '<site user="{}"/>',
         'camera': '<camera user="{}"/>'}[kind].format('1 ' * 200_000))))
    with pytest.raises(ModelError, match='^text has nuser_.* 200000, and at most 100'):
        object_from_model(held)
    few = text_model(mjcf(body=f'<geom size="1" user="{"1 " * 100}"/>'))
    assert object_from_model(few).compile().nuser_geom == 100


def test_files_that_load_each_other_again_and_again_are_given_up(below):
    for number in range(30):
        (below[0] / f'{number}.xml').write_text(
            f'<mujoco>{f"""<include file="{number + 1}.xml"/>""" * 2}</mujoco>')
    (below[0] / '30.xml').write_text('<mujoco/>')
    with pytest.raises(ModelError, match='a request may read at most 200 texts'):
        load_self_contained(below[0] / '0.xml', below[1])


@pytest.mark.parametrize('value', ['nan', '-NaN', '1 0 0 nan(12)', '1\tNan 0'])
def test_nan_is_rejected_before_mujoco_prints_what_it_thinks_of_it(value, capfd):
    with pytest.raises(ModelError, match=r'rgba of <geom> must be a number, got .*[nN]a[nN]'):
        text_model(mjcf(body=f'<geom size="1" rgba="{value}"/>'))
    assert capfd.readouterr().err == ''
    # A name may be anything.
    text_model(mjcf(body='<geom size="1" name="nan" material="banana"/>'))


def test_an_object_of_too_many_joints_is_rejected(tried_here):
    legs = '<body><joint/><geom size="0.01"/></body>'
    assert object_from_model(text_model(mjcf(body=legs * 94)), 'o').dof == 100
    with pytest.raises(ModelError, match='has 101 degrees of freedom, and at most 100'):
        object_from_model(text_model(mjcf(body=legs * 95)), 'o')


def test_memory_that_an_object_asks_for_is_left_out():
    held = text_model(mjcf('<size memory="1000G" nuserdata="1000000"/>'))
    assert held.is_light
    assert object_from_model(held, 'o').compile().nuserdata == 0


@pytest.mark.parametrize(('text', 'light'), [
    (mjcf(), True), (mjcf('<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'),
                     False), (mjcf(geom='<geom size="1"/>' * 100), False),
    (mjcf('<asset><texture type="2d" builtin="flat" width="9" height="9"/></asset>'), False)])
def test_what_compiles_quickly_for_sure_is_not_tried_before(text, light, monkeypatch):
    tried = []
    monkeypatch.setattr(untrusted_models, 'run_limited', lambda *work: tried.append(work))
    text_model(text).load()
    assert bool(tried) != light


def test_a_model_is_tried_once(below, monkeypatch):
    (below[0] / 'm.stl').write_bytes(tetrahedron(0.2))
    (below[0] / 'o.xml').write_text(mjcf('<asset><mesh file="m.stl"/></asset>'))
    load_self_contained(below[0] / 'o.xml', below[1]).load()
    monkeypatch.setattr(untrusted_models, '_answer', lambda *_: (3, b'was tried again'))
    load_self_contained(below[0] / 'o.xml', below[1]).load()
    (below[0] / 'm.stl').write_bytes(tetrahedron(0.3))
    with pytest.raises(ModelError, match='o.xml was tried again'):
        load_self_contained(below[0] / 'o.xml', below[1]).load()


def try_it(text):
    untrusted_models.run_limited('it', untrusted_models.compile_held, {'': text}, {})


def test_a_trial_tells_what_mujoco_says():
    with pytest.raises(ModelError, match='^it does not compile: .*[Ss]ize'):
        try_it('<mujoco><worldbody><geom type="box" size="0 0 0"/></worldbody></mujoco>')


def print_and_return():
    """Print as a library would."""
    os.write(1, b'printed')
    print('printed')
    return b'result'


def test_what_is_printed_is_no_part_of_a_result():
    assert untrusted_models.run_limited('it', print_and_return) == b'result'


def test_a_trial_opens_no_file(secret):
    file, opened = secret
    with pytest.raises(ModelError, match='^it does not compile'):
        try_it(f'<mujoco><asset><texture type="2d" name="t" file="{file}" '
               'content_type="image/ktx"/></asset></mujoco>')
    assert opened.take() == set()


def test_a_trial_has_little_memory(monkeypatch):
    monkeypatch.setattr(untrusted_models, 'MAX_MEMORY_BYTES', 1_000_000_000)
    with pytest.raises(ModelError, match='^it (does not compile|cannot be compiled)'):
        try_it('<mujoco><size memory="2G"/></mujoco>')
