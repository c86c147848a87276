# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish what tools show of a world or plan with: frames, odometry, markers, scenes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from manip_sim.channels.channel import Channel
from manip_sim.channels.kinds import odometry_channel
from manip_sim.errors import ParameterError
from manip_sim.frame_names import FrameNames
from manip_sim.interface.parameters import periods_per_message
from manip_sim.interface.scope import Scope
from manip_sim.physics.end_effectors import EndEffectorReader
from manip_sim.physics.frame_tree import FrameTree
from manip_sim.physics.odometry import OdometryReader
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quoting import quoted
from manip_sim.ros.channel_publishers import ChannelPublishers
from manip_sim.ros.feature import Feature
from manip_sim.ros.markers import MarkerPublisher
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.planning_scene_publisher import PlanningScenePublisher, PLANS, RATE_HZ
from manip_sim.ros.transforms import offer_transforms, TransformPublisher
from manip_sim.sensing.instruments import instrument_sites
from manip_sim.simulation import SimulatedRobot, Simulation

#: The frame in which a mobile base has its odometry (REP 105), after the robot's prefix.
ODOM = 'odom'


def check_frame_prefix(prefix: str) -> str:
    """
    Check a prefix of the names of frames, and return it.

    :raises ParameterError: if it begins with '/' or contains spaces or unprintable characters
    """
    if prefix.startswith('/') or any(not c.isprintable() or c.isspace() for c in prefix):
        raise ParameterError(f"parameter 'frame_prefix': {quoted(prefix)} cannot begin the name "
                             "of a frame: it must not begin with '/' or contain spaces")
    return prefix


class OdometryPublishers(ChannelPublishers):
    """
    The publishers of the odometry of mobile bases.

    :ivar placed: poses of the frames of odometry in ``world``, by name
    """

    def __init__(self, context: NodeContext) -> None:
        self._context = context
        self.placed: dict[str, Pose] = {}
        self._of: dict[Scope, Channel] = {}
        for scope, robot in context.robots.items():
            self._add(scope, robot)
        super().__init__(context, lambda robots: [
            [channel] for scope, channel in self._of.items() if scope in robots])

    def _add(self, scope: Scope, robot: SimulatedRobot) -> None:
        if not robot.twist_joints:
            return
        parameters, simulation = self._context.parameters, self._context.simulation
        name = scope.parameter('prefix')  # Spawned robots have none.
        prefix = (parameters.value(name) if name in parameters.names
                  else robot.robot_model.naming_prefix)
        names = FrameNames(simulation.model, self.placed)
        frame = names.placed(prefix + ODOM)
        reader = OdometryReader(simulation.model, robot.twist_joints)
        self.placed[frame] = reader.origin
        base = names.bodies[simulation.model.body(reader.base).id]
        self._of[scope] = odometry_channel(simulation, robot, scope, reader, *(
            self._context.frame_prefix + name for name in (frame, base)))

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        self._add(scope, robot)
        self.world_changed()

    def robot_removed(self, scope: Scope) -> None:
        super().robot_removed(scope)
        if scope in self._of:
            del self.placed[self._of.pop(scope).frame.removeprefix(self._context.frame_prefix)]


class SceneTopics(Feature):
    """
    Frames, markers and planning scenes at their rates.

    :param placed: poses of further frames in ``world``, by name
    """

    def __init__(self, context: NodeContext, placed: Mapping[str, Pose]) -> None:
        self._context, self._thread, value = context, context.thread, context.parameters.value
        self._end_effectors: dict[str, EndEffectorReader] = {}
        self._placed = placed
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
        self._thread.call(partial(self._end_effectors.update, {
            scope.topic(arm): reader for arm, reader in robot.end_effectors.items()}))
        if PLANS:
            scene = self._scenes[scope] = PlanningScenePublisher(self._context, robot, scope)
            self._thread.observe(scene.publish, self._scene_every, scene.look)

    def robot_removed(self, scope: Scope) -> None:
        def forget() -> None:
            for name in [*self._end_effectors]:
                if name.startswith(scope.topic('')):
                    del self._end_effectors[name]
        self._thread.call(forget)
        scene = self._scenes.pop(scope, None)
        if scene is not None:
            self._thread.unobserve(scene.publish)
            scene.destroy(self._context.node)

    def _frames(self, simulation: Simulation) -> FrameTree:
        sites = [site for reader in self._end_effectors.values()
                 for site in (reader.ft_frame, reader.grip_site)]
        return FrameTree(simulation.model, dict.fromkeys(
            [*sites, *instrument_sites(simulation.model), *simulation.lidars]), self._placed)

    def world_changed(self) -> None:
        if self._transforms is not None:
            self._transforms.follow(self._context.simulation)


def _divider(context: NodeContext, publish_rate: float, tf_rate: float) -> int:
    every = periods_per_message(publish_rate, tf_rate)
    rate = publish_rate / every
    if abs(rate - tf_rate) > 1e-6 * tf_rate:
        context.notes.append(
            f'tf_rate: {tf_rate:g} Hz is not publish_rate, {publish_rate:g} Hz, divided by a '
            f'whole number; /tf and ~/markers come with {rate:g} Hz')
    return every
