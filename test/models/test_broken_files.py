# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Files that no model can be made of end in one clear line, soon and without much memory."""

from __future__ import annotations

import contextlib
import json
import os
import re
import struct
import subprocess
import sys

import pytest

from manip_sim.errors import ModelError
from manip_sim.models.mjcf import MujocoXMLModel

BODY = '<body name="base"><geom name="box" size="0.1"/></body>'
#: Loads files with 3 GB of address space; tells for each the error, CPU time [s], memory [kB].
LOAD = """
import json
from pathlib import Path
import resource
import sys
import time
resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
from manip_sim.errors import ModelError
from manip_sim.models.mjcf import MujocoXMLModel
for case, file in json.load(sys.stdin).items():
    begin, message = time.process_time(), 'loaded'
    try:
        MujocoXMLModel(file)
    except ModelError as error:
        message = str(error)
    # Unlike ru_maxrss, this leaves out the memory of the process that this one was started by.
    peak_kb = int(Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0])
    print(json.dumps([case, message, time.process_time() - begin, peak_kb]), flush=True)
"""


def mjcf(worldbody=BODY, before=''):
    return f'<mujoco>{before}<worldbody>{worldbody}</worldbody></mujoco>'


def with_asset(asset):
    return mjcf(before=f'<asset>{asset}</asset>')


TETRAHEDRON = 'v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n'
ENTITIES = ('<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa">'
            + ''.join(f'<!ENTITY {chr(98 + i)} "{("&" + chr(97 + i) + ";") * 10}">'
                      for i in range(9)) + ']>')
REPLICATE = '<replicate count="{}" offset="1 0 0">{}</replicate>'
GEOM = '<geom size="0.1"/>'

