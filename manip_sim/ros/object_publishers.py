# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish pose and twist of the free bodies of the world; bodies may come and go."""

from __future__ import annotations

from functools import partial
from typing import Any

from manip_sim.arrays import FloatArray
from manip_sim.interface.topics import TOKEN, Topic
from manip_sim.interface.world_topics import topics_of_objects
from manip_sim.ros import messages
from manip_sim.ros.outputs import create_output, Publication, Publications
from manip_sim.simulation import Simulation
from manip_sim.simulation.entities import Entities


class ObjectPublishers(Publications):
    """Publishers of the pose and twist of each free body."""

    def __init__(self, node: Any) -> None:
        super().__init__()
        self._node = node
        self._world = node.frame_prefix + messages.WORLD
        self._topics: dict[str, tuple[Publication, ...]] = {}
        self.follow(node.simulation)

    def follow(self, simulation: Simulation) -> None:
        """
        Create publishers for bodies that have come, and destroy those of bodies that have gone.

        To be called in the thread that spins the node, or before it spins.

        :param simulation: its free bodies are published from now on
        """
        names = [name for name in simulation.entities.free_names if TOKEN.fullmatch(name)]
        gone = {name: self._topics[name] for name in self._topics if name not in names}
        self._topics = {name: self._topics.get(name) or tuple(
            map(self._create, topics_of_objects([name]))) for name in names}
        self.replace(tuple(topic for topics in self._topics.values() for topic in topics))
        for topics in gone.values():
            for topic in topics:
                topic.output.close(self._node)

    def _create(self, row: Topic) -> Publication:
        read, make, count = _READERS[row.by]

        def numbers(simulation: Simulation) -> FloatArray | None:
            # The body may be gone before follow() is called.
            there = row.of in simulation.entities.free_names
            return read(simulation.entities, simulation.data, row.of) if there else None
        return Publication(create_output(self._node, row),
                           partial(make, self._world), numbers, count)


#: By the name in a row of the table: what is read of a body, its message and its size.
_READERS = {'object_pose': (Entities.pose, messages.pose_stamped, 7),
            'object_twist': (Entities.twist, messages.twist_stamped, 6)}
