# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Features that other packages add: how their classes are found, and what becomes of failures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import inspect
from typing import NamedTuple

from rclpy.parameter import Parameter

from manip_sim.entry_points import Offer, offers
from manip_sim.errors import ManipSimError, ModelError, SimulationEnded
from manip_sim.interface.offered_sensors import filled_in
from manip_sim.interface.parameter_spec import ParameterSpec
from manip_sim.interface.topics import Scope, Topic
from manip_sim.quoting import one_line
from manip_sim.ros.declared_parameters import Parameters
from manip_sim.ros.feature import Feature, NodeContext
from manip_sim.simulation import SimulatedRobot

GROUP = 'manip_sim.features'
#: Whatever logs a line.
Warn = Callable[[str], object]


class FeatureClass(NamedTuple):
    """A class of another package, and the entry point that names it."""

    offer: Offer
    feature: type[Feature]


def load_features(parameters: Parameters, warn: Warn) -> list[FeatureClass]:
    """
    Return the features that other packages offer, whose parameters are declared afterwards.

    :param warn: is called with a line about each class that cannot be used
    :raises ParameterError: if the value that the user gave for a parameter cannot be used
    """
    loaded = []
    for offer in offers(GROUP).values():
        try:
            feature = _load(offer)
            taken = {spec.name for spec in feature.parameters} & {*parameters.names}
            if taken:
                raise ModelError(f"its parameter '{min(taken)}' exists already")
        except ManipSimError as error:
            warn(one_line(f'feature {offer} cannot be used: {error}'))
            continue
        parameters.declare(feature.parameters)
        loaded.append(FeatureClass(offer, feature))
    return loaded


def _load(offer: Offer) -> type[Feature]:
    feature = offer.load()
    if not (inspect.isclass(feature) and issubclass(feature, Feature)):
        raise ModelError(f'must be a class that derives from Feature, got {feature!r:.60}')
    for kind, rows in ((Topic, feature.topics), (ParameterSpec, feature.parameters)):
        if not (isinstance(rows, Sequence) and all(isinstance(row, kind) for row in rows)):
            raise ModelError(f'its {kind.__name__} rows must be a list of these, got {rows!r:.60}')
    return feature


def add_offered_features(context: NodeContext, classes: Sequence[FeatureClass], warn: Warn
                         ) -> None:
    """
    Add the features of other packages; one that cannot be created does not hide the others.

    :param classes: whose parameters are declared
    """
    for offer, feature in classes:
        before = [*context.table]
        try:
            context.features.append(OfferedFeature(context, offer, feature))
        except Exception as error:  # Code of another package may raise anything.
            context.table[:] = before
            warn(one_line(
                f'feature {offer} cannot be used: {type(error).__name__}: {error}'))


class OfferedFeature(Feature):
    """
    A feature of another package; an exception of a method is logged and counted.

    :raises Exception: what its constructor raises; :class:`ModelError`, if one of its topics
        exists already
    """

    def __init__(self, context: NodeContext, offer: Offer, feature: type[Feature]) -> None:
        self._context, self._offer, self._rows = context, offer, feature.topics
        self._list_topics(context.robots)
        self._feature = feature(context)

    def _list_topics(self, robots: Mapping[Scope, SimulatedRobot]) -> None:
        table = self._context.table
        for row in self._rows:
            for topic, _, _ in filled_in(row, robots):
                # A private topic is of the node: it is the same for each robot.
                if topic in table and topic.name == row.name:
                    continue
                if topic.name in {other.name for other in table}:
                    raise ModelError(f"its topic '{topic.name}' exists already")
                table.append(topic)

    def _call(self, method: Callable[[], None]) -> None:
        try:
            method()
        except SimulationEnded:
            raise
        except Exception as error:  # Code of another package may raise anything.
            self._context.log.failure('features', f'feature {self._offer}', error)

    def start(self) -> None:
        self._call(self._feature.start)

    def started(self) -> None:
        self._call(self._feature.started)

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        def add() -> None:
            self._list_topics({scope: robot})
            self._feature.robot_added(scope, robot)
        self._call(add)

    def robot_removed(self, scope: Scope) -> None:
        self._call(lambda: self._feature.robot_removed(scope))

    def world_changed(self) -> None:
        self._call(self._feature.world_changed)

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        self._call(lambda: self._feature.parameters_changed(parameters))

    def close(self) -> None:
        self._call(self._feature.close)
