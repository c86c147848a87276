# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Subscribe to commands: validate and count them, log rejected ones, hand over the rest."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
import time
from typing import Any
import weakref

from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
import numpy as np
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker

from manip_sim.control.commands import Command
from manip_sim.control.commands import JointTrajectory as TrajectoryCommand
from manip_sim.control.commands import NoCommand
from manip_sim.control.surroundings import ACTUATORS
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.interface.topics import Scope, SUBSCRIBED, Topic, topics_of, topics_of_surroundings
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quoting import pluralize, quoted
from manip_sim.ros.command_inbox import CommandInbox
from manip_sim.ros.executor import kind_of
from manip_sim.ros.feature import Feature, NodeContext, qos_options
from manip_sim.ros.messages import (
    message_class, MessageReader, nanoseconds_of, numbers_of, read_command, trajectory_fields,
    WORLD)
from manip_sim.simulation import SimulatedRobot

#: Number of commands of a topic that may wait.
COMMAND_DEPTH = 10
#: Rows of a message for joints in impedance mode.
_IMPEDANCE = ('position', 'velocity', 'effort', 'stiffness', 'damping')
Parse = Callable[[Any], Sequence[Command]]
Parser = Callable[[str, Any], Sequence[Command]]
#: Messages whose stamp is that of the state that they answer.
_ANSWERS = (JointState, PoseStamped, TwistStamped)


class CommandSubscription:
    """
    A reliable subscription, to which a best-effort one is added once such a publisher comes.

    A reliable subscription loses nothing, which lock-step needs, but does not match a best-effort
    publisher. Messages of reliable publishers, which then come twice, are taken once.

    :param message_type: of the topic
    :param take: is called with each message in its serialized form
    :param inbox: takes the messages; None: the executor does
    """

    def __init__(self, context: NodeContext, message_type: Any, topic: str,
                 take: Callable[[bytes], None], inbox: CommandInbox | None = None) -> None:
        self._take, self._context, self._inbox = take, context, inbox
        self._taken: deque[tuple[int, int]] = deque(maxlen=4 * COMMAND_DEPTH)
        self._best_effort: Any = None

        def subscribe(qos: QoSProfile, **arguments: Any) -> Any:
            subscription = context.node.create_subscription(
                message_type, topic, self._take_all if inbox is None else self._take_once, qos,
                raw=True,
                callback_group=None if inbox is None else inbox.group, **arguments)
            if inbox is not None:
                inbox.add(subscription)
            return subscription

        def match_best_effort(_: Any) -> None:
            if self._best_effort is None:
                self._best_effort = subscribe(QoSProfile(
                    depth=COMMAND_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
                    event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))

        self._reliable = subscribe(
            QoSProfile(depth=COMMAND_DEPTH),
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=match_best_effort, use_default_callbacks=False),
            **qos_options(context, topic))

    def close(self) -> None:
        """Take no messages any more; to be called in the thread that spins the node."""
        self._take = lambda data: None
        for subscription in (self._reliable, self._best_effort):
            if subscription is not None:
                if self._inbox is not None:
                    self._inbox.remove(subscription)
                # rclpy would keep them for as long as the group lives.
                for entity in (subscription, *subscription.event_handlers):
                    subscription.callback_group.entities.discard(weakref.ref(entity))
                self._context.node.destroy_subscription(subscription)

    def _take_all(self, data: bytes, info: dict[str, Any]) -> None:
        """Take a message, and those that wait behind it: executors would call services before."""
        self._take_once(data, info)
        for subscription in (self._reliable, self._best_effort):
            if subscription is None:
                continue
            for _ in range(COMMAND_DEPTH):
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                self._take_once(*taken)

    def _take_once(self, data: bytes, info: dict[str, Any]) -> None:
        if self._best_effort is not None:  # Until then, a message comes once.
            which = info['source_timestamp'], info['publication_sequence_number']
            if which in self._taken:
                return
            self._taken.append(which)
        self._take(data)


@dataclass
class CommandStatistics:
    """
    Counts of the commands for a part.

    :ivar accepted: messages and goals that were used
    :ivar rejected: messages and goals that were rejected
    :ivar clamped: numbers that were brought into their limits
    :ivar slowed: trajectories that were slowed down to keep to the velocity limits
    :ivar last_s: monotonic wall time when the last one was accepted [s]
    :ivar arrivals: simulation times of the first and the last one since the last report [ns], and
        how many there were
    """

    accepted: int = 0
    rejected: int = 0
    clamped: int = 0
    slowed: int = 0
    last_s: float | None = None
    arrivals: tuple[int, int, int] = (0, 0, 0)

    def take_period(self) -> float | None:
        """Return the mean simulation time between commands since the last call [s], or None."""
        (first_ns, last_ns, count), self.arrivals = self.arrivals, (0, 0, 0)
        return (last_ns - first_ns) * 1e-9 / (count - 1) if count > 1 else None


