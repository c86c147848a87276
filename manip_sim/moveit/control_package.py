# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A ROS package that starts ros2_control for a robot: URDF with the tag, controllers, launch."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models import World
from manip_sim.models.urdf_writer import choose_robot, Hardware, OWN_PLUGIN
from manip_sim.moveit.package import (
    as_yaml, build_files, check_folder, Controlling, describe, GRIPPER_COMMANDS, robot_in,
    Settings, TRAJECTORIES, write_files)
from manip_sim.simulation import SimulatedRobot, Simulation

#: Types of ros2_controllers, branch jazzy.
TRAJECTORY = 'joint_trajectory_controller/JointTrajectoryController'
GRIPPER = 'position_controllers/GripperActionController'
BROADCASTER = 'joint_state_broadcaster/JointStateBroadcaster'
IMU = 'imu_sensor_broadcaster/IMUSensorBroadcaster'
WRENCH = 'force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster'
#: Name, type, mode (empty: always active) and parameters of a controller.
_Controller = tuple[str, str, str, Settings]
_MODES = ('position', 'velocity', 'effort')
#: Stands for a mode where every controller can be active at the same time.
ALL = 'all'
#: Gains for efforts: natural frequency [rad/s] and damping ratio of each joint alone. At 100 Hz
#: and two periods of delay, faster ones oscillate.
_FREQUENCY, _DAMPING = 8.0, 1.0
#: Gain of the position error in velocity mode [1/s]; the velocity itself is fed forward.
_VELOCITY_GAIN = 5.0
_DEPENDENCIES = (
    'controller_manager', 'force_torque_sensor_broadcaster', 'gripper_controllers',
    'imu_sensor_broadcaster', 'joint_state_broadcaster', 'joint_trajectory_controller', 'launch',
    'launch_ros', 'manip_sim')

_BRINGUP = '''"""{robot} simulated, the controller manager, and its controllers."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    package = FindPackageShare('{package}')
    return LaunchDescription([
        DeclareLaunchArgument('mode', default_value='{mode}', choices={modes},
                              description='of the controllers that are activated'),
        Node(
            package='manip_sim', executable='sim_node', output='screen',
            parameters=[PathJoinSubstitution([package, 'config', 'sim_node.yaml'])],
            remappings=[('joint_states', 'robot_joint_states'),
                        ('joint_command', 'robot_joint_commands')]),
        Node(
            package='controller_manager', executable='ros2_control_node', output='screen',
            # In a file it would not reach the nodes of the controllers.
            arguments=['--ros-args', '-p', 'use_sim_time:=true'],
            parameters=[PathJoinSubstitution([package, 'config', 'controllers.yaml'])]),
        IncludeLaunchDescription(
            PathJoinSubstitution([package, 'launch', 'spawn.launch.py']),
            launch_arguments={{'mode': LaunchConfiguration('mode')}}.items()),
    ])
'''

_SPAWN = '''"""Activate the controllers of {robot} in one of its modes."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

CONTROLLERS = {controllers}
ALWAYS = {always}


def spawn(context):
    mode = context.launch_configurations['mode']
    return [Node(
        package='controller_manager', executable='spawner', output='screen',
        arguments=[*ALWAYS, *CONTROLLERS[mode], '--controller-manager-timeout', '60'])]


def generate_launch_description():
    return LaunchDescription([
        DeclareLaunchArgument('mode', default_value='{mode}', choices=[*CONTROLLERS]),
        OpaqueFunction(function=spawn)])
'''

_README = """# ros2_control of {robot}

Written by `manip_sim export --ros2-control`; build it with colcon beside manip_sim, and start it:

```sh
ros2 launch {package} bringup.launch.py
```

- `update_rate` of the controller manager is at most `publish_rate` of the node, so that each
  cycle has a new state.
- `use_sim_time` is on the command line of `ros2_control_node`, so that the nodes of its
  controllers have it too.
- In effort mode the node adds gravity compensation: commands are without it, states with it.
- After `~/reset` an active controller moves the robot back to where it held it. Deactivate the
  controller before, or use the plugin of `manip_sim_hardware`.
"""


def write_control_package(world: World, folder: Path, hardware: Hardware,
                          parameters: Mapping[str, Any]) -> tuple[list[str], Controlling]:
    """
    Write a package that starts ros2_control for the only robot of a world.

    :param folder: becomes the package and gives it its name; must be new or empty
    :param parameters: parameters of the node that serves the same world
    :returns: omissions from the URDF, in sentences, and the controllers that MoveIt uses, of the
        first mode, by joint
    :raises ModelError: if the folder cannot be used, or the robot has no joints to control
    """
    folder = folder.resolve()  # Of the present folder, the path has no name.
    check_folder(folder)
    simulation = Simulation(world)
    robot, model = simulation.robot, simulation.model
    urdf, meshes = describe(model, choose_robot(world), folder.name, hardware)
    name = robot_in(urdf.xml)
    groups = list(_controllers(robot, hardware, _driven(urdf.xml),
                               effective_inertias(simulation), {
                                   instrument.name: instrument.frame
                                   for instrument in simulation.sensors.instruments}))
    by_mode: dict[str, list[str]] = {}
    for controller, _, mode, _ in groups:
        if mode:
            by_mode.setdefault(mode, []).append(controller)
    if not by_mode:
        raise ModelError(f'{name} has no joints that ros2_control could move')
    names = {'package': folder.name, 'robot': name, 'mode': next(iter(by_mode)),
             'modes': list(by_mode), 'controllers': by_mode,
             'always': [controller for controller, _, mode, _ in groups if not mode]}
    manager = {'update_rate': 100, **{other: {'type': kind} for other, kind, _, _ in groups}}
    texts = {path: template.format(**names) for path, template in (
        ('README.md', _README), ('launch/bringup.launch.py', _BRINGUP),
        ('launch/spawn.launch.py', _SPAWN))}
    needed = sorted((*_DEPENDENCIES, hardware.plugin.partition('/')[0]))
    texts |= build_files(folder.name, f'ros2_control of {name}', needed,
                         ('config', 'launch', 'meshes'))
    texts |= as_yaml({
        'config/controllers.yaml': {
            'controller_manager': {'ros__parameters': manager},
            **{other: {'ros__parameters': settings} for other, _, _, settings in groups
               if settings}},
        'config/sim_node.yaml': {'/**': {'ros__parameters': {
            **parameters, 'ros2_control_tag': True, 'ros2_control_plugin': hardware.plugin}}}})
    texts[f'config/{name}.urdf'] = urdf.xml
    write_files(folder, {**{path: text.encode() for path, text in texts.items()}, **meshes})
    return list(urdf.notes), _controlling(groups)


