# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What the node publishes, takes and offers, as tables.

A name holds ``<part>`` (a subsystem or an arm) or ``<arm>`` (an arm with a gripper) where a robot
has one topic for each; :func:`topics_of` fills these in. It holds ``<name>`` for each object and
``<camera>`` for each camera that is chosen; :func:`topics_of_world` fills in all of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Protocol

from manip_sim.interface.scope import Scope

PUBLISHED, SUBSCRIBED = 'published', 'subscribed'
PART, ARM, OBJECT, CAMERA = '<part>', '<arm>', '<name>', '<camera>'
_GRIPPER = f'{ARM}/gripper'


class PartLike(Protocol):
    """A subsystem, an arm or a gripper, as the simulation tells them."""

    @property
    def joints(self) -> Collection[str]:
        """The scalar joints."""

    @property
    def actuators(self) -> Collection[str]:
        """All actuators."""

    @property
    def gripper(self) -> Any:
        """The gripper, or None where the part is none."""


@dataclass(frozen=True)
class Topic:
    """
    A topic.

    :ivar name: relative, absolute, or private to the node (``~/``)
    :ivar type: package and name of the message type
    :ivar direction: :data:`PUBLISHED` or :data:`SUBSCRIBED` by the node
    :ivar meaning: what the messages say
    :ivar needs: what a part must have: ``joints``, ``actuators`` or nothing; ``twist`` is a
        mobile base that moves along x and y and turns; ``object``, ``camera`` and ``depth`` are
        no parts, but free bodies, cameras and cameras with depth
    """

    name: str
    type: str
    direction: str
    meaning: str
    needs: str = ''


@dataclass(frozen=True)
class Service:
    """
    A service.

    :ivar name: private to the node (``~/``)
    :ivar type: package and name of the service type
    :ivar meaning: what it does
    """

    name: str
    type: str
    meaning: str


@dataclass(frozen=True)
class Action:
    """
    An action, where the package of its type is installed.

    :ivar name: relative
    :ivar type: package and name of the action type
    :ivar meaning: what its goals are
    """

    name: str
    type: str
    meaning: str


