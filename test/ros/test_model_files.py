# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A robot, a gripper and an arena from files by parameter; the model that travels."""

from io import BytesIO
import os
from pathlib import Path
import struct
import zipfile

from geometry_msgs.msg import PoseStamped
import mujoco
import numpy as np
import pytest
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String, UInt8MultiArray

from manip_sim.errors import ManipSimError

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
ARM = """<mujoco><compiler angle="radian"/><asset><mesh file="link.stl"/></asset>
<worldbody><body name="base">
  <geom size="0.05" mass="1"/>
  <body name="link" pos="0 0 0.5"><joint name="swing" axis="0 1 0" range="-2 2" damping="1"/>
    <geom type="mesh" mesh="link"/><body name="flange" pos="0.3 0 0"><geom size="0.01"/></body>
  </body></body></worldbody>
  <actuator><position name="servo" joint="swing" kp="200" forcerange="-50 50"/></actuator>
</mujoco>"""


def write_arm(folder):
    """Write an arm of one joint and its mesh, a tetrahedron in binary STL."""
    corners = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.05, 0], [0, 0, 0.05]])
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    triangles = b''.join(struct.pack('<12fH', 0, 0, 0, *corners[list(face)].ravel(), 0)
                         for face in faces)
    folder.mkdir(exist_ok=True)
    (folder / 'link.stl').write_bytes(bytes(80) + struct.pack('<I', len(faces)) + triangles)
    (folder / 'arm.xml').write_text(ARM)
    return folder / 'arm.xml'


def test_a_robot_of_a_file_is_served_and_driven(serve, client, tmp_path):
    log = client.log()
    node = serve(robot=str(write_arm(tmp_path / 'arm')))
    state = client.state()
    assert state.name == ['robot0_swing']
    client.publish('arm/joint_command', JointState(name=state.name, position=[0.5]))
    client.spin_until(lambda: abs(client.state().position[0] - 0.5) < 1e-3)
    client.spin_until(lambda: any('inferred' in text for text in log))
    assert node.simulation.robot.robot_model.eef_name['right'].endswith('flange')


def test_the_log_tells_how_an_arm_without_a_hand_gets_an_end_effector(serve, client, tmp_path):
    log, file = client.log(), str(write_arm(tmp_path / 'arm'))
    serve(robot=file)
    client.spin_until(lambda: any(
        "arm 'right' has no gripper" in text and 'gripper:=NullGripper' in text
        and "'robot0_flange'" in text for text in log))


def test_the_flange_that_the_log_names_is_read_and_led(serve, client, tmp_path):
    log = client.log()
    node = serve(robot=str(write_arm(tmp_path / 'arm')), gripper='NullGripper')
    poses = client.listen(PoseStamped, 'right/eef_pose')
    client.spin_until(lambda: poses)
    found, flange = poses[-1].pose.position, node.simulation.data.body('robot0_flange')
    np.testing.assert_allclose([found.x, found.y, found.z], flange.xpos, atol=1e-3)
    served = {topic for topic, _ in client.node.get_topic_names_and_types()}
    for topic in ('eef_twist', 'target_pose', 'target_twist', 'wrench', 'external_wrench'):
        assert any(name.endswith(f'/right/{topic}') for name in served), topic
    assert not any('has no gripper' in text for text in log)


def test_the_log_tells_which_gains_of_a_file_were_lowered(serve, client, tmp_path):
    log = client.log()
    file = write_arm(tmp_path / 'arm')
    file.write_text(file.read_text().replace('kp="200"', 'kp="200" kv="9000"'))
    serve(robot=str(file))
    client.spin_until(lambda: any("servo of joint 'robot0_swing': " in text for text in log))


def test_the_archive_loads_where_the_files_are_not(serve, client, tmp_path):
    file = write_arm(tmp_path / 'arm')
    serve(robot=str(file), arena='table')
    archives = client.listen(UInt8MultiArray, 'manip_sim/mjcf_archive', LATCHED)
    models = client.listen(String, 'manip_sim/mjcf', LATCHED)
    client.spin_until(lambda: archives and models)
    here = mujoco.MjModel.from_xml_string(models[0].data)
    (file.parent / 'link.stl').unlink()
    with zipfile.ZipFile(BytesIO(bytes(archives[0].data))) as archive:
        archive.extractall(tmp_path / 'elsewhere')
    there = mujoco.MjModel.from_xml_path(str(tmp_path / 'elsewhere' / 'model.xml'))
    assert there.nmesh == 1
    np.testing.assert_allclose(there.body_mass, here.body_mass)
    # What takes the first body for the robot, as pinocchio does, finds it.
    assert there.body(1).name == 'robot0_base'


def test_a_folder_joins_the_catalogue(serve, client, tmp_path):
    write_arm(tmp_path / 'robots')
    serve(model_path=[str(tmp_path)], robot='arm')
    assert client.state().name == ['robot0_swing']


@pytest.mark.parametrize(('parameters', 'what'), [
    ({'robot': 'missing/arm.xml'}, 'missing/arm.xml'),
    ({'robot': 'menagerie:no_such_robot'}, 'menagerie|no_such_robot'),
    ({'gripper': 'hand.urdf'}, 'hand.urdf'),
    ({'arena': 'world.xml'}, 'world.xml'),
    ({'model_path': ['/no/such/folder']}, '/no/such/folder')])
def test_files_that_are_not_there_are_told_in_one_line(serve, parameters, what):
    with pytest.raises(ManipSimError, match=what) as error:
        serve(**parameters)
    assert '\n' not in str(error.value)


needs_menagerie = pytest.mark.skipif(
    not os.environ.get('MENAGERIE_ROOT'), reason='MENAGERIE_ROOT names no checkout of Menagerie')


@needs_menagerie
@pytest.mark.parametrize('parameters', [
    {'robot': 'menagerie:kuka_iiwa_14', 'gripper': 'Robotiq85Gripper'},
    {'robot': 'Panda', 'gripper': 'menagerie:wonik_allegro/right_hand.xml'}])
def test_menagerie_and_our_own_are_driven_together(serve, client, parameters):
    if not Path(os.environ['MENAGERIE_ROOT'],
                'kuka_iiwa_14' if 'iiwa' in parameters['robot'] else 'wonik_allegro').is_dir():
        pytest.skip('the model is not in MENAGERIE_ROOT')
    serve(**parameters)
    start = client.state('arm/joint_states')
    goal = (np.array(start.position) + 0.1).tolist()
    client.publish('arm/joint_command', JointState(name=start.name, position=goal))
    client.spin_until(lambda: np.abs(
        np.array(client.state('arm/joint_states').position) - goal).max() < 5e-3)
    before = np.array(client.state('right/gripper/joint_states').position)
    count = 1 if 'iiwa' in parameters['robot'] else 16
    client.publish('right/gripper/command', Float64MultiArray(data=[1.0] * count))
    client.spin_until(lambda: np.abs(np.array(
        client.state('right/gripper/joint_states').position) - before).max() > 0.2)
