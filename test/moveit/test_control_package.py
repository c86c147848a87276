# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The package that starts ros2_control: files that agree, gains that hold a robot."""

import ast
import importlib.util
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from manip_sim.cli.main import main
from manip_sim.errors import ModelError
from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.models.urdf_writer import Hardware, OWN_PLUGIN
from manip_sim.moveit import srdf
from manip_sim.moveit.package import (
    effective_inertias, effort_gains, GRIPPER, TRAJECTORY, write_control_package)
from manip_sim.simulation import Simulation

pytestmark = pytest.mark.full

#: One arm with the plugin from apt, one in velocity mode, two arms, an arm on a mobile base.
NODES = {
    'panda': {'robot': 'Panda', 'prefix': 'panda_'},
    'velocity': {'robot': 'UR5e', 'control_mode.arm': 'velocity'},
    'baxter': {'robot': 'Baxter', 'ros2_control_plugin': OWN_PLUGIN, 'stepping': 'lockstep'},
    'omron': {'robot': 'PandaOmron', 'ros2_control_plugin': OWN_PLUGIN,
              'sensors': ['{name: robot0_right_imu, rate: 10.0}']}}


@pytest.fixture(params=NODES)
def package(request, tmp_path):
    """Return a package that the command has written, with its files read."""
    given = tmp_path / 'node.yaml'
    given.write_text(yaml.safe_dump({'/**': {'ros__parameters': NODES[request.param]}}))
    folder = tmp_path / f'{request.param}_control'
    assert main(['export', '--ros2-control', str(folder), '--params-file', str(given)]) == 0
    (urdf,) = folder.glob('config/*.urdf')
    return SimpleNamespace(
        folder=folder, parameters=NODES[request.param], urdf=ElementTree.parse(urdf).getroot(),
        controllers=yaml.safe_load((folder / 'config' / 'controllers.yaml').read_text()))


def launched(package, name):
    return ast.parse((package.folder / 'launch' / f'{name}.launch.py').read_text())


def test_controllers_claim_interfaces_that_the_tag_has_and_each_joint_once_in_a_mode(package):
    commands = {joint.get('name'): {c.get('name') for c in joint.findall('command_interface')}
                for joint in package.urdf.find('ros2_control').findall('joint')}
    claimed = set()
    for name, content in package.controllers.items():
        settings = content['ros__parameters']
        joints = settings.get('joints') or ([settings['joint']] if 'joint' in settings else [])
        (mode,) = settings.get('command_interfaces', ['position'])
        for joint in joints:
            assert mode in commands[joint], (name, joint)
            assert (joint, mode) not in claimed
            claimed.add((joint, mode))
        for joint, gains in settings.get('gains', {}).items():
            assert joint in joints and gains['p'] > 0.0
    # Nothing that can be commanded is left out.
    assert {joint for joint, _ in claimed} == {joint for joint, modes in commands.items() if modes}


def test_every_controller_has_a_type_and_is_spawned(package):
    manager = package.controllers['controller_manager']['ros__parameters']
    names = {name for name in manager if name != 'update_rate'}
    assert names - {'joint_state_broadcaster'} == package.controllers.keys() - {
        'controller_manager'}
    values = {target.id: ast.literal_eval(node.value) for node in launched(package, 'spawn').body
              if isinstance(node, ast.Assign) for target in node.targets}
    assert {*values['ALWAYS'], *sum(values['CONTROLLERS'].values(), [])} == names


def test_wrenches_and_imus_are_broadcast_in_the_frame_of_the_sensor(package):
    tag = package.urdf.find('ros2_control')
    sensors = {sensor.get('name') for sensor in tag.findall('sensor')}
    frames = {settings['ros__parameters']['sensor_name']: settings['ros__parameters']['frame_id']
              for settings in package.controllers.values()
              if 'sensor_name' in settings['ros__parameters']}
    assert frames.keys() == sensors
    assert bool(sensors) == ('ros2_control_plugin' in package.parameters)
    assert set(frames.values()) <= {link.get('name') for link in package.urdf.findall('link')}


def test_the_tag_names_the_rate_of_a_sensor_that_is_slower_than_the_states(package):
    rates = {sensor.get('name'): param.text for sensor in package.urdf.iter('sensor')
             for param in sensor.findall('param') if param.get('name') == 'rate'}
    assert rates == ({'robot0_right_imu': '10.0'} if 'sensors' in package.parameters else {})


