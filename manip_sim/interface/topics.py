# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Tables of everything that the node publishes, takes and offers.

The node makes its publishers and subscriptions from the rows of :data:`TOPICS`, in their order; a
further topic is a row and the function of ``manip_sim.ros`` that the row names. It makes its
services from the rows of :data:`SERVICES`.

A name holds ``<part>`` (a subsystem or an arm) or ``<arm>`` (an arm with a gripper) where a robot
has one topic for each, ``<name>`` for each object, ``<camera>`` for each camera that is chosen,
``<lidar>`` for each lidar, and ``<sensor>`` for each instrument of the model;
the functions below the tables fill them in for a world.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
import re
from types import MappingProxyType

from manip_sim.control.surroundings import Surroundings
from manip_sim.models.urdf_writer import Hardware, OWN_PLUGIN, TOPIC_PLUGIN
from manip_sim.physics.parts import Part
from manip_sim.sensing.instruments import Instrument, WRENCH
from manip_sim.simulation import SimulatedRobot, Simulation


@dataclass(frozen=True)
class Scope:
    """
    The namespace of a robot within the node.

    :ivar name: of the robot; empty for the only robot of a node, whose names have no namespace
    """

    name: str = ''

    def topic(self, name: str) -> str:
        """Return the name of a topic; one that is absolute or private is not the robot's."""
        return f'{self.name}/{name}' if self.name and not name.startswith(('/', '~')) else name

    def parameter(self, name: str) -> str:
        """Return the name of a parameter of the robot."""
        return f'{self.name}.{name}' if self.name else name


PUBLISHED, SUBSCRIBED = 'published', 'subscribed'
PART, ARM, OBJECT, CAMERA, SENSOR, LIDAR = (
    '<part>', '<arm>', '<name>', '<camera>', '<sensor>', '<lidar>')
GRIPPER = f'{ARM}/gripper'
#: A valid part of a topic's name; bodies with other names have no topics.
TOKEN = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
#: When topics are published.
_PERIOD, _TF_RATE, _IMAGES, _SCANS = (
    'publish_rate', 'tf_rate', 'camera.<camera>.rate', 'rate of the lidar')
#: Readers of measured quantities, with noise and latency where these are set.
MEASURED = ('joints', 'wrench', 'external_wrench', 'pose', 'twist', 'odometry', 'imu', 'range',
            'magnetic_field', 'values', 'scan', 'points', 'image')
_SCENE = 'at changes, up to 10 Hz'
_ONCE, _CHANGES = 'once', 'at the start and when objects come or go'


@dataclass(frozen=True)
class Topic:
    """
    A topic.

    :ivar name: relative, absolute, or private to the node (``~/``)
    :ivar type: package and name of the message type
    :ivar direction: :data:`PUBLISHED` or :data:`SUBSCRIBED` by the node
    :ivar meaning: what the messages say, with units and frame
    :ivar needs: what a part must have: ``joints``, ``actuators`` or nothing; ``twist`` is a
        mobile base that moves along x and y and turns; ``object``, ``camera``, ``depth`` and
        ``sensor`` are not parts, but free bodies, cameras, cameras with depth, and instruments
    :ivar by: name of the function that reads or takes the messages; empty if a publisher of its
        own makes them
    :ivar rate: when they are published; empty if the node subscribes
    :ivar depth: of the queue, keep last
    :ivar latched: whether the last message is kept for subscribers that come later
    :ivar of: the part, object or camera that it is of; empty where it is of all
    """

    name: str
    type: str
    direction: str
    meaning: str
    needs: str = ''
    by: str = ''
    rate: str = ''
    depth: int = 10
    latched: bool = False
    of: str = ''

    @property
    def per(self) -> str:
        """Return the placeholder that the name holds; that of a gripper counts as a part."""
        return PART if GRIPPER in self.name else next(
            (per for per in (PART, ARM, OBJECT, CAMERA, SENSOR, LIDAR) if per in self.name), '')

    def filled_in(self, of: str) -> Topic:
        """Return the topic of a part, an arm, an object or a camera."""
        return replace(self, name=self.name.replace(self._placeholder, of), of=of)

    @property
    def _placeholder(self) -> str:
        return GRIPPER if GRIPPER in self.name else self.per

    def of_name(self, name: str) -> str:
        """
        Return the part, arm, object or camera whose topic has a name; empty if there is none.

        :raises ValueError: if the topic has no placeholder
        """
        begin, _, end = self.name.partition(self._placeholder)
        owner = name.removeprefix(begin).removesuffix(end)
        return owner if name == f'{begin}{owner}{end}' else ''


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


