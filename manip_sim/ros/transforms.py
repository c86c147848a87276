# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the tree of frames on ``/tf`` and ``/tf_static``, where ``tf2_msgs`` is installed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from manip_sim.ros.log import RejectionLog
from manip_sim.ros.publishers import create_output, LATCHED, Output
from manip_sim.simulation import Simulation
from manip_sim.simulation.frames import Frame, FrameTree
from manip_sim.typing import FloatArray

try:
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError as missing:
    if str(missing.name).split('.')[0] != 'tf2_msgs':
        raise
    TFMessage = None

#: As tf2's broadcasters.
_DEPTH = 100


def offer_transforms(node: Any, frames: Callable[[Simulation], FrameTree], prefix: str,
                     log: RejectionLog) -> TransformPublisher | None:
    """
    Create what publishes ``/tf`` and ``/tf_static``; without ``tf2_msgs`` say so.

    :param frames: returns the tree of a simulation
    :param prefix: beginning of the names of all frames
    :param log: counts and tells what could not be published
    :returns: None without ``tf2_msgs``
    """
    if TFMessage is None:
        node.notes.append('no /tf and /tf_static: the package tf2_msgs is not installed')
        return None
    return TransformPublisher(*create_outputs(node, log), frames, prefix)


def create_outputs(node: Node, log: RejectionLog) -> tuple[Output, Output]:
    """
    Create the publishers of ``/tf`` and ``/tf_static``.

    :param log: counts and tells what could not be published
    """
    return (create_output(node, log, TFMessage, '/tf', _DEPTH),
            Output(node.create_publisher(TFMessage, '/tf_static', LATCHED), log))


class TransformPublisher:
    """
    Publishes where frames are in their parents; frames may come and go with objects.

    Messages are made once and filled again.

    :param moving: takes the messages for ``/tf``
    :param static: takes those for ``/tf_static``
    :param frames: returns the tree of a simulation
    :param prefix: beginning of the names of all frames
    """

    def __init__(self, moving: Output, static: Output, frames: Callable[[Simulation], FrameTree],
                 prefix: str = '') -> None:
        self._moving = moving
        self._static = static
        self._frames = frames
        self._prefix = prefix
        self._present: tuple[FrameTree, Any] | None = None

    def follow(self, simulation: Simulation) -> None:
        """
        Publish all frames that do not move, and from now on those that do.

        To be called in the thread that spins the node, or before it spins.

        :param simulation: whose objects may have come or gone
        """
        tree = self._frames(simulation)
        # The simulation's thread sees the old tree with its message, or the new one.
        self._present = tree, self._message(tree.moving)
        static = self._message(tree.static)
        _fill(static, tree.static_poses, simulation.time_ns)
        self._static.publish(static)

    def publish(self, simulation: Simulation) -> None:
        """Publish where the frames are that move, if somebody listens."""
        if self._present is None or not self._moving.wanted:
            return
        tree, message = self._present
        if tree.model is simulation.model:  # Else objects have changed, and follow is to come.
            _fill(message, tree.moving_poses(simulation.data), simulation.time_ns)
            self._moving.publish(message)

    def _message(self, frames: Sequence[Frame]) -> Any:
        message, transforms, stamp = TFMessage(), [], Time()
        for frame in frames:
            transform = TransformStamped(child_frame_id=self._prefix + frame.name)
            transform.header.frame_id = self._prefix + frame.parent
            transform.header.stamp = stamp  # One for all.
            transforms.append(transform)
        message.transforms = transforms
        return message


def _fill(message: Any, poses: FloatArray, time_ns: int) -> None:
    """Set the stamp and the poses of a message, rows x, y, z and quaternion x, y, z, w."""
    if message.transforms:
        stamp = message.transforms[0].header.stamp
        stamp.sec, stamp.nanosec = divmod(time_ns, 1_000_000_000)
    for transform, row in zip(message.transforms, poses.tolist()):
        place, turn = transform.transform.translation, transform.transform.rotation
        place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = row
