# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
ROS packages for a composed robot: one with every file that MoveIt 2 needs, one for ros2_control.

The latter starts the controllers: URDF with the tag, their parameters, launch files.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
import copy
from pathlib import Path
import re
import shutil
import tempfile
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import yaml

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models import World
from manip_sim.models.robots import RobotModel
from manip_sim.models.urdf_writer import choose_robot, Hardware, OWN_PLUGIN, Urdf, write_urdf
from manip_sim.models.urdf_writer.links import binary_stl, ELLIPSOID, MeshFile, stl_of, unit_sphere
from manip_sim.moveit.srdf import disabled_pairs, find_groups, find_postures, Group, write_srdf
from manip_sim.quoting import quoted
from manip_sim.simulation import SimulatedRobot, Simulation

Settings = dict[str, Any]
_NAME = re.compile(r'[a-z][a-z0-9]*(_[a-z0-9]+)*')
#: Names that are written alike in names of files, Python, XML and Markdown.
_ROBOT = re.compile(r'\w[\w .+-]*')

_PACKAGE = """<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>0.1.0</version>
  <description>{what}, written by manip_sim.</description>
  <maintainer email="you@example.com">you</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
{dependencies}
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""

_CMAKE = """cmake_minimum_required(VERSION 3.22)
project({package})
find_package(ament_cmake REQUIRED)
install(DIRECTORY {folders} DESTINATION share/${{PROJECT_NAME}})
{more}ament_package()
"""


def build_files(package: str, summary: str, dependencies: Iterable[str], folders: Iterable[str],
                more: str = '') -> dict[str, str]:
    """
    Return ``package.xml`` and ``CMakeLists.txt``.

    :param summary: beginning of its description
    :param dependencies: packages that it needs when it is used
    """
    needed = '\n'.join(f'  <exec_depend>{name}</exec_depend>' for name in dependencies)
    return {
        'package.xml': _PACKAGE.format(package=package, what=summary, dependencies=needed),
        'CMakeLists.txt': _CMAKE.format(package=package, folders=' '.join(folders), more=more)}


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write all files of a package, or none."""
    with tempfile.TemporaryDirectory(dir=folder.parent) as unfinished:
        for name, content in files.items():
            file = Path(unfinished, folder.name, name)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        shutil.copytree(Path(unfinished, folder.name), folder, dirs_exist_ok=True)


def check_folder(folder: Path) -> None:
    """
    Check that a folder can become a package.

    :raises ModelError: if its name is that of no ROS package, or it is not empty
    """
    if not _NAME.fullmatch(folder.name):
        raise ModelError(f'{quoted(folder.name)} cannot be the name of a ROS package: it needs '
                         'lower-case letters, digits and single underscores, such as '
                         'panda_moveit_config')
    if not folder.parent.is_dir():
        raise ModelError(f'no such folder: {folder.parent}')
    if folder.exists() and not folder.is_dir():
        raise ModelError(f'{folder} is a file, give the name of a folder')
    if folder.is_dir() and any(folder.iterdir()):
        raise ModelError(f'{folder} is not empty: give a new folder, or remove it first')


def robot_in(urdf: str) -> str:
    """
    Return the name of the robot in a URDF, which becomes part of launch files.

    :raises ModelError: if it has characters that would end a string there
    """
    name = str(ElementTree.fromstring(urdf).get('name'))
    if not _ROBOT.fullmatch(name):
        raise ModelError(f'{quoted(name)} cannot name a robot in a ROS package: it needs letters, '
                         'digits, spaces, _, ., + and -; rename the file of the robot')
    return name


def as_yaml(contents: Mapping[str, Any]) -> dict[str, str]:
    """Return the text of YAML files, by path."""
    return {path: yaml.safe_dump(content, sort_keys=False) for path, content in contents.items()}


