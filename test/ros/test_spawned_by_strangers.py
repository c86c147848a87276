# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What strangers spawn: it does not hold up a node, and reads nothing that it may not."""

from dataclasses import replace
import inspect
import os
from pathlib import Path
import re
import stat
import struct
import sys
import threading
from types import SimpleNamespace as Plain
from xml.sax.saxutils import quoteattr

from geometry_msgs.msg import Point, PoseStamped
from harness import START_S
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

from manip_sim.errors import ManipSimError
from manip_sim.interface.composition import spawn_files
from manip_sim.models import untrusted_models
from manip_sim.models.files import requested_robot
from manip_sim.models.user_files import AllowedRoots
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.resources import asset_path, share_directory
from manip_sim.ros import spawning_services
from manip_sim.ros.executor import BACKGROUND_THREAD, begin, in_background
from manip_sim.ros.spawning_services import SpawningServices, StandardTypes
from manip_sim.simulation.robot_spawning import RequestedRobot
from manip_sim.startup import leave

pytestmark = pytest.mark.full

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'models'))
from opened_files import OpenedFiles  # noqa: E402

MESH = ('<mujoco><asset><mesh name="m" file="m.stl"/></asset><worldbody><body name="o">'
        '<freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>')


def request(text='', uri='', name=''):
    pose = PoseStamped()
    pose.pose.orientation.w = 1.0
    return Plain(name=name, allow_renaming=False, uri=uri, resource_string=text,
                 entity_namespace='', initial_pose=pose)


class TriggeredSpawning:
    """The service of a node, without the package of its type: each call spawns what is set."""

    def __init__(self, node, folder):
        self._node = node
        self.request = request()
        SpawningServices(replace(node.shared, node=self), AllowedRoots([folder], 'spawn_roots'),
                         StandardTypes(Plain(SpawnEntity=Trigger, DeleteEntity=Trigger),
                                       None, None))

    def __getattr__(self, name):
        return getattr(self._node, name)

    def create_service(self, service_type, name, callback, callback_group=None):
        async def answer(_, response):
            answered = Plain(result=Plain(result=0, error_message=''), entity_name='')
            outcome = callback(self.request, answered)
            if inspect.isawaitable(outcome):
                await outcome
            response.success = bool(answered.entity_name)
            response.message = answered.entity_name or answered.result.error_message
            return response
        # The node has a service of this name already where simulation_interfaces is installed.
        self._node.create_service(service_type, f'{name}_by_trigger', answer,
                                  callback_group=callback_group)


def stl(corners):
    faces = np.zeros(len(corners), [('normal', '<f4', 3), ('corners', '<f4', (3, 3)),
                                    ('attribute', '<u2')])
    faces['corners'] = corners
    return bytes(80) + struct.pack('<I', len(faces)) + faces.tobytes()


def slow_mesh(faces):
    """Return an STL of random points on a sphere, all of them on its convex hull."""
    points = np.random.default_rng(1).normal(size=(faces, 3, 3))
    return stl(0.1 * points / np.linalg.norm(points, axis=-1, keepdims=True))


def test_a_mesh_that_takes_too_long_is_rejected_while_all_else_goes_on(
        serve, client, tmp_path, monkeypatch):
    monkeypatch.setattr(untrusted_models, 'MAX_CPU_S', 1)
    seen, answer = threading.Event(), untrusted_models._answer
    monkeypatch.setattr(
        untrusted_models, '_answer', lambda work: seen.wait(START_S) and answer(work))
    (tmp_path / 'm.stl').write_bytes(slow_mesh(100_000))
    (tmp_path / 'o.xml').write_text(MESH)
    node = serve(arena='table')
    spawning = TriggeredSpawning(node, tmp_path)
    spawning.request = request(uri='o.xml')
    states = client.listen(JointState, 'joint_states')
    spawner = client.node.create_client(Trigger, 'manip_sim/spawn_entity_by_trigger')
    client.spin_until(spawner.service_is_ready)
    begin = node.simulation.time_ns
    future = spawner.call_async(Trigger.Request())
    for paused in (True, False) * 3:
        assert client.call(SetBool, 'manip_sim/pause', SetBool.Request(data=paused)).success
    count = len(states)
    client.spin_until(lambda: len(states) > count + 10)
    assert not future.done() and node.simulation.time_ns > begin
    seen.set()
    client.spin_until(future.done)
    assert not future.result().success
    assert future.result().message == (
        f'{tmp_path}/o.xml takes more than 1 s to load, which is the limit')
    assert node.simulation.plan.object_names == ['cube']


