# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish what tools show of a world or plan with: frames, odometry, markers, scenes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
import itertools
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import TransformStamped, Vector3
import numpy as np
from rclpy.node import Node
from shape_msgs.msg import Mesh, MeshTriangle, SolidPrimitive
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from manip_sim.arrays import FloatArray
from manip_sim.channels.contents import Channel
from manip_sim.channels.kinds import odometry_channel
from manip_sim.frame_names import FrameNames
from manip_sim.interface.parameters import periods_per_message
from manip_sim.interface.topics import BY_NAME, Scope
from manip_sim.physics.entities import read_contacts
from manip_sim.physics.parts import EndEffectorReader
from manip_sim.physics.robot_frames import FrameTree, OdometryReader, TreeFrame
from manip_sim.ros.channel_publishers import ChannelPublishers
from manip_sim.ros.feature import create_output, Feature, NodeContext
from manip_sim.ros.messages import filled, import_optional, SerializedMessage, stamp_of, WORLD
from manip_sim.sensing.instruments import instrument_sites
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.simulation.planning_scene import (
    BOX, CYLINDER, HeldObject, MESH, Obstacle, PlanningScene, Solid, SPHERE)

#: Length of the arrow of a force [m/N].
FORCE_SCALE = 0.01
#: Length of the arrow of a torque [m/(N m)].
TORQUE_SCALE = 0.1
#: Diameters of points, shafts and heads of arrows [m].
_POINT_M, _SHAFT_M, _HEAD_M = 0.008, 0.006, 0.012
#: Shorter arrows are left out, as their direction cannot be seen [m].
_SHORTEST_M = 1e-6
#: So many messages with other markers are kept.
_MOST_MESSAGES = 32
_ORANGE, _YELLOW = (1.0, 0.55, 0.0), (1.0, 0.9, 0.1)
_RED, _BLUE = (0.9, 0.15, 0.15), (0.25, 0.45, 1.0)
_OPAQUE = 0.9


class MarkerPublisher:
    """
    A publisher of markers in ``world``; each message replaces the markers of the one before.

    Arrows show contact forces, on the body that can move, and external wrenches; an arrow of a
    torque points along its axis.

    :param end_effectors: readers of wrenches, by the beginning of the namespace of their markers
    """

    def __init__(self, context: NodeContext, end_effectors: Mapping[str, EndEffectorReader]
                 ) -> None:
        self._end_effectors = end_effectors
        self._output = create_output(context, BY_NAME['~/markers'])
        self._frame = context.frame_prefix + WORLD
        #: Those with the same markers as messages before, which differ in numbers only.
        self._messages = lru_cache(_MOST_MESSAGES)(self._message)

    def _message(self, points: int, arrows: tuple[_Arrows, ...]) -> SerializedMessage:
        return SerializedMessage(partial(_markers, self._frame, points, arrows),
                                 3 * points + 6 * len(arrows))

    def look(self) -> bool:
        return self._output.has_subscribers

    def publish(self, simulation: Simulation) -> None:
        data, contacts = simulation.data, read_contacts(simulation.model, simulation.data)
        points = len(contacts.position)
        arrows, starts = [_CONTACT_FORCES] * points, [*contacts.position]
        vectors = [*(FORCE_SCALE * contacts.force)]
        for name, reader in self._end_effectors.items():
            site, wrench = data.site(reader.ft_frame), reader.external_wrench(data)
            to_world = site.xmat.reshape(3, 3)
            arrows += [_Arrows(f'{name}/external_force', _RED),
                       _Arrows(f'{name}/external_torque', _BLUE)]
            starts += [site.xpos] * 2
            vectors += [to_world @ (FORCE_SCALE * wrench[:3]),
                        to_world @ (TORQUE_SCALE * wrench[3:])]
        lines = np.array([starts, vectors]).reshape(2, -1, 3)
        shown = np.linalg.norm(lines[1], axis=1) > _SHORTEST_M
        lines[1] += lines[0]
        self._output.publish(
            self._messages(points, tuple(itertools.compress(arrows, shown))).at(
                simulation.time_ns, np.concatenate(
                    [contacts.position.ravel(), lines[:, shown].swapaxes(0, 1).ravel()])))


class _Arrows(NamedTuple):
    """Arrows of one kind: their namespace and colour."""

    namespace: str
    color: tuple[float, ...]