def _controlling(controllers: Iterable[_Controller]) -> Controlling:
    by_joint: dict[str, tuple[str, str, list[str]]] = {}
    for name, kind, _, settings in controllers:
        joints = settings.get('joints') or [settings[key] for key in ('joint',) if key in settings]
        for joint in joints:
            by_joint.setdefault(joint, (
                name, GRIPPER_COMMANDS if kind == GRIPPER else TRAJECTORIES, [*joints]))
    return by_joint


def _driven(urdf: str) -> set[str]:
    """Return the joints of a URDF that ros2_control can command."""
    return {str(joint.get('name'))
            for joint in ElementTree.fromstring(urdf).iterfind('ros2_control/joint')
            if joint.find('command_interface') is not None}


def effective_inertias(simulation: Simulation) -> dict[str, float]:
    """
    Return the inertia of each joint at the start if all others are free, [kg m^2 or kg].

    It is one over the diagonal of the inverse of the joint-space inertia, armature included.
    """
    model, data = simulation.model, simulation.data
    inverse: FloatArray = np.zeros((model.nv, model.nv))
    mujoco.mj_solveM(model, data, inverse, np.eye(model.nv))
    return {name: 1.0 / float(inverse[address, address])
            for name in simulation.robot.joints.names
            for address in [int(model.joint(name).dofadr[0])]}


def effort_gains(inertia: float) -> Settings:
    """Return the gains of a joint in effort mode, for its effective inertia [kg m^2 or kg]."""
    return {'p': round(inertia * _FREQUENCY ** 2, 4), 'i': 0.0,
            'd': round(2.0 * _DAMPING * inertia * _FREQUENCY, 4)}


def velocity_gains(_inertia: float) -> Settings:
    """Return the gains of a joint in velocity mode."""
    return {'p': _VELOCITY_GAIN, 'i': 0.0, 'd': 0.0, 'ff_velocity_scale': 1.0}


_GAINS = {'velocity': velocity_gains, 'effort': effort_gains}


def _controllers(robot: SimulatedRobot, hardware: Hardware, driven: Collection[str],
                 inertias: Mapping[str, float], frames: Mapping[str, str]
                 ) -> Iterator[_Controller]:
    yield 'joint_state_broadcaster', BROADCASTER, '', {}
    own_plugin = hardware.plugin == OWN_PLUGIN
    for name, part in robot.parts.items():
        if part.atomic != (name,) or not part.joints:
            continue
        title = name.replace('/', '_')
        joints = [joint for joint in part.joints if joint in driven]
        if joints and part.gripper is not None:
            yield _gripper(f'{title}_controller', joints)
        elif joints:
            # The plugin from apt has the interfaces of one mode, which are all used at once.
            for mode in _MODES if own_plugin else [hardware.interfaces[joints[0]]]:
                yield (f'{title}_{mode}_controller', TRAJECTORY, mode if own_plugin else ALL,
                       _trajectory(joints, mode, inertias))
    for sensor in hardware.wrench_topics if own_plugin else ():
        arm = sensor.partition('_')[0]
        yield f'{sensor}_broadcaster', WRENCH, '', {
            'sensor_name': sensor, 'frame_id': robot.end_effectors[arm].wrench_frame}
    for sensor in hardware.imu_topics if own_plugin else ():
        yield f'{sensor}_broadcaster', IMU, '', {'sensor_name': sensor, 'frame_id': frames[sensor]}


def _gripper(name: str, joints: list[str]) -> _Controller:
    if len(joints) == 1:
        # A grasped object keeps the fingers from their goal.
        return name, GRIPPER, '', {'joint': joints[0], 'allow_stalling': True}
    return name, TRAJECTORY, '', _trajectory(joints, 'position', {})


def _trajectory(joints: list[str], mode: str, inertias: Mapping[str, float]) -> Settings:
    # A copy: rcl reads no YAML with references.
    settings: Settings = {'joints': [*joints], 'command_interfaces': [mode],
                          'state_interfaces': ['position', 'velocity']}
    if mode in _GAINS:
        settings['gains'] = {joint: _GAINS[mode](inertias[joint]) for joint in joints}
    return settings