def test_an_object_that_is_made_in_the_background_comes(serve, client, tmp_path):
    (tmp_path / 'm.stl').write_bytes(slow_mesh(100))
    (tmp_path / 'o.xml').write_text(MESH)
    node = serve(arena='table')
    spawning = TriggeredSpawning(node, tmp_path)
    for uri, name in (('o.xml', 'o'), ('', 'ball')):
        spawning.request = request('{shape: sphere, size: 0.1, mass: 0.2, name: ball}', uri)
        answer = client.call(Trigger, 'manip_sim/spawn_entity_by_trigger')
        assert answer.success, answer.message
        assert answer.message == name
    assert node.simulation.plan.object_names == ['cube', 'o', 'ball']
    client.spin_until(lambda: client.node.count_publishers('objects/o/pose') > 0)
    assert not [t for t in threading.enumerate() if t.name == 'background']


def test_an_arm_that_is_spawned_takes_commands_by_its_actuators(serve, client):
    folder = Path(__file__).resolve().parents[1] / 'data/files'
    node = serve(arena='table')
    spawning = TriggeredSpawning(node, folder)
    spawning.request = request(uri='stand_arm.xml')
    assert client.node.count_publishers('actuators/states') == 0
    assert client.call(Trigger, 'manip_sim/spawn_entity_by_trigger').message == 'stand'
    states = client.listen(JointState, 'actuators/states')
    commands = client.node.create_publisher(JointState, 'actuators/command', 10)
    client.spin_until(lambda: states and commands.get_subscription_count())
    assert list(states[0].name) == ['stand_pan', 'stand_lift']
    commands.publish(JointState(name=['stand_pan'], position=[0.6]))
    client.spin_until(lambda: abs(states[-1].position[0] - 0.6) < 1e-2)
    spawning.request = Plain(entity='stand')
    client.call(Trigger, 'manip_sim/delete_entity_by_trigger')
    assert node.simulation.plan.object_names == ['cube']
    client.spin_until(lambda: client.node.count_publishers('actuators/states') == 0)
    commands.publish(JointState(name=['stand_pan'], position=[0.6]))
    client.spin_until(lambda: node.surroundings.statistics['actuators'].rejected == 1)


@pytest.mark.parametrize(('topic', 'message', 'counts', 'what'), [
    ('manip_sim/pull', Marker(ns='stand_fore', points=[Point(x=0.4, z=1.0)] * 2), 'pull',
     "unknown body 'stand_fore'"),
    ('actuators/command', JointState(name=['stand_pan'], position=[0.6]), 'actuators',
     "unknown actuator that is of no part 'stand_pan'")])
def test_a_command_for_what_was_deleted_before_its_period_is_told_and_the_node_goes_on(
        serve, client, topic, message, counts, what):
    node = serve(arena='table', start_paused=True)
    log = client.log()
    spawning = TriggeredSpawning(node, Path(__file__).resolve().parents[1] / 'data/files')
    spawning.request = request(uri='stand_arm.xml')
    assert client.call(Trigger, 'manip_sim/spawn_entity_by_trigger').message == 'stand'
    client.publish(topic, message)
    client.spin_until(lambda: node.surroundings.statistics[counts].accepted == 1)
    spawning.request = Plain(entity='stand')
    client.call(Trigger, 'manip_sim/delete_entity_by_trigger')
    assert client.call(SetBool, 'manip_sim/pause', SetBool.Request(data=False)).success
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: len(states) > 20)
    client.spin_until(lambda: any(what in text for text in log))
    assert node.rejections.failed['commands'] == 1


