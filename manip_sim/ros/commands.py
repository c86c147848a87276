# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Subscribe to commands: validate, count, tell what is refused, hand over the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time
from typing import Any

from geometry_msgs.msg import Twist
import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from manip_sim.errors import CommandError
from manip_sim.ros.log import kind_of, RejectionLog
from manip_sim.ros.messages import nanoseconds_of, Names
from manip_sim.ros.runner import Runner
from manip_sim.simulation import Simulation
from manip_sim.simulation.commands import Command
from manip_sim.simulation.drives import Drive, SubsystemDrive


@dataclass
class CommandStatistics:
    """
    What came in for a part.

    :ivar accepted: messages that were used
    :ivar refused: messages that were refused
    :ivar clamped: numbers that were brought into their range
    :ivar last_s: monotonic wall time of the last accepted message [s]
    """

    accepted: int = 0
    refused: int = 0
    clamped: int = 0
    last_s: float | None = None


class CommandSubscribers:
    """
    Subscriptions to the command topics of all parts.

    :param node: the node
    :param simulation: whose drives validate; they are only read
    :param runner: takes the commands
    :param names: public names
    :ivar statistics: by part, and for the combined topic ``joint_command``, whose commands count
        for their parts too
    """

    def __init__(self, node: Node, simulation: Simulation, runner: Runner, names: Names) -> None:
        self._node = node
        self._simulation = simulation
        self._runner = runner
        self._names = names
        self._log: RejectionLog = node.rejections
        self.statistics = {part: CommandStatistics() for part in simulation.drives}
        self.statistics['joint_command'] = CommandStatistics()
        for part, drive in simulation.drives.items():
            if not drive.part.actuators:
                continue
            self._subscribe(Float64MultiArray, f'{part}/command', part, self._action, drive)
            self._subscribe(JointState, f'{part}/joint_command', part, self._joint_command, drive)
            if isinstance(drive, SubsystemDrive):
                self._subscribe_subsystem(part, drive)
        self._subscribe(JointState, 'joint_command', 'joint_command',
                        self._combined_joint_command, None)

    def _subscribe_subsystem(self, part: str, drive: SubsystemDrive) -> None:
        if part == 'arm':
            self._subscribe(JointTrajectory, 'arm/joint_trajectory', part, self._trajectory, drive)
        if part == 'base' and drive.takes_twist:
            self._subscribe(Twist, 'base/cmd_vel', part, self._twist, drive)

    def _subscribe(self, message_type: Any, topic: str, part: str,
                   parse: Callable[[Any, Any], list[Command]], drive: Drive | None) -> None:
        def take(message: Any) -> None:
            statistics = self.statistics[part]
            try:
                commands = parse(message, drive)
                # The stamp of a trajectory is when it starts, not what it answers.
                answers = (nanoseconds_of(message.header.stamp)
                           if isinstance(message, JointState) else 0)
                self._runner.submit(commands, answers)
            except CommandError as error:
                statistics.refused += 1
                self._log.warn(topic, kind_of(error), f'refused a message on {topic}: {error}')
                return
            for command in commands:
                self._count(topic, self.statistics[command.part], command.clamped)
            if drive is None:
                statistics.accepted += 1
                statistics.clamped += sum(command.clamped for command in commands)
                statistics.last_s = time.monotonic()

        self._node.create_subscription(
            message_type, topic, take, QoSProfile(depth=1),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def _count(self, topic: str, statistics: CommandStatistics, clamped: int) -> None:
        statistics.accepted += 1
        statistics.last_s = time.monotonic()
        if clamped:
            statistics.clamped += clamped
            self._log.warn(topic, 'clamped', f'clamped {clamped} numbers of a message on {topic} '
                           'to their limits')

    def _model_names(self, message: Any) -> list[str]:
        names = message.name if isinstance(message, JointState) else message.joint_names
        return self._names.model(names, self._simulation.joint_names)

    def _action(self, message: Float64MultiArray, drive: Drive) -> list[Command]:
        return [drive.action(message.data)]

    def _joint_command(self, message: JointState, drive: Drive) -> list[Command]:
        return [drive.joint_command(self._model_names(message), message.position,
                                    message.velocity, message.effort)]

    def _combined_joint_command(self, message: JointState, _: None) -> list[Command]:
        return list(self._simulation.split_joint_command(
            self._model_names(message), message.position, message.velocity, message.effort))

    def _trajectory(self, message: JointTrajectory, drive: SubsystemDrive) -> list[Command]:
        points = message.points
        times_s = [p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in points]
        fields: list[list[Any] | None] = [
            None if all(not len(getattr(p, name)) for p in points)
            else [np.asarray(getattr(p, name)) for p in points]
            for name in ('positions', 'velocities', 'accelerations')]
        if any(len(p.effort) for p in points):
            raise CommandError('arm: a trajectory has no use for effort, leave it empty')
        delay_s = self._delay_s(message)
        return [drive.trajectory(self._model_names(message), [t + delay_s for t in times_s],
                                 fields[0] or [], fields[1], fields[2])]

    def _delay_s(self, message: JointTrajectory) -> float:
        """Return in how much simulation time a trajectory starts; a stamp of zero is now."""
        start_ns = nanoseconds_of(message.header.stamp)
        return (start_ns - self._runner.progress.time_ns) * 1e-9 if start_ns else 0.0

    def _twist(self, message: Twist, drive: SubsystemDrive) -> list[Command]:
        linear, angular = message.linear, message.angular
        if linear.z or angular.x or angular.y:
            raise CommandError('base: moves along x and y and turns about z only, leave linear.z, '
                               'angular.x and angular.y at zero')
        return [drive.twist(linear.x, linear.y, angular.z)]