class CommandSubscribers:
    """
    Subscriptions to the command topics of all parts of a robot.

    :param robot: its parser validates; it is only read
    :param scope: namespace of its topics
    :ivar statistics: by atomic part, ``arm`` for messages to both arms of two, and
        ``joint_command`` for messages on the combined topic
    """

    def __init__(self, context: NodeContext, robot: SimulatedRobot, scope: Scope) -> None:
        self._context, self._thread, self._log = context, context.thread, context.log
        self.robot = robot
        self.scope = scope
        self._parse, self._parse_cartesian = robot.parse, robot.parse_cartesian
        self._subscriptions: list[CommandSubscription] = []
        self._entry_of = {name: part.atomic[0] if len(part.atomic) == 1 else name
                          for name, part in robot.parts.items()}
        self.statistics = {entry: CommandStatistics() for entry in self._entry_of.values()}
        self.statistics['joint_command'] = CommandStatistics()
        parse, cartesian = robot.parse, robot.parse_cartesian
        #: Convert a message for a part to commands, by their names in the table.
        parsers: dict[str, Parser] = {
            'action': lambda part, message: [parse.action(part, message.data)],
            'joint_command': self._joint_command, 'impedance': self._impedance,
            'trajectory': self._trajectory, 'base_twist': self._twist,
            'stamped_base_twist': lambda part, message: self._twist(part, message.twist),
            'target_pose': self._in_frame(cartesian.pose, 'pose.position', 'pose.orientation'),
            'target_twist': self._in_frame(cartesian.twist, 'twist.linear', 'twist.angular'),
            'target_wrench': self._in_frame(cartesian.wrench, 'wrench.force', 'wrench.torque'),
            'force_mode': self._force_mode, 'until_contact': self._until_contact,
            'pose_command': lambda arm, message: [cartesian.action(arm, message.data)]}
        for row in topics_of(robot.parts, robot.joints.twist_indices is not None):
            if row.direction == SUBSCRIBED and row.by in parsers:
                self._subscribe(row, partial(parsers[row.by], row.of))

    def _subscribe(self, row: Topic, parse: Parse) -> None:
        topic, message_type = self.scope.topic(row.name), message_class(row.type)
        part, robot = row.of or row.name, self.robot.name
        entry = self._entry_of.get(part, part)
        inbox, read = self._context.inbox, MessageReader(message_type).read
        if message_type is JointTrajectory:
            # Reading it may take long and would delay other commands and the physics.
            inbox, read = None, partial(read_command, message_type)

        def take(data: bytes) -> None:
            try:
                message = read(data)
                commands = parse(message)
                # The stamp of a trajectory is when it starts, not what it answers.
                answers = (nanoseconds_of(message.header.stamp)
                           if isinstance(message, _ANSWERS) else 0)
                refusal = next(filter(None, map(self.robot.reflexes.refusal, commands)), None)
                if refusal is not None:
                    # In lock-step it is an answer nevertheless: the robot has to come to rest.
                    commands = [NoCommand(robot=c.robot, parts=c.parts, indices=c.indices[:0])
                                for c in commands]
                self._thread.submit(commands, answers, robot)
                if refusal is not None:
                    raise CommandError(refusal)
            except (CommandError, UnknownNameError) as error:
                self.statistics[entry].rejected += 1
                self._log.warn(topic, kind_of(error), f'rejected a message on {topic}: {error}')
                return
            commands = [c for c in commands if not isinstance(c, NoCommand)]
            if commands:
                self.count(topic, part, commands)

        self._subscriptions.append(
            CommandSubscription(self._context, message_type, topic, take, inbox))

    def close(self) -> None:
        """Take no commands any more; to be called in the thread that spins the node."""
        for subscription in self._subscriptions:
            subscription.close()

    def count_rejected(self, part: str) -> None:
        self.statistics[self._entry_of[part]].rejected += 1

    def count(self, topic: str, part: str, commands: Sequence[Command]) -> None:
        """
        Count commands that are used, and log which of them were clamped or slowed down.

        :param topic: topic or action that they came on
        :param part: that they are for, or ``joint_command``
        """
        entry = self._entry_of.get(part, part)
        now_s, clamped = time.monotonic(), sum(command.clamped for command in commands)
        now_ns = self._thread.progress.time_ns
        entries = {entry: clamped}
        for command in commands:
            for part in command.parts:
                entries[self._entry_of[part]] = command.clamped
        for name, count in entries.items():
            self.statistics[name].accepted += 1
            self.statistics[name].clamped += count
            self.statistics[name].last_s = now_s
            first_ns, _, number = self.statistics[name].arrivals
            self.statistics[name].arrivals = first_ns if number else now_ns, now_ns, number + 1
        if clamped:
            example = next((c.clamped_example for c in commands if c.clamped_example), '')
            self._log.warn(topic, 'clamped', f'clamped {pluralize(clamped, "number")} of a '
                           f'message on {topic}{": " + example if example else " to its limits"}')
        for command in commands:
            if isinstance(command, TrajectoryCommand) and command.slowed > 1.0:
                self.statistics[entry].slowed += 1
                self._log.warn(topic, 'slowed', f'slowed a trajectory on {topic} down by the '
                               f'factor {command.slowed:.3g}, to {command.trajectory.end_s:.3g} '
                               's, to keep to the velocity limits')

    def _joint_command(self, part: str, message: JointState) -> Sequence[Command]:
        return self._parse.joint_command(
            self._context.joint_names.own(message.name), message.position, message.velocity,
            message.effort, part or None)

    def _impedance(self, part: str, message: Float64MultiArray) -> Sequence[Command]:
        joints = self.robot.joints
        names = [joints.names[i] for i in joints.indices_of(part)]
        if len(message.data) != len(_IMPEDANCE) * len(names):
            raise CommandError(
                f'{part}: an impedance must have {len(_IMPEDANCE)} numbers for each of '
                f'{pluralize(len(names), "joint")}, got {len(message.data)}: '
                f'{", ".join(_IMPEDANCE)} of all joints, row after row, NaN for what stays')
        rows = np.reshape(message.data, (len(_IMPEDANCE), -1))
        return self._parse.joint_impedance(names, part=part, **dict(zip(_IMPEDANCE, rows)))

    def _trajectory(self, part: str, message: JointTrajectory) -> Sequence[Command]:
        times_s, positions, velocities, accelerations = trajectory_fields(part, message)
        return [self._parse.trajectory(
            part, self._context.joint_names.own(message.joint_names), times_s, positions,
            velocities, accelerations,
            start_ns=nanoseconds_of(message.header.stamp),
            now_ns=self._thread.progress.time_ns)]

    def _twist(self, _: str, message: Twist) -> Sequence[Command]:
        linear, angular = message.linear, message.angular
        if linear.z or angular.x or angular.y:
            raise CommandError('base: moves along x and y and turns about z only, leave linear.z, '
                               'angular.x and angular.y at zero')
        return [self._parse.twist(linear.x, linear.y, angular.z)]

    def _in_frame(self, parse: Callable[..., Command], *fields: str) -> Parser:
        """Return the parser of stamped messages by two of their fields, in their frame."""
        vectors, prefix = attrgetter(*fields), self._context.frame_prefix
        return lambda arm, message: [parse(arm, *map(numbers_of, vectors(message)),
                                           message.header.frame_id.removeprefix(prefix))]

    def _force_mode(self, arm: str, message: Float64MultiArray) -> Sequence[Command]:
        if len(message.data) != 18:
            raise CommandError(f'{arm}: force mode must have 18 numbers, got {len(message.data)}: '
                               'selection, wrench and limits of the six axes, row after row')
        return [self._parse_cartesian.force_mode(arm, *np.reshape(message.data, (3, 6)))]

    def _until_contact(self, arm: str, message: Float64MultiArray) -> Sequence[Command]:
        numbers = list(message.data)
        if len(numbers) != 9:
            raise CommandError(f'{arm}: a motion until contact must have 9 numbers, got '
                               f'{len(numbers)}: linear and angular velocity in world, force, '
                               'distance and duration')
        return [self._parse_cartesian.until_contact(
            arm, numbers[:3], numbers[3:6], force=numbers[6], distance=numbers[7],
            duration_s=numbers[8])]