NO_PLAIN_DATA = [
    '{shape: !!bool maybe}', '{size: 0x' + 4990 * 'f' + '}', '{mass: !!int ""}',
    '{name: "\\UFFFFFFFF"}', '{shape: !!timestamp never}', '{shape: !!set [a]}',
    f'{{mass: {":".join(400 * "1")}.5}}', f'{{mass: 1{400 * "0"}}}']


def test_yaml_that_is_no_plain_data_is_answered(serve, client):
    spawning = TriggeredSpawning(serve(arena='table'), Path())
    for text in NO_PLAIN_DATA:
        spawning.request = request(text)
        answer = client.call(Trigger, 'manip_sim/spawn_entity_by_trigger')
        assert not answer.success, text
        assert answer.message.startswith('resource_string is invalid or unsafe YAML: '), text


def test_a_process_that_ends_does_not_wait_for_the_background(monkeypatch):
    node, going, ended = Plain(executor=None), threading.Event(), []
    monkeypatch.setattr(os, '_exit', ended.append)
    waiting = in_background(node, lambda: going.wait(START_S))
    waiting.send(None)
    assert leave(3, 'others') == 3 and ended == []
    assert leave(3, 'others', BACKGROUND_THREAD) == 3 and ended == [3]
    going.set()
    with pytest.raises(StopIteration):
        while True:
            waiting.send(None)


def test_what_is_tried_is_given_up_by_a_process_that_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(untrusted_models, 'MAX_CPU_S', 60)
    (tmp_path / 'm.stl').write_bytes(slow_mesh(100_000))
    (tmp_path / 'o.xml').write_text(MESH)
    held = untrusted_models.load_self_contained(
        tmp_path / 'o.xml', AllowedRoots([tmp_path], 'spawn_roots'))
    loading = begin(held.load)
    while not untrusted_models._running:
        assert not loading.done()
    untrusted_models.give_up()
    with pytest.raises(ManipSimError, match='to load, which is the limit'):
        loading.result(START_S)
    assert not untrusted_models._running


@pytest.mark.parametrize('folders', [[], ['']])
def test_nothing_but_our_own_assets_may_be_read_unless_the_operator_says_so(folders):
    files = spawn_files(folders)
    assert files.read(asset_path('robots', 'panda'), 'MJCF file').startswith(b'<')
    for path in ('package.xml', 'assets/../package.xml'):
        with pytest.raises(ManipSimError, match='only files below spawn_roots may be: .*assets$'):
            files.read(share_directory() / path, 'MJCF file')


def test_a_node_with_a_root_that_is_missing_does_not_start(serve):
    with pytest.raises(ManipSimError, match='^no such folder in spawn_roots: /nowhere$'):
        serve(spawn_roots=['/nowhere'])


# ---------------------------------------------------------------------- random requests


