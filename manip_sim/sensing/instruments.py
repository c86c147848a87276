# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The instruments of a model: which of its sensors are read together, and where their values are.

An accelerometer, a gyro and a framequat of one site are one IMU; a force and a torque of one site
are one force/torque sensor. What the messages look like is not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
import math
import re
from typing import Protocol

import mujoco
import numpy as np

from manip_sim.algebra import XYZW
from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import UnknownNameError
from manip_sim.frame_names import FrameNames

IMU, WRENCH, RANGE, MAGNETIC_FIELD, VALUES = KINDS = (
    'imu', 'wrench', 'range', 'magnetic_field', 'values')
#: Places in the reading of an IMU: orientation x, y, z, w, angular velocity, acceleration.
ORIENTATION, GYRO, ACCELEROMETER = slice(0, 4), slice(4, 7), slice(7, 10)
_IMU_LENGTH = 10
_SITE = int(mujoco.mjtObj.mjOBJ_SITE)
_BODIES = (int(mujoco.mjtObj.mjOBJ_BODY), int(mujoco.mjtObj.mjOBJ_XBODY))
#: By type of sensor: the kind of instrument that it belongs to, and its places in what that reads.
_ROLES = {
    'accelerometer': (IMU, ACCELEROMETER), 'gyro': (IMU, GYRO), 'framequat': (IMU, ORIENTATION),
    'force': (WRENCH, slice(0, 3)), 'torque': (WRENCH, slice(3, 6)),
    'rangefinder': (RANGE, slice(0, 1)), 'magnetometer': (MAGNETIC_FIELD, slice(0, 3))}


@dataclass(frozen=True)
class Instrument:
    """
    One or more sensors of a model that are read together.

    :ivar name: of the site that they share, or of the sensor
    :ivar kind: one of :data:`KINDS`
    :ivar frame: name of the site or body that it is fixed to; empty if there is none
    :ivar types: their types, such as ``gyro``
    :ivar elements: names of what they are sensors of, such as a joint
    :ivar sources: places in ``sensordata``, shape (n,)
    :ivar targets: places in the reading, shape (n,)
    :ivar length: of the reading
    :ivar reach: of a rangefinder, distance from which on it reads as if there were nothing [m]
    """

    name: str
    kind: str
    frame: str
    sensors: tuple[str, ...]
    types: tuple[str, ...]
    elements: tuple[str, ...]
    sources: IntArray
    targets: IntArray
    length: int
    reach: float = math.inf

    def read(self, data: mujoco.MjData) -> FloatArray:
        """
        Return what the sensors measure at the instant of the last ``mj_forward``, exactly.

        :returns: in SI units, shape (length,): of an IMU orientation x, y, z, w, angular velocity
            and acceleration, zero where it has no such sensor; of a force/torque sensor force and
            torque; else as MuJoCo gives it
        """
        values = np.zeros(self.length)
        values[self.targets] = data.sensordata[self.sources]
        return values

    @property
    def topic(self) -> str:
        """Its name as a part of the name of a topic."""
        token = re.sub('_+', '_', re.sub('[^A-Za-z0-9]', '_', self.name)).strip('_')
        return token if token[:1].isalpha() else f'sensor_{token}'


def sensor_type(model: mujoco.MjModel, sensor: int) -> str:
    """Return the type of a sensor, such as ``gyro``."""
    return _type_name(int(model.sensor_type[sensor]))


@cache
def _type_name(number: int) -> str:
    return str(mujoco.mjtSensor(number).name[7:].lower())


def find_instruments(model: mujoco.MjModel) -> list[Instrument]:
    """
    Return the instruments of a model, in the order of their first sensors.

    The names of their topics differ; where they would not, a number is added to the name.
    """
    groups: list[tuple[str, list[int]]] = []
    open_groups: dict[tuple[str, int], list[int]] = {}
    for sensor in range(model.nsensor):
        kind = _kind(model, sensor)
        key = kind, int(model.sensor_objid[sensor])
        group = open_groups.get(key)
        if kind == VALUES or group is None or any(
                model.sensor_type[other] == model.sensor_type[sensor] for other in group):
            group = []
            groups.append((kind, group))
            open_groups[key] = group
        group.append(sensor)
    instruments: dict[str, Instrument] = {}
    for kind, group in [part for entry in groups for part in _complete(model, *entry)]:
        instrument = _instrument(model, kind, group)
        name, number = instrument.name, 2
        while instrument.topic in instruments:
            instrument = replace(instrument, name=f'{name}_{number}')
            number += 1
        instruments[instrument.topic] = instrument
    return [*instruments.values()]


def _kind(model: mujoco.MjModel, sensor: int) -> str:
    """Return the kind of instrument that a sensor belongs to."""
    kind, places = _ROLES.get(sensor_type(model, sensor), (VALUES, slice(0)))
    fits = (int(model.sensor_objtype[sensor]) == _SITE and int(model.sensor_refid[sensor]) < 0
            and int(model.sensor_dim[sensor]) == places.stop - (places.start or 0))
    return kind if fits else VALUES


