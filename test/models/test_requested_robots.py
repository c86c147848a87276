# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots of somebody who is not trusted: from files below some folders, or from a text."""

import copy
from pathlib import Path
import re
import shutil
from xml.sax.saxutils import quoteattr

from files_rig import ARM, ARM_WITH_HAND
from hypothesis import given, settings, strategies as st
import mujoco
import numpy as np
from opened_files import OpenedFiles
import pytest
from requested_rig import stl, urdf, write_package
import yaml

from manip_sim.errors import ManipSimError, ModelError
from manip_sim.models import compose
from manip_sim.models.asset_files import LostShape
from manip_sim.models.files import load_robot, requested_robot
from manip_sim.models.files.requested_robot import load_requested
from manip_sim.models.urdf_writer import urdf_of
from manip_sim.models.user_files import AllowedRoots, CachedFiles, InMemoryFile

DATA = Path(__file__).resolve().parents[1] / 'data/files'
ROBOTS = sorted(file.name for file in DATA.iterdir() if file.suffix in ('.xml', '.urdf')
                and file.stem not in ('room', 'no_meshes', 'lost_mesh', 'soft_pads'))
#: Arrays of a model that its file decides.
NUMBERS = [name for name in dir(mujoco.MjModel)
           if name.startswith(('body_', 'jnt_', 'dof_', 'geom_', 'actuator_', 'eq_', 'mesh_vert',
                               'qpos0', 'exclude_', 'site_', 'sensor_'))]


@pytest.fixture
def roots(tmp_path):
    """Return a folder with robots, with all that it should not read beside it."""
    folder = tmp_path / 'roots'
    write_package(folder)
    (folder / 'hand.xml').write_text(ARM_WITH_HAND)
    (tmp_path / 'private').mkdir()
    for name in ('arm.urdf', 'arm.xml', 'arm.yaml', 'arm.srdf', 'link.stl', 'package.xml'):
        (tmp_path / 'private' / name).write_bytes(
            stl() if name == 'link.stl' else ARM.encode())
    return folder


@pytest.fixture
def opened(roots):
    found = OpenedFiles(roots.parent / 'private')
    yield found
    assert not found.take()
    found.close()


@pytest.fixture
def here(monkeypatch):
    """Load in this process alone, where nothing else keeps MuJoCo from opening files."""
    monkeypatch.setattr(requested_robot, 'run_limited', lambda *_, **__: None)


def requested(file, folder, **arguments):
    return load_requested(Path(file), AllowedRoots([folder], 'spawn_roots'), **arguments)


def rejection(file, folder):
    with pytest.raises(ModelError) as error:
        requested(file, folder)
    assert '\n' not in str(error.value)
    return str(error.value)


def same(one, other):
    models = [robot.compile() for robot in (one, other)]
    for name in NUMBERS:
        first, second = (getattr(model, name) for model in models)
        if isinstance(first, np.ndarray) and not name.endswith(('pathadr', 'matid')):
            np.testing.assert_array_equal(first, second, name)
    assert one.described | {'model': ''} == other.described | {'model': ''}
    assert one.init_qpos.tolist() == other.init_qpos.tolist()


@pytest.mark.parametrize('name', ROBOTS)
def test_a_robot_is_the_same_as_for_somebody_who_may_read_everything(name, tmp_path, here):
    shutil.copy(DATA / name, tmp_path / name)
    mine, trusted = requested(tmp_path / name, tmp_path), load_robot(tmp_path / name)
    assert mine.inferred == trusted.inferred
    same(mine, trusted)


def test_soft_bodies_of_files_are_refused(tmp_path, here):
    shutil.copy(DATA / 'soft_pads.xml', tmp_path)
    with pytest.raises(ModelError, match='<flexcomp> names the file .pad.obj., which what'):
        requested(tmp_path / 'soft_pads.xml', tmp_path)


