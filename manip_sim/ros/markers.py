# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish contacts and external wrenches as markers, for RViz and the like."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from geometry_msgs.msg import Point
import numpy as np
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from manip_sim.arrays import FloatArray
from manip_sim.interface.topics import BY_NAME
from manip_sim.physics.contacts import read_contacts
from manip_sim.physics.end_effectors import EndEffectorReader
from manip_sim.ros import messages
from manip_sim.ros.lazy_publishers import create_output
from manip_sim.ros.node_context import NodeContext
from manip_sim.simulation import Simulation

#: Length of the arrow of a force [m/N].
FORCE_SCALE = 0.01
#: Length of the arrow of a torque [m/(N m)].
TORQUE_SCALE = 0.1
#: Diameters of points, shafts and heads of arrows [m].
_POINT_M, _SHAFT_M, _HEAD_M = 0.008, 0.006, 0.012
#: Shorter arrows are left out, as their direction cannot be seen [m].
_SHORTEST_M = 1e-6
_ORANGE, _YELLOW = (1.0, 0.55, 0.0), (1.0, 0.9, 0.1)
_RED, _BLUE = (0.9, 0.15, 0.15), (0.25, 0.45, 1.0)


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
        self._header = Header(frame_id=context.frame_prefix + messages.WORLD)
        self._all_gone = Marker(header=self._header, action=Marker.DELETEALL)
        self._points = self._marker('contact_points', 0, Marker.SPHERE_LIST, _ORANGE,
                                    (_POINT_M, _POINT_M, _POINT_M))
        self._arrows: dict[tuple[str, int], Marker] = {}

    def _marker(self, namespace: str, number: int, kind: int, color: tuple[float, ...],
                scale: tuple[float, ...]) -> Marker:
        marker = Marker(header=self._header, ns=namespace, id=number, type=kind,
                        color=ColorRGBA(r=color[0], g=color[1], b=color[2], a=0.9))
        marker.scale.x, marker.scale.y, marker.scale.z = scale
        return marker

    def look(self) -> bool:
        return self._output.has_subscribers

    def publish(self, simulation: Simulation) -> None:
        self._header.stamp = messages.stamp_of(simulation.time_ns)
        markers = [self._all_gone]
        contacts = read_contacts(simulation.model, simulation.data)
        if len(contacts.position):
            self._points.points = [_point(at) for at in contacts.position]
            markers.append(self._points)
        markers += self._arrows_of('contact_forces', _YELLOW, contacts.position,
                                   FORCE_SCALE * contacts.force)
        for name, reader in self._end_effectors.items():
            markers += self._wrench(simulation.data, name, reader)
        self._output.publish(MarkerArray(markers=markers))

    def _wrench(self, data: Any, name: str, reader: EndEffectorReader) -> list[Marker]:
        site = data.site(reader.ft_frame)
        wrench, to_world = reader.read(data).external_wrench, site.xmat.reshape(3, 3)
        return [marker for what, color, vector in (
            ('force', _RED, FORCE_SCALE * wrench.force),
            ('torque', _BLUE, TORQUE_SCALE * wrench.torque))
            for marker in self._arrows_of(f'{name}/external_{what}', color, [site.xpos],
                                          [to_world @ vector])]

    def _arrows_of(self, namespace: str, color: tuple[float, ...],
                   starts: Iterable[FloatArray], vectors: Iterable[FloatArray]) -> list[Marker]:
        markers: list[Marker] = []
        for start, vector in zip(starts, vectors):
            if not np.linalg.norm(vector) > _SHORTEST_M:
                continue
            key = namespace, len(markers)
            if key not in self._arrows:
                self._arrows[key] = self._marker(*key, Marker.ARROW, color,
                                                 (_SHAFT_M, _HEAD_M, 0.0))
            self._arrows[key].points = [_point(start), _point(start + vector)]
            markers.append(self._arrows[key])
        return markers


def _point(position: FloatArray) -> Point:
    x, y, z = position.tolist()
    return Point(x=x, y=y, z=z)