def _published(name: str, message_type: str, meaning: str, needs: str = '', by: str = '',
               rate: str = _PERIOD, depth: int = 10, latched: bool = False) -> Topic:
    return Topic(name, message_type, PUBLISHED, meaning, needs, by, rate, depth, latched)


def _subscribed(name: str, message_type: str, meaning: str, needs: str = '', by: str = '',
                of: str = '') -> Topic:
    return Topic(name, message_type, SUBSCRIBED, meaning, needs, by, of=of)


TOPICS = (
    _published('joint_states', 'sensor_msgs/JointState',
               'all joints of the robot [rad or m, rad/s or m/s, N m or N]', by='joints'),
    _published('<part>/joint_states', 'sensor_msgs/JointState', 'joints of a part', 'joints',
               'joints'),
    _published('<arm>/gripper/joint_states', 'sensor_msgs/JointState', 'joints of a gripper',
               'joints', 'joints'),
    _published('<part>/controller_state', 'trajectory_msgs/JointTrajectory',
               'reference, feedback, error, output; control_msgs/JointTrajectoryControllerState '
               'where control_msgs is installed', 'actuators', 'controllers'),
    _published('<arm>/wrench', 'geometry_msgs/WrenchStamped',
               'force and torque as the sensor gives them, in ft_frame [N, N m]', by='wrench'),
    _published('<arm>/external_wrench', 'geometry_msgs/WrenchStamped',
               'external force and torque on the tool, period mean, tared, in ft_frame '
               '[N, N m]', by='external_wrench'),
    _published('<arm>/eef_pose', 'geometry_msgs/PoseStamped', 'grip_site in world [m]',
               by='pose'),
    _published('<arm>/eef_twist', 'geometry_msgs/TwistStamped',
               'velocity of grip_site in world [m/s, rad/s]', by='twist'),
    _published('objects/<name>/pose', 'geometry_msgs/PoseStamped', 'a free body in world [m]',
               'object', 'object_pose'),
    _published('objects/<name>/twist', 'geometry_msgs/TwistStamped',
               'velocity of a free body, in the axes of world [m/s, rad/s]', 'object',
               'object_twist'),
    _published('arena/joint_states', 'sensor_msgs/JointState',
               'joints of the arena, such as doors and drawers, with the efforts of its actuators '
               '[rad or m, rad/s or m/s, N m or N]', 'arena', 'arena_joints'),
    _published('actuators/states', 'sensor_msgs/JointState',
               'actuators of no part, such as those of tendons, by name: length, its rate and '
               'force [rad or m, rad/s or m/s, N m or N]', 'loose', 'loose_actuators'),
    _published('odom', 'nav_msgs/Odometry',
               'pose of a mobile base in the frame odom, and its velocity in its own axes',
               'twist', 'odometry'),
    _published('/tf', 'tf2_msgs/TFMessage', 'frames that move, where tf2_msgs is installed',
               rate=_TF_RATE, depth=100),
    _published('/tf_static', 'tf2_msgs/TFMessage',
               'frames that do not, latched, where tf2_msgs is installed', rate=_CHANGES, depth=1,
               latched=True),
    _published('~/markers', 'visualization_msgs/MarkerArray',
               'contacts with their forces, and external wrenches, to display', rate=_TF_RATE),
    _published('planning_scene_world', 'moveit_msgs/PlanningSceneWorld',
               'the world around the robot, for MoveIt, where moveit_msgs is installed',
               rate='with a new subscriber, and when objects come or go'),
    _published('collision_object', 'moveit_msgs/CollisionObject',
               'objects that have moved, in world [m], where moveit_msgs is installed',
               rate=_SCENE),
    _published('attached_collision_object', 'moveit_msgs/AttachedCollisionObject',
               'what a gripper grasps since now, in its link [m], or does not any more, where '
               'moveit_msgs is installed', rate=_SCENE),
    _published('robot_description', 'std_msgs/String', 'URDF of the robot, latched',
               rate=_ONCE, depth=1, latched=True),
    _published('~/dynamics', 'std_msgs/String',
               'armature, damping, friction and limits of each joint as JSON, latched',
               rate=_ONCE, depth=1, latched=True),
    _published('sensors/<sensor>/imu', 'sensor_msgs/Imu',
               'accelerometer, gyro and framequat of a site, in its frame [m/s^2, rad/s]',
               'sensor', 'imu'),
    _published('sensors/<sensor>/wrench', 'geometry_msgs/WrenchStamped',
               'force and torque sensor of a site, in its frame [N, N m]', 'sensor', 'wrench'),
    _published('sensors/<sensor>/range', 'sensor_msgs/Range',
               'rangefinder, along z of its site [m], +Inf where there is nothing', 'sensor',
               'range'),
    _published('sensors/<sensor>/magnetic_field', 'sensor_msgs/MagneticField',
               'magnetometer, in the frame of its site, in the unit of the file', 'sensor',
               'magnetic_field'),
    _published('sensors/<sensor>/values', 'std_msgs/Float64MultiArray',
               'any other sensor; the label says of what, in SI units', 'sensor', 'values'),
    _published('<camera>/color/image_raw', 'sensor_msgs/Image', 'what it sees, rgb8',
               'camera', 'image', _IMAGES, 2),
    _published('<camera>/color/image_raw/compressed', 'sensor_msgs/CompressedImage',
               'the same as JPEG', 'camera', 'image', _IMAGES, 2),
    _published('<camera>/color/camera_info', 'sensor_msgs/CameraInfo', 'its intrinsics',
               'camera', rate=_IMAGES, depth=2),
    _published('<camera>/depth/image_raw', 'sensor_msgs/Image',
               'depth along the view, 32FC1 [m], +Inf where there is nothing', 'depth',
               'image', _IMAGES, 2),
    _published('<camera>/depth/camera_info', 'sensor_msgs/CameraInfo', 'the same intrinsics',
               'depth', rate=_IMAGES, depth=2),
    _published('<camera>/depth/points', 'sensor_msgs/PointCloud2',
               'a point for each pixel in the optical frame [m], with its colour', 'depth',
               'image', _IMAGES, 2),
    _published('<camera>/labels/image_raw', 'sensor_msgs/Image',
               'ids of the bodies that it sees, 32SC1, -1 for the background', 'camera',
               'image', _IMAGES, 2),
    _published('<camera>/labels/names', 'std_msgs/String',
               'names of the bodies by their ids as JSON, latched', 'camera', rate=_CHANGES,
               depth=1, latched=True),
    _published('<lidar>/scan', 'sensor_msgs/LaserScan',
               'distances that a planar lidar measures in its frame [m], +Inf beyond its range',
               'lidar', 'scan', _SCANS),
    _published('<lidar>/points', 'sensor_msgs/PointCloud2',
               'points that a lidar with several rings measures in its frame [m]', 'lidar',
               'points', _SCANS),
    _published('/clock', 'rosgraph_msgs/Clock', 'simulation time', depth=1),
    _published('/diagnostics', 'diagnostic_msgs/DiagnosticArray',
               'real-time factor, missed deadlines, what became of commands',
               rate='1 Hz of wall time'),
    _published('~/task', 'std_msgs/String',
               'with a task: its success, reward and goal as JSON, latched', 'task', depth=1,
               latched=True),
    _published('~/episode', 'std_msgs/String',
               'seed, what was drawn, versions and digest of the start of the episode as JSON, '
               'latched', rate='at the start and at each reset', depth=1, latched=True),
    _published('~/contact', 'std_msgs/String',
               'the end of the last motion until contact: robot, arm, cause, position in world, '
               'wrench in ft_frame, distance and duration as JSON, latched', rate='at each end',
               depth=1, latched=True),
    _published('~/safety_state', 'std_msgs/String',
               'running, protective_stop, emergency_stop or recovering, latched',
               rate='at each change', depth=1, latched=True),
    _published('~/journal', 'std_msgs/String',
               'what changed the simulation, in order, as JSON: what records repeat',
               rate='20 Hz of wall time', depth=1000),
    _published('~/mjcf', 'std_msgs/String', 'the composed model, latched', rate=_CHANGES,
               depth=1, latched=True),
    _published('~/mjcf_archive', 'std_msgs/UInt8MultiArray',
               'zip archive of the composed model and its files, latched', rate=_CHANGES,
               depth=1, latched=True),
    _subscribed('<part>/command', 'std_msgs/Float64MultiArray',
                'a number in [-1, 1] for each actuator', 'actuators', 'action'),
    _subscribed('<arm>/gripper/command', 'std_msgs/Float64MultiArray',
                'numbers in [-1, 1] for format_action; +1 closes', 'actuators', 'action'),
    _subscribed('<part>/joint_command', 'sensor_msgs/JointState',
                'goals by joint name, in the control mode', 'actuators', 'joint_command'),
    _subscribed('<part>/impedance_command', 'std_msgs/Float64MultiArray',
                'position, velocity, effort, stiffness and damping of all joints', 'actuators',
                'impedance'),
    _subscribed('<arm>/gripper/joint_command', 'sensor_msgs/JointState',
                'positions of driven finger joints [rad or m]', 'actuators', 'joint_command'),
    _subscribed('<part>/joint_trajectory', 'trajectory_msgs/JointTrajectory',
                'a spline through the points, in position mode', 'actuators', 'trajectory'),
    _subscribed('base/cmd_vel', 'geometry_msgs/Twist',
                "velocity in the base's own frame, in velocity mode [m/s, rad/s]", 'twist',
                'base_twist', 'base'),
    _subscribed('base/cmd_vel_stamped', 'geometry_msgs/TwistStamped',
                'the same with a stamp, which counts in lockstep', 'twist',
                'stamped_base_twist', 'base'),
    _subscribed('joint_command', 'sensor_msgs/JointState', 'goals of joints of any parts',
                by='joint_command'),
    _subscribed('arena/joint_command', 'sensor_msgs/JointState',
                'what actuators of the arena shall do, by joint name', 'arena',
                'direct_command', 'arena'),
    _subscribed('actuators/command', 'sensor_msgs/JointState',
                'what actuators of no part shall do, by their names', 'loose',
                'direct_command', 'actuators'),
    _subscribed('objects/<name>/target_pose', 'geometry_msgs/PoseStamped',
                'where a mocap body goes in world [m]', 'mocap', 'mocap_pose'),
    _subscribed('~/pull', 'visualization_msgs/Marker',
                'a spring from a point of a body to a target: an arrow in world [m], ns the body',
                'bodies', 'pull'),
    _subscribed('<arm>/target_pose', 'geometry_msgs/PoseStamped',
                'a goal of grip_site in world or a link of the robot [m]', 'actuators',
                'target_pose'),
    _subscribed('<arm>/target_twist', 'geometry_msgs/TwistStamped',
                'velocity of grip_site in the axes of world or a link [m/s, rad/s]', 'actuators',
                'target_twist'),
    _subscribed('<arm>/target_wrench', 'geometry_msgs/WrenchStamped',
                'force and torque of grip_site on its surroundings beside the springs of an '
                'impedance, in the axes of world or a link [N, N m]', 'actuators',
                'target_wrench'),
    _subscribed('<arm>/force_mode', 'std_msgs/Float64MultiArray',
                'selection, wrench and limits of the axes of an impedance [N, N m, m/s, rad/s]',
                'actuators', 'force_mode'),
    _subscribed('<arm>/move_until_contact', 'std_msgs/Float64MultiArray',
                'velocity of grip_site in world [m/s, rad/s], then force [N], distance [m] and '
                'duration [s] that end the motion', 'actuators', 'until_contact'),
    _subscribed('<arm>/pose_command', 'std_msgs/Float64MultiArray',
                "robosuite's action OSC_POSE: six numbers in [-1, 1]", 'actuators',
                'pose_command'),
)
#: The rows of the table by name.
BY_NAME = {topic.name: topic for topic in TOPICS}

