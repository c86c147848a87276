# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish what the instruments of a model measure; those of objects may come and go."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from functools import partial
import math
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
import numpy as np
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, MagneticField, Range
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from manip_sim.arrays import FloatArray
from manip_sim.interface.scope import Scope
from manip_sim.interface.served_instruments import (
    SensorSettings, served_instruments, ServedInstrument)
from manip_sim.ros.feature import Feature
from manip_sim.ros.lazy_publishers import create_output, Publication, Publications
from manip_sim.ros.messages import stamped
from manip_sim.ros.node_context import NodeContext
from manip_sim.sensing.instruments import (
    IMU, Instrument, MAGNETIC_FIELD, RANGE, VALUES, WRENCH)
from manip_sim.simulation import Simulation

#: What an entry of a covariance is set to where there is no such sensor (sensor_msgs/Imu).
_NONE = -1.0
#: Rows of a tactile sensor: depths, and speeds of sliding along two tangents.
_TACTILE_CHANNELS = 3


class InstrumentPublishers(Publications, Feature):
    """
    Publishers of all instruments of a world, but for the gripper's, which have topics of the arms.

    :raises ManipSimError: if the parameter ``sensors`` cannot be used
    :ivar rates_hz: of the sensors with fewer messages than control periods [Hz]
    """

    def __init__(self, context: NodeContext) -> None:
        super().__init__()
        simulation = context.simulation
        served = served_instruments(simulation, context.robots)
        settings = SensorSettings(context.parameters.value('sensors'), served,
                                  1.0 / context.thread.period_s)
        if settings.noise:
            simulation.instruments.set_noise(settings.noise)
        self._every = settings.every
        self.rates_hz = settings.rates_hz
        self._context = context
        self._topics: dict[str, tuple[ServedInstrument, Publication]] = {}
        #: Robots whose exact values are published too.
        self._true: frozenset[Scope] = frozenset()
        self._noisy = frozenset(settings.noise)
        self.world_changed()
        context.thread.observe(self.publish, look=self.look)

    def robot_removed(self, scope: Scope) -> None:
        self._true -= {scope}

    def world_changed(self) -> None:
        """Create publishers for instruments that have come, and destroy those of what has gone."""
        served = {one.topic.name: one for one in served_instruments(
            self._context.simulation, self._context.robots, self._true, self._noisy)}
        gone = {name: publication for name, (one, publication) in self._topics.items()
                if name not in served or not _alike(served[name], one)}
        self._topics = {name: (one, self._topics[name][1] if name in self._topics
                               and name not in gone else self._create(one))
                        for name, one in served.items()}
        self.replace(tuple(publication for _, publication in self._topics.values()))
        for publication in gone.values():
            publication.output.close(self._context.node)
        table = self._context.table
        table[:] = [row for row in table if row.name not in gone or row.name in served]

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        """Also publish exact values of instruments of robots with noise, below ``truth/``."""
        noisy = {scope for scope, robot in self._context.robots.items()
                 if robot.sensing.settings.measures}
        if noisy - self._true:
            self._true |= noisy
            self.world_changed()

    def _create(self, served: ServedInstrument) -> Publication:
        found, name = served.instrument, served.topic.name
        frame = self._context.frame_prefix + found.frame if found.frame else ''
        if served.topic not in self._context.table:
            self._context.table.append(served.topic)
        return Publication(
            create_output(self._context, served.topic), _MAKERS[found.kind](frame, found),
            lambda simulation: self._read(name, simulation), found.length,
            self._every.get(found.name, 1))

    def publish(self, simulation: Simulation) -> None:
        """Publish the present instant of what has subscribers and is due."""
        for topic in self._subscribed:
            if topic.every == 1 or self._context.thread.is_due(topic.every):
                topic.publish(simulation)

    def _read(self, name: str, simulation: Simulation) -> FloatArray | None:
        # Objects that have come or gone make another model before world_changed() is called.
        served, _ = self._topics[name]
        found = simulation.sensors.instrument(served.instrument.name)
        if found is None:
            return None
        return (found.read(simulation.data) if served.exact
                else simulation.instruments.measured(found))


def _alike(one: ServedInstrument, other: ServedInstrument) -> bool:
    """Tell whether the messages of two instruments differ in their numbers only."""
    return all(getattr(one.instrument, field) == getattr(other.instrument, field)
               for field in ('kind', 'frame', 'types', 'elements', 'length', 'reach'))


def _imu(frame_id: str, found: Instrument) -> Callable[[Time, FloatArray], Imu]:
    def make(stamp: Time, numbers: FloatArray) -> Imu:
        message: Imu = stamped(Imu, frame_id, stamp, numbers)
        for kind, field in (('framequat', message.orientation_covariance),
                            ('gyro', message.angular_velocity_covariance),
                            ('accelerometer', message.linear_acceleration_covariance)):
            field[0] = 0.0 if kind in found.types else _NONE
        return message
    return make


def _range(frame_id: str, found: Instrument) -> Callable[[Time, FloatArray], Range]:
    def make(stamp: Time, numbers: FloatArray) -> Range:
        message = Range(radiation_type=Range.INFRARED, max_range=found.reach)
        message.header.stamp, message.header.frame_id = stamp, frame_id
        # MuJoCo gives -1 or the cutoff where there is nothing, REP 117 wants +Inf.
        message.range = float(numbers[0]) if 0.0 <= numbers[0] < found.reach else math.inf
        return message
    return make


def _values(_: str, found: Instrument) -> Callable[[Time, FloatArray], Float64MultiArray]:
    label = ' of '.join(filter(None, (found.types[0], found.elements[0])))
    sizes = [(label, found.length)]
    if found.types[0] == 'tactile' and found.length % _TACTILE_CHANNELS == 0:
        sizes = [(f'{label}: depth, slip, slip', _TACTILE_CHANNELS),
                 ('taxels', found.length // _TACTILE_CHANNELS)]

    def make(_: Time, numbers: FloatArray) -> Float64MultiArray:
        message = Float64MultiArray(data=array('d', np.asarray(numbers, float).tobytes()))
        strides = np.cumprod([size for _, size in reversed(sizes)])[::-1].tolist()
        message.layout.dim = [MultiArrayDimension(label=name, size=size, stride=stride)
                              for (name, size), stride in zip(sizes, strides)]
        return message
    return make


_MAKERS: dict[str, Callable[[str, Instrument], Callable[[Time, FloatArray], Any]]] = {
    IMU: _imu, RANGE: _range, VALUES: _values,
    MAGNETIC_FIELD: lambda frame_id, _: partial(stamped, MagneticField, frame_id),
    WRENCH: lambda frame_id, _: partial(stamped, WrenchStamped, frame_id)}