def test_the_node_is_started_as_the_package_was_written_for(package):
    node = yaml.safe_load((package.folder / 'config' / 'sim_node.yaml').read_text())
    parameters = node['/**']['ros__parameters']
    assert parameters.items() >= {**package.parameters, 'ros2_control_tag': True}.items()
    plugin = package.urdf.find('ros2_control/hardware/plugin').text
    assert plugin == parameters['ros2_control_plugin']
    bringup = launched(package, 'bringup')
    strings = {n.value for n in ast.walk(bringup) if isinstance(n, ast.Constant)}
    topics = {p.text.rpartition('/')[2] for p in package.urdf.iterfind(
        'ros2_control/hardware/param') if p.get('name').endswith('topic')}
    assert topics | {package.folder.name, 'use_sim_time:=true'} <= strings
    catkin_pkg = pytest.importorskip('catkin_pkg.package', reason='needs catkin_pkg')
    # As colcon does, which takes no underscore in the domain of an e-mail address.
    catkin_pkg.parse_package(str(package.folder / 'package.xml'))
    manifest = ElementTree.parse(package.folder / 'package.xml')
    assert manifest.find('name').text == package.folder.name
    needed = {element.text for element in manifest.findall('exec_depend')}
    assert plugin.partition('/')[0] in needed
    for module in (n for n in ast.walk(bringup) if isinstance(n, ast.ImportFrom)):
        assert module.module.partition('.')[0] in needed


@pytest.mark.parametrize('given', [
    *NODES.values(), {'robot': 'Jaco'}, {'robot': 'GR1', 'ros2_control_plugin': OWN_PLUGIN}],
    ids=lambda given: given['robot'])
def test_moveit_uses_the_controllers_of_the_package_written_with_its_own(
        given, tmp_path, monkeypatch):
    # Which links never collide is of no matter here.
    monkeypatch.setattr(srdf, '_SAMPLES', 20)
    parameters = tmp_path / 'node.yaml'
    parameters.write_text(yaml.safe_dump({'/**': {'ros__parameters': given}}))
    assert main(['export', '--moveit', str(tmp_path / 'own_moveit'), '--ros2-control',
                 str(tmp_path / 'own_control'), '--params-file', str(parameters)]) == 0
    moveit = yaml.safe_load((tmp_path / 'own_moveit/config/moveit_controllers.yaml').read_text())[
        'moveit_simple_controller_manager']
    control = yaml.safe_load((tmp_path / 'own_control/config/controllers.yaml').read_text())
    types = control['controller_manager']['ros__parameters']
    assert moveit['controller_names']
    for name in moveit['controller_names']:
        action, settings = moveit[name], control[name]['ros__parameters']
        assert action['joints'] == (settings.get('joints') or [settings['joint']])
        assert (action['type'], action['action_ns']) == {
            TRAJECTORY: ('FollowJointTrajectory', 'follow_joint_trajectory'),
            GRIPPER: ('GripperCommand', 'gripper_cmd')}[types[name]['type']]
    spawn = (tmp_path / 'own_control/launch/spawn.launch.py').read_text()
    # Of the controllers that are active together at first: no joint twice.
    joints = sum((moveit[name]['joints'] for name in moveit['controller_names']), [])
    assert len(joints) == len(set(joints)) and all(
        f"'{name}'" in spawn for name in moveit['controller_names'])


def test_two_packages_need_two_folders(tmp_path, capsys):
    folder = str(tmp_path / 'own')
    assert main(['export', '--moveit', folder, '--ros2-control', folder]) == 1
    assert 'cannot be both packages: give two folders' in capsys.readouterr().err
    assert not (tmp_path / 'own').exists()


@pytest.mark.skipif(importlib.util.find_spec('rclpy') is None,
                    reason='rcl, of ROS 2, reads the parameters')
def test_rcl_reads_the_parameters_of_each_controller(package):
    import rclpy
    from rclpy.node import Node
    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    try:
        for name, content in package.controllers.items():
            node = Node(name, context=context, cli_args=[
                '--ros-args', '--params-file',
                str(package.folder / 'config' / 'controllers.yaml')],
                automatically_declare_parameters_from_overrides=True)
            for key, value in content['ros__parameters'].items():
                if not isinstance(value, dict):
                    assert node.get_parameter(key).value == value
            node.destroy_node()
    finally:
        rclpy.shutdown(context=context)


