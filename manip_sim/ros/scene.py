# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish what tools show of a world or plan with: frames, odometry, markers, scenes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.parameter import Parameter

from manip_sim.arrays import FloatArray
from manip_sim.errors import ParameterError
from manip_sim.frame_names import FrameNames
from manip_sim.interface.parameters import periods_per_message
from manip_sim.interface.scope import Scope
from manip_sim.physics.end_effectors import EndEffectorReader
from manip_sim.physics.frame_tree import FrameTree
from manip_sim.physics.odometry import OdometryReader
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quoting import quoted
from manip_sim.ros.feature import Feature
from manip_sim.ros.markers import MarkerPublisher
from manip_sim.ros.messages import stamped
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.planning_scene_publisher import PlanningScenePublisher, PLANS, RATE_HZ
from manip_sim.ros.state_publishers import Read, Reading, StatePublishers
from manip_sim.ros.transforms import offer_transforms, TransformPublisher
from manip_sim.sensing.instruments import instrument_sites
from manip_sim.simulation import SimulatedRobot, Simulation

#: The frame in which a mobile base has its odometry (REP 105), after the robot's prefix.
ODOM = 'odom'


def odometry_publishers(context: NodeContext, robot: SimulatedRobot, reader: OdometryReader,
                        scope: Scope, frame: str, base: str) -> StatePublishers:
    """
    Publish a base's pose in the frame of its odometry, and its twist in its own axes.

    They have no noise: the covariances are zero.

    :param scope: namespace of its topic
    :param frame: name of the frame of the odometry
    :param base: name of the frame of the base
    """
    def exact() -> FloatArray:
        found = reader.read(context.simulation.model, context.simulation.data)
        return np.concatenate([found.position, found.quat_xyzw, found.linear, found.angular])

    def reading(_: SimulatedRobot, __: str, prefix: str, read: Read) -> Reading:
        return (partial(odometry, prefix + frame, prefix + base),
                lambda simulation: read('odom'), 13)
    robot.sensing.add('odom', exact)
    return StatePublishers(context, robot, scope, {'odometry': reading})


def odometry(frame_id: str, child_frame_id: str, stamp: Time, numbers: FloatArray) -> Odometry:
    """
    Return a message with the pose of a frame in another one, and its twist.

    :param numbers: position [m], quaternion x, y, z, w, and linear [m/s] and angular velocity
        [rad/s] in the axes of the frame that moves, shape (13,)
    """
    message: Odometry = stamped(Odometry, frame_id, stamp, numbers)
    message.child_frame_id = child_frame_id
    return message


def check_frame_prefix(prefix: str) -> str:
    """
    Check a prefix of the names of frames, and return it.

    :raises ParameterError: if it begins with '/' or contains spaces or unprintable characters
    """
    if prefix.startswith('/') or any(not c.isprintable() or c.isspace() for c in prefix):
        raise ParameterError(f"parameter 'frame_prefix': {quoted(prefix)} cannot begin the name "
                             "of a frame: it must not begin with '/' or contain spaces")
    return prefix


class SceneTopics(Feature):
    """Odometry of each period, and frames, markers and planning scenes at their rates."""

    def __init__(self, context: NodeContext) -> None:
        self._context, self._thread, value = context, context.thread, context.parameters.value
        self._end_effectors: dict[str, EndEffectorReader] = {}
        #: Poses of the frames of odometry in ``world``, by name.
        self._placed: dict[str, Pose] = {}
        self._odometry: dict[Scope, tuple[str, StatePublishers]] = {}
        self._scenes: dict[Scope, PlanningScenePublisher] = {}
        every = _divider(context, value('publish_rate'), value('tf_rate'))
        self._scene_every = periods_per_message(value('publish_rate'), RATE_HZ)
        if not PLANS:
            context.missing['moveit_msgs'] = 'planning scene for MoveIt'
        for scope, robot in context.robots.items():
            self.robot_added(scope, robot)
        markers = MarkerPublisher(context, self._end_effectors)
        self._thread.observe(markers.publish, every, markers.look)
        self._transforms: TransformPublisher | None = None
        if value('publish_tf'):
            self._transforms = offer_transforms(context, self._frames)
        if self._transforms is not None:
            self._transforms.follow(context.simulation)
            self._thread.observe(self._transforms.publish, every, self._transforms.look)

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        """Serve a robot; its frames come with :meth:`world_changed`."""
        thread, parameters = self._thread, self._context.parameters
        if robot.twist_joints:
            name = scope.parameter('prefix')  # Spawned robots have none.
            prefix = (parameters.value(name) if name in parameters.names
                      else robot.robot_model.naming_prefix)
            model = self._context.simulation.model
            names = FrameNames(model, self._placed)
            frame = names.placed(prefix + ODOM)
            reader = OdometryReader(model, robot.twist_joints)
            self._placed[frame] = reader.origin
            odometry = odometry_publishers(self._context, robot, reader, scope, frame,
                                           names.bodies[model.body(reader.base).id])
            self._odometry[scope] = frame, odometry
            thread.observe(odometry.publish, look=odometry.look)
        thread.call(partial(self._end_effectors.update, {
            scope.topic(arm): reader for arm, reader in robot.end_effectors.items()}))
        if PLANS:
            scene = self._scenes[scope] = PlanningScenePublisher(self._context, robot, scope)
            thread.observe(scene.publish, self._scene_every, scene.look)

    def robot_removed(self, scope: Scope) -> None:
        frame, odometry = self._odometry.pop(scope, ('', None))
        scene = self._scenes.pop(scope, None)
        self._placed.pop(frame, None)

        def forget() -> None:
            for name in [*self._end_effectors]:
                if name.startswith(scope.topic('')):
                    del self._end_effectors[name]
        self._thread.call(forget)
        for publisher in (odometry, scene):
            if publisher is not None:
                self._thread.unobserve(publisher.publish)
                publisher.destroy(self._context.node)

    def _frames(self, simulation: Simulation) -> FrameTree:
        sites = [site for reader in self._end_effectors.values()
                 for site in (reader.ft_frame, reader.grip_site)]
        return FrameTree(simulation.model, dict.fromkeys(
            [*sites, *instrument_sites(simulation.model), *simulation.lidars]), self._placed)

    def world_changed(self) -> None:
        if self._transforms is not None:
            self._transforms.follow(self._context.simulation)

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        for _, odometry in self._odometry.values():
            odometry.publish_truth()


def _divider(context: NodeContext, publish_rate: float, tf_rate: float) -> int:
    every = periods_per_message(publish_rate, tf_rate)
    rate = publish_rate / every
    if abs(rate - tf_rate) > 1e-6 * tf_rate:
        context.notes.append(
            f'tf_rate: {tf_rate:g} Hz is not publish_rate, {publish_rate:g} Hz, divided by a '
            f'whole number; /tf and ~/markers come with {rate:g} Hz')
    return every