#: By what is wrong, the main file, the line that tells so, and further files.
BROKEN = {
    'cut off': (mjcf()[:-9], r'main\.xml is not well-formed XML: .*: line 1, column \d+; correct '
                'it there$', {}),
    'empty': ('', r'main\.xml is not well-formed XML: no element found', {}),
    'random bytes': (bytes(range(256)) * 20, r'main\.xml is not well-formed XML: ', {}),
    'unknown encoding': ('<?xml version="1.0" encoding="klingon"?><mujoco/>',
                         r'main\.xml is not well-formed XML: unknown encoding', {}),
    'world': ('<world><body/></world>', r'main\.xml is not a model: its root element is <world>, '
                                        'that of MJCF is <mujoco>, that of URDF is <robot>$', {}),
    'unknown element': (mjcf('<bodi/>'),
                        r'main\.xml is not MJCF that MuJoCo can read: .*bodi', {}),
    'equal names': (mjcf(BODY + BODY), "repeated name 'base' in body", {}),
    'mesh missing': (with_asset('<mesh name="m" file="no/such.stl"/>'),
                     r'no such mesh file: .*/no/such\.stl$', {}),
    'mesh above the folder missing': (with_asset('<mesh name="m" file="../../such.stl"/>'),
                                      r'no such mesh file: /.*such\.stl$', {}),
    'texture missing': (with_asset('<texture name="t" type="2d" file="such.png"/>'),
                        r'no such texture file: .*/such\.png$', {}),
    'cube texture missing': (with_asset('<texture name="t" type="cube" fileright="such.png"/>'),
                             r'no such texture file: .*/such\.png$', {}),
    'height field missing': (with_asset('<hfield name="h" size="1 1 1 1" file="such.png"/>'),
                             r'no such height field file: .*/such\.png$', {}),
    'device as mesh': (with_asset('<mesh name="m" content_type="model/stl" file="/dev/zero"/>'),
                       '^cannot read mesh file /dev/zero: it is a device or a pipe$', {}),
    'folder as mesh': (with_asset('<mesh name="m" file="../x.stl/"/>'),
                       r'^cannot read mesh file .*x\.stl: it is a folder$', {'../x.stl/y': ''}),
    'empty mesh': (with_asset('<mesh name="m" file="m.stl"/>'),
                   '^MujocoXMLModel0 does not compile', {'m.stl': ''}),
    'mesh cut off': (with_asset('<mesh name="m" file="m.stl"/>'),
                     '^MujocoXMLModel0 does not compile: ',
                     {'m.stl': b'\0' * 80 + struct.pack('<I', 1000) + b'\0' * 500}),
    'pipe as texture': (with_asset('<texture name="t" type="2d" file="t.png"/>'),
                        'cannot read texture file .*t.png: it is a device or a pipe$',
                        {'t.png': os.mkfifo}),
    'include missing': (mjcf(before='<include file="such.xml"/>'),
                        r'^no such included file: .*/such\.xml$', {}),
    'include of no XML': (mjcf(before='<include file="a.txt"/>'),
                          r'a\.txt is not well-formed XML: ', {'a.txt': 'root:x:0:0'}),
    'include of itself': (mjcf(before='<include file="main.xml"/>'),
                          r'main\.xml is loaded into itself: main\.xml > main\.xml$', {}),
    'includes in a circle': (
        mjcf(before='<include file="a.xml"/>'),
        r'main\.xml is loaded into itself: main\.xml > a\.xml > b\.xml > main\.xml$',
        {'a.xml': '<x><include file="./b.xml"/></x>',
         'b.xml': '<x><include file="../model/main.xml"/></x>'}),
    'model of itself': (with_asset('<model name="m" file="main.xml"/>'),
                        r'main\.xml is loaded into itself: main\.xml > main\.xml$', {}),
    'model without a file': (with_asset('\n<model name="m"/>'),
                             r'main\.xml, line 2: <model> needs a file$', {}),
    'model of an empty file name': (
        mjcf(before='<include file="a.xml"/>'), r'a\.xml, line 3: <model> needs a file$',
        {'a.xml': '<x>\n<asset>\n<model name="m" file=""/></asset></x>'}),
    'models in a circle': (
        with_asset('<model name="m" file="a.xml"/>'),
        r'a\.xml is loaded into itself: a\.xml > b\.xml > a\.xml$',
        {'a.xml': with_asset('<model name="m" file="b.xml"/>'),
         'b.xml': with_asset('<model name="m" file="a.xml"/>')}),
    'entity': (ENTITIES + mjcf('<body name="&j;"/>'),
               r"main\.xml, line 1: the entity 'a' is declared; models must not declare any$", {}),
    'entity of a file': ('<!DOCTYPE m [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
                         + mjcf('<body name="&x;"/>'), "line 1: the entity 'x' is declared", {}),
    'entity in an include': (mjcf(before='<include file="a.xml"/>'),
                             r"a\.xml, line 1: the entity 'a' is declared",
                             {'a.xml': ENTITIES + '<x><option/></x>'}),
    'replicate of no number': (mjcf(REPLICATE.format('nan', GEOM)), 'is not MJCF that MuJoCo', {}),
    'replicate of words': (mjcf(REPLICATE.format('many', GEOM)), 'is not MJCF that MuJoCo', {}),
    'memory': (mjcf(before='<size memory="100T"/>'), 'does not compile: .*memory', {}),
    'name with a null character': (with_asset('<mesh name="m" file="a&#0;b"/>'),
                                   'not well-formed XML', {}),
    'not a number': (mjcf('<body name="base" pos="nan 0 0"><geom size="0.1"/></body>'),
                     "does not compile: pos of body 'base' must be finite$", {}),
    'infinite mass': (
        mjcf('<body name="b"><inertial pos="0 0 0" mass="inf" diaginertia="1 1 1"/></body>'),
        "does not compile: mass of body 'b' must be finite$", {}),
    'damping that is none': (
        mjcf('<body><joint name="j" damping="nan"/><geom size="0.1"/></body>'),
        "does not compile: (damping of joint 'j' must be finite$|.* QACC)", {}),
    'gear that is none': (
        mjcf('<body><joint name="j"/><geom size="0.1"/></body>').replace(
            '</mujoco>', '<actuator><motor name="m" joint="j" gear="nan"/></actuator></mujoco>'),
        "does not compile: gear of actuator 'm' must be finite$", {}),
}