@pytest.fixture(scope='module')
def hostile(tmp_path_factory):
    """Return the roots, with all that should not be read in them, and what is private."""
    folder = tmp_path_factory.mktemp('spawn')
    roots, private = folder / 'roots', folder / 'private'
    for made in (roots, private, roots / 'sub', roots / 'dir.xml'):
        made.mkdir()
    for name in ('key', 'key.xml', 'key.stl', 'key.png', 'key.yaml', 'key.urdf'):
        (private / name).write_text(f'<mujoco>{MESH}</mujoco> PRIVATE')
    (roots / 'good.xml').write_text(MESH.replace('m.stl', 'good.stl'))
    (roots / 'good.stl').write_bytes(slow_mesh(20))
    for suffix in ('.xml', '.stl', '.png', '.yaml', '.urdf'):
        (roots / f'out{suffix}').symlink_to(private / f'key{suffix}')
        (roots / f'loop{suffix}').symlink_to(roots / f'loop{suffix}')
        (roots / f'zero{suffix}').symlink_to('/dev/zero')
        (roots / f'proc{suffix}').symlink_to('/proc/self/environ')
        os.mkfifo(roots / f'pipe{suffix}')
        os.mknod(roots / f'socket{suffix}', stat.S_IFSOCK | 0o600)
    (roots / 'outside').symlink_to(private)
    (roots / 'many.stl').write_bytes(bytes(80) + b'\xff\xff\xff\xee' + bytes(100))
    (roots / 'bomb.png').write_bytes(
        b'\x89PNG\r\n\x1a\n\0\0\0\rIHDR' + struct.pack('>II', 65535, 65535) + bytes(100))
    (roots / 'bomb.obj').write_text('v 0 0 0\n' + f'f {"1 " * 5000}\n' * 9)
    (roots / 'bomb.xml').write_text(
        '<!DOCTYPE a [<!ENTITY b "bbbbbbbb"><!ENTITY c "&b;&b;&b;&b;">]><mujoco>&c;</mujoco>')
    (roots / 'deep.xml').write_text('<mujoco>' * 20_000)
    (roots / 'self.xml').write_text('<mujoco><include file="self.xml"/></mujoco>')
    (roots / 'zip.xml').write_bytes(b'PK\x03\x04' + bytes(1000))
    (roots / 'bomb.yaml').write_text('a: &a [1, 1]\nobjects: [*a, *a]')
    (roots / 'list.yaml').write_text('objects: [{name: o, file: outside/key.xml}]')
    opened = OpenedFiles(private)
    yield roots, private, opened
    opened.close()


STEMS = (
    'good', 'out', 'loop', 'zero', 'proc', 'pipe', 'socket', 'many', 'bomb', 'deep', 'self', 'zip',
    'dir', 'missing', 'key', 'list', 'outside/key', '../private/key', 'sub/../../private/key',
    'PRIVATE/key', './' * 200 + 'out', 'a' * 5000, 'x\0y', '~/key', '/dev/stdin', '%2e%2e/key')
PATHS = st.builds(lambda scheme, stem, suffix: f'{scheme}{stem}{suffix}',
                  st.sampled_from(['', '', '', 'file://', 'package://', 'package://private/',
                                   'http://', '//']),
                  st.one_of(st.sampled_from(STEMS), st.text(max_size=8)),
                  st.sampled_from(['.xml', '.stl', '.png', '.obj', '.yaml', '.mjcf', '.urdf',
                                   '.urdf.xacro a:=b', '']))
ATTRIBUTES = ('file', 'filename', 'fileright', 'fileup', 'meshdir', 'texturedir', 'assetdir',
              'content_type', 'name', 'type', 'model', 'plugin', 'class', 'File')
ELEMENTS = ('include', 'mesh', 'texture', 'hfield', 'skin', 'model', 'flexcomp', 'plugin', 'body',
            'geom', 'attach', 'asset', 'worldbody', 'compiler', 'extension', 'default',
            'replicate', 'size', 'keyframe', 'visual', 'link', 'geometry', 'material')
VALUES = st.one_of(PATHS, st.sampled_from(
    ['m', 'cube', '2d', 'mesh', 'image/ktx', '1000000', 'true']))
TREES = st.recursive(
    st.just(''), lambda inner: st.builds(
        lambda tag, attributes, content: f'<{tag}{attributes}>{content}</{tag}>',
        st.sampled_from(ELEMENTS),
        st.dictionaries(st.sampled_from(ATTRIBUTES), VALUES, max_size=3).map(
            lambda given: ''.join(f' {key}={quoteattr(value)}' for key, value in given.items())),
        st.lists(inner, max_size=3).map(''.join)), max_leaves=8)
BODY = '<worldbody><body><freejoint/><geom size="0.1"/></body></worldbody>'
ROBOT = ('<robot name="r"><link name="a"/><link name="b"><visual><geometry><mesh filename={}/>'
         '</geometry></visual></link><joint name="j" type="revolute"><parent link="a"/>'
         '<child link="b"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint>{}</robot>')
