# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Topics that other packages add: what makes their messages, and how these classes are found."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
import inspect
from typing import Annotated, Any, ClassVar, Optional

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError, ModelError, UnknownNameError
from manip_sim.interface.parameters import periods_per_image
from manip_sim.interface.topics import PUBLISHED, Scope, Topic, topics_of
from manip_sim.models.user_files import parse_yaml
from manip_sim.quoting import quoted
from manip_sim.resources import Offer, offers
from manip_sim.sensing.images import MAX_RATE_HZ, MIN_RATE_HZ
from manip_sim.sensing.randomness import generator
from manip_sim.simulation import SimulatedRobot, Simulation

_MAX_NOISE = 1e3


class SensorSettings:
    """
    The settings of sensors by name.

    :param descriptions: descriptions; empty texts are ignored
    :param names: of the instruments that have topics
    :param publish_rate: control periods per second [Hz]
    :raises ModelError: if a description cannot be used, on one line
    :raises UnknownNameError: if the sensor is unknown
    :raises ParameterError: if a sensor is faster than ``publish_rate``
    :ivar every: after how many control periods a message comes
    :ivar rates_hz: of the sensors with fewer messages than control periods [Hz]
    :ivar noise: standard deviation on each number that is read, in its unit
    """

    def __init__(self, descriptions: Sequence[str], names: Iterable[str], publish_rate: float
                 ) -> None:
        self.every: dict[str, int] = {}
        self.rates_hz: dict[str, float] = {}
        self.noise: dict[str, float] = {}
        texts = [text for text in descriptions if text]
        if not texts:
            return
        names = list(dict.fromkeys(names))
        seen: set[str] = set()
        for text in texts:
            name, rate, noise = _described(parse_yaml(text, "one of 'sensors'"))
            if name not in names:
                raise UnknownNameError('sensor', name, names)
            if name in seen:
                raise ModelError(f'the sensor {quoted(name)} is described twice')
            seen.add(name)
            if rate is not None:
                self.every[name] = periods_per_image(publish_rate, rate, f'sensors: {name}')
                if self.every[name] > 1:
                    self.rates_hz[name] = publish_rate / self.every[name]
            if noise:
                self.noise[name] = noise


def _described(values: Mapping[str, Any]) -> tuple[str, float | None, float]:
    # Imported late: it needs pydantic 2, which Ubuntu 24.04 does not have.
    from manip_sim.models.descriptions import checked, Field, Number, Strict

    class SensorDescription(Strict):
        name: str
        rate: Optional[Annotated[Number, Field(  # noqa: UP045
            ge=MIN_RATE_HZ, le=MAX_RATE_HZ, allow_inf_nan=False)]] = None
        noise: Annotated[Number, Field(ge=0.0, le=_MAX_NOISE, allow_inf_nan=False)] = 0.0

    name = values.get('name')
    description = checked(
        SensorDescription, values,
        'sensor without a name' if name is None else f'sensor {quoted(str(name))}')
    return description.name, description.rate, description.noise


GROUP = 'manip_sim.sensors'


class TopicSource(ABC):
    """
    Makes the messages of a topic; one is created for each topic that the row stands for.

    :param simulation: which it may read, but not change
    :param robot: the robot whose topic it is; of a topic of the world the first robot
    :param of: the part or arm that it is of, such as ``right``; empty if the name has neither
    :cvar topic: its row; the name may hold ``<part>`` or ``<arm>``, or be private (``~/``)
    :ivar frame: the ``frame_id`` of messages with a header
    """

    topic: ClassVar[Topic]
    frame = ''

    def __init__(self, simulation: Simulation, robot: SimulatedRobot, of: str) -> None:
        self.simulation = simulation
        self.robot = robot
        self.of = of

    @abstractmethod
    def write(self, message: Any, simulation: Simulation) -> bool | None:
        """
        Write the present instant into a new message, whose stamp and frame are there already.

        It is called in the simulation's thread, at the end of a control period, while somebody
        subscribes. Objects that come or go give the simulation another model.

        :returns: False to publish no message
        """