@pytest.mark.full
def test_a_robot_of_a_package_brings_its_meshes_and_its_pairs(roots):
    mine, trusted = (load(roots / 'lab_arm/arm.urdf') for load in (
        lambda file: requested(file, roots), load_robot))
    assert mine.inferred == trusted.inferred
    assert 'left out: collisions of 1 pair of links, as its SRDF says' in mine.inferred
    assert mine.compile().nmesh == 1 and mine.compile().nexclude == 1
    world = compose(mine)
    assert f'file://{(roots / "lab_arm/meshes/link.stl").resolve()}' in urdf_of(world).xml


def test_a_robot_may_have_many_meshes(roots, here):
    for number in range(250):
        shutil.copy(roots / 'lab_arm/meshes/link.stl', roots / f'lab_arm/meshes/m{number}.stl')
    text = urdf().replace('<link name="base"/>', '<link name="base">' + ''.join(
        f'<visual><geometry><mesh filename="package://lab_arm/meshes/m{number}.stl"/></geometry>'
        '</visual>' for number in range(250)) + '</link>')
    (roots / 'lab_arm/arm.urdf').write_text(text)
    assert requested(roots / 'lab_arm/arm.urdf', roots).compile().nmesh == 251


def test_textures_of_a_urdf_are_not_read(roots, here):
    text = urdf().replace('</geometry></visual>', '</geometry><material name="m">'
                          '<texture filename="missing.png"/></material></visual>')
    (roots / 'lab_arm/arm.urdf').write_text(text)
    same(requested(roots / 'lab_arm/arm.urdf', roots), load_robot(roots / 'lab_arm/arm.urdf'))


@pytest.mark.full
def test_a_hand_a_keyframe_and_a_description_of_an_mjcf_file_count(roots):
    (roots / 'hand.yaml').write_text('{start: {turn: 0.5}, velocity_limits: {turn: 1.5}}')
    mine = requested(roots / 'hand.xml', roots)
    assert mine.init_qpos.tolist()[:1] == [0.5] and list(mine.grippers) == ['right']
    same(mine, load_robot(roots / 'hand.xml'))


def test_a_text_is_a_robot_and_names_no_file(roots, here):
    text = re.sub('<visual>.*?</visual>', '', urdf())
    files = AllowedRoots([roots], 'spawn_roots')
    robot = load_requested(InMemoryFile(text, 'resource_string'), files, 'left')
    assert len(robot.joints) == 2
    text = urdf(f'{roots}/lab_arm/meshes/link.stl')
    robot = load_requested(InMemoryFile(text, 'resource_string'), files)
    assert robot.naming_prefix == 'robot0_' and not robot.compile().nmesh
    assert 'a text must not name files' in ''.join(robot.inferred)


@pytest.mark.parametrize('name', ['robot.urdf.xacro', 'arm.yaml'])
def test_xacro_is_not_expanded_and_the_message_leads_to_the_fix(roots, name):
    made = roots / 'made'
    (roots / 'robot.urdf.xacro').write_text(
        '<robot xmlns:xacro="http://ros.org/wiki/xacro" name="r"><link name="${open(\''
        f'{made}\', \'w\').name}}"/></robot>')
    (roots / 'arm.yaml').write_text('{model: robot.urdf.xacro, xacro_args: {a: 1}}')
    reason = rejection(roots / name, roots)
    assert 'xacro evaluates Python' in reason and "'xacro robot.urdf.xacro > robot.urdf'" in reason
    assert 'model_path' in reason and not made.exists()


@pytest.mark.parametrize(('mesh', 'problem'), [
    ('../../private/link.stl', 'is no file; only files below spawn_roots may be read'),
    ('PRIVATE/link.stl', 'only files below spawn_roots may be read'),
    ('file://PRIVATE/link.stl', 'is no file'),
    ('package://private/link.stl', "package 'private'"),
    ('package://../private/link.stl', 'package'),
    ('package://lab_arm/../../private/link.stl', 'is no file'),
    ('lab_arm/out.stl', 'is no file'),
    ('other.dae', 'a type that cannot be spawned')])
