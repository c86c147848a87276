# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Copy a simulation, much faster than by composing and compiling its world again."""

from __future__ import annotations

import copy
from dataclasses import dataclass
import enum
import functools
import io
import pickle
import types
from typing import Any

import mujoco
import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from manip_sim.models.grippers import GripperModel
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.world import World
from manip_sim.simulation import Simulation
from manip_sim.simulation.control_state import is_foreign, is_frozen, owner_of, ViewPickler

#: Types without state, or with one that all copies share, such as descriptions.
_SHARED = (type, types.FunctionType, types.BuiltinFunctionType, types.ModuleType, enum.Enum,
           np.dtype, World)
_PLAIN = {type(None), bool, int, float, str, bytes, bytearray, tuple, list, dict, set, frozenset}
#: A field of a field, of which a simulation keeps a view.
_WARNINGS = 'warning.number'


class SimulationPrototype:
    """
    A simulation at its start, of which copies are made.

    A copy has a ``MjModel`` and a ``MjData`` of its own, so servo gains, control modes and edits
    of its model are its own too. It shares the descriptions of robots and objects. Grippers, whose
    ``format_action`` may have a state, are copied.

    :param simulation: which is never changed here; no command must have been applied to it
    """

    def __init__(self, simulation: Simulation) -> None:
        self._model, self._data = simulation.model, simulation.data
        file = io.BytesIO()
        pickler = _Pickler(file, self._model, self._data)
        pickler.dump(simulation)
        self._pickled, self._outside = file.getvalue(), pickler.outside
        #: What each copy has of its own, by its place in :attr:`_outside`.
        self._own = [(number, item) for number, item in enumerate(self._outside)
                     if isinstance(item, (_Own, _OwnArray))]

    def copy(self) -> Simulation:
        """Return a new simulation in the state that the first one had."""
        model = copy.copy(self._model)
        data = mujoco.MjData(model)
        mujoco.mj_copyData(data, model, self._data)
        outside = self._outside.copy()
        for number, item in self._own:
            outside[number] = item.of(model, data)
        simulation: Simulation = _Unpickler(self._pickled, outside).load()
        return simulation


@dataclass(frozen=True)
class _Own:
    """What belongs to the model or the data of a copy: a field of it, or a view of the field."""

    of_model: bool
    field: str
    offset: int = 0
    shape: tuple[int, ...] | None = None
    strides: tuple[int, ...] = ()

    def of(self, model: mujoco.MjModel, data: mujoco.MjData) -> Any:
        """Return the same of another model and its data."""
        value: Any = model if self.of_model else data
        for name in self.field.split('.') if self.field else ():
            value = getattr(value, name)
        if self.shape is None:
            return value
        if value.flags.c_contiguous:
            return np.ndarray(self.shape, value.dtype, value, self.offset, self.strides)
        return as_strided(value[self.offset // value.strides[0]:], self.shape, self.strides)


@dataclass(frozen=True)
class _OwnArray:
    """An array of which each copy has its own, made much faster than by pickle."""

    array: NDArray[Any]

    def of(self, model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[Any]:
        """Return a new array with the same numbers."""
        return self.array.copy('K')


class _Pickler(ViewPickler):
    """
    A pickler that keeps aside what copies share, and what belongs to model and data.

    :ivar outside: what it has kept aside, by the number in the pickle
    """

    def __init__(self, file: io.BytesIO, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        super().__init__(file, protocol=5)
        self.outside: list[object] = []
        self._number_of: dict[int, int] = {}
        #: So that no other object gets the id of one that is kept aside.
        self._kept: list[object] = []
        self._model, self._data = model, data
        self._fields = [(of_model, name, array)
                        for of_model, owner in ((False, data), (True, model))
                        for name, array in _arrays(owner)]

    def reducer_override(self, found: Any) -> Any:
        """Let the copy of a cached method begin with an empty cache."""
        if isinstance(found, functools._lru_cache_wrapper):
            return _cached, (found.cache_parameters()['maxsize'], found.__wrapped__)
        return super().reducer_override(found)

    def persistent_id(self, found: object) -> int | None:
        kind = type(found)
        if kind in _PLAIN or kind is pickle.PickleBuffer:
            return None
        number = self._number_of.get(id(found))
        if number is None:
            outside = self._outside(found)
            if outside is None:
                return None
            number = self._number_of[id(found)] = len(self.outside)
            self.outside.append(outside)
            self._kept.append(found)
        return number

    def _outside(self, found: object) -> object | None:
        """Return what stands for an object in every copy, or None if it is copied."""
        if isinstance(found, np.ndarray):
            if is_foreign(found):
                return self._find(found)
            if owner_of(found) is not found or found.dtype.hasobject:
                return None
            return _OwnArray(found.copy('K')) if found.flags.writeable else found
        if found is self._model or found is self._data:
            return _Own(found is self._model, '')
        if isinstance(found, mujoco.MjOption):
            return _Own(True, 'opt')
        root = type(found).__module__.partition('.')[0]
        shared = (isinstance(found, _SHARED) or root == 'mujoco'
                  or isinstance(found, MujocoXMLModel) and not isinstance(found, GripperModel)
                  or is_frozen(found) and not any(
                      isinstance(field, GripperModel) for field in vars(found).values()))
        return found if shared else None

    def _find(self, view: NDArray[Any]) -> _Own:
        address = view.__array_interface__['data'][0]
        for of_model, name, array in self._fields:
            offset = address - array.__array_interface__['data'][0]
            if 0 <= offset < max(len(array) * array.strides[0], 1) and (
                    view.dtype == array.dtype):
                return _Own(of_model, name, offset, view.shape, view.strides)
        raise pickle.PicklingError('a view of neither the model nor the data of the simulation')


def _cached(size: int, method: types.MethodType) -> Any:
    return functools.lru_cache(size)(method)


def _arrays(found: Any) -> list[tuple[str, NDArray[Any]]]:
    """Return the arrays of a ``MjModel`` or a ``MjData``, by name."""
    named = [(name, getattr(found, name)) for name in dir(found) if not name.startswith('_')]
    if isinstance(found, mujoco.MjData):
        named.append((_WARNINGS, found.warning.number))
    return [(name, array) for name, array in named
            if isinstance(array, np.ndarray) and array.size]


class _Unpickler(pickle.Unpickler):
    """A reader of what :class:`_Pickler` has written."""

    def __init__(self, pickled: bytes, outside: list[object]) -> None:
        super().__init__(io.BytesIO(pickled))
        self._outside = outside

    def persistent_load(self, number: int) -> object:
        return self._outside[number]