SERVICES = (
    Service('~/pause', 'std_srvs/SetBool', 'pause or go on'),
    Service('~/step', 'std_srvs/Trigger', 'when paused: one control period'),
    Service('~/reset', 'std_srvs/Trigger', 'back to the start; simulation time goes on'),
    Service('~/reset_reflex', 'std_srvs/Trigger',
            'let parts that a reflex has stopped take commands again'),
    Service('~/emergency_stop', 'std_srvs/Trigger',
            'stop all parts of all robots, which reject commands until ~/recover'),
    Service('~/recover', 'std_srvs/Trigger',
            'let all parts take commands again as soon as they rest'),
    Service('~/move_until_contact', 'diagnostic_msgs/AddDiagnostics',
            'move an arm until contact, as YAML in load_namespace, and answer at the end'),
    Service('~/inject_fault', 'diagnostic_msgs/AddDiagnostics',
            'let something of a part fail, as YAML in load_namespace, and tell all faults of the '
            'episode; an empty text only tells them'),
    Service('~/set_payload', 'diagnostic_msgs/AddDiagnostics',
            'declare what an arm holds, as YAML in load_namespace, and tell all payloads; an '
            'empty text only tells them'),
    Service('~/estimate_payload', 'diagnostic_msgs/AddDiagnostics',
            'let an arm turn its wrist, and tell what it holds; YAML in load_namespace names it'),
    Service('~/tare_wrench', 'std_srvs/Trigger', 'let the external wrenches read zero now'),
    Service('~/save_state', 'std_srvs/Trigger', 'save the state; the message is its digest'),
    Service('~/restore_state', 'std_srvs/Trigger',
            'continue from the saved state; simulation time goes on'),
)

