# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The URDF of every robot, read by MuJoCo, pinocchio, yourdfpy and check_urdf."""

import io
import shutil
import subprocess
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from urdf_rig import (
    data_at, exported, frames, mass_matrix, random_position, read_by_mujoco, scalar_joints)

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose, compose_robot, World
from manip_sim.models.files.urdf import load_urdf
from manip_sim.models.robots import robot_names
from manip_sim.models.urdf_writer import urdf_of

ROBOTS = robot_names()


@pytest.fixture(params=ROBOTS)
def robot(request):
    """Return the model and the URDF of each robot of the catalogue as it is by default."""
    return exported(request.param)


@pytest.mark.full
def test_mujoco_reads_the_same_kinematics_and_inertia_from_it(robot):
    model, urdf = robot
    read, random = read_by_mujoco(urdf.xml), np.random.default_rng(1)
    joints = scalar_joints(model, urdf.tree)
    ours, theirs = mujoco.MjData(model), mujoco.MjData(read)
    for number in range(100):
        position = random_position(model, joints, random)
        data_at(model, position, ours)
        data_at(read, position, theirs)
        links, places, rotations = zip(*frames(model, ours, urdf.tree))
        bodies = [read.body(link).id for link in links]
        np.testing.assert_allclose(theirs.xpos[bodies], places, rtol=0, atol=1e-12)
        np.testing.assert_allclose(theirs.xmat[bodies].reshape(-1, 3, 3), rotations, rtol=0,
                                   atol=1e-12)
        if number % 10 == 0:
            expected = mass_matrix(model, ours, position, armature=False)
            np.testing.assert_allclose(mass_matrix(read, theirs, position), expected, rtol=0,
                                       atol=5e-11 * np.abs(expected).max())


def test_mujoco_reads_the_same_limits_and_masses_from_it(robot):
    model, urdf = robot
    read = read_by_mujoco(urdf.xml)
    element_of = {e.get('name'): e for e in ElementTree.fromstring(urdf.xml).iter('joint')}
    joints = scalar_joints(model, urdf.tree)
    assert read.njnt == len(joints) == model.njnt
    for number in joints:
        ours, theirs = model.joint(number), read.joint(model.joint(number).name)
        limit = element_of[ours.name].find('limit')
        if ours.limited[0]:
            np.testing.assert_array_equal(theirs.range, ours.range)
        elif ours.type[0] == mujoco.mjtJoint.mjJNT_HINGE:
            assert not theirs.limited[0] and element_of[ours.name].get('type') == 'continuous'
        if model.jnt_actfrclimited[number]:
            assert float(limit.get('effort')) == model.jnt_actfrcrange[number, 1]
            np.testing.assert_array_equal(read.jnt_actfrcrange[theirs.id],
                                          model.jnt_actfrcrange[number])
        if model.jnt_user[number, 0] > 0.0:
            assert float(limit.get('velocity')) <= model.jnt_user[number, 0]
        assert float(limit.get('velocity')) > 0.0
        assert read.dof_frictionloss[theirs.dofadr[0]] == model.dof_frictionloss[ours.dofadr[0]]
    bodies = [model.body(body).name for body in urdf.tree.link_of_body]
    assert sum(read.body_mass) == pytest.approx(
        sum(model.body(name).mass[0] for name in bodies), rel=1e-12)


@pytest.mark.full
def test_pinocchio_finds_the_same_frames_and_inertia_in_it(robot):
    pinocchio = pytest.importorskip('pinocchio', reason='pin is a tool of the extra test')
    model, urdf = robot
    read = pinocchio.buildModelFromXML(urdf.xml)
    data, random = read.createData(), np.random.default_rng(2)
    joints, ours = scalar_joints(model, urdf.tree), mujoco.MjData(model)
    for number in range(100):
        position, q = random_position(model, joints, random), pinocchio.neutral(read)
        data_at(model, position, ours)
        for name, value in position.items():
            joint = read.joints[read.getJointId(name)]
            # A joint without limits has the cosine and the sine.
            q[joint.idx_q:joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else (np.cos(value), np.sin(value)))
        pinocchio.framesForwardKinematics(read, data, q)
        links, places, rotations = zip(*frames(model, ours, urdf.tree))
        found = [data.oMf[read.getFrameId(link, pinocchio.FrameType.BODY)] for link in links]
        np.testing.assert_allclose([f.translation for f in found], places, rtol=0, atol=1e-12)
        np.testing.assert_allclose([f.rotation for f in found], rotations, rtol=0, atol=1e-12)
        if number % 10 == 0:
            whole = pinocchio.crba(read, data, q)
            whole = np.triu(whole) + np.triu(whole, 1).T
            dofs = [read.joints[read.getJointId(name)].idx_v for name in position]
            expected = mass_matrix(model, ours, position, armature=False)
            np.testing.assert_allclose(whole[np.ix_(dofs, dofs)], expected, rtol=0,
                                       atol=5e-11 * np.abs(expected).max())


