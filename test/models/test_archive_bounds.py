# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Archives from anywhere: what is unpacked and compiled, and what is rejected before."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import archive as archives, compose, robots, untrusted_models
from manip_sim.models.archive import load_archive

XML = '<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody></mujoco>'


def archive(files, method=zipfile.ZIP_DEFLATED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, 'w', method) as written:
        for name, content in files.items():
            written.writestr(name, content)
    return buffer.getvalue()


def of_xml(xml):
    return archive({'model.xml': xml}, zipfile.ZIP_STORED)


def rejected(data, text):
    with pytest.raises(ModelError, match=text) as error:
        load_archive(data)
    assert str(error.value).isprintable()


@pytest.mark.full
@pytest.mark.parametrize('robot', ['Panda', 'GR1', 'PandaOmron'])
def test_the_archive_of_a_world_is_its_model(robot):
    world = compose(robot, arena='table')
    model, loaded = world.compile(), load_archive(world.to_archive())
    for field in ('body_mass', 'body_pos', 'jnt_range', 'actuator_gainprm', 'geom_size'):
        np.testing.assert_allclose(getattr(loaded, field), getattr(model, field), rtol=1e-5,
                                   atol=1e-6)


def sphere(faces):
    """Return an STL of random points on a sphere, all of them on its convex hull."""
    points = np.random.default_rng(1).normal(size=(faces, 3, 3))
    found = np.zeros(faces, [('normal', '<f4', 3), ('corners', '<f4', (3, 3)), ('end', '<u2')])
    found['corners'] = points / np.linalg.norm(points, axis=-1, keepdims=True)
    return bytes(80) + struct.pack('<I', faces) + found.tobytes()


def of_mesh(faces):
    return archive({'assets/m.stl': sphere(faces), 'model.xml':
                    '<mujoco><asset><mesh name="m" file="assets/m.stl"/></asset><worldbody>'
                    '<body><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'})


@pytest.mark.full
def test_a_model_that_takes_too_long_is_rejected(monkeypatch):
    monkeypatch.setattr(archives, '_MAX_CPU_S', 1)
    rejected(of_mesh(100_000), '^the model of the archive takes more than 1 s to load')
    assert load_archive(of_mesh(50)).nmesh == 1


@pytest.mark.full
def test_a_model_that_takes_too_much_memory_is_rejected(monkeypatch):
    monkeypatch.setattr(untrusted_models, 'MAX_MEMORY_BYTES', 1_000_000_000)
    rejected(of_xml(f'<mujoco><size memory="2G"/>{XML[8:]}'),
             '^the model of the archive (does not compile|cannot be compiled)')


@pytest.fixture
def untried(monkeypatch):
    monkeypatch.setattr(untrusted_models, '_passed', {})
    monkeypatch.setattr(untrusted_models, '_tried', lambda *_: 'was tried')


@pytest.mark.parametrize('robot', robots.robot_names())
def test_a_robot_that_is_shipped_is_shown_without_a_trial(robot, untried):
    load_archive(compose(robot, arena='bins').to_archive())


@pytest.mark.parametrize('element', [
    '<size memory="1M"/>', '<size nuserdata="9"/>', '<worldbody>' + 5001 * '<geom size="1"/>'
    + '</worldbody>', '<asset><texture name="t" builtin="flat" type="cube" width="1100"/></asset>',
    '<asset><texture name="t" builtin="flat" type="2d" width="9" height="200000"/></asset>',
    '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>',
    '<asset><hfield name="h" nrow="9" ncol="9" size="1 1 1 1"/></asset>',
    '<worldbody><replicate count="9"><geom size="1"/></replicate></worldbody>',
    '<worldbody><flexcomp name="f" type="grid" count="3 3 3"/></worldbody>'])
def test_what_may_take_long_is_tried(element, untried):
    rejected(of_xml(f'<mujoco>{element}</mujoco>'), '^the model of the archive was tried$')


@pytest.mark.parametrize(('element', 'text'), [
    ('<include file="/etc/passwd"/>', "names the included file '/etc/passwd': the"),
    ('<asset><model name="m" file="model.xml"/></asset>',
     "the model file 'model.xml': the model of an archive loads no other"),
    ('<worldbody><attach model="m" body="b" prefix="x"/></worldbody>', "could not find model 'm'"),
    ('<asset><mesh name="m" file="/etc/passwd"/></asset>', "the file '/etc/passwd', which is not"),
    ('<asset><mesh name="m" file="../model.xml"/></asset>', "'../model.xml', which is not"),
    ('<asset><texture name="t" type="cube" fileright="/a.png"/></asset>', "the file '/a.png'"),
    ('<asset><texture name="t" file="/home/u/.ssh/id" content_type="image/ktx"/></asset>', 'id'),
    ('<asset><hfield name="h" file="far.png" size="1 1 1 1"/></asset>', "the file 'far.png'"),
    ('<asset><skin name="s" file="a.skn"/></asset>', "the file 'a.skn'"),
    ('<compiler meshdir="/etc"/>', "names the folder '/etc'"),
    ('<compiler assetdir=".."/>', "names the folder '..'"),
    ('<worldbody><replicate count="100000"><geom size="1"/></replicate></worldbody>', 'replicate'),
    ('<size nuserdata="2000000000"/>', 'nuserdata'),
    ('<worldbody>' + 200_001 * '<geom size="1"/>' + '</worldbody>',
     'may have at most 200000 elements'),
    (101 * '<default>' + 101 * '</default>', '100 in each other'),
    ('<worldbody><geom size="-1"/></worldbody>', 'size 0 must be positive'),
    ('<worldbody>', 'not well-formed XML')])