_MOVEIT_DEPENDENCIES = (
    'launch', 'launch_ros', 'moveit_configs_utils', 'moveit_kinematics', 'moveit_planners_ompl',
    'moveit_ros_move_group', 'moveit_ros_visualization', 'moveit_simple_controller_manager',
    'pilz_industrial_motion_planner', 'robot_state_publisher', 'rviz2', 'xacro')
FOLDERS = ('config', 'launch', 'meshes', 'rviz')

_LAUNCH = '''"""MoveIt for {robot}: move_group, RViz, and TF if nothing else publishes it."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from moveit_configs_utils import MoveItConfigsBuilder

ARGUMENTS = {{
    'namespace': ('', 'of the robot, where the node serves several'),
    'use_sim_time': ('true', 'take the time from /clock'),
    'use_rviz': ('true', 'start RViz'),
    'use_robot_state_publisher': (
        'false', 'publish TF from joint_states, if the node does not'),
}}


def generate_launch_description():
    config = (
        MoveItConfigsBuilder('{robot}', package_name='{package}')
        .planning_pipelines(
            default_planning_pipeline='ompl', pipelines=['ompl', 'pilz_industrial_motion_planner'])
        .trajectory_execution(
            'config/moveit_controllers.yaml', moveit_manage_controllers=False)
        .to_moveit_configs())
    common = {{
        'namespace': LaunchConfiguration('namespace'),
        'output': 'screen',
    }}
    time = {{'use_sim_time': LaunchConfiguration('use_sim_time')}}
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=value, description=meaning)
          for name, (value, meaning) in ARGUMENTS.items()),
        Node(
            package='moveit_ros_move_group', executable='move_group',
            parameters=[config.to_dict(), time, {{'publish_robot_description_semantic': True}}],
            **common),
        Node(
            package='robot_state_publisher', executable='robot_state_publisher',
            parameters=[config.robot_description, time],
            condition=IfCondition(LaunchConfiguration('use_robot_state_publisher')), **common),
        Node(
            package='rviz2', executable='rviz2',
            arguments=['-d', str(config.package_path / 'rviz' / 'moveit.rviz')],
            parameters=[
                config.robot_description, config.robot_description_semantic,
                config.robot_description_kinematics, config.joint_limits,
                config.planning_pipelines, time],
            condition=IfCondition(LaunchConfiguration('use_rviz')), **common),
    ])
'''

_MOVEIT_README = """# MoveIt configuration of {robot}

Written by `manip_sim export --moveit`; build it with colcon, next to manip_sim, and start it
beside the node:

```sh
ros2 launch {package} moveit.launch.py
```
"""


#: A view for RViz, but for the group that is planned for at first.
_RVIZ: Settings = {
    'Panels': [{'Class': 'rviz_common/Displays', 'Name': 'Displays'},
               {'Class': 'rviz_common/Views', 'Name': 'Views'}],
    'Visualization Manager': {
        'Displays': [
            {'Class': 'rviz_default_plugins/Grid', 'Name': 'Grid', 'Enabled': True},
            {'Class': 'moveit_rviz_plugin/MotionPlanning', 'Name': 'MotionPlanning',
             'Enabled': True, 'Robot Description': 'robot_description',
             'Planning Scene Topic': 'monitored_planning_scene',
             'Planning Request': {'Planning Group': '', 'Query Goal State': True}}],
        'Global Options': {'Fixed Frame': 'world', 'Frame Rate': 30},
        'Tools': [{'Class': 'rviz_default_plugins/Interact'},
                  {'Class': 'rviz_default_plugins/MoveCamera'}],
        'Views': {'Current': {
            'Class': 'rviz_default_plugins/Orbit', 'Name': 'Current View', 'Distance': 3.0,
            'Focal Point': {'X': 0.0, 'Y': 0.0, 'Z': 0.8}, 'Pitch': 0.4, 'Yaw': 0.8}}}}