@pytest.mark.full
@pytest.mark.filterwarnings('ignore')  # Of packages that yourdfpy imports.
def test_yourdfpy_finds_the_same_frames_with_followers_where_they_belong(robot):
    yourdfpy = pytest.importorskip('yourdfpy', reason='yourdfpy is a tool of the extra test')
    model, urdf = robot
    read = yourdfpy.URDF.load(io.BytesIO(urdf.xml.encode()), build_scene_graph=True,
                              load_meshes=False)
    random, joints = np.random.default_rng(3), scalar_joints(model, urdf.tree)
    for _ in range(3):
        position = random_position(model, joints, random, urdf.mimics)
        ours = data_at(model, position)
        read.update_cfg({name: position[name] for name in read.actuated_joint_names})
        for link, place, rotation in frames(model, ours, urdf.tree):
            found = read.get_transform(link, 'world')
            np.testing.assert_allclose(found[:3, 3], place, rtol=0, atol=1e-9, err_msg=link)
            np.testing.assert_allclose(found[:3, :3], rotation, rtol=0, atol=1e-9)


def test_urdfdom_accepts_it(robot, tmp_path):
    if shutil.which('check_urdf') is None:
        pytest.skip('check_urdf, of liburdfdom-tools, is not installed')
    _, urdf = robot
    (tmp_path / 'robot.urdf').write_text(urdf.xml)
    checked = subprocess.run(['check_urdf', tmp_path / 'robot.urdf'], capture_output=True,
                             text=True, check=False)
    assert checked.returncode == 0 and not checked.stderr, checked.stdout + checked.stderr
    assert 'root Link: world has 1 child' in checked.stdout


def test_the_root_is_world_without_mass_and_names_are_unique(robot):
    _, urdf = robot
    root = ElementTree.fromstring(urdf.xml)
    links = [link.get('name') for link in root.findall('link')]
    joints = root.findall('joint')
    assert len(set(links)) == len(links) == len(joints) + 1
    assert len({joint.get('name') for joint in joints}) == len(joints)
    children = [joint.find('child').get('link') for joint in joints]
    assert set(links) - set(children) == {'world'}
    assert len(root.find('link[@name="world"]')) == 0
    # No reader resolves a follower of a follower.
    following = {joint.get('name') for joint in joints if joint.find('mimic') is not None}
    assert not following & {j.find('mimic').get('joint') for j in joints
                            if j.find('mimic') is not None}


def test_fingers_that_are_coupled_follow_within_their_limits():
    model, urdf = exported('UR5e')
    followers = {model.joint(joint).name: (model.joint(mimic.leader).name, mimic.multiplier)
                 for joint, mimic in urdf.mimics.items()}
    # The right knuckle follows the left one, and the right fingers the right knuckle.
    assert followers['gripper0_right_right_outer_knuckle_joint'] == (
        'gripper0_right_finger_joint', 1.0)
    assert followers['gripper0_right_right_inner_finger_joint'] == (
        'gripper0_right_finger_joint', -1.0)
    assert len(followers) == 5
    # A coupling by a curve is told, and not made a straight line.
    _, jaco = exported('Jaco')
    assert not jaco.mimics and '<mimic' not in jaco.xml
    assert any('joint_thumb_distal' in note and 'curve' in note for note in jaco.notes)