@pytest.fixture(scope='module')
def told(tmp_path_factory):
    """Load all broken files in one process, and return what it tells by case."""
    files = {}
    for case, (content, _, others) in BROKEN.items():
        folder = tmp_path_factory.mktemp('broken') / 'model'
        for name, made in {**others, 'main.xml': content}.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if callable(made):
                made(path)
            else:
                path.write_bytes(made if isinstance(made, bytes) else made.encode())
        files[case] = str(folder / 'main.xml')
    child = subprocess.run([sys.executable, '-c', LOAD], input=json.dumps(files), text=True,
                           capture_output=True, timeout=110.0)
    found = {case: rest for case, *rest in map(json.loads, child.stdout.splitlines())}
    assert list(found) == list(BROKEN), child.stderr
    return found


@pytest.mark.full
@pytest.mark.parametrize('case', BROKEN)
def test_a_broken_file_is_told_in_one_line_within_ten_seconds_and_a_gigabyte(case, told):
    message, seconds, kilobytes = told[case]
    assert re.search(BROKEN[case][1], message)
    assert '\n' not in message and len(message) < 700
    assert seconds < 10.0 and kilobytes < 1e6


@pytest.mark.parametrize('name', ['main.xml', 'mesh.obj'])
def test_a_file_that_must_not_be_read_is_told(name, tmp_path, as_nobody):
    (tmp_path / 'mesh.obj').write_text(TETRAHEDRON)
    (tmp_path / 'main.xml').write_text(with_asset('<mesh name="m" file="mesh.obj"/>'))
    (tmp_path / name).chmod(0)
    with as_nobody(), pytest.raises(ModelError, match=rf'^cannot read \w+ file .*{name}: '
                                                      'Permission denied$'):
        MujocoXMLModel(tmp_path / 'main.xml')


@pytest.fixture
def as_nobody(tmp_path):
    """Return a context in which files without permissions cannot be read, also by root."""
    @contextlib.contextmanager
    def switch():
        is_root = os.geteuid() == 0
        if is_root:
            for folder in (tmp_path, *tmp_path.parents):
                if 'pytest-of-' in str(folder):
                    folder.chmod(0o755)
            os.seteuid(65534)
        try:
            yield
        finally:
            if is_root:
                os.seteuid(0)
    return switch


@pytest.mark.parametrize(('file', 'why'), [
    ('/dev/zero', 'it is a device or a pipe'), ('.', 'it is a folder'), ('a\0b', '.*null')])
def test_a_model_that_is_no_file_is_told(file, why):
    with pytest.raises(ModelError, match=f'^cannot read MJCF file .*: {why}'):
        MujocoXMLModel(file)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / 'pipe.xml')
    with pytest.raises(ModelError, match='pipe.xml: it is a device or a pipe$'):
        MujocoXMLModel(tmp_path / 'pipe.xml')


@pytest.mark.parametrize('content', [
    mjcf(REPLICATE.format(50, '<body><freejoint/><geom size="0.1"/></body>')),
    '<!DOCTYPE mujoco>' + mjcf(), '\ufeff' + mjcf(),
    mjcf(before='<include file="sub/a.xml"/>'),
    with_asset('<model name="m" file="sub/m.xml"/><model name="n" file="sub/m.xml"/>'),
    mjcf(before='<compiler autolimits="true"/><size nuserdata="100" nkey="3" memory="10M" '
                'nuser_geom="4"/><statistic extent="3"/>'
                '<visual><map znear="0.1"/></visual><option cone="elliptic"/>'),
    mjcf(before='<size njmax="500" nconmax="50"/>'),
    mjcf('<body><joint range="-inf inf" limited="false"/><geom size="0.1"/></body>')])
def test_what_is_not_broken_is_loaded(content, tmp_path):
    (tmp_path / 'sub').mkdir()
    # From the folder of the model, and from that of the file which includes.
    (tmp_path / 'sub' / 'a.xml').write_text('<x><include file="sub/b.xml"/></x>')
    (tmp_path / 'sub' / 'b.xml').write_text('<x><include file="c.xml"/></x>')
    (tmp_path / 'sub' / 'c.xml').write_text('<x><option timestep="0.004"/></x>')
    (tmp_path / 'sub' / 'm.xml').write_text(mjcf())
    file = tmp_path / 'main.xml'
    file.write_text(content, encoding='utf-8')
    assert MujocoXMLModel(file).compile().ngeom >= 1