#: Name, kind and joints of the controller of each joint, for MoveIt.
Controlling = Mapping[str, tuple[str, str, list[str]]]
TRAJECTORIES, GRIPPER_COMMANDS = 'FollowJointTrajectory', 'GripperCommand'
#: Default velocity and acceleration scaling factor of plans.
_CAUTION = 0.1
#: Time in which a finger accelerates to its velocity limit [s].
_FINGER_SPEED_UP_S = 0.1
#: Joints that an arm needs to reach a pose with its orientation.
_FULL_POSE = 6
_PLANNERS = {'RRTConnect': 'geometric::RRTConnect', 'RRTstar': 'geometric::RRTstar',
             'PRM': 'geometric::PRM', 'BiTRRT': 'geometric::BiTRRT'}
_REQUESTS = [f'default_planning_request_adapters/{name}' for name in (
    'ResolveConstraintFrames', 'ValidateWorkspaceBounds', 'CheckStartStateBounds',
    'CheckStartStateCollision')]
_RESPONSES = [f'default_planning_response_adapters/{name}' for name in (
    'AddTimeOptimalParameterization', 'ValidateSolution', 'DisplayMotionPath')]
_PILZ = {
    'planning_plugins': ['pilz_industrial_motion_planner/CommandPlanner'],
    'default_planner_config': 'PTP', 'request_adapters': _REQUESTS,
    'response_adapters': _RESPONSES[1:],  # Its trajectories have times already.
    'capabilities': ' '.join(f'pilz_industrial_motion_planner/MoveGroupSequence{kind}'
                             for kind in ('Action', 'Service'))}
#: Moderate for any of the arms [m, rad, s].
_PILZ_LIMITS = {'cartesian_limits': {'max_trans_vel': 0.5, 'max_trans_acc': 1.0,
                                     'max_trans_dec': -1.0, 'max_rot_vel': 1.57}}
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)


def kinematics(groups: Iterable[Group]) -> Settings:
    """Return ``kinematics.yaml``: a solver for each chain."""
    solvers: Settings = {}
    for group in groups:
        if not group.tip:
            continue
        solvers[group.name] = {
            'kinematics_solver': 'kdl_kinematics_plugin/KDLKinematicsPlugin',
            'kinematics_solver_search_resolution': 0.005,
            'kinematics_solver_timeout': 0.05}
        if len(group.joints) < _FULL_POSE:
            solvers[group.name]['position_only_ik'] = True
    return solvers


def joint_limits(groups: Iterable[Group], passive: Iterable[str], robot: SimulatedRobot,
                 velocity: Mapping[str, float]) -> Settings:
    """
    Return ``joint_limits.yaml``: velocities as in the URDF, and accelerations.

    :param passive: joints of groups for which MoveIt does not plan, but wants limits
    :param velocity: limits by joint [rad/s or m/s]
    """
    names = robot.joints.names
    accelerations = dict(zip(names, robot.joints.acceleration_limits(
        robot.joints.find(names)).tolist()))
    limits = {}
    active = (joint for group in groups for joint in group.active)
    for joint in dict.fromkeys((*active, *passive)):
        limits[joint] = {
            'has_velocity_limits': True, 'max_velocity': velocity[joint],
            'has_acceleration_limits': True,
            'max_acceleration': accelerations.get(joint, velocity[joint] / _FINGER_SPEED_UP_S)}
    return {'default_velocity_scaling_factor': _CAUTION,
            'default_acceleration_scaling_factor': _CAUTION, 'joint_limits': limits}


