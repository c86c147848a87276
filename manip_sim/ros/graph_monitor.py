# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Conflicts of a node with others: names, topics of two publishers, and what does not match."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import difflib
from itertools import chain, islice
import time
from typing import Any

from rclpy.node import Node, NodeNameNonExistentError
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

from manip_sim.interface.topics import Scope
from manip_sim.quoting import one_line, quoted, quoted_names
from manip_sim.rclpy_internals import describe_unheard, endpoint_counts, is_unheard

#: Programs of this package; what they publish may outlive a node by a moment.
_OWN_PROGRAMS = ('sim_view', 'pick_cube', 'hand_over')
#: Least similarity of a topic with one end to a topic of the node with the other end.
_SIMILAR = 0.8
#: The packages of services that every node has, so that a call of one may be for any other node.
_OF_EVERY_NODE = ('rcl_interfaces', 'type_description_interfaces')
#: Longest time of messages of a node after its endpoints [s].
_UNHEARD_S = 5.0
#: Greatest number of conflicts that are reported.
_MOST_CONFLICTS = 20


class GraphMonitor:
    """
    Conflicts with other nodes; each is logged once for as long as it lasts.

    A conflict is reported when two looks in a row find it, because discovery has no order: the
    name of a node may come after its endpoints. As long as neither the graph nor the conflicts
    change, a look is a comparison of the names and numbers of its endpoints.

    :param scopes: namespace of the topics of each robot
    """

    def __init__(self, node: Node, scopes: Sequence[Scope]) -> None:
        self._node = node
        self._graph: tuple[Any, ...] = ()
        self._looks = 0
        self._unheard_since_s: float | None = None
        self._found: dict[str, str] = {}
        self._reported: dict[str, str] = {}
        self._own = (node.get_name(), node.get_namespace())
        self._topics = {
            '/clock': 'time goes back and forth; set publish_clock:=false in all but one',
            **{node.resolve_topic_name(scope.topic('joint_states')):
               'subscribers see two robots in one; give each node a namespace'
               for scope in scopes}}

    def conflicts(self) -> list[str]:
        """
        Return the present conflicts: names, topics of two publishers, and what does not match.

        To be called from time to time; new conflicts are logged as warnings.
        """
        topics = self._node.get_topic_names_and_types()
        graph = (self._node.get_node_names_and_namespaces(), topics,
                 self._node.get_service_names_and_types(),
                 endpoint_counts(self._node, [name for name, _ in topics]))
        if graph != self._graph:
            self._graph, self._looks = graph, 2
        if self._looks:
            self._looks -= 1
            self._look(dict(topics))
        return list(self._reported.values())

    def _look(self, topics: Mapping[str, Sequence[str]]) -> None:
        seen = {**self._same_name(), **self._same_topics(), **self._unheard(),
                **{text: text for text in islice(chain(
                    self._mismatches(topics), self._missed_services()), _MOST_CONFLICTS)}}
        confirmed = {key: text for key, text in seen.items() if key in self._found}
        for key in confirmed.keys() - self._reported.keys():
            self._node.get_logger().warning(confirmed[key])
        if seen != self._found or self._unheard_since_s is not None and 'unheard' not in seen:
            self._looks = max(1, self._looks)
        self._found, self._reported = seen, confirmed

    def _same_name(self) -> dict[str, str]:
        count = self._node.get_node_names_and_namespaces().count(self._own)
        if count < 2:
            return {}
        return {'name': f'{count} nodes are named {self._node.get_fully_qualified_name()}: '
                'services and parameters reach any of them; rename all but one with '
                '-r __node:=NAME (one that was killed counts for 20 s more)'}

    def _unheard(self) -> dict[str, str]:
        text = describe_unheard(self._node)
        if not text:
            self._unheard_since_s = None
        elif self._unheard_since_s is None:
            self._unheard_since_s = time.monotonic()
        elif time.monotonic() - self._unheard_since_s > _UNHEARD_S:
            return {'unheard': text}
        return {}

    def _same_topics(self) -> dict[str, str]:
        published = [publisher.topic_name for publisher in self._node.publishers]
        others = {topic: self._others(topic) for topic in self._topics if topic in published}
        return {topic: f'{topic} is also published by {names}: {self._topics[topic]}'
                for topic, names in others.items() if names}

    def _others(self, topic: str) -> str:
        names = [(info.node_name, info.node_namespace)
                 for info in self._node.get_publishers_info_by_topic(topic)
                 if not is_unheard(info)]
        if self._own in names:
            # One of the nodes that have this name is this node.
            names.remove(self._own)
        return quoted_names(sorted({f'{space.rstrip("/")}/{name}' for name, space in names}))

    def _mismatches(self, topics: Mapping[str, Sequence[str]]) -> Iterator[str]:
        """Yield a line for each endpoint of others that does not match one of this node."""
        node = self._node
        taken, published = _types(node.subscriptions), _types(node.publishers)
        for topic, kind in taken.items():
            for info in self._others_of(node.get_publishers_info_by_topic(topic)):
                if info.topic_type != kind:
                    yield (f'{topic} takes {_short(kind)}; {_name(info)} publishes '
                           f'{_short(info.topic_type)}{_taking(topic, info.topic_type, taken)}')
                elif reason := _incompatible([(info.qos_profile, qos) for qos in self._own_qos(
                        node.get_subscriptions_info_by_topic(topic))]):
                    yield f'{topic} cannot take what {_name(info)} publishes: {reason}'
        for topic, kind in published.items():
            for info in self._others_of(node.get_subscriptions_info_by_topic(topic)):
                if info.topic_type != kind:
                    yield (f'{topic} is {_short(kind)}; {_name(info)} subscribes to '
                           f'{_short(info.topic_type)}')
                elif reason := _incompatible([(qos, info.qos_profile) for qos in self._own_qos(
                        node.get_publishers_info_by_topic(topic))]):
                    yield f'{_name(info)} cannot receive {topic}: {reason}'
        for topic in sorted(topics.keys() - taken.keys() - published.keys()):
            senders = node.get_publishers_info_by_topic(topic)
            readers = node.get_subscriptions_info_by_topic(topic)
            if senders and readers:
                continue
            other, verb, names = (('publishes', 'takes', taken) if senders else
                                  ('subscribes to', 'publishes', published))
            near = _nearest(topic, topics[topic], names)
            for info in self._others_of([*senders, *readers] if near else ()):
                yield (f'{_name(info)} {other} {quoted(topic)}, which nobody {verb}; this node '
                       f'{verb} {near}')

    def _missed_services(self) -> Iterator[str]:
        """Yield a line for each service that others wait for, and that this node has otherwise."""
        node = self._node
        services = {service: kinds for service, kinds in node.get_service_names_and_types_by_node(
            *self._own) if kinds[0].partition('/')[0] not in _OF_EVERY_NODE}
        for name, space in node.get_node_names_and_namespaces():
            if (name, space) == self._own or name in _OWN_PROGRAMS:
                continue
            try:
                asked = node.get_client_names_and_types_by_node(name, space)
            except NodeNameNonExistentError:  # It has ended.
                continue
            for service, kinds in asked:
                client = quoted(f'{space.rstrip("/")}/{name}')
                if service in services and not set(kinds) <= set(services[service]):
                    yield (f'{service} is {_short(services[service][0])}; {client} calls it as '
                           f'{_short(kinds[0])}')
                elif not node.count_services(service):
                    last = f"/{service.rpartition('/')[2]}"
                    alike = [other for other in services if other.endswith(last)]
                    for near in difflib.get_close_matches(service, alike, n=1, cutoff=0.0):
                        yield (f'{client} calls {quoted(service)}, which nobody offers; this node '
                               f'offers {near}')

    def _others_of(self, infos: Sequence[TopicEndpointInfo]) -> Iterator[TopicEndpointInfo]:
        for info in infos:
            if not (self._is_own(info) or is_unheard(info)
                    or info.node_name in _OWN_PROGRAMS):
                yield info

    def _own_qos(self, infos: Sequence[TopicEndpointInfo]) -> list[QoSProfile]:
        # As the middleware has them: in the node's own profiles, zero stands for a default.
        return [info.qos_profile for info in infos if self._is_own(info)]

    def _is_own(self, info: TopicEndpointInfo) -> bool:
        return (info.node_name, info.node_namespace) == self._own