_CONTACT_FORCES = _Arrows('contact_forces', _YELLOW)


def _markers(frame: str, points: int, arrows: Sequence[_Arrows], stamp: Time, numbers: FloatArray
             ) -> MarkerArray:
    """
    Return a message that replaces all markers.

    :param points: of contacts
    :param arrows: the kind of each arrow
    :param numbers: positions of points, then begin and end of each arrow [m], shape
        (3 points + 6 arrows,)
    """
    header = Header(frame_id=frame, stamp=stamp)
    rest = iter([Point(x=x, y=y, z=z) for x, y, z in numbers.reshape(-1, 3).tolist()])

    def marker(namespace: str, number: int, kind: int, color: tuple[float, ...],
               scale: tuple[float, ...], count: int) -> Marker:
        # As a reader gets them, in single precision, or SerializedMessage finds a difference.
        red, green, blue, alpha = np.array([*color, _OPAQUE], np.float32).tolist()
        return Marker(header=header, ns=namespace, id=number, type=kind,
                      scale=Vector3(x=scale[0], y=scale[1], z=scale[2]),
                      color=ColorRGBA(r=red, g=green, b=blue, a=alpha),
                      points=[*itertools.islice(rest, count)])
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    if points:
        markers.append(marker('contact_points', 0, Marker.SPHERE_LIST, _ORANGE,
                              (_POINT_M, _POINT_M, _POINT_M), points))
    ids: Counter[str] = Counter()
    for namespace, color in arrows:
        markers.append(marker(namespace, ids[namespace], Marker.ARROW, color,
                              (_SHAFT_M, _HEAD_M, 0.0), 2))
        ids[namespace] += 1
    return MarkerArray(markers=markers)


TFMessage: Any = getattr(import_optional('tf2_msgs.msg'), 'TFMessage', None)


class TransformPublisher:
    """
    A publisher of the transforms of frames; frames may come and go with objects.

    :param frames: returns the tree of a simulation
    """

    def __init__(self, context: NodeContext, frames: Callable[[Simulation], FrameTree]) -> None:
        self._moving, self._static = (
            create_output(context, BY_NAME[name], TFMessage) for name in ('/tf', '/tf_static'))
        self._frames, self._prefix = frames, context.frame_prefix
        self._present: tuple[FrameTree, SerializedMessage] | None = None

    def follow(self, simulation: Simulation) -> None:
        """
        Publish all frames that do not move, and from now on those that do.

        To be called in the thread that spins the node, or before it spins.

        :param simulation: whose objects may have come or gone
        """
        tree = self._frames(simulation)
        message = SerializedMessage(
            partial(transforms, tree.moving, self._prefix), 7 * len(tree.moving))
        message.prepare()
        # Assigned at once, because the simulation's thread needs a tree with its own message.
        self._present = tree, message
        self._static.publish(transforms(
            tree.static, self._prefix, stamp_of(simulation.time_ns), tree.static_poses))

    def look(self) -> bool:
        return self._moving.has_subscribers

    def publish(self, simulation: Simulation) -> None:
        if self._present is None:
            return
        tree, message = self._present
        if tree.model is simulation.model:  # Else follow() is about to be called.
            self._moving.publish(message.at(
                simulation.time_ns, tree.moving_poses(simulation.data).ravel()))


def transforms(frames: Sequence[TreeFrame], prefix: str, stamp: Time, numbers: FloatArray) -> Any:
    """
    Return a message with the poses of frames in their parents.

    :param frames: n of them
    :param prefix: prefix of the names of all frames
    :param numbers: position [m] and quaternion x, y, z, w of each, shape (7 n,) or (n, 7)
    """
    message, stamped = TFMessage(), []
    for frame, row in zip(frames, numbers.reshape(-1, 7)):
        transform = TransformStamped(child_frame_id=prefix + frame.name)
        transform.header.frame_id = prefix + frame.parent
        transform.header.stamp = stamp
        stamped.append(filled(transform, row))
    message.transforms = stamped
    return message


#: The frame in which a mobile base has its odometry (REP 105), after the robot's prefix.
ODOM = 'odom'