TEXTS = st.one_of(
    st.builds(lambda root, tree, end: f'<{root}>{tree}{BODY}</{root}{end}>',
              st.sampled_from(['mujoco', 'robot', 'sdf']), TREES,
              st.sampled_from(['', '', '', ' '])),
    st.builds(lambda path: f'{{name: o, file: {path!r}}}', PATHS),
    st.builds(lambda path: f'{{robot: {path!r}}}', PATHS),
    st.builds(lambda path: f'{{model: {path!r}, base: {path!r}}}', PATHS),
    st.builds(lambda path, more: ROBOT.format(quoteattr(path), more), PATHS, TREES),
    st.builds(lambda path: f'objects: [{{name: o, file: {path!r}}}]', PATHS),
    st.text(max_size=30), st.binary(max_size=30).map(lambda data: data.decode('latin-1')))


def door(files, text='', uri=''):
    """Return what is spawned, or the one line that says why nothing is."""
    try:
        found = spawning_services._prepared(request(text, uri), files)[1]()
        return found.create('left', Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))) if (
            isinstance(found, RequestedRobot)) else found
    except ManipSimError as error:
        assert error.args and str(error) and '\n' not in str(error) and len(str(error)) < 3000
        return None


@pytest.fixture
def tried_here(monkeypatch):
    """Compile in this process, where nothing else keeps MuJoCo from opening files."""
    monkeypatch.setattr(untrusted_models, 'run_limited', lambda *_: None)
    monkeypatch.setattr(requested_robot, 'run_limited', lambda *_, **__: None)


@settings(max_examples=300)
@given(uri=PATHS)
def test_no_uri_leads_outside_or_stops_the_reader(hostile, tried_here, uri):
    roots, private, opened = hostile
    files = AllowedRoots([roots], 'spawn_roots')
    found = door(files, uri=uri.replace('PRIVATE', str(private)).replace(
        'file://', f'file://{roots}/'))
    assert found is None or 'good' in uri
    assert opened.take() == set()


@settings(max_examples=400)
@given(text=TEXTS)
def test_no_text_and_no_file_reads_what_is_private(hostile, tried_here, text):
    roots, private, opened = hostile
    text = text.replace('PRIVATE', str(private))
    door(AllowedRoots([roots], 'spawn_roots'), text)
    for name in ('try.xml', 'try.yaml', 'try.urdf'):
        (roots / name).write_bytes(text.encode(errors='replace'))
        door(AllowedRoots([roots], 'spawn_roots'), uri=name)
        door(AllowedRoots([roots], 'spawn_roots'), f'{{robot: {name}}}')
    assert opened.take() == set()


def test_materials_that_a_mesh_names_are_not_read(hostile, tried_here):
    roots, private, opened = hostile
    (roots / 'm.obj').write_text(
        f'mtllib {private}/key\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl key\n'
        'f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n')
    (roots / 'try.xml').write_text(MESH.replace('m.stl', 'm.obj'))
    assert door(AllowedRoots([roots], 'spawn_roots'), uri='try.xml').mass_kg > 1.0
    assert opened.take() == set()


@pytest.mark.parametrize('name', [
    'many.stl', 'bomb.png', 'bomb.obj', 'pipe.stl', 'socket.stl', 'zero.png', 'loop.stl',
    'proc.png', 'dir.xml', 'out.stl', '../private/key.png', 'missing.obj'])
def test_a_file_that_is_a_trap_is_told_in_one_line(hostile, name):
    roots, _, opened = hostile
    kind = 'texture type="2d"' if name.endswith('.png') else 'mesh'
    (roots / 'try.xml').write_text(
        f'<mujoco><asset><{kind} name="m" file="{name}"/></asset>{BODY}</mujoco>')
    with pytest.raises(ManipSimError) as error:
        spawning_services._prepared(
            request(uri='try.xml'), AllowedRoots([roots], 'spawn_roots'))[1]()
    assert re.search(f'{Path(name).stem}|does not compile', str(error.value))
    assert '\n' not in str(error.value)
    assert opened.take() == set()