def test_a_model_that_reaches_out_of_its_archive_or_is_too_large_is_rejected(element, text):
    rejected(of_xml(f'<mujoco>{element}</mujoco>'), text)


@pytest.mark.parametrize('folder', ['', ' meshdir="{}"'], ids=['by path', 'by folder'])
def test_a_mesh_beside_the_archive_is_not_read_though_it_is_there(folder, tmp_path):
    # In the other process MuJoCo would take a file that is there, and that it cannot open, for an
    # empty one: not each reader of a format must reject that, so names are checked.
    (tmp_path / 'm.stl').write_bytes(sphere(50))
    name = 'm.stl' if folder else f'{tmp_path}/m.stl'
    rejected(of_xml(f'<mujoco><compiler{folder.format(tmp_path)}/><asset><mesh name="m" '
                    f'file="{name}"/></asset><worldbody><geom type="mesh" mesh="m"/></worldbody>'
                    '</mujoco>'), 'the model of the archive names the f(ile|older) ')


def test_elements_are_counted_before_they_take_memory():
    data = archive({'model.xml': '<mujoco>' + 8_000_000 * '<a/>' + '</mujoco>',
                    'noise': np.random.default_rng(1).bytes(200_000)})
    tracemalloc.start()
    rejected(data, 'may have at most 200000 elements')
    assert tracemalloc.get_traced_memory()[1] < 1.5e8
    tracemalloc.stop()


@pytest.mark.parametrize(('xml', 'text'), [
    (XML.replace('mujoco', 'robot'), "begins with 'robot'"), ('', 'not well-formed'),
    ('<!DOCTYPE mujoco [<!ENTITY e SYSTEM "file:///etc/passwd">]><mujoco>&e;</mujoco>',
     "the model of the archive, line 1: the entity 'e' is declared"),
    (XML.encode() + b'\0<mujoco/>', 'not well-formed'),
    (f'<?xml version="1.0" encoding="nonsense"?>{XML}', 'not well-formed')])
def test_what_two_parsers_may_read_differently_is_rejected(xml, text):
    rejected(of_xml(xml), text)


def test_what_two_parsers_read_differently_is_read_as_it_was_checked():
    # tinyxml2 ends a document type at the first bracket, and would see what expat takes for none.
    hidden = '<mujoco><worldbody><body/><body/><body/></worldbody></mujoco>'
    model = load_archive(of_xml(f'<!DOCTYPE mujoco [ <!-- > {hidden} --> ]>{XML}'))
    assert (model.nbody, model.njnt) == (2, 1)


@pytest.mark.parametrize('name', [
    '../up.obj', '/abs.obj', 'a/../../up.obj', 'a\\b.obj', './here.obj', 'a//b.obj', 'n' * 201,
    'line\nend', 'C:\\x'])
def test_names_that_lead_out_of_the_archive_are_rejected(name):
    rejected(archive({'model.xml': XML, name: b'x'}), 'has a file of the name')


def test_sizes_are_bounded_before_anything_is_unpacked():
    # A kilobyte of it unpacks to a megabyte.
    rejected(archive({'model.xml': XML, 'zeros': bytes(2**26)}), 'unpacks to 67108')
    rejected(archive({f'{n}.obj': b'' for n in range(1001)}), 'the archive has 1001 files')
    rejected(bytes(2**26 + 1), 'has 67108865 bytes')
    # The list is read as a whole by zipfile, so what it says of itself is not enough.
    long = archive({'n' * 60_000 + str(n): b'' for n in range(5)})
    rejected(long, 'in a list of 3.* bytes')


def test_what_is_no_archive_is_rejected():
    good = archive({'model.xml': XML})
    load_archive(good)
    for data in (b'', b'garbage', good[:-1], good + b'x', good[:30], b'PK\5\6' + bytes(18)):
        rejected(data, 'archive')
    rejected(archive({'other.xml': XML}), 'has no model.xml')
    twice = archive({'model.xml': XML, 'nodel.xml': XML}).replace(b'nodel', b'model')
    rejected(twice, "has the file 'model.xml' twice")
    rejected(archive({'model.xml': XML}, zipfile.ZIP_LZMA), 'neither stored nor deflated')
    encrypted = bytearray(good)
    for signature, offset in ((b'PK\3\4', 6), (b'PK\1\2', 8)):
        encrypted[good.index(signature) + offset] |= 1
    rejected(bytes(encrypted), 'cannot be unpacked')
    # What is unpacked is not what the list says.
    lying = bytearray(good)
    begin = good.index(b'PK\1\2') + 24
    struct.pack_into('<L', lying, begin, len(XML) - 5)
    rejected(bytes(lying), 'cannot be unpacked')


def test_spoiled_archives_are_rejected_or_read():
    rng, good = np.random.default_rng(1), compose('Panda').to_archive()
    for _ in range(150):
        data = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        try:
            load_archive(bytes(data))
        except ModelError as error:
            assert str(error).isprintable()