def test_wrist_and_tool_frames_and_cameras_are_links():
    model, urdf = exported('Panda')
    tree = urdf.tree
    assert {tree.link_of_site[model.site(f'gripper0_right_{name}').id]
            for name in ('ft_frame', 'grip_site')} == {
                'gripper0_right_ft_frame', 'gripper0_right_grip_site'}
    read = read_by_mujoco(urdf.xml)
    data = data_at(read, {})
    camera = data.body('robot0_eye_in_hand').xmat.reshape(3, 3)
    optical = data.body('robot0_eye_in_hand_optical_frame').xmat.reshape(3, 3)
    # REP 103: z forward, which is where the camera of MuJoCo has -z, and x right in both.
    np.testing.assert_allclose(optical[:, 2], -camera[:, 2], atol=1e-12)
    np.testing.assert_allclose(optical[:, 0], camera[:, 0], atol=1e-12)


def test_the_place_of_the_robot_is_the_first_joint_and_the_prefix_is_everywhere():
    world = compose('UR5e', prefix='left_', position=[1.0, 2.0, 0.0], orientation=[0, 0, 0.5])
    root = ElementTree.fromstring(urdf_of(world).xml)
    first = root.find('joint')
    assert (first.find('parent').get('link'), first.get('type')) == ('world', 'fixed')
    assert [float(v) for v in first.find('origin').get('xyz').split()][:2] == [1.0, 2.0]
    assert float(first.find('origin').get('rpy').split()[2]) == pytest.approx(0.5)
    names = {e.get('name') for e in [*root.findall('link'), *root.findall('joint')]}
    assert {name for name in names if not name.startswith('left_')} == {'world'}


def test_one_robot_of_several_is_chosen_by_name():
    world = World([compose_robot('Panda', prefix='left_'), compose_robot('UR5e', prefix='right_')])
    assert '<robot name="UR5e">' in urdf_of(world, 'right').xml
    assert '"left_' not in urdf_of(world, 'right').xml
    with pytest.raises(ModelError, match='a URDF describes one robot: name one of left, right'):
        urdf_of(world)
    with pytest.raises(UnknownNameError, match="unknown robot 'rigth': did you mean 'right'"):
        urdf_of(world, 'rigth')


def test_we_read_it_ourselves_with_its_meshes(tmp_path):
    model, urdf = exported('Panda')
    (tmp_path / 'panda.urdf').write_text(urdf.xml)
    spec, told = load_urdf(tmp_path / 'panda.urdf')
    read = spec.compile()
    assert read.nmesh and not any('left out' in sentence for sentence in told)
    assert read.joint('robot0_joint1').id >= 0
    ellipsoid = next(geom for geom in range(model.ngeom)
                     if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID)
    body = read.body(model.body(int(model.geom_bodyid[ellipsoid])).name)
    mesh = next(int(read.geom_dataid[g]) for g in range(body.geomadr[0], body.geomadr[0]
                + body.geomnum[0]) if read.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH)
    first = read.mesh_vertadr[mesh]
    corners = read.mesh_vert[first:first + read.mesh_vertnum[mesh]]
    # Its frame is that of its inertia, so its axes may be in another order.
    np.testing.assert_allclose(np.sort(np.ptp(corners, axis=0)) / 2.0,
                               np.sort(model.geom_size[ellipsoid]), rtol=0.01)


@pytest.mark.parametrize('name', ['Panda', 'GR1'])
def test_visual_shapes_are_what_is_seen_and_collision_shapes_what_collides(name):
    model, urdf = exported(name)
    root = ElementTree.fromstring(urdf.xml)
    bodies = set(urdf.tree.link_of_body)
    geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in bodies]
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    for tag, group in (('visual', 2), ('collision', 3)):
        kinds = [model.geom_type[g] for g in geoms if model.geom_group[g] == group]
        # A capsule is a cylinder and two spheres.
        assert len(root.findall(f'link/{tag}')) == len(kinds) + 2 * sum(
            kind == capsule for kind in kinds)
    colours = {material.get('name'): material.find('color').get('rgba')
               for material in root.findall('material')}
    assert len(set(colours.values())) == len(colours)
    assert {visual.find('material').get('name') for visual in root.findall('link/visual')
            } == set(colours)


def test_urdf_of_a_world_of_one_robot_needs_no_name():
    assert urdf_of(compose('Panda')).xml == exported('Panda')[1].xml