TOPICS = (
    Topic('joint_states', 'sensor_msgs/JointState', PUBLISHED, 'all joints of the robot'),
    Topic('<part>/joint_states', 'sensor_msgs/JointState', PUBLISHED, 'joints of a part',
          'joints'),
    Topic('<arm>/gripper/joint_states', 'sensor_msgs/JointState', PUBLISHED,
          'joints of a gripper', 'joints'),
    Topic('<arm>/wrench', 'geometry_msgs/WrenchStamped', PUBLISHED,
          'force and torque as the sensor gives them, in ft_frame'),
    Topic('<arm>/external_wrench', 'geometry_msgs/WrenchStamped', PUBLISHED,
          'what the world does to the tool, mean over the period, tared, in ft_frame'),
    Topic('<arm>/eef_pose', 'geometry_msgs/PoseStamped', PUBLISHED, 'grip_site in world'),
    Topic('<arm>/eef_twist', 'geometry_msgs/TwistStamped', PUBLISHED,
          'velocity of grip_site in world'),
    Topic('<part>/controller_state', 'trajectory_msgs/JointTrajectory', PUBLISHED,
          'reference, feedback, error, output; control_msgs/JointTrajectoryControllerState where '
          'control_msgs is installed', 'actuators'),
    Topic('objects/<name>/pose', 'geometry_msgs/PoseStamped', PUBLISHED,
          'a free body in world', 'object'),
    Topic('objects/<name>/twist', 'geometry_msgs/TwistStamped', PUBLISHED,
          'velocity of a free body, in the axes of world', 'object'),
    Topic('odom', 'nav_msgs/Odometry', PUBLISHED,
          'pose of a mobile base in the frame odom, and its velocity in its own axes', 'twist'),
    Topic('/tf', 'tf2_msgs/TFMessage', PUBLISHED,
          'frames that move, where tf2_msgs is installed'),
    Topic('/tf_static', 'tf2_msgs/TFMessage', PUBLISHED,
          'frames that do not, latched, where tf2_msgs is installed'),
    Topic('~/markers', 'visualization_msgs/MarkerArray', PUBLISHED,
          'contacts with their forces, and external wrenches, to look at'),
    Topic('robot_description', 'std_msgs/String', PUBLISHED, 'URDF of the robot, latched'),
    Topic('~/dynamics', 'std_msgs/String', PUBLISHED,
          'armature, damping, friction and limits of each joint as JSON, latched'),
    Topic('<camera>/color/image_raw', 'sensor_msgs/Image', PUBLISHED, 'what it sees, rgb8',
          'camera'),
    Topic('<camera>/color/image_raw/compressed', 'sensor_msgs/CompressedImage', PUBLISHED,
          'the same as JPEG', 'camera'),
    Topic('<camera>/color/camera_info', 'sensor_msgs/CameraInfo', PUBLISHED, 'its intrinsics',
          'camera'),
    Topic('<camera>/depth/image_raw', 'sensor_msgs/Image', PUBLISHED,
          'depth along the view, 32FC1, +Inf where there is nothing', 'depth'),
    Topic('<camera>/depth/camera_info', 'sensor_msgs/CameraInfo', PUBLISHED, 'the same intrinsics',
          'depth'),
    Topic('/clock', 'rosgraph_msgs/Clock', PUBLISHED, 'simulation time'),
    Topic('/diagnostics', 'diagnostic_msgs/DiagnosticArray', PUBLISHED,
          'real-time factor, missed deadlines, what became of commands'),
    Topic('~/mjcf', 'std_msgs/String', PUBLISHED, 'the composed model, latched'),
    Topic('~/mjcf_archive', 'std_msgs/UInt8MultiArray', PUBLISHED,
          'zip archive of the composed model and its files, latched'),
    Topic('<part>/command', 'std_msgs/Float64MultiArray', SUBSCRIBED,
          'a number in [-1, 1] for each actuator', 'actuators'),
    Topic('<arm>/gripper/command', 'std_msgs/Float64MultiArray', SUBSCRIBED,
          'numbers in [-1, 1] for format_action; +1 closes', 'actuators'),
    Topic('<part>/joint_command', 'sensor_msgs/JointState', SUBSCRIBED,
          'goals by joint name, in the control mode', 'actuators'),
    Topic('<arm>/gripper/joint_command', 'sensor_msgs/JointState', SUBSCRIBED,
          'positions of driven finger joints', 'actuators'),
    Topic('joint_command', 'sensor_msgs/JointState', SUBSCRIBED, 'goals of joints of any parts'),
    Topic('<part>/joint_trajectory', 'trajectory_msgs/JointTrajectory', SUBSCRIBED,
          'a spline through the points, in position mode', 'actuators'),
    Topic('<arm>/target_pose', 'geometry_msgs/PoseStamped', SUBSCRIBED,
          'a goal of grip_site in world or a link of the robot', 'actuators'),
    Topic('<arm>/target_twist', 'geometry_msgs/TwistStamped', SUBSCRIBED,
          'velocity of grip_site in the axes of world or a link', 'actuators'),
    Topic('<arm>/pose_command', 'std_msgs/Float64MultiArray', SUBSCRIBED,
          "robosuite's action OSC_POSE: six numbers in [-1, 1]", 'actuators'),
    Topic('base/cmd_vel', 'geometry_msgs/Twist', SUBSCRIBED,
          "velocity in the base's own frame, in velocity mode", 'twist'),
    Topic('base/cmd_vel_stamped', 'geometry_msgs/TwistStamped', SUBSCRIBED,
          'the same with a stamp, which counts in lockstep', 'twist'),
)

