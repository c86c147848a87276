# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Archives from anywhere: what is unpacked and compiled, and what is rejected before."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
from opened_files import OpenedFiles
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import archive as archives, compose, untrusted_models
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
    rejected(of_mesh(100_000), '^the archive takes more than 1 s to load')
    assert load_archive(of_mesh(50)).nmesh == 1


@pytest.mark.full
def test_a_model_that_takes_too_much_memory_is_rejected(monkeypatch):
    monkeypatch.setattr(untrusted_models, 'MAX_MEMORY_BYTES', 1_000_000_000)
    rejected(of_xml(f'<mujoco><size memory="2G"/>{XML[8:]}'),
             '^the archive (does not compile|cannot be compiled)')


@pytest.mark.parametrize('element', [
    '<include file="/etc/passwd"/>', '<asset><model name="m" file="model.xml"/></asset>',
    '<worldbody><attach model="m" body="b" prefix="x"/></worldbody>',
    '<asset><mesh name="m" file="/etc/passwd"/></asset>',
    '<asset><texture name="t" type="cube" fileright="/a.png"/></asset>',
    '<asset><texture name="t" file="/etc/passwd" content_type="image/ktx"/></asset>',
    '<asset><hfield name="h" file="/etc/passwd" size="1 1 1 1"/></asset>',
    '<asset><skin name="s" file="/etc/passwd"/></asset>',
    '<worldbody><replicate count="1000000000"><geom size="1"/></replicate></worldbody>',
    '<size nuserdata="2000000000"/>', 200_000 * '<default>' + 200_000 * '</default>',
    '<worldbody><geom size="-1"/></worldbody>', '<worldbody>'], ids=lambda text: text[:40])
def test_a_model_that_reaches_out_of_its_archive_or_is_too_large_is_rejected(
        element, monkeypatch):
    monkeypatch.setattr(archives, '_MAX_CPU_S', 1)
    rejected(of_xml(f'<mujoco>{element}</mujoco>'),
             '^the archive (does not compile|cannot be|takes more|is not|has elements)')


@pytest.mark.parametrize('folder', ['', ' meshdir="{}"'], ids=['by path', 'by folder'])
def test_a_mesh_beside_the_archive_is_not_read_though_it_is_there(folder, tmp_path):
    (tmp_path / 'm.stl').write_bytes(sphere(50))
    opened = OpenedFiles(tmp_path)
    name = 'm.stl' if folder else f'{tmp_path}/m.stl'
    rejected(of_xml(f'<mujoco><compiler{folder.format(tmp_path)}/><asset><mesh name="m" '
                    f'file="{name}"/></asset><worldbody><geom type="mesh" mesh="m"/></worldbody>'
                    '</mujoco>'), '^the archive does not compile')
    assert opened.take() == set()
    opened.close()


@pytest.mark.full
def test_what_takes_much_memory_takes_none_here(monkeypatch):
    monkeypatch.setattr(archives, '_MAX_CPU_S', 1)
    data = archive({'model.xml': '<mujoco>' + 2_000_000 * '<a/>' + '</mujoco>',
                    'zeros': bytes(2**26)})
    tracemalloc.start()
    rejected(data, '^the archive ')
    assert tracemalloc.get_traced_memory()[1] < 2e7
    tracemalloc.stop()


@pytest.mark.parametrize('xml', [
    '', '<?xml version="1.0" encoding="nonsense"?><mujoco>'])
def test_what_is_no_model_is_rejected(xml):
    rejected(of_xml(xml), '^the archive is not well-formed XML')


def test_files_of_an_archive_are_not_written_whatever_their_names_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = ('../up.obj', '/abs.obj', 'a\\b.obj', 'n' * 201, 'line\nend')
    load_archive(archive({'model.xml': XML, **dict.fromkeys(names, b'x')}))
    assert not [*tmp_path.iterdir()]


def test_an_archive_is_bounded_before_it_is_sent_to_another_process():
    rejected(bytes(2**26 + 1), 'has 67108865 bytes')


@pytest.mark.full
def test_what_is_no_archive_is_rejected():
    good = archive({'model.xml': XML})
    load_archive(good)
    for data in (b'', b'garbage', good[:-1], good[:30], b'PK\5\6' + bytes(18)):
        rejected(data, 'archive')
    rejected(archive({'other.xml': XML}), 'has no model.xml')
    encrypted = bytearray(good)
    for signature, offset in ((b'PK\3\4', 6), (b'PK\1\2', 8)):
        encrypted[good.index(signature) + offset] |= 1
    rejected(bytes(encrypted), 'cannot be unpacked')
    # What is unpacked is not what the list says.
    lying = bytearray(good)
    begin = good.index(b'PK\1\2') + 24
    struct.pack_into('<L', lying, begin, len(XML) - 5)
    rejected(bytes(lying), 'cannot be unpacked')


@pytest.mark.full
def test_spoiled_archives_are_rejected_or_read():
    rng, good = np.random.default_rng(1), compose('Panda').to_archive()
    for _ in range(12):
        data = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        try:
            load_archive(bytes(data))
        except ModelError as error:
            assert str(error).isprintable()
