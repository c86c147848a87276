# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The robots of a running world, and the measurements of the sensors of its model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.seats import Seats
from manip_sim.models.robots import RobotModel
from manip_sim.physics.clock import Clock
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.entities import Entities
from manip_sim.physics.external_wrench import ExternalWrench
from manip_sim.physics.physics import Physics
from manip_sim.physics.state_dependent_terms import FrictionLaws
from manip_sim.sensing.instruments import Instrument, Sensors
from manip_sim.sensing.robot_sensing import RobotSensing
from manip_sim.sensing.sensor_noise import InstrumentChannel
from manip_sim.simulation.robot import SimulatedRobot

#: Begin of the names of the channels of instruments.
_CHANNELS = 'sensors/'


class RobotSet:
    """
    The robots of a world, with the updates that each of them needs when the model is replaced.

    :param physics: of the world at the start, after ``mj_forward``
    :param efforts: of the actuators of the model
    :param clock: of the simulation
    :param robots: that are there at the start, all of the model
    :ivar by_name: the robots, in the order of the model
    :ivar entities: the robots and the free bodies
    """

    def __init__(self, physics: Physics, efforts: ActuatorEfforts, clock: Clock,
                 robots: Iterable[RobotModel]) -> None:
        self._physics, self._efforts, self._clock = physics, efforts, clock
        self.by_name: dict[str, SimulatedRobot] = {}
        self._adapts: dict[str, list[Callable[[], None]]] = {}
        self._laws: dict[str, FrictionLaws] = {}
        for robot in robots:
            self._create(robot)
        self._at_start = frozenset(self.by_name)
        physics.on_change(self._adapt)

    def _create(self, robot: RobotModel) -> SimulatedRobot:
        with self._physics.collected() as adapts:
            made = SimulatedRobot(self._physics, robot, self._efforts, self._clock)
            if robot.friction_laws:
                self._laws[made.name] = FrictionLaws(self._physics, robot.friction_laws)
        self.by_name[made.name], self._adapts[made.name] = made, adapts
        return made

    def _adapt(self) -> None:
        for adapts in self._adapts.values():
            for adapt in adapts:
                adapt()
        self._find_entities()

    def _find_entities(self) -> None:
        spawned, robots = self.spawned, self.by_name.values()
        self.entities = Entities(self._physics.model, {
            robot.name if robot.name in spawned else robot.robot_model.root_body: robot.frame_body
            for robot in robots}, [robot.robot_model.root_body for robot in robots])

    @property
    def spawned(self) -> list[str]:
        """Names of the robots that were not there at the start."""
        return [name for name in self.by_name if name not in self._at_start]

    @property
    def tools(self) -> list[ExternalWrench]:
        """The external wrenches of all grippers."""
        return [reader.external for robot in self.by_name.values()
                for reader in robot.end_effectors.values()]

    @property
    def laws(self) -> list[FrictionLaws]:
        """The laws of the joints, of the robots that have such."""
        return [*self._laws.values()]

    @property
    def seats(self) -> list[Seats]:
        """The laws of users, of each robot."""
        return [robot.joints.seats for robot in self.by_name.values()]

    def delete(self, name: str) -> None:
        """Delete a robot, before its model is; its commands are aborted."""
        self.by_name.pop(name).abort(f"robot '{name}' was deleted")
        self._adapts.pop(name)
        self._laws.pop(name, None)

    def begin(self, robot: RobotModel, start: Mapping[str, float], seed: int) -> None:
        """
        Let a robot that is in the model now begin, at rest.

        :param start: of its joints, by name [rad or m]
        :param seed: of the noise of its sensors
        """
        model, data = self._physics.model, self._physics.data
        for joint, position in start.items():
            data.joint(joint).qpos[0] = position
        mujoco.mj_forward(model, data)
        made = self._create(robot)
        made.reset()
        mujoco.mj_forward(model, data)
        self._efforts.restart(np.concatenate(
            [part.dof_addresses for part in made.parts.values()]))
        for reader in made.end_effectors.values():
            reader.external.reset(data)
        made.sensing.reset(seed)
        self._find_entities()


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
            sensing.add(_CHANNELS + instrument.name, partial(self._exact, instrument),
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

    def _exact(self, instrument: Instrument) -> FloatArray:
        return instrument.read(self._physics.data)

    def measured(self, instrument: Instrument) -> FloatArray:
        """
        Return what an instrument of the model measures, with noise and latency.

        :param instrument: one of the instruments of :attr:`sensors`
        :returns: as ``Instrument.read``
        """
        sensing = self._sensing.get(instrument.name)
        if sensing is None or not (sensing.settings.measures or instrument.name in self._noise):
            return self._exact(instrument)
        return sensing.measured(_CHANNELS + instrument.name)
