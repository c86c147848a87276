# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Where bodies are on the page, what they look like, and from where they are seen."""

import itertools
import math

import mujoco
import numpy as np
import pytest

trimesh = pytest.importorskip('trimesh', reason='the viewer needs the extra viewer')

from manip_sim.models import compose  # noqa: E402
from manip_sim.viewer.page.interaction import VIEWS  # noqa: E402
from manip_sim.viewer.page.model_scene import (  # noqa: E402
    body_meshes, FIELD_OF_VIEW, first_view, Kinematics, local_poses, ROOT, Scene)

SHAPES = {
    'type="box" size="0.1 0.2 0.3"': (8 * 0.1 * 0.2 * 0.3, (0.1, 0.2, 0.3)),
    'type="sphere" size="0.2"': (4 / 3 * math.pi * 0.2**3, (0.2, 0.2, 0.2)),
    'type="ellipsoid" size="0.1 0.2 0.3"': (
        4 / 3 * math.pi * 0.1 * 0.2 * 0.3, (0.1, 0.2, 0.3)),
    'type="cylinder" size="0.1 0.3"': (math.pi * 0.1**2 * 0.6, (0.1, 0.1, 0.3)),
    'type="capsule" size="0.1 0.3"': (
        math.pi * 0.1**2 * (0.6 + 4 / 3 * 0.1), (0.1, 0.1, 0.4)),
    'type="mesh" mesh="tetrahedron"': (1 / 6, None)}
TETRAHEDRON = '<asset><mesh name="tetrahedron" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'


@pytest.mark.parametrize('shape', SHAPES)
def test_a_shape_has_the_volume_and_the_extent_of_its_geom(shape):
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco>{TETRAHEDRON}<worldbody><body><geom {shape}/></body></worldbody></mujoco>')
    volume, half = SHAPES[shape]
    mesh, = body_meshes(model)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces)
    # A shape of flat faces inside a round one is a little smaller.
    assert solid.volume == pytest.approx(volume, rel=0.03)
    if half is not None:
        np.testing.assert_allclose(solid.bounds, [np.negative(half), half], atol=0.005)


def test_shapes_are_placed_in_their_body_and_joined_by_colour():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody><body pos="5 5 5">
          <geom type="box" size="0.1 0.1 0.1" pos="1 0 0" rgba="1 0 0 1"/>
          <geom type="box" size="0.1 0.2 0.1" pos="0 2 0" euler="0 0 90" rgba="1 0 0 1"/>
          <geom type="sphere" size="0.1" rgba="0 1 0 1"/>
          <geom type="sphere" size="0.1" rgba="0 1 0 1" group="3"/>
          <geom type="sphere" size="0.1" rgba="0 1 0 0"/>
        </body></worldbody></mujoco>""")
    red, green, collision = sorted(body_meshes(model), key=lambda m: (m.collides, m.rgba[1]))
    np.testing.assert_allclose([red.vertices.min(axis=0), red.vertices.max(axis=0)],
                               [[-0.2, -0.1, -0.1], [1.1, 2.1, 0.1]], atol=1e-9)
    assert (red.rgba, green.rgba) == ((1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0))
    assert (red.collides, green.collides, collision.collides) == (False, False, True)


def test_a_material_gives_the_colour_where_the_geom_has_none():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><asset>
          <texture name="t" type="2d" builtin="flat" rgb1="0.5 1 1" width="8" height="8"/>
          <material name="m" rgba="0.8 0.4 0.2 1" texture="t"/></asset>
        <worldbody><body><geom size="0.1" material="m"/></body></worldbody></mujoco>""")
    mesh, = body_meshes(model)
    assert mesh.rgba == pytest.approx((0.4, 0.4, 0.2, 1.0), abs=0.01)


