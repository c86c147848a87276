# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The tree of frames against MuJoCo's poses in world, and its camera sensor."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from manip_sim.frame_names import ROOT
from manip_sim.models import compose, create_arena
from manip_sim.models.robots import robot_names
from manip_sim.models.urdf_writer.links import robot_tree
from manip_sim.physics.robot_frames import FrameTree
from manip_sim.simulation import Simulation

CAMERAS = """<mujoco>
  <worldbody>
    <body name="cart" pos="0.3 0.1 0.5" euler="10 20 30">
      <freejoint/>
      <geom size="0.1"/>
      <site name="cart" pos="0.1 0 0"/>
      <camera name="eye" pos="0.1 0.2 0.3" euler="70 5 20" resolution="640 480" fovy="60"/>
      <camera name="follower" pos="0 -3 0" mode="track"/>
    </body>
    <body pos="0.1 2.5 1.6"><geom size="0.1"/><site name="point" pos="0.05 0.3 0"/></body>
    <body mocap="true"/>
  </worldbody>
  <sensor><camprojection site="point" camera="eye"/></sensor>
</mujoco>"""


def in_world(tree, data):
    """Return position and rotation of each frame in world, composed from the root on."""
    found = {ROOT: (np.zeros(3), Rotation.identity())}
    steps = {frame.name: (frame.parent, pose) for frames, poses in (
        (tree.static, tree.static_poses), (tree.moving, tree.moving_poses(data)))
        for frame, pose in zip(frames, poses)}
    assert len(steps) == len(tree.static) + len(tree.moving), 'a frame has two parents'
    while steps:
        ready = [name for name, (parent, _) in steps.items() if parent in found]
        assert ready, f'these do not hang on world: {steps}'
        for name in ready:
            parent, pose = steps.pop(name)
            position, rotation = found[parent]
            found[name] = (position + rotation.apply(pose[:3]),
                           rotation * Rotation.from_quat(pose[3:]))
    return found


def assert_is_at(found, position, matrix):
    np.testing.assert_allclose(found[0], position, atol=1e-9)
    np.testing.assert_allclose(found[1].as_matrix(), np.reshape(matrix, (3, 3)), atol=1e-9)


@pytest.mark.parametrize('name', robot_names())
def test_composed_along_the_tree_each_frame_is_where_it_is_in_mujoco(name):
    simulation = Simulation(compose(name, arena=create_arena('table', cube=True)))
    model, data, robot = simulation.model, simulation.data, simulation.robot
    sites = [site for reader in robot.end_effectors.values()
             for site in (reader.ft_frame, reader.grip_site)]
    tree = FrameTree(model, sites)
    random = np.random.default_rng(1)
    for _ in range(3):
        data.qpos[:] += random.uniform(-1.0, 1.0, model.nq)
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_forward(model, data)
        found = in_world(tree, data)
        for body in range(1, model.nbody):
            assert_is_at(found[model.body(body).name], data.xpos[body], data.xmat[body])
        for camera in range(model.ncam):
            assert_is_at(found[model.camera(camera).name], data.cam_xpos[camera],
                         data.cam_xmat[camera])
        for site in sites:
            assert_is_at(found[site], data.site(site).xpos, data.site(site).xmat)
    assert len(sites) == 2 * len(robot.end_effectors) > 0
    assert {frame.name for frame in tree.static} >= {
        f'{model.camera(camera).name}_optical_frame' for camera in range(model.ncam)}
    moving = {model.body(model.jnt_bodyid[joint]).name for joint in range(model.njnt)}
    forward, side, yaw = (
        f'mobilebase0_joint_mobile_{way}_link' for way in ('forward', 'side', 'yaw'))
    # As in the URDF, the base itself does not move in the frame of its last joint, unless it turns
    # about its own origin.
    assert {frame.name for frame in tree.moving} == {
        'PandaOmron': moving - {'mobilebase0_base'} | {forward, side, yaw},
        'Tiago': moving | {forward, side}}.get(name, moving)
    assert 'cube' in moving


@pytest.mark.parametrize('name', robot_names())
def test_frames_have_the_parents_that_links_have_in_the_robot_description(name):
    world = compose(name, arena='table')
    model = Simulation(world).model
    links = robot_tree(model, world.robots[0])
    tree = FrameTree(model, [model.site(site).name for site in links.link_of_site])
    parents = {frame.name: frame.parent for frame in (*tree.static, *tree.moving)}
    for joint in links.joints:
        assert parents[joint.child] == joint.parent