ACTIONS = (
    Action('<part>/follow_joint_trajectory', 'control_msgs/FollowJointTrajectory',
           'a trajectory, with tolerances on the way and at the end'),
    Action('<arm>/gripper/gripper_cmd', 'control_msgs/GripperCommand',
           'a position of the first driven joint, or the vacuum of suction cups, with a largest '
           'effort'),
    Action('<arm>/gripper/parallel_gripper_cmd', 'control_msgs/ParallelGripperCommand',
           'the same as a joint state of one joint, with a largest velocity too'),
)


#: Fields of rows that are of the world, not of a robot.
_OF_WORLD = ('task', 'arena', 'loose', 'bodies')


def actions_of(parts: Mapping[str, Part]) -> list[Action]:
    """
    Return the actions that the node has for a robot where control_msgs is installed.

    :param parts: by name: ``arm``, ``base``, ``right``, ``right/gripper`` ...
    """
    return [replace(pattern, name=pattern.name.replace(GRIPPER, name).replace(PART, name))
            for pattern in ACTIONS for name, part in parts.items()
            if part.actuators and (part.gripper is not None) == (GRIPPER in pattern.name)]


def topics_of(parts: Mapping[str, Part], twist: bool, rows: Iterable[Topic] = TOPICS
              ) -> list[Topic]:
    """
    Return the topics that the node has for a robot, but for topics of objects and cameras.

    Rows of the table that follow each other are filled in together, part by part, arm by arm.

    :param parts: by name: ``arm``, ``base``, ``right``, ``right/gripper`` ...
    :param twist: whether the base takes a twist
    :param rows: of the table
    """
    arms = [name.split('/')[0] for name, part in parts.items() if part.gripper is not None]
    topics: list[Topic] = []
    for per, group in groupby(rows, lambda row: row.per):
        patterns = list(group)
        if not per:
            topics += (row for row in patterns if row.needs not in _OF_WORLD
                       and (twist or row.needs != 'twist'))
        elif per in (PART, ARM):
            topics += (row.filled_in(name) for name in (parts if per == PART else arms)
                       for row in patterns if _has(row, name, parts))
    return topics