def test_a_mesh_that_may_not_be_read_is_left_out_and_told(mesh, problem, roots, opened, here):
    (roots / 'lab_arm/out.stl').symlink_to(roots.parent / 'private/link.stl')
    (roots / 'other.dae').write_text('solid x')
    (roots / 'try.urdf').write_text(urdf(mesh.replace('PRIVATE', str(roots.parent / 'private'))))
    robot = requested(roots / 'try.urdf', roots)
    (lost,) = [said for said in robot.inferred if isinstance(said, LostShape)]
    assert problem in lost and robot.compile().nmesh == 0


@pytest.mark.parametrize(('text', 'problem'), [
    (urdf().replace('<link name="base"/>', '<include file="PRIVATE/arm.xml"/>'),
     'must not be read'),
    (ARM.replace('<worldbody>', '<include file="../private/arm.xml"/><worldbody>'),
     'must not be read'),
    (ARM.replace('<worldbody>', '<asset><mesh name="m" file="PRIVATE/link.stl"/></asset>'
                 '<worldbody>'), 'must not be read'),
    (ARM.replace('<compiler ', '<compiler meshdir="../private" ').replace(
        '<worldbody>', '<asset><mesh name="m" file="link.stl"/></asset><worldbody>'),
     'must not be read'),
    ('{model: ../private/arm.xml}', 'only files below spawn_roots may be read'),
    ('{model: PRIVATE/arm.urdf}', 'only files below spawn_roots may be read'),
    ('{model: lab_arm/arm.urdf, base: ../private/arm.xml}', 'of the catalogue'),
    ('{model: hand.xml, arms: {right: {gripper: ../private/arm.xml}}}', 'of the catalogue'),
    ('{model: hand.xml, arms: {right: {gripper: "menagerie:../private"}}}', 'of the catalogue'),
    ('{model: out.xml}', 'no such file')])
def test_nothing_outside_is_read_and_the_message_says_what_may_be(
        text, problem, roots, opened, here):
    (roots / 'out.xml').symlink_to(roots.parent / 'private/arm.xml')
    text = text.replace('PRIVATE', str(roots.parent / 'private'))
    file = roots / f'try{".yaml" if text[0] == "{" else ".urdf" if "<robot" in text else ".xml"}'
    file.write_text(text)
    assert problem in rejection(file, roots)


@pytest.mark.full
def test_a_mesh_that_is_none_is_rejected_in_another_process(roots):
    (roots / 'fake.stl').write_text('solid x')
    (roots / 'try.urdf').write_text(urdf('fake.stl'))
    assert 'does not compile' in rejection(roots / 'try.urdf', roots)


@pytest.mark.full
def test_a_robot_of_many_bodies_is_rejected(roots, here):
    (roots / 'many.xml').write_text(ARM.replace(
        '</body>', '<replicate count="5000"><geom size="0.01" mass="1"/></replicate></body>', 1))
    assert 'bodies, joints, shapes and so on' in rejection(roots / 'many.xml', roots)


def test_what_lies_beside_a_robot_is_not_read_through_a_link(roots, opened, here):
    private = roots.parent / 'private'
    (roots / 'lab_arm/arm.srdf').unlink()
    for name in ('arm.srdf', 'arm.yaml', 'robot.yaml'):
        (roots / 'lab_arm' / name).symlink_to(private / 'arm.yaml')
    assert not any('SRDF' in said for said in requested(
        roots / 'lab_arm/arm.urdf', roots).inferred)


