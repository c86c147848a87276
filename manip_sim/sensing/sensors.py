# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The values of all sensors of a running model, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Protocol

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import UnknownNameError
from manip_sim.sensing.instruments import find_instruments, Instrument


class Present(Protocol):
    """What holds a model and its data; objects that come or go replace them."""

    @property
    def model(self) -> mujoco.MjModel:
        """The ``mujoco.MjModel``."""

    @property
    def data(self) -> mujoco.MjData:
        """The ``mujoco.MjData``."""


class Sensors(Mapping[str, FloatArray]):
    """
    What the sensors of a model measure, by name, with the noise and latency that are set.

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
            self._by_name = {found.name: found for found in self._instruments}
            self._of_sensor = {sensor: found for found in self._instruments
                               for sensor in found.sensors}
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
        found, values = self._of_sensor[name], np.empty(len(data.sensordata))
        values[found.sources] = self._measure(found)[found.targets]
        return values[self._slices[name]].copy()

    def __iter__(self) -> Iterator[str]:
        self._look()
        return iter(self._slices)

    def __len__(self) -> int:
        self._look()
        return len(self._slices)
