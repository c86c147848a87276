# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish states: every message of one instant has the same stamp."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from rclpy.parameter import Parameter
from std_msgs.msg import String, UInt8MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from manip_sim.arrays import FloatArray
from manip_sim.control.controlled_joints import ControllerState
from manip_sim.interface.scope import Scope
from manip_sim.interface.topics import BY_NAME, PUBLISHED, Topic
from manip_sim.interface.world_topics import topics_of, truths
from manip_sim.models import World
from manip_sim.ros import messages
from manip_sim.ros.feature import Feature
from manip_sim.ros.lazy_publishers import (
    create_output, create_publisher, Publication, Publications)
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.optional_packages import import_optional
from manip_sim.ros.serialized import Make
from manip_sim.simulation import SimulatedRobot, Simulation

JointTrajectoryControllerState: Any = getattr(
    import_optional('control_msgs.msg'), 'JointTrajectoryControllerState', None)

#: The type of ``<part>/controller_state``.
MESSAGE_TYPE: Any = JointTrajectoryControllerState or JointTrajectory
#: Number of rows of :func:`controller_numbers`.
ROWS = 9
#: What makes a message of stamp and numbers, what reads the numbers, and how many there are.
Reading = tuple[Make, Callable[[Simulation], FloatArray | None], int]
#: Returns the numbers of a channel: measured or exact.
Read = Callable[[str], FloatArray]
#: Returns what reads a part of a robot, for a prefix of the names of frames.
Reader = Callable[[SimulatedRobot, str, str, Read], Reading]


def controller_numbers(state: ControllerState) -> FloatArray:
    """
    Return the numbers of a message; without a setpoint the reference is the measured state.

    :returns: rows, of n joints each: position, velocity, acceleration and effort of the reference;
        measured position, velocity and effort; error of position and velocity; shape (9 n,)
    """
    reference, gives = state.reference, state.reference.gives_effort
    position, velocity, acceleration = (
        reference.position, reference.velocity, reference.acceleration)
    if gives.any():
        position = np.where(gives, state.position, position)
        velocity = np.where(gives, state.velocity, velocity)
        acceleration = np.where(gives, 0.0, acceleration)
    return np.concatenate([
        position, velocity, acceleration, reference.effort,
        state.position, state.velocity, state.effort,
        position - state.position, velocity - state.velocity])


def controller_state(names: Sequence[str], stamp: Time, numbers: FloatArray) -> Any:
    """
    Return the state of the controllers of a part's joints.

    Without the package control_msgs it is a ``JointTrajectory`` with four points, which are the
    fields of ``control_msgs/JointTrajectoryControllerState``: reference, feedback, error, output.

    :param names: of the joints, n
    :param numbers: as :func:`controller_numbers` returns them, shape (9 n,)
    """
    rows = numbers.reshape(ROWS, len(names))
    points = {'reference': _point(*rows[:4]), 'feedback': _point(rows[4], rows[5], None, rows[6]),
              'error': _point(*rows[7:]), 'output': _point(effort=rows[6])}
    message = MESSAGE_TYPE()
    message.header.stamp = stamp
    message.joint_names = list(names)
    if JointTrajectoryControllerState is None:
        message.points = list(points.values())
    else:
        for name, point in points.items():
            setattr(message, name, point)
    return message


def _point(position: Any = None, velocity: Any = None, acceleration: Any = None,
           effort: Any = None) -> JointTrajectoryPoint:
    fields = {'positions': position, 'velocities': velocity, 'accelerations': acceleration,
              'effort': effort}
    return JointTrajectoryPoint(
        **{name: values.tolist() for name, values in fields.items() if values is not None})


class ClockPublisher(Publications, Feature):
    """The publisher of ``/clock``."""

    def __init__(self, context: NodeContext) -> None:
        super().__init__()
        output, nothing = create_output(context, BY_NAME['/clock']), np.empty(0)
        self.replace((Publication(output, messages.clock, lambda _: nothing, 0),))
        context.thread.observe(self.publish, look=self.look)


