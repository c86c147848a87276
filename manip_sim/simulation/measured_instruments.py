# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Measurements of the sensors of a model: each has the noise and latency of a robot."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from manip_sim.arrays import FloatArray
from manip_sim.physics.physics import Physics
from manip_sim.sensing.instruments import Instrument, Sensors
from manip_sim.sensing.robot_sensing import RobotSensing
from manip_sim.sensing.sensor_noise import InstrumentChannel
from manip_sim.simulation.robot import SimulatedRobot

#: Begin of the names of the channels of instruments.
_CHANNELS = 'sensors/'


class MeasuredInstruments:
    """
    The instruments of a model, with the noise of their robots; the world's with the first one's.

    :param physics: of the world
    :param robots: whose sensing measures, by name, as they are when the model is replaced; without
        one, all values are exact
    :ivar sensors: values of all sensors of the model, by name
    """

    def __init__(self, physics: Physics, robots: Mapping[str, SimulatedRobot]) -> None:
        self._physics, self._robots = physics, robots
        self._noise: dict[str, float] = {}
        self.sensors = Sensors(physics, self.measured)
        physics.on_change(self.rebind)

    def rebind(self) -> None:
        """Find the instruments of the model, and the robots that they belong to."""
        self._sensing: dict[str, RobotSensing] = {}
        robots = [*self._robots.values()]
        if not robots:
            return
        owners = {name: robot for robot in robots for name in robot.sensor_names}
        for robot in robots:
            robot.sensing.forget(_CHANNELS)
        for instrument in self.sensors.instruments:
            owner = owners.get(instrument.sensors[0], robots[0])
            sensing = self._sensing[instrument.name] = owner.sensing
            sensing.add(_CHANNELS + instrument.name, partial(self._exact, instrument.name),
                        InstrumentChannel(instrument, self._physics.model,
                                          self._noise.get(instrument.name, 0.0)))

    def set_noise(self, noise: Mapping[str, float]) -> None:
        """
        Add white noise to single instruments, whatever the settings of their robots are.

        :param noise: standard deviation on each number that is read, in its unit, by the name of
            the instrument
        """
        self._noise = dict(noise)
        self.rebind()

    def sensing_of(self, body: int) -> RobotSensing:
        """
        Return the sensing of the robot that has a body, or of the first one.

        :param body: its id
        """
        model, names = self._physics.model, set()
        while body:
            names.add(model.body(body).name)
            body = int(model.body_parentid[body])
        robots = [*self._robots.values()]
        return next((robot for robot in robots if robot.robot_model.root_body in names),
                    robots[0]).sensing

    def _exact(self, name: str) -> FloatArray:
        instrument = self.sensors.instrument(name)
        assert instrument is not None
        return instrument.read(self._physics.data)

    def measured(self, instrument: Instrument) -> FloatArray:
        """
        Return what an instrument of the model measures, with noise and latency.

        :param instrument: one of the instruments of :attr:`sensors`
        :returns: as ``Instrument.read``
        """
        sensing = self._sensing.get(instrument.name)
        if sensing is None or not (sensing.settings.measures or instrument.name in self._noise):
            return instrument.read(self._physics.data)
        return sensing.measured(_CHANNELS + instrument.name)