def _complete(model: mujoco.MjModel, kind: str, group: list[int]
              ) -> Iterable[tuple[str, list[int]]]:
    """Take apart what lacks a sensor that a message of its kind needs."""
    types = {sensor_type(model, sensor) for sensor in group}
    lacks = (kind == WRENCH and len(types) < 2) or (kind == IMU and types == {'framequat'})
    return [(VALUES, [sensor]) for sensor in group] if lacks else [(kind, group)]


def _instrument(model: mujoco.MjModel, kind: str, group: list[int]) -> Instrument:
    sensors = tuple(_name(model, mujoco.mjtObj.mjOBJ_SENSOR, n) or f'sensor_{n}' for n in group)
    elements = tuple(_name(model, int(model.sensor_objtype[n]), int(model.sensor_objid[n]))
                     for n in group)
    sources, targets = [], []
    for sensor in group:
        begin, size = int(model.sensor_adr[sensor]), int(model.sensor_dim[sensor])
        addresses = np.arange(begin, begin + size)
        if kind == VALUES:
            places = slice(0, size)
        else:
            places = _ROLES[sensor_type(model, sensor)][1]
            if places == ORIENTATION:
                addresses = addresses[XYZW]
        sources.append(addresses)
        targets.append(np.arange(places.start, places.stop))
    length = _IMU_LENGTH if kind == IMU else sum(map(len, targets))
    name = elements[0] if kind in (IMU, WRENCH) and elements[0] else sensors[0]
    return Instrument(
        name, kind, _frame(model, group[0]), sensors,
        tuple(sensor_type(model, n) for n in group), elements, np.concatenate(sources),
        np.concatenate(targets), length,
        # MuJoCo shortens longer distances to the cutoff; 0 for none.
        (float(model.sensor_cutoff[group[0]]) or math.inf) if kind == RANGE else math.inf)


def _name(model: mujoco.MjModel, kind: int, number: int) -> str:
    return (mujoco.mj_id2name(model, kind, number) or '') if number >= 0 else ''


def _frame(model: mujoco.MjModel, sensor: int) -> str:
    """Return the name of the frame of the site or body that a sensor is fixed to."""
    kind, number = int(model.sensor_objtype[sensor]), int(model.sensor_objid[sensor])
    if kind == _SITE:
        return FrameNames(model).sites[number]
    return FrameNames(model).bodies[number] if kind in _BODIES else ''


def instrument_sites(model: mujoco.MjModel) -> list[str]:
    """Return the names of the sites whose frames messages have."""
    sites = [int(model.sensor_objid[n]) for n in range(model.nsensor)
             if _kind(model, n) != VALUES]
    return list(dict.fromkeys(filter(None, (_name(model, _SITE, site) for site in sites))))


class Present(Protocol):
    """Holder of a model and its data; objects that come or go replace them."""

    @property
    def model(self) -> mujoco.MjModel:
        """The ``mujoco.MjModel``."""

    @property
    def data(self) -> mujoco.MjData:
        """The ``mujoco.MjData``."""


class Sensors(Mapping[str, FloatArray]):
    """
    Measurements of the sensors of a model, by name, with the noise and latency that are set.

    Each value is a copy, in the units and the order of MuJoCo.

    :param measure: returns what an instrument measures
    """

    def __init__(self, present: Present, measure: Callable[[Instrument], FloatArray]) -> None:
        self._present = present
        self._measure = measure
        self._model: mujoco.MjModel | None = None

    def _look(self) -> mujoco.MjData:
        model, data = self._present.model, self._present.data
        if model is not self._model:
            self._instruments = find_instruments(model)
            self._by_name = {instrument.name: instrument for instrument in self._instruments}
            self._of_sensor = {sensor: instrument for instrument in self._instruments
                               for sensor in instrument.sensors}
            self._slices = {
                mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SENSOR, n) or f'sensor_{n}':
                slice(int(model.sensor_adr[n]), int(model.sensor_adr[n] + model.sensor_dim[n]))
                for n in range(model.nsensor)}
            self._model = model
        return data

    @property
    def instruments(self) -> list[Instrument]:
        """The instruments of the model, such as IMUs."""
        self._look()
        return self._instruments

    def instrument(self, name: str) -> Instrument | None:
        """Return an instrument of the model, or None if there is none of this name."""
        self._look()
        return self._by_name.get(name)

    def __getitem__(self, name: str) -> FloatArray:
        data = self._look()
        if name not in self._slices:
            raise UnknownNameError('sensor', name, self._slices)
        instrument, values = self._of_sensor[name], np.empty(len(data.sensordata))
        values[instrument.sources] = self._measure(instrument)[instrument.targets]
        return values[self._slices[name]].copy()

    def __iter__(self) -> Iterator[str]:
        self._look()
        return iter(self._slices)

    def __len__(self) -> int:
        self._look()
        return len(self._slices)
