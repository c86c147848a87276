# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish states: every message of one instant has the same stamp."""

from __future__ import annotations

from array import array
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt8MultiArray

from manip_sim.ros import messages
from manip_sim.ros.controller_state import controller_state, MESSAGE_TYPE
from manip_sim.ros.log import RejectionLog
from manip_sim.interface.scope import Scope
from manip_sim.models import World
from manip_sim.simulation import Simulation, SimulatedRobot

#: For who comes later too.
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


class Output:
    """
    A publisher that never stops the simulation.

    With history ``keep_all`` a reader that does not acknowledge fills the history. Publishing then
    waits (100 ms with Fast DDS) and fails. Until all is acknowledged, or the reader is gone,
    further messages are dropped and counted without waiting.

    :param publisher: the publisher
    :param log: counts and tells what could not be published
    """

    def __init__(self, publisher: Publisher, log: RejectionLog) -> None:
        self._publisher = publisher
        self._log = log
        self._stalled = False
        self._closed = False

    @property
    def wanted(self) -> bool:
        """Whether somebody listens and the next message can be published."""
        try:
            if self._closed or not self._publisher.get_subscription_count():
                return False
        except InvalidHandle:  # It is being closed in another thread.
            return False
        if self._stalled:
            self._stalled = not self._publisher.wait_for_all_acked(Duration())
            if self._stalled:
                topic = self._publisher.topic_name
                self._log.failed['publications'] += 1
                self._log.warn(topic, 'stalled', f'{topic}: a reader does not acknowledge, '
                               'messages are dropped until it does or is gone')
        return not self._stalled

    def close(self, node: Node) -> None:
        """
        Destroy the publisher; nothing is wanted from now on.

        :param node: that created it
        """
        self._closed = True
        node.destroy_publisher(self._publisher)

    def publish(self, message: Any) -> None:
        """Publish a message, or count it as dropped."""
        try:
            self._publisher.publish(message)
        except InvalidHandle:  # It is being closed in another thread.
            pass
        except RCLError as error:
            self._stalled = True
            self._log.failure('publications', self._publisher.topic_name, error)


def create_output(node: Node, log: RejectionLog, message_type: Any, topic: str, depth: int = 10
                  ) -> Output:
    """
    Create a publisher whose quality of service can be overridden by parameters.

    :param log: counts and tells what could not be published
    :param depth: how many messages are kept
    """
    return Output(node.create_publisher(
        message_type, topic, QoSProfile(depth=depth),
        qos_overriding_options=QoSOverridingOptions.with_default_policies()), log)


class ClockPublisher:
    """
    Publishes ``/clock``.

    :param node: the node
    :param log: counts and tells what could not be published
    """

    def __init__(self, node: Node, log: RejectionLog) -> None:
        self._output = create_output(node, log, Clock, '/clock', depth=1)

    def publish(self, simulation: Simulation) -> None:
        """Publish the time of the present instant."""
        if self._output.wanted:
            self._output.publish(Clock(clock=messages.stamp_of(simulation.time_ns)))


class StatePublishers:
    """
    Publishers for the joint states of all parts of a robot, its wrenches and poses.

    :param node: the node
    :param robot: tells the parts and their joints
    :param scope: where its topics are
    :param log: counts and tells what could not be published
    :param frame_prefix: beginning of the names of frames
    """

    def __init__(self, node: Node, robot: SimulatedRobot, scope: Scope, log: RejectionLog,
                 frame_prefix: str = '') -> None:
        self._node = node
        self._robot = robot
        self._scope = scope
        self._log = log
        self._world = frame_prefix + messages.WORLD
        joints = list(robot.joint_names)
        self._joint_states: list[tuple[Output, list[str], Any]] = [
            (self._publisher(JointState, 'joint_states'), joints, slice(None))]
        self._controllers = []
        for name, part in robot.parts.items():
            if part.joints:
                self._joint_states.append((self._publisher(JointState, f'{name}/joint_states'),
                                           list(part.joints), robot.indices_of[name]))
            if part.actuators and part.gripper is None:
                self._controllers.append((
                    self._publisher(MESSAGE_TYPE, f'{name}/controller_state'), name))
        self._arms = []
        for arm, reader in robot.end_effectors.items():
            self._arms.append((
                arm, frame_prefix + reader.ft_frame,
                self._publisher(WrenchStamped, f'{arm}/wrench'),
                self._publisher(WrenchStamped, f'{arm}/external_wrench'),
                self._publisher(PoseStamped, f'{arm}/eef_pose'),
                self._publisher(TwistStamped, f'{arm}/eef_twist')))

    def _publisher(self, message_type: Any, topic: str) -> Output:
        return create_output(self._node, self._log, message_type, self._scope.topic(topic))

    def publish(self, simulation: Simulation) -> None:
        """Publish the robot's state on all topics that somebody listens to."""
        state = self._robot.state()
        stamp = messages.stamp_of(state.time_ns)
        for publisher, joints, part in self._joint_states:
            if publisher.wanted:
                publisher.publish(messages.joint_state(stamp, joints, state, part))
        for publisher, name in self._controllers:
            if publisher.wanted:
                publisher.publish(controller_state(stamp, self._robot.controller_state(name)))
        for arm, frame, wrench, external_wrench, pose, twist in self._arms:
            end_effector = state.end_effectors[arm]
            for publisher, measured in ((wrench, end_effector.wrench),
                                        (external_wrench, end_effector.external_wrench)):
                if publisher.wanted:
                    publisher.publish(messages.wrench_stamped(stamp, frame, measured))
            if pose.wanted:
                pose.publish(messages.pose_stamped(stamp, end_effector.pose, self._world))
            if twist.wanted:
                twist.publish(messages.twist_stamped(stamp, end_effector.twist, self._world))


class ModelPublisher:
    """
    Publishes the composed model, and again when objects come or go; for everyone who comes later.

    ``~/mjcf`` is its MJCF, ``~/mjcf_archive`` a zip archive of the MJCF and of the files, such as
    meshes, that it refers to.

    :param node: the node
    :param world: the model, as it is at the start
    """

    def __init__(self, node: Node, world: World) -> None:
        self._world = world
        self._mjcf = node.create_publisher(String, '~/mjcf', LATCHED)
        self._archive = node.create_publisher(UInt8MultiArray, '~/mjcf_archive', LATCHED)

    def publish(self) -> None:
        """
        Publish it as it is at the start.

        :raises ModelError: if a file cannot be read
        """
        self._publish(self._world)

    def follow(self, simulation: Simulation) -> None:
        """Publish the model with the objects that a simulation has now."""
        self._publish(self._world.with_objects(simulation.plan.objects))

    def _publish(self, world: World) -> None:
        self._mjcf.publish(String(data=world.to_xml()))
        self._archive.publish(UInt8MultiArray(data=array('B', world.to_archive())))
