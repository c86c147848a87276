# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Many copies of one world: advance, reset, save and restore them together or one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
import contextlib
import copy
from dataclasses import dataclass
import enum
import functools
from functools import partial
import io
import pickle
import types
from types import TracebackType
from typing import Any

import mujoco
import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import ArrayLike, NDArray

from manip_sim.arrays import BoolArray, IntArray
from manip_sim.errors import (
    CommandError, DivergenceError, ModelError, SimulationEnded, UnknownNameError)
from manip_sim.models.grippers import GripperModel
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.randomization import checked_seed
from manip_sim.models.world import World
from manip_sim.physics.physics import BECAME, ENDED, ROW, WENT_ON
from manip_sim.simulation import Simulation, SimulationState
from manip_sim.simulation.compiled_period import go_on, load, run_prepared
from manip_sim.startup import processors
from manip_sim.validation import whole_number
from manip_sim.worlds.commands import world_mask
from manip_sim.worlds.robot_in_worlds import RobotInWorlds

#: Types without state, or with one that all copies share, such as descriptions.
_SHARED = (type, types.FunctionType, types.BuiltinFunctionType, types.ModuleType, enum.Enum,
           np.dtype, World)
_PLAIN = {type(None), bool, int, float, str, bytes, bytearray, tuple, list, dict, set, frozenset}
#: A field of a field, of which a simulation keeps a view.
_WARNINGS = 'warning.number'


