# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The files of the package that hold no numbers of the robot: build, launch, RViz."""

from __future__ import annotations

from typing import Any

from manip_sim.moveit.ros_package import build_files

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