SERVICES = (
    Service('~/pause', 'std_srvs/SetBool', 'pause or go on'),
    Service('~/step', 'std_srvs/Trigger', 'when paused: one control period'),
    Service('~/reset', 'std_srvs/Trigger', 'back to the start; simulation time goes on'),
    Service('~/reset_reflex', 'std_srvs/Trigger',
            'let parts that a reflex has stopped take commands again'),
    Service('~/tare_wrench', 'std_srvs/Trigger', 'let the external wrenches read zero now'),
    Service('~/save_state', 'std_srvs/Trigger', 'save the state; the message is its digest'),
    Service('~/restore_state', 'std_srvs/Trigger',
            'continue from the saved state; simulation time goes on'),
)

ACTIONS = (
    Action('<part>/follow_joint_trajectory', 'control_msgs/FollowJointTrajectory',
           'a trajectory, with tolerances on the way and at the end'),
    Action('<arm>/gripper/gripper_cmd', 'control_msgs/GripperCommand',
           'a position of the first driven joint, with a largest effort'),
    Action('<arm>/gripper/parallel_gripper_cmd', 'control_msgs/ParallelGripperCommand',
           'the same as a joint state of one joint, with a largest velocity too'),
)


def actions_of(parts: Mapping[str, PartLike]) -> list[Action]:
    """
    Return the actions that the node has for a robot where control_msgs is installed.

    :param parts: by name: ``arm``, ``base``, ``right``, ``right/gripper`` ...
    """
    return [replace(pattern, name=pattern.name.replace(_GRIPPER, name).replace(PART, name))
            for pattern in ACTIONS for name, part in parts.items()
            if part.actuators and (part.gripper is not None) == (_GRIPPER in pattern.name)]


def topics_of(parts: Mapping[str, PartLike], twist: bool) -> list[Topic]:
    """
    Return the topics that the node has for a robot, but for those of objects and cameras.

    :param parts: by name: ``arm``, ``base``, ``right``, ``right/gripper`` ...
    :param twist: whether the base takes a twist
    """
    return [topic for pattern in TOPICS if pattern.needs not in ('object', 'camera', 'depth')
            for topic in _filled_in(pattern, parts, twist)]


def topics_of_world(robots: Iterable[tuple[Scope, Mapping[str, PartLike], bool]],
                    objects: Iterable[str] = (),
                    cameras: Mapping[str, bool] = MappingProxyType({})) -> list[Topic]:
    """
    Return the topics that the node has for a world.

    :param robots: where the topics of each are, its parts, and whether its base takes a twist
    :param objects: names of free bodies
    :param cameras: that are chosen, by name: whether with depth
    """
    found: dict[Topic, None] = {}
    for scope, parts, twist in robots:
        # A name that is absolute or private is the world's.
        found.update(dict.fromkeys(
            topic if topic.name[0] in '/~' else replace(topic, name=scope.topic(topic.name))
            for topic in topics_of(parts, twist)))
    others = {'object': (OBJECT, list(objects)), 'camera': (CAMERA, list(cameras)),
              'depth': (CAMERA, [name for name, depth in cameras.items() if depth])}
    for pattern in TOPICS:
        placeholder, names = others.get(pattern.needs, ('', []))
        found.update(dict.fromkeys(
            replace(pattern, name=pattern.name.replace(placeholder, name)) for name in names))
    return list(found)


def _filled_in(pattern: Topic, parts: Mapping[str, PartLike], twist: bool) -> Iterator[Topic]:
    grippers = [name for name, part in parts.items() if part.gripper is not None]
    if _GRIPPER in pattern.name:
        placeholder, names = _GRIPPER, grippers
    elif ARM in pattern.name:
        placeholder, names = ARM, [name.split('/')[0] for name in grippers]
    elif PART in pattern.name:
        placeholder, names = PART, [name for name in parts if name not in grippers]
    else:
        if twist or pattern.needs != 'twist':
            yield pattern
        return
    for name in names:
        if not pattern.needs or (name in parts and getattr(parts[name], pattern.needs)):
            yield replace(pattern, name=pattern.name.replace(placeholder, name))
