# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the tree of frames on ``/tf`` and ``/tf_static``, where ``tf2_msgs`` is installed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped

from manip_sim.arrays import FloatArray
from manip_sim.interface.topics import BY_NAME
from manip_sim.physics.frame_tree import FrameTree, TreeFrame
from manip_sim.ros.lazy_publishers import create_output, Output
from manip_sim.ros.messages import filled, stamp_of
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.optional_packages import import_optional
from manip_sim.ros.serialized import SerializedMessage
from manip_sim.simulation import Simulation

TFMessage: Any = getattr(import_optional('tf2_msgs.msg'), 'TFMessage', None)


def offer_transforms(context: NodeContext, frames: Callable[[Simulation], FrameTree]
                     ) -> TransformPublisher | None:
    """
    Create the publisher of ``/tf`` and ``/tf_static``; note if ``tf2_msgs`` is missing.

    :param frames: returns the tree of a simulation
    :returns: None without ``tf2_msgs``
    """
    if TFMessage is None:
        context.missing['tf2_msgs'] = '/tf and /tf_static'
        return None
    return TransformPublisher(context, frames)


def create_outputs(context: NodeContext) -> tuple[Output, Output]:
    return (create_output(context, BY_NAME['/tf'], TFMessage),
            create_output(context, BY_NAME['/tf_static'], TFMessage))


class TransformPublisher:
    """
    A publisher of the transforms of frames; frames may come and go with objects.

    :param frames: returns the tree of a simulation
    """

    def __init__(self, context: NodeContext, frames: Callable[[Simulation], FrameTree]) -> None:
        self._moving, self._static = create_outputs(context)
        self._frames, self._prefix = frames, context.frame_prefix
        self._present: tuple[FrameTree, SerializedMessage] | None = None

    def follow(self, simulation: Simulation) -> None:
        """
        Publish all frames that do not move, and from now on those that do.

        To be called in the thread that spins the node, or before it spins.

        :param simulation: whose objects may have come or gone
        """
        tree = self._frames(simulation)
        # Assigned at once, because the simulation's thread needs a tree with its own message.
        self._present = tree, SerializedMessage(
            partial(transforms, tree.moving, self._prefix), 7 * len(tree.moving))
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
    message, found = TFMessage(), []
    for frame, row in zip(frames, numbers.reshape(-1, 7)):
        transform = TransformStamped(child_frame_id=prefix + frame.name)
        transform.header.frame_id = prefix + frame.parent
        transform.header.stamp = stamp
        found.append(filled(transform, row))
    message.transforms = found
    return message