@pytest.mark.full
@pytest.mark.parametrize(('text', 'problem'), [
    (urdf(more='<gazebo/>' * 60_000), 'with 60000 tags'),
    (urdf(more=f'<link name="x">{"<a>" * 2000}{"</a>" * 2000}</link>'), 'nested too deeply'),
    ('<!DOCTYPE r [<!ENTITY b "bb">]><robot name="r">&b;</robot>', 'the entity'),
    ('<robot name="r"><link name="l"/></robot>', 'is not a robot'),
    ('<robot', 'not well-formed'), (urdf().replace('"1"', '"nan"'), ''),
    (urdf(more=' ' * 3_000_000), 'at most 200 texts of 3 MB'),
    (urdf(more=''.join(
        f'<link name="c{i}"/><joint name="n{i}" type="revolute"><parent link="base"/>'
        f'<child link="c{i}"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint>'
        for i in range(101))), 'degrees of freedom')])
def test_what_costs_too_much_or_is_no_robot_is_rejected_on_one_line(text, problem, roots, here):
    (roots / 'try.urdf').write_text(text)
    assert problem in rejection(roots / 'try.urdf', roots)


@pytest.mark.full
@pytest.mark.parametrize('name', ['masses.urdf', 'two_hands.xml', 'rover.xml'])
def test_a_robot_passes_in_another_process_which_opens_no_file(name, tmp_path):
    shutil.copy(DATA / name, tmp_path / name)
    requested(tmp_path / name, tmp_path)


@pytest.mark.full
def test_an_error_of_another_kind_is_told_too(roots, monkeypatch):
    monkeypatch.setattr(requested_robot, '_try', open)
    reason = rejection(roots / 'hand.xml', roots)
    assert 'cannot be loaded: TypeError' in reason


def load_for_ever(*held):
    """Load a robot again and again: how long once takes is up to the machine."""
    while True:
        requested_robot.load_held(*held)


@pytest.mark.full
def test_a_robot_that_takes_too_long_is_given_up_in_another_process(roots, monkeypatch):
    monkeypatch.setattr(requested_robot, 'MAX_CPU_S', 1)
    monkeypatch.setattr(requested_robot, '_try', load_for_ever)
    assert 'takes more than 1 s to load' in rejection(roots / 'lab_arm/arm.urdf', roots)


def test_a_file_that_changes_after_it_was_read_makes_no_difference(roots, monkeypatch):
    def tried(name, load, *held, max_cpu_s):
        (roots / 'hand.xml').write_text('<mujoco/>')
        (roots / 'hand.yaml').write_text('{start: nowhere}')
        load(*held)
    monkeypatch.setattr(requested_robot, 'run_limited', tried)
    assert list(requested(roots / 'hand.xml', roots).grippers) == ['right']


def test_kept_files_ask_once_and_a_copy_asks_nothing(tmp_path):
    file = tmp_path / 'a'
    file.write_text('first')
    kept = CachedFiles(AllowedRoots([tmp_path], 'spawn_roots'))
    assert kept.read(file, 'file') == b'first' and not kept.is_file(tmp_path / 'b')
    file.write_text('second')
    (tmp_path / 'b').write_text('')
    held = copy.copy(kept)
    assert held.read(file, 'file') == kept.read(file, 'file') == b'first'
    assert not held.is_file(tmp_path / 'b') and not held.is_folder(tmp_path)
    assert held.first([tmp_path / 'b', file]) == file
    with pytest.raises(ModelError, match='was not read before'):
        held.read(tmp_path / 'b', 'file')


# ---------------------------------------------------------------------- random robots

NAMES = st.sampled_from(['base', 'upper', 'lower', 'l', '', 'world'])
WORDS = st.one_of(st.sampled_from(
    ['0', '1', '-1', 'nan', 'inf', '1e308', '1e-300', '', '1 2 3', '0 0 0', '1 0', 'base',
     'upper', '../private/link.stl', 'package://lab_arm/meshes/link.stl', 'revolute', 'fixed',
     'floating', 'mesh', 'true']), st.text(max_size=6))