def controllers(groups: Iterable[Group], effort: Mapping[str, float],
                controlling: Controlling | None = None) -> Settings:
    """
    Return ``moveit_controllers.yaml``: which actions move which joints.

    :param effort: limits by joint, for grippers [N m or N]
    :param controlling: of ros2_control; None for the node's own actions,
        ``<part>/follow_joint_trajectory`` and ``<arm>/gripper/gripper_cmd``
    """
    manager: Settings = {'controller_names': []}
    for group in groups:
        joints = list(group.active if group.is_gripper else group.driven)
        if group.subgroups or not joints:
            continue
        name, kind = group.part, GRIPPER_COMMANDS if group.is_gripper else TRAJECTORIES
        if controlling is not None:
            name, kind, joints = controlling[joints[0]]
        settings: Settings = {'type': kind, 'action_ns': 'follow_joint_trajectory'}
        if kind == GRIPPER_COMMANDS:
            settings = {'type': kind, 'action_ns': 'gripper_cmd',
                        'command_joint': joints[0], 'max_effort': effort[joints[0]],
                        # A grasped object keeps the fingers from their goal.
                        'allow_failure': True}
        manager['controller_names'].append(name)
        manager[name] = {**settings, 'default': True, 'joints': joints}
    return {'moveit_controller_manager':
            'moveit_simple_controller_manager/MoveItSimpleControllerManager',
            'moveit_simple_controller_manager': manager}


def ompl(groups: Iterable[Group]) -> Settings:
    """Return ``ompl_planning.yaml``."""
    settings: Settings = {
        'planning_plugins': ['ompl_interface/OMPLPlanner'], 'request_adapters': _REQUESTS,
        'response_adapters': _RESPONSES,
        'planner_configs': {name: {'type': kind} for name, kind in _PLANNERS.items()}}
    for group in groups:
        if group.active:
            settings[group.name] = {'default_planner_config': next(iter(_PLANNERS)),
                                    'planner_configs': list(_PLANNERS)}
    return settings


def write_package(world: World, folder: Path, controlling: Controlling | None = None
                  ) -> list[str]:
    """
    Write a MoveIt configuration package for the only robot of a world.

    :param world: with one robot
    :param folder: becomes the package and gives it its name; must be new or empty
    :param controlling: the controllers of ros2_control; None for the node's own actions
    :returns: omissions from the URDF, in sentences
    :raises ModelError: if the folder cannot be used, or there is nothing to plan for
    """
    folder = folder.resolve()  # Of the present folder, the path has no name.
    check_folder(folder)
    model, robot, package = world.compile(), choose_robot(world), folder.name
    urdf, meshes = describe(model, robot, package)
    simulation = Simulation(world)
    groups, passive = find_groups(model, simulation.robot, urdf)
    if not groups:
        raise ModelError(f'{robot.name} has no joints that MoveIt could plan for')
    postures = find_postures(simulation, simulation.robot)
    name = robot_in(urdf.xml)
    limits = {str(joint.get('name')): limit
              for joint in ElementTree.fromstring(urdf.xml).iter('joint')
              if (limit := joint.find('limit')) is not None}
    velocity, effort = ({joint: float(limit.get(key, 0.0)) for joint, limit in limits.items()}
                        for key in ('velocity', 'effort'))
    disabled = disabled_pairs(world, robot, urdf.tree.link_of_body, postures)
    view = copy.deepcopy(_RVIZ)
    view['Visualization Manager']['Displays'][1]['Planning Request']['Planning Group'] = (
        groups[0].name)
    texts = {
        **build_files(package, f'MoveIt configuration of {name}', _MOVEIT_DEPENDENCIES, FOLDERS,
                      'install(FILES .setup_assistant DESTINATION share/${PROJECT_NAME})\n'),
        'README.md': _MOVEIT_README.format(package=package, robot=name),
        'launch/moveit.launch.py': _LAUNCH.format(package=package, robot=name),
        f'config/{name}.urdf': urdf.xml,
        f'config/{name}.srdf': write_srdf(name, groups, postures, passive, disabled),
        **as_yaml({
            'config/kinematics.yaml': kinematics(groups),
            'config/joint_limits.yaml': joint_limits(groups, passive, simulation.robot, velocity),
            'config/moveit_controllers.yaml': controllers(groups, effort, controlling),
            'config/ompl_planning.yaml': ompl(groups),
            'config/pilz_industrial_motion_planner_planning.yaml': _PILZ,
            'config/pilz_cartesian_limits.yaml': _PILZ_LIMITS,
            # It says where URDF and SRDF are, also to MoveItConfigsBuilder.
            '.setup_assistant': {'moveit_setup_assistant_config': {
                'urdf': {'package': package, 'relative_path': f'config/{name}.urdf'},
                'srdf': {'relative_path': f'config/{name}.srdf'}}},
            'rviz/moveit.rviz': view})}
    write_files(folder, {**{path: text.encode() for path, text in texts.items()}, **meshes})
    return list(urdf.notes)