def topics_of_objects(names: Iterable[str]) -> list[Topic]:
    """Return the topics that the node has for free bodies."""
    return [row.filled_in(name) for name in names for row in TOPICS
            if row.per == OBJECT and row.needs == 'object']


def topics_of_surroundings(surroundings: Surroundings) -> list[Topic]:
    """Return the topics that the node has for bodies, mocap bodies and joints of the arena."""
    there = {'arena/joint_states': surroundings.joints,
             'arena/joint_command': surroundings.actuators,
             'actuators/states': surroundings.other_actuators,
             'actuators/command': surroundings.other_actuators}
    return [*(BY_NAME[name] for name, has in there.items() if has),
            *(row.filled_in(name) for name in surroundings.mocap_names if TOKEN.fullmatch(name)
              for row in TOPICS if row.by in ('object_pose', 'mocap_pose')), BY_NAME['~/pull']]


def topics_of_cameras(cameras: Mapping[str, bool]) -> list[Topic]:
    """
    Return the topics that the node has for cameras.

    :param cameras: that are chosen, by name: whether with depth
    """
    return [row.filled_in(name) for name, depth in cameras.items() for row in TOPICS
            if row.per == CAMERA and (depth or row.needs != 'depth')]


def topics_of_lidars(lidars: Mapping[str, bool]) -> list[Topic]:
    """
    Return the topics that the node has for lidars.

    :param lidars: by name: whether with several rings
    """
    return [BY_NAME[f'{LIDAR}/points' if rings else f'{LIDAR}/scan'].filled_in(name)
            for name, rings in lidars.items()]


