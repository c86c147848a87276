# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A ROS package with every file that MoveIt 2 needs for a robot, made for each composition."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
import re
import shutil
import tempfile
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import yaml

from manip_sim.errors import ModelError
from manip_sim.models import World
from manip_sim.models.robots import RobotModel
from manip_sim.models.urdf_writer import choose_robot, Hardware, Urdf, write_urdf
from manip_sim.models.urdf_writer.links import binary_stl, ELLIPSOID, MeshFile, stl_of, unit_sphere
from manip_sim.moveit.srdf import disabled_pairs, find_groups, find_postures, Group, write_srdf
from manip_sim.quoting import quoted
from manip_sim.simulation import Simulation
from manip_sim.simulation.robot import SimulatedRobot

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
    :param folders: that are installed
    :param more: further lines of ``CMakeLists.txt``
    """
    needed = '\n'.join(f'  <exec_depend>{name}</exec_depend>' for name in dependencies)
    return {
        'package.xml': _PACKAGE.format(package=package, what=summary, dependencies=needed),
        'CMakeLists.txt': _CMAKE.format(package=package, folders=' '.join(folders), more=more)}


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """
    Write all files of a package, or none.

    :param folder: new or empty
    """
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


_DEPENDENCIES = (
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

_README = """# MoveIt configuration of {robot}

Written by `manip_sim export --moveit`; build it with colcon, next to manip_sim, and start it
beside the node:

```sh
ros2 launch {package} moveit.launch.py
```
"""


def text_files(package: str, robot: str) -> dict[str, str]:
    """Return the contents of the files by path."""
    return {
        **build_files(package, f'MoveIt configuration of {robot}', _DEPENDENCIES, FOLDERS,
                      'install(FILES .setup_assistant DESTINATION share/${PROJECT_NAME})\n'),
        **{name: template.format(package=package, robot=robot) for name, template in (
            ('README.md', _README), ('launch/moveit.launch.py', _LAUNCH))}}


def setup_assistant(package: str, robot: str) -> dict[str, Any]:
    """Return ``.setup_assistant``: where URDF and SRDF are, also for MoveItConfigsBuilder."""
    return {'moveit_setup_assistant_config': {
        'urdf': {'package': package, 'relative_path': f'config/{robot}.urdf'},
        'srdf': {'relative_path': f'config/{robot}.srdf'}}}


def rviz(group: str) -> dict[str, Any]:
    """
    Return a view for RViz.

    :param group: that is planned for at first
    """
    return {
        'Panels': [{'Class': 'rviz_common/Displays', 'Name': 'Displays'},
                   {'Class': 'rviz_common/Views', 'Name': 'Views'}],
        'Visualization Manager': {
            'Displays': [
                {'Class': 'rviz_default_plugins/Grid', 'Name': 'Grid', 'Enabled': True},
                {'Class': 'moveit_rviz_plugin/MotionPlanning', 'Name': 'MotionPlanning',
                 'Enabled': True, 'Robot Description': 'robot_description',
                 'Planning Scene Topic': 'monitored_planning_scene',
                 'Planning Request': {'Planning Group': group, 'Query Goal State': True}}],
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


def joint_limits(groups: Iterable[Group], robot: SimulatedRobot, velocity: Mapping[str, float]
                 ) -> Settings:
    """
    Return ``joint_limits.yaml``: velocities as in the URDF, and accelerations.

    :param velocity: limits by joint [rad/s or m/s]
    """
    names = robot.joints.names
    accelerations = dict(zip(names, robot.joints.acceleration_limits(
        robot.joints.find(names)).tolist()))
    limits = {}
    for joint in dict.fromkeys(joint for group in groups for joint in group.active):
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


def pilz() -> Settings:
    """Return ``pilz_industrial_motion_planner_planning.yaml``."""
    return {'planning_plugins': ['pilz_industrial_motion_planner/CommandPlanner'],
            'default_planner_config': 'PTP', 'request_adapters': _REQUESTS,
            # Its trajectories have times already.
            'response_adapters': _RESPONSES[1:],
            'capabilities': ' '.join(f'pilz_industrial_motion_planner/MoveGroupSequence{kind}'
                                     for kind in ('Action', 'Service'))}


def pilz_cartesian_limits() -> Settings:
    """Return ``pilz_cartesian_limits.yaml``, moderate for any of the arms [m, rad, s]."""
    return {'cartesian_limits': {'max_trans_vel': 0.5, 'max_trans_acc': 1.0,
                                 'max_trans_dec': -1.0, 'max_rot_vel': 1.57}}


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
    files, notes = _contents(world, folder.name, controlling)
    write_files(folder, files)
    return notes


def _contents(world: World, package: str, controlling: Controlling | None
              ) -> tuple[dict[str, bytes], list[str]]:
    """Return the contents of all files by path, and the omissions."""
    model, robot = world.compile(), choose_robot(world)
    urdf, meshes = describe(model, robot, package)
    simulation = Simulation(world)
    simulated = simulation.robot
    groups, passive = find_groups(model, simulated, urdf)
    if not groups:
        raise ModelError(f'{robot.name} has no joints that MoveIt could plan for')
    postures = find_postures(simulation, simulated)
    name, velocity, effort = _read(urdf)
    disabled = disabled_pairs(world, robot, urdf.tree.link_of_body, postures)
    srdf = write_srdf(name, groups, postures, passive, disabled)
    texts = {f'config/{name}.urdf': urdf.xml, f'config/{name}.srdf': srdf,
             **text_files(package, name),
             **as_yaml({
                 'config/kinematics.yaml': kinematics(groups),
                 'config/joint_limits.yaml': joint_limits(groups, simulated, velocity),
                 'config/moveit_controllers.yaml': controllers(groups, effort, controlling),
                 'config/ompl_planning.yaml': ompl(groups),
                 'config/pilz_industrial_motion_planner_planning.yaml': pilz(),
                 'config/pilz_cartesian_limits.yaml': pilz_cartesian_limits(),
                 '.setup_assistant': setup_assistant(package, name),
                 'rviz/moveit.rviz': rviz(groups[0].name)})}
    return {**{path: text.encode() for path, text in texts.items()}, **meshes}, list(urdf.notes)


def describe(model: mujoco.MjModel, robot: RobotModel, package: str,
             hardware: Hardware | None = None) -> tuple[Urdf, dict[str, bytes]]:
    """Return the URDF of a robot, and the meshes that it names in its package, by path."""
    meshes = _meshes(model)
    uris = {key: MeshFile(f'package://{package}/meshes/{name}', np.ones(3), np.zeros(3), np.eye(3))
            for key, (name, _) in meshes.items()}
    urdf = write_urdf(model, robot, uris, hardware)
    used = [mesh for mesh in meshes.values() if f'/meshes/{mesh[0]}"' in urdf.xml]
    return urdf, {'meshes/README.md': b'Meshes of the robot as MuJoCo has compiled them.\n',
                  **{f'meshes/{file}': content for file, content in used}}


def _read(urdf: Urdf) -> tuple[str, dict[str, float], dict[str, float]]:
    """Return the name in a URDF, and its velocity and effort limits by joint."""
    root = ElementTree.fromstring(urdf.xml)
    limits = {str(joint.get('name')): limit for joint in root.iter('joint')
              if (limit := joint.find('limit')) is not None}
    velocity, effort = ({name: float(limit.get(key, 0.0)) for name, limit in limits.items()}
                        for key in ('velocity', 'effort'))
    return robot_in(urdf.xml), velocity, effort


def _meshes(model: mujoco.MjModel) -> dict[str, tuple[str, bytes]]:
    """Return the name and content of an STL file for each mesh, whatever it was read from."""
    files = {ELLIPSOID: ('unit_sphere.stl', binary_stl(unit_sphere()))}
    for mesh in np.unique(model.geom_dataid[model.geom_type == _MESH]).tolist():
        files[model.mesh(mesh).name] = (f'mesh_{mesh}.stl', stl_of(model, mesh))
    return files
