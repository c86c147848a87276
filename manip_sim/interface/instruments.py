# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which instruments of a world have topics, and in the namespace of which robot."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from manip_sim.interface.topics import Scope, Topic
from manip_sim.interface.world_topics import topics_of_sensors, truths
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
