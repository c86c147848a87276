# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Look for other nodes that publish the same time or states, or have the same name."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.node import Node

from manip_sim.quoting import quoted_names
from manip_sim.interface.scope import Scope


class Neighbours:
    """
    Conflicts with other nodes; each is logged once for as long as it lasts.

    :param node: the node
    :param scopes: namespace of the topics of each robot
    """

    def __init__(self, node: Node, scopes: Sequence[Scope]) -> None:
        self._node = node
        self._told: set[str] = set()
        self._own = (node.get_name(), node.get_namespace())
        self._topics = {
            '/clock': 'time goes back and forth; set publish_clock:=false in all but one',
            **{node.resolve_topic_name(scope.topic('joint_states')):
               'subscribers see two robots in one; give each node a namespace'
               for scope in scopes}}

    def conflicts(self) -> list[str]:
        """
        Return the present conflicts: nodes of the same name, publishers of the same topics.

        To be called from time to time; new conflicts are logged as warnings.
        """
        found = {**self._same_name(), **self._same_topics()}
        for what in found.keys() - self._told:
            self._node.get_logger().warning(found[what])
        self._told = set(found)
        return list(found.values())

    def _same_name(self) -> dict[str, str]:
        count = self._node.get_node_names_and_namespaces().count(self._own)
        if count < 2:
            return {}
        return {'name': f'{count} nodes are named {self._node.get_fully_qualified_name()}: '
                'services and parameters reach any of them; rename all but one with '
                '-r __node:=NAME (one that was killed counts for 20 s more)'}

    def _same_topics(self) -> dict[str, str]:
        own = [publisher.topic_name for publisher in self._node.publishers]
        others = {topic: self._others(topic) for topic in self._topics if topic in own}
        return {topic: f'{topic} is also published by {names}: {self._topics[topic]}'
                for topic, names in others.items() if names}

    def _others(self, topic: str) -> str:
        names = [(info.node_name, info.node_namespace)
                 for info in self._node.get_publishers_info_by_topic(topic)]
        if self._own in names:
            # One of the nodes that have this name is this node.
            names.remove(self._own)
        return quoted_names(sorted({f'{space.rstrip("/")}/{name}' for name, space in names}))