class Sensor(TopicSource):
    """
    A topic of numbers: they are read, noise is added, then they are written into the message.

    Noise depends on the seed of the episode, the topic and the steps since the last reset only, so
    that it is the same whoever subscribes, and a state that is repeated has the same noise again.
    """

    @abstractmethod
    def read(self, simulation: Simulation) -> FloatArray:
        """Return the exact numbers of the present instant, in SI units, shape (n,)."""

    def add_noise(self, values: FloatArray, random: np.random.Generator) -> FloatArray:
        """Return numbers with noise, shape (n,); by default those that were read."""
        return values

    @abstractmethod
    def fill(self, message: Any, values: FloatArray) -> None:
        """Write numbers into a new message, whose stamp and frame are there already."""

    def write(self, message: Any, simulation: Simulation) -> None:
        """
        Write what :meth:`measure` returns into the message.

        :raises ModelError: if the reading is not a row of finite numbers
        """
        self.fill(message, self.measure(simulation))

    def measure(self, simulation: Simulation) -> FloatArray:
        """
        Return the numbers of the present instant with noise, shape (n,).

        :raises ModelError: if the reading is not a row of finite numbers
        """
        name = f'{self.topic.name} {self.robot.name} {self.of}'
        sensing = self.robot.sensing
        random = generator(sensing.seed, name, sensing.count)
        values = np.asarray(self.add_noise(self.read(simulation), random), dtype=np.float64)
        if values.ndim != 1 or not np.isfinite(values).all():
            raise ModelError(f'must read a row of finite numbers, got {values!r:.60}')
        return values


class Offered:
    """
    A topic that another package adds to a node.

    :param offer: the entry point
    :param source: its class
    :param robot: the robot
    :ivar scope: namespace of the topics of the robot
    :ivar topic: its row, filled in
    :ivar offer: the entry point
    """

    def __init__(self, topic: Topic, offer: Offer, source: type[TopicSource],
                 scope: Scope, robot: SimulatedRobot) -> None:
        self.scope = scope
        self.topic = topic
        self.offer = offer
        self._source = source
        self._robot = robot

    def create(self, simulation: Simulation) -> TopicSource:
        """
        Return what makes the messages.

        :raises ModelError: if that raises anything
        """
        try:
            return self._source(simulation, self._robot, self.topic.of)
        except Exception as error:  # A class of another package may raise anything.
            raise ModelError(f'{type(error).__name__}: {error}') from error


def offered_topics(robots: Mapping[Scope, SimulatedRobot], listed: Iterable[Topic],
                   warn: Callable[[str], object]) -> list[Offered]:
    """
    Return the topics that other packages add; one that cannot be used does not hide the others.

    :param robots: by the scope of their topics
    :param listed: the topics that are there already
    :param warn: is called with a line about each class that cannot be used
    """
    owners: dict[str, object] = dict.fromkeys((topic.name for topic in listed), 'manip_sim')
    offered: list[Offered] = []
    for offer in offers(GROUP).values():
        try:
            source = _load(offer)
            for topic, scope, robot in filled_in(source.topic, robots):
                owner = owners.setdefault(topic.name, offer)
                if owner is not offer:
                    raise ModelError(f"its topic '{topic.name}' is that of {owner}")
                if topic.name not in {other.topic.name for other in offered}:
                    offered.append(Offered(topic, offer, source, scope, robot))
        except ManipSimError as error:
            warn(f'sensor {offer} cannot be used: {error}')
            offered = [other for other in offered if other.offer is not offer]
    return offered


def _load(offer: Offer) -> type[TopicSource]:
    source = offer.load()
    if not (inspect.isclass(source) and issubclass(source, TopicSource)
            and not inspect.isabstract(source)):
        raise ModelError(f'must be a class that derives from Sensor or TopicSource and has their '
                         f'methods, got {source!r:.60}')
    topic = getattr(source, 'topic', None)
    if not (isinstance(topic, Topic) and topic.direction == PUBLISHED and not topic.needs
            and topic.type.count('/') == 1):
        raise ModelError(f'its topic must be a row that is published, got {topic!r:.200}')
    return source


def filled_in(row: Topic, robots: Mapping[Scope, SimulatedRobot]
              ) -> Iterator[tuple[Topic, Scope, SimulatedRobot]]:
    """Yield the topics that a row of another package stands for, each with its robot."""
    for scope, robot in robots.items():
        for topic in topics_of(robot.parts, twist=True, rows=[row]):
            yield replace(topic, name=scope.topic(topic.name)), scope, robot