TAGS = ('link', 'joint', 'parent', 'child', 'origin', 'axis', 'limit', 'mimic', 'visual',
        'collision', 'geometry', 'mesh', 'box', 'sphere', 'inertial', 'mass', 'inertia',
        'material', 'texture', 'mujoco', 'compiler', 'dynamics', 'include', 'gazebo')
KEYS = ('name', 'type', 'link', 'xyz', 'rpy', 'lower', 'upper', 'velocity', 'effort', 'joint',
        'multiplier', 'offset', 'filename', 'scale', 'size', 'radius', 'value', 'ixx', 'iyy',
        'izz', 'ixy', 'meshdir', 'file')
EDITS = st.lists(st.tuples(st.integers(0, 80), st.sampled_from(KEYS), WORDS), max_size=4)
MORE = st.recursive(st.just(''), lambda inner: st.builds(
    lambda tag, key, word, content: f'<{tag} {key}={quoteattr(word)}>{content}</{tag}>',
    st.sampled_from(TAGS), st.sampled_from(KEYS), WORDS,
    st.lists(inner, max_size=3).map(''.join)), max_leaves=6)
DESCRIPTIONS = st.dictionaries(
    st.sampled_from(['model', 'arms', 'subsystems', 'start', 'base', 'foot', 'mocap', 'meshes',
                     'velocity_limits', 'placement', 'controllers', 'robot', 'xacro_args']),
    st.one_of(st.none(), st.booleans(), st.floats(), st.text(max_size=5), st.sampled_from(
        ['none', 'try.urdf', '../private/arm.xml', 'home', {'right': {'hand': 'lower'}},
         {'right': {'mount': 'upper', 'gripper': '../private/arm.xml'}}, {'shoulder': 1.0},
         {'shoulder': 'torso'}, {'turn': 1e308}, [0.0, 0.0, 1.0], {'left': {}}])), max_size=3)


def changed(text, edits):
    """Return a URDF with other values of some attributes."""
    found = list(re.finditer(r'(\w+)="([^"]*)"', text))
    for place, _, word in edits:
        attribute = found[place % len(found)]
        text = text.replace(attribute[0], f'{attribute[1]}="{word}"', 1)
    return text


@pytest.fixture(scope='module')
def random_roots(tmp_path_factory):
    folder = tmp_path_factory.mktemp('random') / 'roots'
    write_package(folder)
    private = folder.parent / 'private'
    private.mkdir()
    for name in ('arm.xml', 'link.stl'):
        (private / name).write_text(ARM)
    opened = OpenedFiles(private)
    yield folder, opened
    opened.close()


@pytest.mark.full
@pytest.mark.filterwarnings('ignore::UserWarning')  # MuJoCo's, of inertia.
@settings(max_examples=300)
@given(base=st.sampled_from([urdf(), ARM, ARM_WITH_HAND]), edits=EDITS,
       more=st.one_of(st.just(''), MORE),
       description=st.one_of(st.none(), st.none(), DESCRIPTIONS))
def test_no_robot_reads_what_is_private_or_ends_in_anything_but_one_line(
        random_roots, base, edits, more, description):
    folder, opened = random_roots
    end = '</robot>' if '<robot' in base else '</worldbody>'
    text = changed(base, edits).replace(end, more + end)
    file = folder / ('try.urdf' if '<robot' in base else 'try.xml')
    for suffix in ('.xml', '.urdf', '.yaml'):
        file.with_suffix(suffix).unlink(missing_ok=True)
    file.write_text(text, errors='replace')
    if description is not None:
        file.with_suffix('.yaml').write_text(yaml.safe_dump(description))
    before, requested_robot.run_limited = requested_robot.run_limited, lambda *_, **__: None
    try:
        load_requested(file, AllowedRoots([folder], 'spawn_roots'))
    except ManipSimError as error:
        assert str(error) and '\n' not in str(error) and len(str(error)) < 3000
    finally:
        requested_robot.run_limited = before
    assert opened.take() == set()