def truths(rows: Iterable[Topic]) -> list[Topic]:
    """
    Return the topics with exact values beside those that noise or latency may change.

    :param rows: of one robot, without its namespace
    """
    return [replace(row, name=f'truth/{row.name}', meaning=f'exactly: {row.meaning}')
            for row in rows if row.by in MEASURED]


def topics_of_instruments(simulation: Simulation, robots: Mapping[Scope, SimulatedRobot]
                          ) -> list[tuple[Instrument, Scope, Topic]]:
    """
    Return the instruments with topics of their own, their namespace, and their topic without it.

    The force/torque sensor of a gripper is published as the wrench of its arm.

    :param robots: by the scope of their topics; instruments of other robots are left out
    """
    scopes = {sensor: scope for scope, robot in robots.items() for sensor in robot.sensor_names}
    elsewhere = {sensor for robot in simulation.robots.values() if robot not in robots.values()
                 for sensor in robot.sensor_names}
    of_arms = {reader.ft_frame for robot in robots.values()
               for reader in robot.end_effectors.values()}
    return [(instrument, scopes.get(instrument.sensors[0], Scope()),
             row.filled_in(instrument.topic))
            for instrument in simulation.sensors.instruments for row in TOPICS
            if row.per == SENSOR and row.by == instrument.kind
            and instrument.sensors[0] not in elsewhere
            and not (instrument.kind == WRENCH and instrument.elements[0] in of_arms)]


