# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish what the instruments of a model measure; those of objects may come and go."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from functools import partial
import math
from typing import Any, TYPE_CHECKING

from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
import numpy as np
from sensor_msgs.msg import Imu, MagneticField, Range
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from manip_sim.arrays import FloatArray
from manip_sim.interface.scope import Scope
from manip_sim.interface.served_instruments import (
    SensorSettings, served_instruments, ServedInstrument)
from manip_sim.ros.lazy_publishers import create_output, Publication, Publications
from manip_sim.ros.messages import stamped
from manip_sim.sensing.instruments import (
    IMU, Instrument, MAGNETIC_FIELD, RANGE, VALUES, WRENCH)
from manip_sim.simulation import Simulation

if TYPE_CHECKING:
    from manip_sim.ros.sim_node import SimNode

#: What an entry of a covariance is set to where there is no such sensor (sensor_msgs/Imu).
_NONE = -1.0
#: Rows of a tactile sensor: depths, and speeds of sliding along two tangents.
_TACTILE_CHANNELS = 3


class InstrumentPublishers(Publications):
    """
    Publishers of all instruments of a world, but for the gripper's, which have topics of the arms.

    :raises ManipSimError: if the parameter ``sensors`` cannot be used
    :ivar rates_hz: of the sensors with fewer messages than control periods [Hz]
    """

    def __init__(self, node: SimNode) -> None:
        super().__init__()
        simulation = node.simulation
        served = served_instruments(simulation, node.robots)
        settings = SensorSettings(node.get_parameter('sensors').value, served,
                                  1.0 / node.thread.period_s)
        if settings.noise:
            simulation.instruments.set_noise(settings.noise)
        self._every = settings.every
        self.rates_hz = settings.rates_hz
        self._node = node
        self._topics: dict[str, tuple[ServedInstrument, Publication]] = {}
        #: Robots whose exact values are published too.
        self._true: frozenset[Scope] = frozenset()
        self._noisy = frozenset(settings.noise)
        self.follow(simulation)

    def follow(self, simulation: Simulation) -> None:
        """
        Create publishers for instruments that have come, and destroy those of what has gone.

        To be called in the thread that spins the node, or before it spins.

        :param simulation: its instruments are published from now on
        """
        served = {one.topic.name: one for one in served_instruments(
            simulation, self._node.robots, self._true, self._noisy)}
        gone = {name: publication for name, (one, publication) in self._topics.items()
                if name not in served or not _alike(served[name], one)}
        self._topics = {name: (one, self._topics[name][1] if name in self._topics
                               and name not in gone else self._create(one))
                        for name, one in served.items()}
        self.replace(tuple(publication for _, publication in self._topics.values()))
        for publication in gone.values():
            publication.output.close(self._node)
        table = self._node.table
        table[:] = [row for row in table if row.name not in gone or row.name in served]

    def publish_truth(self, scope: Scope) -> None:
        """Also publish the exact values of the instruments of a robot, below ``truth/``."""
        self._true |= {scope}
        self.follow(self._node.simulation)

    def _create(self, served: ServedInstrument) -> Publication:
        found, name = served.instrument, served.topic.name
        frame = self._node.frame_prefix + found.frame if found.frame else ''
        if served.topic not in self._node.table:
            self._node.table.append(served.topic)
        return Publication(
            create_output(self._node, served.topic), _MAKERS[found.kind](frame, found),
            lambda simulation: self._read(name, simulation), found.length,
            self._every.get(found.name, 1))

    def publish(self, simulation: Simulation) -> None:
        """Publish the present instant of what has subscribers and is due."""
        for topic in self._subscribed:
            if topic.every == 1 or self._node.thread.is_due(topic.every):
                topic.publish(simulation)

    def _read(self, name: str, simulation: Simulation) -> FloatArray | None:
        # Objects that have come or gone make another model before follow() is called.
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