def test_between_the_joints_of_a_body_there_are_frames_as_in_a_robot_description():
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody>
      <body pos="1 2 3" name="base"><body name="arm" pos="0.1 0.2 0.3" euler="40 50 60">
        <joint name="slide" type="slide" axis="0.6 0 0.8" ref="0.1"/>
        <joint name="turn" pos="0.2 0.1 0" axis="0 0.6 0.8" ref="0.2"/>
        <joint name="last" pos="0 0 0.4" axis="1 0 0"/>
        <geom size="0.1"/></body></body>
      <body name="off"><joint name="hinge" pos="0.3 0 0"/><geom size="0.1"/></body>
      <body name="on"><joint name="own" axis="1 0 0"/><geom size="0.1"/></body>
    </worldbody></mujoco>""")
    data, tree = mujoco.MjData(model), FrameTree(model)
    data.qpos[:] = [0.5, 1.0, -0.7, 0.4, 0.3]
    mujoco.mj_forward(model, data)
    found = in_world(tree, data)
    links = [f.name for f in tree.moving if f.name.endswith('_link')]
    assert links == ['slide_link', 'turn_link', 'last_link', 'hinge_link']
    for joint in ('turn', 'last', 'hinge'):
        np.testing.assert_allclose(found[f'{joint}_link'][0], data.joint(joint).xanchor, atol=1e-9)
    # The next axis in world is that of the frame before it; the last one turns with the body.
    np.testing.assert_allclose(
        found['slide_link'][1].apply([0.0, 0.6, 0.8]), data.joint('turn').xaxis, atol=1e-9)
    np.testing.assert_allclose(
        found['turn_link'][1].apply([1.0, 0.0, 0.0]), data.joint('last').xaxis, atol=1e-9)
    for joint, body in (('last', 'arm'), ('hinge', 'off')):
        place, turn = found[f'{joint}_link']
        assert_is_at((place - turn.apply(model.joint(joint).pos), turn), data.body(body).xpos,
                     data.body(body).xmat)


@pytest.fixture
def cart():
    """Return model and data of a body with two cameras that turns, and the tree of its frames."""
    model = mujoco.MjModel.from_xml_string(CAMERAS)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data, FrameTree(model, ['cart'])


def test_the_optical_frame_of_a_camera_sees_a_point_where_its_image_has_it(cart):
    model, data, tree = cart
    position, rotation = in_world(tree, data)['eye_optical_frame']
    x, y, z = rotation.inv().apply(data.site('point').xpos - position)
    width, height = model.cam_resolution[0]
    focal = 0.5 * height / np.tan(np.radians(60.0) / 2.0)
    seen = data.sensordata  # In pixels, to the right and down.
    assert z > 0.0 and 0.0 < seen[0] < width and 0.0 < seen[1] < height
    np.testing.assert_allclose(
        [width / 2.0 + focal * x / z, height / 2.0 + focal * y / z], seen, atol=1e-6)


def test_a_camera_that_follows_a_body_moves_in_world(cart):
    model, data, tree = cart
    assert next(f for f in tree.moving if f.name == 'follower').parent == ROOT
    data.qpos[:] = [1.0, 2.0, 3.0, 0.0, 0.6, 0.0, 0.8]
    mujoco.mj_forward(model, data)
    position, rotation = in_world(tree, data)['follower_optical_frame']
    np.testing.assert_allclose(position, data.cam('follower').xpos, atol=1e-12)
    ahead = -data.cam('follower').xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(rotation.apply([0.0, 0.0, 1.0]), ahead, atol=1e-12)


def test_names_differ_although_a_site_has_that_of_a_free_body(cart):
    _, _, tree = cart
    assert {f.name: f.parent for f in tree.static} == {
        'body_2': ROOT, 'cart': 'cart_body', 'eye': 'cart_body', 'eye_optical_frame': 'eye',
        'follower_optical_frame': 'follower'}
    # What is placed by hand has no joint and moves all the same.
    assert [frame.name for frame in tree.moving] == ['cart_body', 'body_3', 'follower']


def test_a_placed_frame_stands_in_world(cart):
    model, data, _ = cart
    pose = np.array([1.0, 2.0, 3.0, 0.0, 0.6, 0.0, 0.8])
    found = in_world(FrameTree(model, placed={'odom': lambda: pose}), data)['odom']
    assert_is_at(found, pose[:3], Rotation.from_quat(pose[3:]).as_matrix())
