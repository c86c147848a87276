# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which instruments of a world have topics, in which namespace, and what a user sets of them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Optional

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.interface.parameters import periods_per_image
from manip_sim.interface.scope import Scope
from manip_sim.interface.topics import Topic
from manip_sim.interface.world_topics import topics_of_sensors, truths
from manip_sim.models.cameras import MAX_RATE_HZ, MIN_RATE_HZ
from manip_sim.models.strict_yaml import parse_yaml
from manip_sim.quoting import quoted
from manip_sim.sensing.instruments import Instrument
from manip_sim.simulation import SimulatedRobot, Simulation


@dataclass(frozen=True)
class ServedInstrument:
    """
    An instrument with its topic.

    :ivar instrument: the instrument
    :ivar topic: the row of the table, filled in
    :ivar exact: whether its values are exact, without noise and latency
    """

    instrument: Instrument
    topic: Topic
    exact: bool = False


def served_instruments(simulation: Simulation, robots: Mapping[Scope, SimulatedRobot],
                       true: Collection[Scope] = (), noisy: Collection[str] = ()
                       ) -> list[ServedInstrument]:
    """
    Return the instruments of a world that have topics of their own.

    The force/torque sensor of a gripper is published as the wrench of its arm.

    :param simulation: of the world
    :param robots: by the scope of their topics; what belongs to none has no namespace, and the
        noise of the first
    :param true: of the robots whose exact values have topics too
    :param noisy: names of further instruments whose exact values have topics too
    """
    scopes = {sensor: scope for scope, robot in robots.items() for sensor in robot.sensor_names}
    of_arms = {reader.ft_frame for robot in robots.values()
               for reader in robot.end_effectors.values()}
    found: list[ServedInstrument] = []
    first = next(iter(robots), Scope())
    for instrument in simulation.sensors.instruments:
        if instrument.kind == 'wrench' and instrument.elements[0] in of_arms:
            continue
        scope = scopes.get(instrument.sensors[0], Scope())
        rows = topics_of_sensors([(instrument.topic, instrument.kind)])
        found += [ServedInstrument(instrument, replace(row, name=scope.topic(row.name)))
                  for row in rows]
        if (scope if scope in robots else first) in true or instrument.name in noisy:
            found += [ServedInstrument(instrument, replace(row, name=scope.topic(row.name)), True)
                      for row in truths(rows)]
    return found


_MAX_NOISE = 1e3


class SensorSettings:
    """
    The settings of sensors by name.

    :param given: descriptions; empty texts are ignored
    :param served: the instruments that have topics
    :param publish_rate: control periods per second [Hz]
    :raises ModelError: if a description cannot be used, on one line
    :raises UnknownNameError: if there is no such sensor
    :raises ParameterError: if a sensor is faster than ``publish_rate``
    :ivar every: after how many control periods a message comes
    :ivar rates_hz: of the sensors with fewer messages than control periods [Hz]
    :ivar noise: standard deviation on each number that is read, in its unit
    """

    def __init__(self, given: Sequence[str], served: Iterable[ServedInstrument],
                 publish_rate: float) -> None:
        self.every: dict[str, int] = {}
        self.rates_hz: dict[str, float] = {}
        self.noise: dict[str, float] = {}
        texts = [text for text in given if text]
        if not texts:
            return
        names = list(dict.fromkeys(one.instrument.name for one in served))
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
    from manip_sim.models.strict_descriptions import checked, Field, Number, Strict

    class SensorDescription(Strict):
        name: str
        rate: Optional[Annotated[Number, Field(  # noqa: UP045
            ge=MIN_RATE_HZ, le=MAX_RATE_HZ, allow_inf_nan=False)]] = None
        noise: Annotated[Number, Field(ge=0.0, le=_MAX_NOISE, allow_inf_nan=False)] = 0.0

    name = values.get('name')
    found = checked(SensorDescription, values,
                    'sensor without a name' if name is None else f'sensor {quoted(str(name))}')
    return found.name, found.rate, found.noise
