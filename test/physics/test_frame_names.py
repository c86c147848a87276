# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Names that the node makes up and those of files are never the same frame."""

import mujoco
import numpy as np
import pytest

from manip_sim.frame_names import FrameNames
from manip_sim.models import compose
from manip_sim.models.urdf_writer import urdf_of
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.physics.robot_frames import FrameTree, RobotFrames
from manip_sim.sensing.instruments import find_instruments, instrument_sites
from manip_sim.simulation import Simulation

#: Every kind of name that may meet another: of links, cameras, optical frames, sites and joints.
ARM = """<mujoco><worldbody><body name="base"><geom size="0.05"/>
  <body name="arm" pos="0 0 0.1"><joint name="eye" axis="0 1 0" pos="0 0 0.01"/>
    <geom size="0.05" mass="1"/>
    <camera name="arm"/><camera name="eye"/><site name="eye"/><site name="arm"/>
    <body name="eye_optical_frame" pos="0.1 0 0"><geom size="0.01"/></body>
    <body name="arm_camera" pos="0.2 0 0"><geom size="0.01"/></body>
    <body name="eye_link" pos="0.3 0 0"><geom size="0.01"/></body></body></body></worldbody>
  <actuator><motor joint="eye" ctrlrange="-9 9"/></actuator>
  <sensor><accelerometer site="eye"/><gyro site="eye"/><force site="arm"/><torque site="arm"/>
  </sensor></mujoco>"""


@pytest.fixture
def world(tmp_path):
    (tmp_path / 'arm.xml').write_text(ARM)
    return compose(str(tmp_path / 'arm.xml'), gripper='PandaGripper', objects=[
        {'name': 'front', 'shape': 'box', 'size': [0.02, 0.02, 0.02], 'position': [1, 0, 0.1]}],
        cameras=[{'name': 'front', 'position': [1, 0, 1], 'look_at': [0, 0, 0]}])


def test_frames_in_tf_and_links_of_the_urdf_have_the_same_names_at_the_same_places(world):
    simulation = Simulation(world, visual=True)
    model, urdf = simulation.model, urdf_of(world)
    tf = FrameTree(model, instrument_sites(model))
    frames = {frame.name: frame.parent for frame in [*tf.static, *tf.moving]}
    assert len(frames) == len(tf.static) + len(tf.moving)
    joints = {joint.child: joint.parent for joint in urdf.tree.joints}
    assert set(joints) - set(frames) <= {
        name for name in joints if name.endswith(('ft_frame', 'grip_site'))}
    assert {child: frames[child] for child in joints if child in frames} == {
        child: parent for child, parent in joints.items() if child in frames}


def test_images_and_instruments_name_the_frames_that_look_as_they_do(world):
    simulation = Simulation(world, visual=True)
    model = simulation.model
    names = FrameNames(model)
    every = [*names.bodies, *names.cameras, *names.opticals, *names.sites]
    assert len(set(every)) == len(every)
    tf = FrameTree(model, instrument_sites(model))
    frames = {frame.name: frame.parent for frame in [*tf.static, *tf.moving]}
    for camera in range(model.ncam):
        assert frames[names.opticals[camera]] == names.cameras[camera]
    cameras = [names.cameras[model.camera(name).id] for name in (
        'robot0_arm', 'robot0_eye', 'front')]
    assert cameras == ['robot0_arm_camera_camera', 'robot0_eye', 'front']
    assert names.opticals[model.camera('robot0_eye').id] == 'robot0_eye_optical_frame_'
    for instrument in find_instruments(model):
        assert not instrument.frame or instrument.frame in frames
    assert names.bodies[model.body('front').id] == 'front_body'
    assert names.bodies[model.body('robot0_eye_link').id] == 'robot0_eye_link'


def test_an_object_that_comes_renames_no_camera():
    text = '<mujoco><worldbody><camera name="front"/>{}</worldbody></mujoco>'
    box = '<body name="front"><freejoint/><geom size="0.1"/></body>'
    for more in ('', box):
        names = FrameNames(mujoco.MjModel.from_xml_string(text.format(more)))
        assert (names.cameras, names.opticals) == (['front'], ['front_optical_frame'])


def test_frames_that_are_placed_give_way_to_what_stays_and_objects_to_them():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="odom"/><site name="odom_frame"/><body name="map">'
        '<freejoint/><geom size="0.1"/></body></worldbody></mujoco>')
    names = FrameNames(model)
    assert [names.placed(name) for name in ('odom', 'map', 'world')] == [
        'odom_frame_frame', 'map', 'world_frame']
    names = FrameNames(model, ['odom_frame_frame', 'map'])
    assert names.bodies == ['world', 'odom', 'map_body']
    assert names.placed('map') == 'map_frame'
    pose = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    tree = FrameTree(model, placed={'map': pose})
    assert sorted(frame.name for frame in [*tree.static, *tree.moving]) == [
        'map', 'map_body', 'odom']


def test_targets_are_in_the_frames_that_have_their_names_in_tf():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="grip_site" pos="1 0 0"><geom size="0.1"/>'
        '<site name="grip_site" pos="0 2 0"/></body></worldbody></mujoco>')
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    frames = RobotFrames(model, ['grip_site'], ['grip_site'])
    at = {name: frames.find(name, 'here').pose(data)[0].tolist()
          for name in ('grip_site', 'grip_site_site')}
    assert at == {'grip_site': [1.0, 0.0, 0.0], 'grip_site_site': [1.0, 2.0, 0.0]}