def describe(model: mujoco.MjModel, robot: RobotModel, package: str,
             hardware: Hardware | None = None) -> tuple[Urdf, dict[str, bytes]]:
    """Return the URDF of a robot, and the meshes that it names in its package, by path."""
    # An STL file for each mesh, whatever it was read from.
    meshes = {ELLIPSOID: ('unit_sphere.stl', binary_stl(unit_sphere()))}
    for mesh in np.unique(model.geom_dataid[model.geom_type == _MESH]).tolist():
        meshes[model.mesh(mesh).name] = f'mesh_{mesh}.stl', stl_of(model, mesh)
    uris = {key: MeshFile(f'package://{package}/meshes/{name}', np.ones(3), np.zeros(3), np.eye(3))
            for key, (name, _) in meshes.items()}
    urdf = write_urdf(model, robot, uris, hardware)
    return urdf, {'meshes/README.md': b'Meshes of the robot as MuJoCo has compiled them.\n',
                  **{f'meshes/{file}': content for file, content in meshes.values()
                     if f'/meshes/{file}"' in urdf.xml}}


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
_CONTROL_DEPENDENCIES = (
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

_CONTROL_README = """# ros2_control of {robot}

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
    driven = {str(joint.get('name'))
              for joint in ElementTree.fromstring(urdf.xml).iterfind('ros2_control/joint')
              if joint.find('command_interface') is not None}
    frames = {sensor.name: sensor.frame for sensor in simulation.sensors.instruments}
    groups = list(_controllers(robot, hardware, driven, effective_inertias(simulation), frames))
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
        ('README.md', _CONTROL_README), ('launch/bringup.launch.py', _BRINGUP),
        ('launch/spawn.launch.py', _SPAWN))}
    needed = sorted((*_CONTROL_DEPENDENCIES, hardware.plugin.partition('/')[0]))
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
    controlling: dict[str, tuple[str, str, list[str]]] = {}
    for other, kind, _, settings in groups:
        joints = settings.get('joints') or ([settings['joint']] if 'joint' in settings else [])
        for joint in joints:
            controlling.setdefault(joint, (
                other, GRIPPER_COMMANDS if kind == GRIPPER else TRAJECTORIES, [*joints]))
    return list(urdf.notes), controlling


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


#: By mode, for the effective inertia of a joint.
_GAINS: dict[str, Callable[[float], Settings]] = {
    'effort': effort_gains, 'velocity': lambda _: {
        'p': _VELOCITY_GAIN, 'i': 0.0, 'd': 0.0, 'ff_velocity_scale': 1.0}}


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
        if part.gripper is not None and len(joints) == 1:
            # A grasped object keeps the fingers from their goal.
            yield f'{title}_controller', GRIPPER, '', {
                'joint': joints[0], 'allow_stalling': True}
        elif part.gripper is not None and joints:
            yield f'{title}_controller', TRAJECTORY, '', _trajectory(joints, 'position', {})
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


def _trajectory(joints: list[str], mode: str, inertias: Mapping[str, float]) -> Settings:
    # A copy: rcl reads no YAML with references.
    settings: Settings = {'joints': [*joints], 'command_interfaces': [mode],
                          'state_interfaces': ['position', 'velocity']}
    if mode in _GAINS:
        settings['gains'] = {joint: _GAINS[mode](inertias[joint]) for joint in joints}
    return settings