def topics_of_robot(scope: Scope, robot: SimulatedRobot) -> list[Topic]:
    """Return the topics of a robot in its namespace, and the topics of the world beside them."""
    return [replace(topic, name=scope.topic(topic.name))
            for topic in topics_of(robot.parts, bool(robot.twist_joints))]


def topics_of_world(simulation: Simulation, robots: Mapping[Scope, SimulatedRobot],
                    cameras: Mapping[str, bool] = MappingProxyType({}), task: bool = False
                    ) -> list[Topic]:
    """
    Return the topics that the node has for a world.

    :param robots: by the scope of their topics
    :param cameras: that are chosen, by name: whether with depth
    :param task: whether there is one
    """
    # A name that is absolute or private is the world's, and found with each robot.
    return list(dict.fromkeys([
        *(topic for scope, robot in robots.items() for topic in topics_of_robot(scope, robot)),
        *topics_of_objects(simulation.entities.free_names), *topics_of_cameras(cameras),
        *(replace(row, name=scope.topic(row.name))
          for _, scope, row in topics_of_instruments(simulation, robots)),
        *topics_of_lidars({name: lidar.rays.rings > 1
                           for name, lidar in simulation.lidars.items()}),
        *topics_of_surroundings(simulation.surroundings), *[BY_NAME['~/task']] * task]))


def _has(row: Topic, name: str, parts: Mapping[str, Part]) -> bool:
    """Return whether a part or an arm has a topic."""
    if row.per == PART and (parts[name].gripper is not None) != (GRIPPER in row.name):
        return False
    return not row.needs or bool(name in parts and getattr(parts[name], row.needs))


#: Names of the topics of a robot for ros2_control, whose joint_state_broadcaster and whose
#: controllers use the other names.
REMAPPED = {'joint_states': 'robot_joint_states', 'joint_command': 'robot_joint_commands'}
STALLS = (f'ros2_control_tag with stepping lockstep: {TOPIC_PLUGIN} does not answer the states '
          'one by one, so that simulated time stands still; set ros2_control_plugin to '
          f'{OWN_PLUGIN}, or stepping to realtime')


def remapped(topic: str) -> str:
    """Return the absolute name of a topic of a robot after :data:`REMAPPED`."""
    space, slash, name = topic.rpartition('/')
    return f'/{space}{slash}{REMAPPED.get(name, name)}'


def hardware_of(simulation: Simulation, robot: SimulatedRobot, scope: Scope, plugin: str,
                lockstep: bool, resolve: Callable[[str], str], node: str = '/manip_sim',
                rates_hz: Mapping[str, float] = MappingProxyType({})) -> Hardware:
    """
    Return the hardware of the ``<ros2_control>`` tag, in the present control modes.

    :param simulation: of the world
    :param robot: the robot
    :param scope: of its topics and parameters
    :param plugin: the hardware component
    :param lockstep: whether the physics waits for commands
    :param resolve: returns what a topic is called
    :param node: name of the node, with its namespace
    :param rates_hz: of the sensors with fewer messages than control periods [Hz]
    """
    modes = {joint: scope.parameter(f'control_mode.{name}') for name, part in robot.parts.items()
             if part.gripper is None and part.atomic == (name,) for joint in part.joints}
    wrenches = {f'{arm}_{topic}': resolve(scope.topic(f'{arm}/{topic}'))
                for arm in robot.end_effectors for topic in ('wrench', 'external_wrench')}
    sensors = set(robot.sensor_names)
    imus = {instrument.name: resolve(scope.topic(row.name))
            for instrument, _, row in topics_of_instruments(simulation, {scope: robot})
            if instrument.kind == 'imu' and instrument.sensors[0] in sensors}
    return Hardware(
        robot.command_interfaces(), resolve(scope.topic('joint_states')),
        resolve(scope.topic('joint_command')), plugin, node, modes, wrenches, lockstep, imus,
        {name: rates_hz[name] for name in imus if name in rates_hz})