class OdometryPublishers(ChannelPublishers):
    """
    The publishers of the odometry of mobile bases.

    :ivar placed: functions that return the poses of the frames of odometry in ``world``, by name
    """

    def __init__(self, context: NodeContext) -> None:
        self._context = context
        self.placed: dict[str, Callable[[], FloatArray]] = {}
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
        self.placed[frame] = partial(_pose_of_odometry, reader, robot)
        base = names.bodies[simulation.model.body(reader.base).id]
        self._of[scope] = odometry_channel(robot, scope, *(
            self._context.frame_prefix + name for name in (frame, base)))

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        self._add(scope, robot)
        self.world_changed()

    def robot_removed(self, scope: Scope) -> None:
        super().robot_removed(scope)
        if scope in self._of:
            del self.placed[self._of.pop(scope).frame.removeprefix(self._context.frame_prefix)]


def _pose_of_odometry(reader: OdometryReader, robot: SimulatedRobot) -> FloatArray:
    """
    Return the pose in ``world`` of the frame of an odometry, shape (7,).

    It moves where the odometry drifts, so that the base is where it truly is in ``world``.
    """
    drift = robot.sensing.odometry
    return reader.frame_moved_by(*((0.0, 0.0, 0.0) if drift is None else drift.frame))


class SceneTopics(Feature):
    """
    Frames, markers and planning scenes at their rates.

    :param placed: functions that return the poses of further frames in ``world``, by name
    """

    def __init__(self, context: NodeContext, placed: Mapping[str, Callable[[], FloatArray]]
                 ) -> None:
        self._context, self._thread, value = context, context.thread, context.parameters.value
        self._end_effectors: dict[str, EndEffectorReader] = {}
        self._placed = placed
        self._scenes: dict[Scope, PlanningScenePublisher] = {}
        publish_rate, tf_rate = value('publish_rate'), value('tf_rate')
        every = periods_per_message(publish_rate, tf_rate)
        if abs(publish_rate / every - tf_rate) > 1e-6 * tf_rate:
            context.notes.append(
                f'tf_rate: {tf_rate:g} Hz is not publish_rate, {publish_rate:g} Hz, divided by a '
                f'whole number; /tf and ~/markers come with {publish_rate / every:g} Hz')
        self._scene_every = periods_per_message(publish_rate, RATE_HZ)
        if not PLANS:
            context.missing['moveit_msgs'] = 'planning scene for MoveIt'
        for scope, robot in context.robots.items():
            self.robot_added(scope, robot)
        markers = MarkerPublisher(context, self._end_effectors)
        self._thread.observe(markers.publish, every, markers.look)
        self._transforms: TransformPublisher | None = None
        if value('publish_tf') and TFMessage is None:
            context.missing['tf2_msgs'] = '/tf and /tf_static'
        elif value('publish_tf'):
            self._transforms = TransformPublisher(context, self._frames)
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


moveit_msgs: Any = import_optional('moveit_msgs.msg')

#: True if the package moveit_msgs is installed.
PLANS = moveit_msgs is not None
PLANNING_SCENE_TOPICS = ('planning_scene_world', 'collision_object', 'attached_collision_object')
#: Rate of looking for changes, of simulated time [Hz].
RATE_HZ = 10.0
#: MoveIt queues 10 messages of a topic; the whole world replaces more changes at once.
_MOST = 5
#: A subscriber may match later than the publisher: the whole world comes again so many looks
#: later.
_AGAIN = 10
_KINDS = {BOX: SolidPrimitive.BOX, SPHERE: SolidPrimitive.SPHERE,
          CYLINDER: SolidPrimitive.CYLINDER}