def _types(own: Iterator[Any]) -> dict[str, str]:
    """Return the types of the publishers or subscriptions of the node, by topic."""
    return {endpoint.topic_name: f'{endpoint.msg_type.__module__.partition(".")[0]}/msg/'
            f'{endpoint.msg_type.__name__}' for endpoint in list(own)}


def _incompatible(pairs: Sequence[tuple[QoSProfile, QoSProfile]]) -> str:
    """Return why none of some pairs of publisher and subscription match, or nothing."""
    results = [qos_check_compatible(*pair) for pair in pairs]
    if not results or any(result != QoSCompatibility.ERROR for result, _ in results):
        return ''
    return results[0][1].replace('ERROR: ', '').rstrip(';').replace(';', ', ').lower()


def _taking(topic: str, kind: str, taken: Mapping[str, str]) -> str:
    """Return the hint that another topic with a similar name takes a type."""
    near = difflib.get_close_matches(
        topic, [name for name, other in taken.items() if other == kind], n=1, cutoff=0.7)
    return f', which {near[0]} takes' if near else ''


def _nearest(topic: str, kinds: Sequence[str], taken: Mapping[str, str]) -> str | None:
    """Return the topic of the node that was probably meant by one that it does not have."""
    in_other_namespace = [name for name in taken if name.endswith(topic) or topic.endswith(name)]
    of_one_kind = [name for name, kind in taken.items()
                   if kind in kinds and name.rpartition('/')[2] == topic.rpartition('/')[2]]
    for names, similarity in ((in_other_namespace, 0.0), (of_one_kind, 0.0), (taken, _SIMILAR)):
        near = difflib.get_close_matches(topic, names, n=1, cutoff=similarity)
        if near:
            return near[0]
    return None


def _short(kind: str) -> str:
    return one_line(kind.rpartition('/')[2])


def _name(info: TopicEndpointInfo) -> str:
    return quoted(f'{info.node_namespace.rstrip("/")}/{info.node_name}')
