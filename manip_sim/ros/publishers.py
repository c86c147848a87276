# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish states: every message of one instant has the same stamp."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
import numpy as np
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt8MultiArray

from manip_sim.ros import messages
from manip_sim.ros.controller_state import (
    controller_numbers, controller_state, MESSAGE_TYPE, ROWS)
from manip_sim.ros.log import RejectionLog
from manip_sim.ros.outputs import create_output, LATCHED, Output, Topic, Topics
from manip_sim.interface.scope import Scope
from manip_sim.models import World
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.simulation.wrench import EndEffectorReader


class ClockPublisher(Topics):
    """
    The publisher of ``/clock``.

    :param node: the node
    :param log: counts and logs what could not be published
    """

    def __init__(self, node: Node, log: RejectionLog) -> None:
        super().__init__()
        output, nothing = create_output(node, log, Clock, '/clock', depth=1), np.empty(0)
        self.replace((Topic(output, messages.clock, lambda _: nothing, 0),))


class StatePublishers(Topics):
    """
    Publishers of the joint and controller states of a robot's parts, its wrenches, poses, twists.

    :param node: the node
    :param robot: whose states are read
    :param scope: namespace of its topics
    :param log: counts and logs what could not be published
    :param frame_prefix: prefix of the names of frames
    """

    def __init__(self, node: Node, robot: SimulatedRobot, scope: Scope, log: RejectionLog,
                 frame_prefix: str = '') -> None:
        super().__init__()
        self._node = node
        self._robot = robot
        self._scope = scope
        self._log = log
        topics = [self._joints('joint_states', None, robot.joint_names)]
        for name, part in robot.parts.items():
            if part.joints:
                topics.append(self._joints(f'{name}/joint_states', name, part.joints))
            if part.actuators and part.gripper is None:
                topics.append(self._controllers(name))
        for arm, reader in robot.end_effectors.items():
            topics += self._end_effector(arm, reader, frame_prefix)
        self.replace(tuple(topics))

    def _output(self, message_type: Any, topic: str) -> Output:
        return create_output(self._node, self._log, message_type, self._scope.topic(topic))

    def _joints(self, topic: str, part: str | None, names: tuple[str, ...]) -> Topic:
        return Topic(self._output(JointState, topic), partial(messages.joint_state, names),
                     lambda _: self._robot.measured(part), 3 * len(names))

    def _controllers(self, part: str) -> Topic:
        names = self._robot.controller_state(part).names
        return Topic(self._output(MESSAGE_TYPE, f'{part}/controller_state'),
                     partial(controller_state, names),
                     lambda _: controller_numbers(self._robot.controller_state(part)),
                     ROWS * len(names))

    def _end_effector(self, arm: str, reader: EndEffectorReader, frame_prefix: str
                      ) -> list[Topic]:
        ft_frame, world = frame_prefix + reader.ft_frame, frame_prefix + messages.WORLD
        kinds: list[tuple[str, Any, Any, str, Callable[[Any], Any], int]] = [
            ('wrench', WrenchStamped, messages.wrench_stamped, ft_frame, reader.wrench, 6),
            ('external_wrench', WrenchStamped, messages.wrench_stamped, ft_frame,
             reader.external_wrench, 6),
            ('eef_pose', PoseStamped, messages.pose_stamped, world, reader.pose, 7),
            ('eef_twist', TwistStamped, messages.twist_stamped, world, reader.twist, 6)]
        return [Topic(self._output(message_type, f'{arm}/{name}'), partial(make, frame),
                      lambda simulation, read=read: read(simulation.data),  # type: ignore[misc]
                      count)
                for name, message_type, make, frame, read, count in kinds]


class ModelPublisher:
    """
    Latched publishers of the composed model, which publish it again when objects come or go.

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
        Publish the model as it is at the start.

        :raises ModelError: if a file cannot be read
        """
        self._publish(self._world)

    def follow(self, simulation: Simulation) -> None:
        """Publish the model with the objects that a simulation has now."""
        self._publish(self._world.with_objects(simulation.plan.objects))

    def _publish(self, world: World) -> None:
        xml, archive = world.to_xml_and_archive()
        self._mjcf.publish(String(data=xml))
        self._archive.publish(UInt8MultiArray(data=array('B', archive)))