class PlanningScenePublisher:
    """
    A publisher of the world around one robot, on the topics that MoveIt's monitors subscribe to.

    The monitors keep no messages for those that come later, and neither do the topics: a new
    subscriber gets the whole world. Frames are links of ``robot_description``, which have no
    ``frame_prefix``.

    :param robot: for which is planned
    :param scope: namespace of its topics
    """

    def __init__(self, context: NodeContext, robot: SimulatedRobot, scope: Scope) -> None:
        self._robot, self._log = robot, context.log
        self._world, self._object, self._attached = self._outputs = [
            create_output(context, replace(BY_NAME[name], name=scope.topic(name)))
            for name in PLANNING_SCENE_TOPICS]
        self._counts = [0] * len(PLANNING_SCENE_TOPICS)
        self._model: Any = None
        self._scene: PlanningScene | None = None
        #: In how many looks the whole world is published again.
        self._whole_in = -1

    def destroy(self, node: Node) -> None:
        """Destroy the publishers, after the last call of the others."""
        for output in self._outputs:
            output.close(node)

    def look(self) -> bool:
        counts = [output.subscribers for output in self._outputs]
        if any(now > before for now, before in zip(counts, self._counts)):
            self._whole_in = _AGAIN
        self._counts = counts
        return any(counts)

    def publish(self, simulation: Simulation) -> None:
        """Publish the changes, or the whole world to a new subscriber."""
        stamp, scene = stamp_of(simulation.time_ns), self._scene
        if scene is None or simulation.model is not self._model:
            for name in () if scene is None else scene.holds:
                self._detach(name, stamp)  # Held objects may have been deleted.
            scene = self._scene_of(simulation)
        changes = scene.look(simulation.data)
        attached: Mapping[str, HeldObject] = changes.attached
        due, self._whole_in = self._whole_in, max(self._whole_in - 1, -1)
        for name in changes.detached:
            self._detach(name, stamp)
        places = {**changes.added, **changes.moved}
        if due in (0, _AGAIN) or len(places) > _MOST:
            self._world.publish(moveit_msgs.PlanningSceneWorld(collision_objects=[
                _added(scene.obstacles[name], WORLD, pose, stamp)
                for name, pose in scene.poses(simulation.data).items()]))
            attached, places = scene.holds, {}
        for name, pose in places.items():
            self._object.publish(_added(scene.obstacles[name], WORLD, pose, stamp)
                                 if name in changes.added else _moved(name, pose, stamp))
        for name, hold in attached.items():
            self._attached.publish(_attached(scene.obstacles[name], hold, stamp))

    def _scene_of(self, simulation: Simulation) -> PlanningScene:
        """Return a new scene, of which the whole world will be published."""
        grippers = {name: tuple(part.gripper.bodies) for name, part in self._robot.parts.items()
                    if part.gripper is not None}
        scene = PlanningScene(simulation.model, self._robot.robot_model.root_body, grippers)
        if scene.left_out:
            self._log.warn('planning_scene_world', 'left_out', 'the planning scene is without '
                           f'{", ".join(scene.left_out)}: MoveIt has no such shape')
        self._model, self._scene, self._whole_in = simulation.model, scene, _AGAIN
        return scene

    def _detach(self, name: str, stamp: Any) -> None:
        message = moveit_msgs.AttachedCollisionObject()
        message.object = _object(name, WORLD, stamp, moveit_msgs.CollisionObject.REMOVE)
        self._attached.publish(message)


def _object(name: str, frame: str, stamp: Any, operation: bytes) -> Any:
    message = moveit_msgs.CollisionObject(id=name, operation=operation)
    message.header.frame_id, message.header.stamp = frame, stamp
    return message


def _moved(name: str, pose: FloatArray, stamp: Any) -> Any:
    message = _object(name, WORLD, stamp, moveit_msgs.CollisionObject.MOVE)
    message.pose = filled(PoseMessage(), pose)
    return message


def _added(obstacle: Obstacle, frame: str, pose: FloatArray, stamp: Any) -> Any:
    message = _object(obstacle.name, frame, stamp, moveit_msgs.CollisionObject.ADD)
    message.pose = filled(PoseMessage(), pose)
    for solid in obstacle.solids:
        if solid.kind == MESH:
            message.meshes.append(_mesh(solid))
            message.mesh_poses.append(filled(PoseMessage(), solid.pose))
        else:
            message.primitives.append(SolidPrimitive(
                type=_KINDS[solid.kind], dimensions=solid.dimensions))
            message.primitive_poses.append(filled(PoseMessage(), solid.pose))
    return message


def _attached(obstacle: Obstacle, hold: HeldObject, stamp: Any) -> Any:
    message = moveit_msgs.AttachedCollisionObject(
        link_name=hold.link, touch_links=list(hold.touch_links), weight=obstacle.mass)
    message.object = _added(obstacle, hold.link, hold.pose, stamp)
    return message


def _mesh(solid: Solid) -> Mesh:
    assert solid.triangles is not None
    corners, numbers = np.unique(solid.triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return Mesh(
        vertices=[Point(x=x, y=y, z=z) for x, y, z in corners.tolist()],
        triangles=[MeshTriangle(vertex_indices=three)
                   for three in numbers.reshape(-1, 3).astype(np.uint32)])