@pytest.fixture(scope='module')
def omron():
    """Return a model with all kinds of joints, and data in a random posture."""
    model = compose('PandaOmron', arena='table', objects=[
        {'name': 'ball', 'shape': 'sphere', 'size': 0.05, 'mass': 0.1,
         'position': [0.0, 0.0, 1.0]}]).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = np.random.default_rng(1).uniform(-1.0, 1.0, model.nq)
    mujoco.mj_normalizeQuat(model, data.qpos)
    mujoco.mj_kinematics(model, data)
    return model, data


def test_poses_in_parents_lead_to_the_poses_in_the_world(omron):
    model, data = omron
    positions, quats = local_poses(model, data)
    poses = [np.eye(4)]
    for body in range(1, model.nbody):
        pose = np.eye(4)
        pose[:3, :3] = trimesh.transformations.quaternion_matrix(quats[body])[:3, :3]
        pose[:3, 3] = positions[body]
        poses.append(poses[model.body_parentid[body]] @ pose)
        np.testing.assert_allclose(poses[-1][:3, 3], data.xpos[body], atol=1e-9)
        np.testing.assert_allclose(poses[-1][:3, :3], data.xmat[body].reshape(3, 3), atol=1e-9)


def test_a_posture_takes_joints_by_name_and_free_bodies_by_pose(omron):
    model, data = omron
    posture = Kinematics(model)
    scalar = [model.joint(i).name for i in range(model.njnt) if int(model.jnt_type[i]) > 1]
    posture.set_joints(['no_such_joint', *reversed(scalar)],
                       [9.0, *(float(data.joint(name).qpos[0]) for name in reversed(scalar))])
    for body in ('ball', 'cube'):
        posture.place(body, data.body(body).xpos, data.body(body).xquat)
    posture.place('no_such_body', np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    posture.compute()
    np.testing.assert_allclose(posture.data.xpos, data.xpos, atol=1e-12)
    assert set(posture.free_bodies) == {'ball', 'cube'}


class Recorder:
    """Stands for the server and for all that is in it; keeps what is assigned."""

    def __init__(self, name='', log=None):
        object.__setattr__(self, 'name', name)
        object.__setattr__(self, 'log', [] if log is None else log)

    @property
    def scene(self):
        return self

    def __getattr__(self, method):
        if method == 'atomic':
            return lambda: self
        return lambda name='', *_, **__: Recorder(name, self.log)

    def __setattr__(self, attribute, value):
        self.log.append((self.name, attribute))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


class Made(Recorder):
    """Keeps how frames and grids are made."""

    def __getattr__(self, method):
        def make(name='', *_, **properties):
            self.log.append((method, properties))
            return Recorder(name)
        return super().__getattr__(method) if method == 'atomic' else make


def test_a_floor_has_the_size_of_its_plane_and_axes_are_hidden_at_first():
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody>
        <geom type="plane" size="3 2 0.1"/><geom type="plane" size="0 2 0.1"/>
        <body><geom size="0.1"/></body></worldbody></mujoco>""")
    server = Made()
    Scene(server, model, Kinematics(model).data)
    grids = [made for method, made in server.log if method == 'add_grid']
    assert [(one['width'], one['height'], bool(one['infinite_grid'])) for one in grids] == [
        (6.0, 4.0, False), (20.0, 4.0, True)]
    frames = [made for method, made in server.log if method == 'add_frame']
    assert frames
    assert not any(made['show_axes'] for made in frames)


def test_only_what_has_moved_in_its_parent_is_sent(omron):
    model, _ = omron
    posture = Kinematics(model)
    server = Recorder()
    scene = Scene(server, model, posture.data)
    server.log.clear()
    scene.update(posture.data)
    assert server.log == []
    posture.set_joints(['robot0_joint2', 'robot0_joint5'], [0.3, 1e-6])
    posture.compute()
    scene.update(posture.data)
    (path, attribute), = server.log
    assert (path.split('/')[-1], attribute) == ('robot0_link2', 'wxyz')
    assert path.startswith(f'{ROOT}/')
    # A slide moves its body and does not turn it.
    server.log.clear()
    posture.set_joints(['mobilebase0_joint_torso_height'], [0.1])
    posture.compute()
    scene.update(posture.data)
    assert [attribute for _, attribute in server.log] == ['position']


@pytest.mark.parametrize('robot', ['Panda', 'Baxter', 'GR1'])
@pytest.mark.parametrize(('aspect', 'covered', 'below'), [
    (16 / 9, 0.0, 0.0), (1.5, 0.4, 0.0), (9 / 19, 0.0, 0.5)])
@pytest.mark.parametrize('view', VIEWS)
def test_each_view_shows_the_whole_robot(robot, aspect, covered, below, view):
    model = compose(robot).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    position, target = first_view(model, data, aspect, covered, below, VIEWS[view])
    assert (position - target) @ VIEWS[view] > 0.9 * np.linalg.norm(position - target)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen = data.xpos[model.body_weldid > 0] - position
    depth = seen @ forward
    assert (depth > 0.0).all()
    tangent = math.tan(FIELD_OF_VIEW / 2.0)
    above = seen @ np.cross(right, forward)
    assert (above < depth * tangent).all()
    assert (above > -depth * tangent * (1.0 - 2.0 * below)).all()
    assert (seen @ right > -depth * tangent * aspect).all()
    assert (seen @ right < depth * tangent * aspect * (1.0 - 2.0 * covered)).all()
    # It does not look from afar, either; an arm is slim from above.
    widest = max(np.ptp(seen @ right / depth) / aspect / (1.0 - covered),
                 np.ptp(above / depth) / (1.0 - below))
    assert widest > (0.3 if view == 'Top' else 0.5) * tangent


@pytest.mark.parametrize(('aspect', 'covered', 'below'), [
    (1.6, 400 / 1280, 0.0), (390 / 844, 0.0, 0.45), (4 / 3, 0.5, 0.0)])
@pytest.mark.parametrize('arena', ['table', 'bins'])
def test_the_first_view_shows_the_whole_table(arena, aspect, covered, below):
    model = compose('Panda', arena=arena).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    position, target = first_view(model, data, aspect, covered, below)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    tangent = math.tan(FIELD_OF_VIEW / 2.0)
    boxes = [i for i in range(model.ngeom) if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX]
    assert len(boxes) > 1
    for geom in boxes:
        for signs in itertools.product((-1.0, 1.0), repeat=3):
            seen = data.geom_xpos[geom] - position + data.geom_xmat[geom].reshape(3, 3) @ (
                model.geom_size[geom] * signs)
            depth = seen @ forward
            assert -1.0 < seen @ right / depth / tangent / aspect < 1.0 - 2.0 * covered
            above = seen @ np.cross(right, forward) / depth / tangent
            assert 2.0 * below - 1.0 < above < 1.0


def test_walls_and_floors_and_what_is_far_away_do_not_widen_the_first_view():
    def view(more):
        model = mujoco.MjModel.from_xml_string(
            '<mujoco><worldbody><body><freejoint/><geom size="0.2"/></body>'
            f'{more}</worldbody></mujoco>')
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        return first_view(model, data, 1.5)
    alone = view('')
    for more in ('<geom type="box" size="9 9 0.1"/>', '<geom size="0.1" pos="8 0 0"/>',
                 '<geom type="plane" size="1 1 1"/>'):
        np.testing.assert_array_equal(view(more), alone)
    assert np.linalg.norm(view('<geom size="0.1" pos="1 0 0"/>')[0]) > 1.5 * np.linalg.norm(
        alone[0])


def test_colours_have_four_digits():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom size="0.1" rgba="0.12346 0.5 0.98764 0.33333"/></worldbody>'
        '</mujoco>')
    (mesh,) = body_meshes(model)
    assert mesh.rgba == (0.1235, 0.5, 0.9876, 0.3333)