@pytest.mark.parametrize('name', robot_names())
def test_the_gains_for_efforts_lead_every_robot_to_its_goal(name):
    simulation = Simulation(compose(name))
    robot, data = simulation.robot, simulation.data
    joints, inertias = robot.joints.names, effective_inertias(simulation)
    for part, of in robot.parts.items():
        if of.gripper is None and of.actuators and of.atomic == (part,):
            robot.set_control_mode(part, 'effort')
    gains = [effort_gains(inertias[joint]) for joint in joints]
    stiffness, damping = (np.array([gain[key] for gain in gains]) for key in 'pd')

    def measured():
        return np.array([[data.joint(joint).qpos[0], data.joint(joint).qvel[0]]
                         for joint in joints]).T
    start = measured()[0]
    low, high = np.array([simulation.model.joint(joint).range for joint in joints]).T
    goal = start + np.clip((low + high) / 2.0 - start, -0.2, 0.2)
    # What the controller reads is one period old.
    late = [measured()]
    for period in range(800):
        share = min(period / 200.0, 1.0)
        setpoint = start + (goal - start) * share ** 3 * (10.0 - 15.0 * share + 6.0 * share ** 2)
        late.append(measured())
        position, velocity = late.pop(0)
        robot.apply(*robot.parse.joint_command(joints, effort=[
            *(stiffness * (setpoint - position) - damping * velocity)]), period_s=0.01)
        simulation.advance(5)
    position, velocity = measured()
    assert np.abs(position - goal).max() < 2e-3
    assert np.abs(velocity).max() < 2e-3


def test_a_folder_or_a_robot_that_cannot_be_used_is_told(tmp_path):
    (tmp_path / 'full_control').mkdir()
    (tmp_path / 'full_control' / 'mine').touch()
    world = compose('UR5e', gripper='none')
    with pytest.raises(ModelError, match='full_control is not empty'):
        write_control_package(world, tmp_path / 'full_control', Hardware({}), {})
    with pytest.raises(ModelError, match='cannot be the name of a ROS package'):
        write_control_package(world, tmp_path / 'My-Robot', Hardware({}), {})
    with pytest.raises(ModelError, match='UR5e has no joints that ros2_control could move'):
        write_control_package(world, tmp_path / 'ur_control', Hardware({}), {})
    assert not (tmp_path / 'ur_control').exists()


def test_imus_are_broadcast_in_the_frame_that_their_site_has_among_all_names(tmp_path):
    (tmp_path / 'arm.xml').write_text(
        '<mujoco><worldbody><body name="base"><geom size="0.05" mass="1"/><body name="imu" '
        'pos="0 0 0.1"><joint name="j" axis="0 1 0"/><geom size="0.05" mass="1"/>'
        '<site name="imu"/><site name="tip"/></body></body></worldbody><actuator>'
        '<motor joint="j" ctrlrange="-9 9"/></actuator><sensor><gyro site="imu"/>'
        '<accelerometer site="imu"/><gyro site="tip"/><gyro site="tip"/></sensor></mujoco>')
    given = tmp_path / 'node.yaml'
    given.write_text(yaml.safe_dump({'/**': {'ros__parameters': {
        'robot': str(tmp_path / 'arm.xml'), 'ros2_control_plugin': OWN_PLUGIN}}}))
    folder = tmp_path / 'control'
    assert main(['export', '--ros2-control', str(folder), '--params-file', str(given)]) == 0
    controllers = yaml.safe_load((folder / 'config' / 'controllers.yaml').read_text())
    frames = {settings['ros__parameters']['sensor_name']: settings['ros__parameters']['frame_id']
              for name, settings in controllers.items() if 'imu' in name or 'tip' in name}
    assert frames == {'robot0_imu': 'robot0_imu_site', 'robot0_tip': 'robot0_tip',
                      'robot0_tip_2': 'robot0_tip'}
    (urdf,) = folder.glob('config/*.urdf')
    links = {link.get('name') for link in ElementTree.parse(urdf).getroot().findall('link')}
    assert set(frames.values()) <= links
