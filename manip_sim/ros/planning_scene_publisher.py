# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the world around a robot as MoveIt's planning scene, where ``moveit_msgs`` is there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import Point, Pose
import numpy as np
from rclpy.node import Node
from shape_msgs.msg import Mesh, MeshTriangle, SolidPrimitive

from manip_sim.arrays import FloatArray
from manip_sim.interface.topics import BY_NAME, Scope
from manip_sim.ros.feature import create_output, NodeContext
from manip_sim.ros.messages import filled, import_optional, stamp_of, WORLD
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.simulation.planning_scene import (
    BOX, CYLINDER, HeldObject, MESH, Obstacle, PlanningScene, Solid, SPHERE)

moveit_msgs: Any = import_optional('moveit_msgs.msg')

#: Whether the package moveit_msgs is installed.
PLANS = moveit_msgs is not None
TOPICS = ('planning_scene_world', 'collision_object', 'attached_collision_object')
#: How often it is looked for changes, of simulated time [Hz].
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
            for name in TOPICS]
        self._counts = [0] * len(TOPICS)
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
            self._release(stamp)
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

    def _release(self, stamp: Any) -> None:
        """Detach everything: held objects may have been deleted."""
        for name in self._scene.holds if self._scene is not None else ():
            self._detach(name, stamp)

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
    message.pose = filled(Pose(), pose)
    return message


def _added(obstacle: Obstacle, frame: str, pose: FloatArray, stamp: Any) -> Any:
    message = _object(obstacle.name, frame, stamp, moveit_msgs.CollisionObject.ADD)
    message.pose = filled(Pose(), pose)
    for solid in obstacle.solids:
        if solid.kind == MESH:
            message.meshes.append(_mesh(solid))
            message.mesh_poses.append(filled(Pose(), solid.pose))
        else:
            message.primitives.append(SolidPrimitive(
                type=_KINDS[solid.kind], dimensions=solid.dimensions))
            message.primitive_poses.append(filled(Pose(), solid.pose))
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