class RobotCommands(Feature):
    """
    The command topics of all robots.

    :ivar robots: the subscriptions of each robot
    """

    def __init__(self, context: NodeContext) -> None:
        self._context = context
        self.robots: list[CommandSubscribers] = []
        for scope, robot in context.robots.items():
            self.robot_added(scope, robot)

    def of_robot(self, scope: Scope) -> CommandSubscribers:
        return next(commands for commands in self.robots if commands.scope == scope)

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        self.robots.append(CommandSubscribers(self._context, robot, scope))

    def robot_removed(self, scope: Scope) -> None:
        commands = self.of_robot(scope)
        self.robots.remove(commands)
        commands.close()


#: Content of the message of a pull: two points, and no pose of its own.
_ENDS, _NOWHERE = 2, PoseMessage()


class SurroundingsCommands(Feature):
    """
    Subscriptions of mocap bodies, of actuators of no robot and of pulls; objects may come and go.

    :ivar statistics: counts of the commands, for ``arena``, ``actuators``,
        ``objects/<name>`` and ``pull``
    """

    def __init__(self, context: NodeContext) -> None:
        self._context, self._changes = context, context.thread.changes
        self._surroundings, self._pulls = context.simulation.surroundings, context.simulation.pulls
        self.statistics: dict[str, CommandStatistics] = {}
        self._take: dict[str, Callable[[str, Any], None]] = {
            'direct_command': self._command, 'mocap_pose': self._target, 'pull': self._pull}
        self._inputs: dict[Topic, CommandSubscription] = {}
        self.world_changed()

    def world_changed(self) -> None:
        """
        Take commands of the mocap bodies and the actuators of no part that there are now.

        Commands of actuators stay subscribed to.
        """
        rows = [row for row in topics_of_surroundings(self._surroundings)
                if row.direction == SUBSCRIBED]
        for row in [row for row in self._inputs if row not in rows and row.of != ACTUATORS]:
            self._inputs.pop(row).close()
            del self.statistics[_counted_as(row)]
        for row in rows:
            if row not in self._inputs:
                self._inputs[row] = self._subscribe(row)

    def _subscribe(self, row: Topic) -> CommandSubscription:
        message_type, use = message_class(row.type), partial(self._take[row.by], row.of)
        counts = self.statistics[_counted_as(row)] = CommandStatistics()
        read = MessageReader(message_type).read

        def take(data: bytes) -> None:
            try:
                use(read(data))
                counts.accepted, counts.last_s = counts.accepted + 1, time.monotonic()
            except (CommandError, UnknownNameError) as error:
                counts.rejected += 1
                self._context.log.warn(row.name, kind_of(error),
                                       f'rejected a message on {row.name}: {error}')

        return CommandSubscription(
            self._context, message_type, row.name, take, self._context.inbox)

    def _command(self, part: str, message: JointState) -> None:
        direct = self._surroundings.commands[part]
        controls = direct.checked(
            message.name, message.position, message.velocity, message.effort)
        stamp_ns = nanoseconds_of(message.header.stamp)
        if not controls:  # They go on as before, which answers a state too.
            self._changes.at_next_period(f'{part}/', 'answer', stamp_ns=stamp_ns)
        for name, value in controls.items():
            self._changes.at_next_period(
                f'{part}/{name}', 'direct_command', part, name, direct.control(name)[0], value,
                stamp_ns=stamp_ns)

    def _check_frame(self, frame_id: str) -> None:
        if frame_id.removeprefix(self._context.frame_prefix) not in ('', WORLD):
            raise CommandError(f'frame_id {quoted(frame_id)} is not supported: '
                               f"leave it empty or write '{WORLD}'")

    def _target(self, name: str, message: PoseStamped) -> None:
        self._check_frame(message.header.frame_id)
        pose = Pose.checked(*map(numbers_of, (
            message.pose.position, message.pose.orientation)))
        self._changes.at_next_period(f'objects/{name}', 'target', name,
                                     pose.position.tolist(), pose.quat_xyzw.tolist())

    def _pull(self, _: str, message: Marker) -> None:
        pulls, key = self._pulls, f'pull/{message.ns}'
        if message.action == Marker.DELETE:
            pulls.check_body(message.ns)
            self._changes.at_next_period(key, 'end_pull', message.ns)
            return
        self._check_frame(message.header.frame_id)
        if message.action != Marker.ADD or message.type != Marker.ARROW or (
                len(message.points) != _ENDS or message.pose != _NOWHERE):
            raise CommandError('pull: expected an ARROW to ADD, with two points and no pose, or '
                               f'to DELETE, got action {message.action}, type {message.type} and '
                               f'{pluralize(len(message.points), "point")}')
        point, target = map(numbers_of, message.points)
        pulls.check(message.ns, point, target)
        self._changes.at_next_period(
            key, 'pull', message.ns, point, target, message.id)


def _counted_as(row: Topic) -> str:
    """Return the key of a topic in the statistics."""
    return 'pull' if row.by == 'pull' else row.name.rpartition('/')[0]