class StatePublishers(Publications):
    """
    Publishers of the states of a robot: the rows of the table that some functions can read.

    :param robot: whose states are read
    :param scope: namespace of its topics
    :param readers: by the name in a row; None: :data:`READERS`
    """

    def __init__(self, context: NodeContext, robot: SimulatedRobot, scope: Scope,
                 readers: Mapping[str, Reader] | None = None) -> None:
        super().__init__()
        self._context, self._robot, self._scope = context, robot, scope
        self._readers = READERS if readers is None else readers
        self._rows = [row for row in topics_of(robot.parts, twist=True)
                      if row.direction == PUBLISHED and row.by in self._readers]
        self._measured = tuple(self._create(row, robot.sensing.measured) for row in self._rows)
        self.replace(self._measured)

    def _create(self, row: Topic, read: Read) -> Publication:
        named = replace(row, name=self._scope.topic(row.name))
        return Publication(
            create_output(self._context, named, _OTHER_TYPES.get(row.by)),
            *self._readers[row.by](self._robot, row.of, self._context.frame_prefix, read))

    def publish_truth(self) -> None:
        """Also publish exact values, below ``truth/``, if noise or latency of the robot is set."""
        if self._all == self._measured and self._robot.sensing.settings.measures:
            rows = truths(self._rows)
            self._context.table += [replace(row, name=self._scope.topic(row.name)) for row in rows]
            self.replace((*self._measured, *(
                self._create(row, self._robot.sensing.exact) for row in rows)))


class RobotStates(Feature):
    """The topics of the states of all robots."""

    def __init__(self, context: NodeContext) -> None:
        self._context = context
        self._robots: dict[Scope, StatePublishers] = {}
        for scope, robot in context.robots.items():
            self.robot_added(scope, robot)

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        states = self._robots[scope] = StatePublishers(self._context, robot, scope)
        self._context.thread.observe(states.publish, look=states.look)

    def robot_removed(self, scope: Scope) -> None:
        states = self._robots.pop(scope)
        self._context.thread.unobserve(states.publish)
        states.destroy(self._context.node)

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        for states in self._robots.values():
            states.publish_truth()


def _joints(robot: SimulatedRobot, part: str, _: str, read: Read) -> Reading:
    names = robot.parts[part].joints if part else robot.joint_names
    exact = read == robot.sensing.exact
    of_part = robot.reader.exact if exact else robot.reader.measured
    return (partial(messages.joint_state, names), lambda _: of_part(part or None),
            3 * len(names))


def _controllers(robot: SimulatedRobot, part: str, _: str, __: Read) -> Reading:
    names = robot.controller_state(part).names
    return (partial(controller_state, names),
            lambda _: controller_numbers(robot.controller_state(part)), ROWS * len(names))


def _of_arm(name: str, make: Make, count: int, robot: SimulatedRobot, arm: str, prefix: str,
            read: Read) -> Reading:
    frame = messages.WORLD if name in ('pose', 'twist') else robot.end_effectors[arm].wrench_frame
    return partial(make, prefix + frame), lambda _: read(f'{arm}/{name}'), count


#: By the name in a row of the table: returns what reads a part of a robot.
READERS: dict[str, Reader] = {
    'joints': _joints, 'controllers': _controllers, **{
        name: partial(_of_arm, name, make, count) for name, make, count in (
            ('wrench', messages.wrench_stamped, 6),
            ('external_wrench', messages.wrench_stamped, 6),
            ('pose', messages.pose_stamped, 7), ('twist', messages.twist_stamped, 6))}}
#: Message types that depend on what is installed.
_OTHER_TYPES = {'controllers': MESSAGE_TYPE}


class ModelPublisher(Feature):
    """
    Latched publishers of the composed model; it comes again when robots or objects come or go.

    ``~/mjcf`` is its MJCF, ``~/mjcf_archive`` a zip archive of the MJCF and of the files, such as
    meshes, that it refers to.

    :param world: as it is at the start
    """

    def __init__(self, context: NodeContext, world: World) -> None:
        self._mjcf = create_publisher(context, BY_NAME['~/mjcf'])
        self._archive = create_publisher(context, BY_NAME['~/mjcf_archive'])
        self._simulation, self._world = context.simulation, world

    def started(self) -> None:
        self._publish(self._world)

    def world_changed(self) -> None:
        self._publish(self._simulation.world)

    def _publish(self, world: World) -> None:
        """
        Publish the model.

        :raises ModelError: if a file cannot be read
        """
        xml, archive = world.to_xml_and_archive()
        self._mjcf.publish(String(data=xml))
        self._archive.publish(UInt8MultiArray(data=array('B', archive)))
