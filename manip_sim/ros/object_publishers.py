# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish where the free bodies of the world are; bodies may come and go."""

from __future__ import annotations

import re

from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.node import Node

from manip_sim.ros import messages
from manip_sim.ros.log import RejectionLog
from manip_sim.ros.publishers import create_output, Output
from manip_sim.simulation import Simulation

#: What a part of a topic's name may be.
_TOKEN = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')


class ObjectPublishers:
    """
    Publishers for pose and twist of each free body.

    :param node: the node
    :param log: counts and tells what could not be published
    :param frame_prefix: beginning of the names of frames
    """

    def __init__(self, node: Node, log: RejectionLog, frame_prefix: str = '') -> None:
        self._node = node
        self._log = log
        self._world = frame_prefix + messages.WORLD
        self._outputs: dict[str, tuple[Output, Output]] = {}

    def follow(self, simulation: Simulation) -> None:
        """
        Create publishers for bodies that have come, and destroy those of bodies that have gone.

        To be called in the thread that spins the node, or before it spins.

        :param simulation: its free bodies are published from now on
        """
        names = [name for name in simulation.entities.free_names if _TOKEN.fullmatch(name)]
        gone = {name: self._outputs[name] for name in self._outputs if name not in names}
        # The simulation's thread sees the old publishers or the new ones, all of them.
        self._outputs = {name: self._outputs.get(name) or self._create(name) for name in names}
        for outputs in gone.values():
            for output in outputs:
                output.close(self._node)

    def _create(self, name: str) -> tuple[Output, Output]:
        return (create_output(self._node, self._log, PoseStamped, f'objects/{name}/pose'),
                create_output(self._node, self._log, TwistStamped, f'objects/{name}/twist'))

    def publish(self, simulation: Simulation) -> None:
        """Publish all poses and twists that somebody listens to."""
        free_names = simulation.entities.free_names
        for name, (pose_output, twist_output) in self._outputs.items():
            pose_wanted, twist_wanted = pose_output.wanted, twist_output.wanted
            if not (pose_wanted or twist_wanted) or name not in free_names:
                continue
            stamp = messages.stamp_of(simulation.time_ns)
            pose, twist = simulation.entities.frame(simulation.data, name)
            if pose_wanted:
                pose_output.publish(messages.pose_stamped(stamp, pose, self._world))
            if twist_wanted:
                twist_output.publish(messages.twist_stamped(stamp, twist, self._world))