class Worlds:
    """
    Many copies of one world in one process, compiled once.

    Each has a model, data, control modes and a divergence of its own. World *i* is, to the last
    bit, what a ``Simulation`` of the same world is after the same seeds and commands. Only one
    thread at a time may use an instance; close it, or use it in a ``with`` statement, to end the
    threads of its physics.

    :param world: an arena with robots
    :param count: number of copies
    :param threads: that compute the physics; None for one per processor that the process may use
    :param visual: keep the geoms that cannot collide, for rendering; they slow down each step
    :ivar simulations: one for each world, for values without an array; a change there affects
        that world alone
    :ivar robots: the robots, each in all worlds, by name
    :raises ModelError: if ``count`` or ``threads`` is not a whole number from 1, or with the
        reason why the world cannot be simulated
    """

    def __init__(self, world: World, count: int, threads: int | None = None,
                 visual: bool = False) -> None:
        count = whole_number(count, 1, 'count of worlds')
        self._threads = PhysicsThreads(threads)
        load()
        first = Simulation(world, visual)
        template = SimulationPrototype(first)
        self.simulations: tuple[Simulation, ...] = (
            first, *(template.copy() for _ in range(count - 1)))
        self._closed = False
        #: State of each world in compiled code.
        self._table = np.zeros((count, len(first.physics.standing)), np.int64)
        for simulation, standing in zip(self.simulations, self._table):
            simulation.physics.standing = standing
        self._everything = np.arange(count)
        self.robots = {name: RobotInWorlds([simulation.robots[name]
                                            for simulation in self.simulations],
                                           self._table, first.timestep_s)
                       for name in first.robots}

    def __len__(self) -> int:
        return len(self.simulations)

    def __enter__(self) -> Worlds:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 traceback: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the threads of the physics; worlds can be read, no longer advanced or reset."""
        self._closed = True
        self._threads.close()

    def _check_open(self) -> None:
        if self._closed:
            raise SimulationEnded('these worlds are closed')

    @property
    def threads(self) -> int:
        """Number of threads that compute the physics."""
        return self._threads.count

    @property
    def robot(self) -> RobotInWorlds:
        """
        The only robot of each world.

        :raises ModelError: if a world has several, or none
        """
        return self.robots[self.simulations[0].robot.name]

    @property
    def timestep_s(self) -> float:
        """Length of a physics step [s]."""
        return self.simulations[0].timestep_s

    @property
    def time_ns(self) -> IntArray:
        """Simulation time of each world [ns], shape (count,)."""
        return np.array([simulation.time_ns for simulation in self.simulations], dtype=np.int64)

    @property
    def diverged(self) -> BoolArray:
        """Mask of worlds whose physics is on hold, shape (count,), a copy."""
        return np.array([simulation.diverged is not None for simulation in self.simulations])

    @property
    def reasons(self) -> list[str | None]:
        """Reasons why the physics of each world is on hold, None where it runs."""
        return [simulation.diverged for simulation in self.simulations]

    def read(self, field: str) -> NDArray[Any]:
        """
        Return an array of ``MjData`` of all worlds, such as ``qpos`` or ``xpos``.

        :param field: its name
        :returns: shape (count, ...), a copy
        :raises UnknownNameError: if the array is unknown
        :raises ValueError: if its shape differs from world to world, as that of contacts
        """
        datas = [simulation.data for simulation in self.simulations]
        if not (isinstance(field, str)
                and isinstance(getattr(datas[0], field, None), np.ndarray)):
            raise UnknownNameError('array of MjData', field, [
                name for name in dir(datas[0])
                if isinstance(getattr(datas[0], name), np.ndarray)])
        return np.stack([getattr(data, field) for data in datas])

    # ------------------------------------------------------------------ time

    def advance(self, steps: int, where: ArrayLike | None = None) -> None:
        """
        Run one control period in each world; afterwards all data belongs to the new instant.

        A world that diverges is held at its last good state, at rest, until it is reset or
        restored; the others go on. See :attr:`diverged` and :attr:`reasons`.

        :param steps: number of physics steps, from 1
        :param where: which worlds go on, shape (count,); None for all
        :raises CommandError: if ``where`` has another shape or type, or ``steps`` is not a whole
            number from 1
        :raises SimulationEnded: after :meth:`close`
        """
        self._check_open()
        steps = whole_number(steps, 1, 'steps', CommandError)
        running = self._everything if where is None else np.flatnonzero(
            world_mask(where, len(self)))
        count = min(self._threads.count, len(running))
        self._threads.run([partial(self._advance, running[begin::count].copy(), steps)
                           for begin in range(count)])

    def _advance(self, numbers: IntArray, steps: int) -> None:
        """Run a control period in some worlds, all of which end it."""
        for places in _by_sizes([self.simulations[number] for number in numbers.tolist()]):
            alike = numbers[places]
            go_on(self._table[:, ROW][alike], self._table, alike, steps,
                  self.simulations[alike[0]].physics.scratch)
        others = numbers[self._table[:, BECAME][numbers] != WENT_ON]
        _advance([self.simulations[number] for number in others.tolist()], steps)

    def reset(self, seeds: Sequence[int] | IntArray | None = None,
              where: ArrayLike | None = None) -> None:
        """
        Reset worlds to their start and abort their commands; time goes on, control modes stay.

        :param seeds: one for each world, which draws its start anew where the world has
            ``initialization_noise``; None keeps the starts
        :param where: which worlds are reset, shape (count,); None for all. Seeds of others are
            ignored
        :raises CommandError: if ``where`` has another shape or type
        :raises ModelError: if there is not one seed for each world, or one is not a whole number
            from 0; no world is reset then
        :raises SimulationEnded: after :meth:`close`
        """
        self._check_open()
        mask, world_seeds = world_mask(where, len(self)), self._seeds(seeds)
        for seed, included in zip(world_seeds, mask):
            if included and seed is not None:
                checked_seed(seed)
        self._threads.run([
            partial(simulation.reset, seed)
            for simulation, seed, included in zip(self.simulations, world_seeds, mask)
            if included])

    def _seeds(self, seeds: Sequence[int] | IntArray | None) -> list[int | None]:
        if seeds is None:
            return [None] * len(self)
        try:
            world_seeds = [seed.item() if isinstance(seed, np.generic) else seed for seed in seeds]
        except TypeError:
            world_seeds = []
        if len(world_seeds) != len(self):
            raise ModelError(f'expected {len(self)} seeds, one for each world, got {seeds!r:.60}')
        return world_seeds

    # ------------------------------------------------------------------ saved states

    def save(self, where: ArrayLike | None = None) -> list[SimulationState]:
        """
        Return the present state of each world, as :meth:`Simulation.save` does.

        :param where: of which worlds, shape (count,); None for all
        :raises CommandError: if ``where`` has another shape or type
        """
        return [simulation.save() for simulation in self._of(where)]

    def restore(self, states: Sequence[SimulationState], where: ArrayLike | None = None) -> None:
        """
        Continue from states, each of any world of any instance or simulation of an equal world.

        :param states: one for each world that is restored, in the order of the worlds
        :param where: which worlds are restored, shape (count,); None for all
        :raises CommandError: if ``where`` has another shape or type
        :raises ModelError: if there is not one state for each of these worlds, or it belongs to
            another world or version; no world is restored then
        """
        simulations = list(self._of(where))
        new_states = list(states) if isinstance(states, Sequence) else []
        if len(new_states) != len(simulations):
            raise ModelError(f'expected {len(simulations)} states, one for each world that is '
                             f'restored, got {len(new_states) or repr(states)[:60]}')
        for simulation, state in zip(simulations, new_states):
            simulation.states.check(state)
        for simulation, state in zip(simulations, new_states):
            simulation.restore(state)

    def digest(self, where: ArrayLike | None = None) -> list[str]:
        """
        Return a digest of the present state of each world, equal to that of a simulation.

        :param where: of which worlds, shape (count,); None for all
        :raises CommandError: if ``where`` has another shape or type
        """
        return [simulation.digest() for simulation in self._of(where)]

    def _of(self, where: ArrayLike | None) -> Sequence[Simulation]:
        if where is None:
            return self.simulations
        mask = world_mask(where, len(self))
        return [simulation for simulation, included in zip(self.simulations, mask) if included]


def _advance(worlds: Sequence[Simulation], steps: int) -> None:
    """Run a control period in some worlds, all of which end it."""
    prepared, failures = [], []
    for world in worlds:
        try:
            if world.physics.standing[BECAME] == ENDED:
                world.periods.end_standing(steps)
                continue
            if world.periods.begin(steps):
                prepared.append(world)
                continue
            world.periods.end(steps)
        except DivergenceError:
            pass
        except Exception as error:  # A user's gripper may raise anything.
            failures.append(error)
    for places in _by_sizes(prepared):
        alike = [prepared[place] for place in places]
        run_prepared([world.periods.compiled.row for world in alike], alike[0].physics.scratch)
        for world in alike:
            with contextlib.suppress(DivergenceError):
                world.periods.end(steps)
    if failures:
        raise failures[0]


def _by_sizes(worlds: Sequence[Simulation]) -> Iterable[list[int]]:
    """Return the places of worlds that can share a scratch; some may have other objects."""
    places: dict[tuple[int, ...], list[int]] = {}
    for place, world in enumerate(worlds):
        places.setdefault(world.physics.sizes, []).append(place)
    return places.values()


class PhysicsThreads:
    """
    The calling thread and some others, which share the work.

    They compute the physics of several worlds at once, without Python's global lock.

    :param count: number of threads, the calling one included; None for one per processor that
        this process may use
    :ivar count: number of threads
    :raises ModelError: if it is not a whole number from 1
    """

    def __init__(self, count: int | None) -> None:
        self.count = processors() if count is None else whole_number(count, 1, 'threads')
        self._others = (
            ThreadPoolExecutor(self.count - 1, 'manip_sim_worlds') if self.count > 1 else None)

    def run(self, work: Sequence[Callable[[], object]]) -> None:
        """
        Call functions, each in any of the threads, and return when all threads are done.

        An exception of a function ends the work of its thread, and is raised then.
        """
        if self._others is None or len(work) < 2:
            _call(work)
            return
        count = min(self.count, len(work))
        others = [self._others.submit(_call, work[begin::count]) for begin in range(1, count)]
        try:
            _call(work[::count])
        finally:
            wait(others)
        for share in others:
            share.result()

    def close(self) -> None:
        """End the other threads."""
        if self._others is not None:
            self._others.shutdown()


def _call(work: Sequence[Callable[[], object]]) -> None:
    for function in work:
        function()


class SimulationPrototype:
    """
    A simulation at its start, of which copies are made.

    A copy is made much faster than its world is composed and compiled again. It has a ``MjModel``
    and a ``MjData`` of its own, so servo gains, control modes and edits of its model are its own
    too. It shares the descriptions of robots and objects. Grippers, whose ``format_action`` may
    have a state, are copied.

    :param simulation: which is never changed here; no command must have been applied to it
    """

    def __init__(self, simulation: Simulation) -> None:
        self._model, self._data = simulation.model, simulation.data
        file = io.BytesIO()
        pickler = _Pickler(file, self._model, self._data)
        pickler.dump(simulation)
        self._pickled, self._outside = file.getvalue(), pickler.outside
        #: Fields and views of each copy, by their places in :attr:`_outside`.
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
    """A field of the model or the data of a copy, or a view of the field."""

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


def owner_of(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array that an array is a view of, or itself."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def _is_foreign(array: NDArray[Any]) -> bool:
    """Return whether an array is a view into ``MjData`` or ``MjModel``."""
    return type(owner_of(array).base).__name__ == 'PyCapsule'


def _is_frozen(item: object) -> bool:
    """Return whether an object is of a frozen dataclass."""
    parameters = getattr(type(item), '__dataclass_params__', None)
    return parameters is not None and parameters.frozen


def _view(owner: NDArray[Any], offset: int, shape: tuple[int, ...], strides: tuple[int, ...],
          kind: str) -> NDArray[Any]:
    return np.ndarray(shape, kind, owner.data, offset, strides)


class _Pickler(pickle.Pickler):
    """
    A pickler that keeps aside what copies share, and what belongs to model and data.

    Views of the same array stay views of the same array.

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

    def reducer_override(self, item: Any) -> Any:
        """Let copies of cached methods begin with empty caches, and views be views."""
        if isinstance(item, functools._lru_cache_wrapper):
            return _cached, (item.cache_parameters()['maxsize'], item.__wrapped__)
        if not isinstance(item, np.ndarray) or (owner := owner_of(item)) is item:
            return NotImplemented
        offset = item.__array_interface__['data'][0] - owner.__array_interface__['data'][0]
        return _view, (owner, offset, item.shape, item.strides, item.dtype.str)

    def persistent_id(self, item: object) -> int | None:
        kind = type(item)
        if kind in _PLAIN or kind is pickle.PickleBuffer:
            return None
        number = self._number_of.get(id(item))
        if number is None:
            outside = self._outside(item)
            if outside is None:
                return None
            number = self._number_of[id(item)] = len(self.outside)
            self.outside.append(outside)
            self._kept.append(item)
        return number

    def _outside(self, item: object) -> object | None:
        """Return what stands for an object in every copy, or None if it is copied."""
        if isinstance(item, np.ndarray):
            if _is_foreign(item):
                return self._find(item)
            if owner_of(item) is not item or item.dtype.hasobject:
                return None
            return _OwnArray(item.copy('K')) if item.flags.writeable else item
        if item is self._model or item is self._data:
            return _Own(item is self._model, '')
        if isinstance(item, mujoco.MjOption):
            return _Own(True, 'opt')
        root = type(item).__module__.partition('.')[0]
        shared = (isinstance(item, _SHARED) or root == 'mujoco'
                  or isinstance(item, MujocoXMLModel) and not isinstance(item, GripperModel)
                  or _is_frozen(item) and not any(
                      isinstance(field, GripperModel) for field in vars(item).values()))
        return item if shared else None

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


def _arrays(source: Any) -> list[tuple[str, NDArray[Any]]]:
    """Return the arrays of a ``MjModel`` or a ``MjData``, by name."""
    named = [(name, getattr(source, name)) for name in dir(source) if not name.startswith('_')]
    if isinstance(source, mujoco.MjData):
        named.append((_WARNINGS, source.warning.number))
    return [(name, array) for name, array in named
            if isinstance(array, np.ndarray) and array.size]


class _Unpickler(pickle.Unpickler):
    """A reader of what :class:`_Pickler` has written."""

    def __init__(self, pickled: bytes, outside: list[object]) -> None:
        super().__init__(io.BytesIO(pickled))
        self._outside = outside

    def persistent_load(self, number: int) -> object:
        return self._outside[number]
