# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What MoveIt's nodes take as parameters, as plain data for YAML.

Names and meanings are those of MoveIt 2, branch jazzy: ``moveit_configs_utils`` (which files there
are), ``moveit_simple_controller_manager``, ``robot_model_loader``, ``kdl_kinematics_plugin``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from manip_sim.moveit.groups import Group
from manip_sim.simulation.robot import SimulatedRobot

Settings = dict[str, Any]
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


def kinematics(groups: Iterable[Group]) -> Settings:
    """Return ``kinematics.yaml``: a solver for each chain."""
    found: Settings = {}
    for group in groups:
        if not group.tip:
            continue
        found[group.name] = {
            'kinematics_solver': 'kdl_kinematics_plugin/KDLKinematicsPlugin',
            'kinematics_solver_search_resolution': 0.005,
            'kinematics_solver_timeout': 0.05}
        if len(group.joints) < _FULL_POSE:
            found[group.name]['position_only_ik'] = True
    return found


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


def controllers(groups: Iterable[Group], effort: Mapping[str, float]) -> Settings:
    """
    Return ``moveit_controllers.yaml``: which actions move which joints.

    They are ``<part>/follow_joint_trajectory`` and ``<arm>/gripper/gripper_cmd``.

    :param effort: limits by joint, for grippers [N m or N]
    """
    manager: Settings = {'controller_names': []}
    for group in groups:
        joints = list(group.active if group.is_gripper else group.driven)
        if group.subgroups or not joints:
            continue
        settings: Settings = {'type': 'FollowJointTrajectory',
                              'action_ns': 'follow_joint_trajectory'}
        if group.is_gripper:
            settings = {'type': 'GripperCommand', 'action_ns': 'gripper_cmd',
                        'command_joint': joints[0], 'max_effort': effort[joints[0]],
                        # A grasped object keeps the fingers from their goal.
                        'allow_failure': True}
        manager['controller_names'].append(group.part)
        manager[group.part] = {**settings, 'default': True, 'joints': joints}
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
