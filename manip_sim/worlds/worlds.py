# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Many copies of one world: advance, reset, save and restore them together or one by one."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from functools import partial
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip_sim.arrays import BoolArray, IntArray
from manip_sim.errors import (
    CommandError, DivergenceError, ModelError, SimulationEnded, UnknownNameError)
from manip_sim.models.placements import checked_seed
from manip_sim.models.world import World
from manip_sim.physics.physics import BECAME, ENDED, WENT_ON
from manip_sim.simulation import Simulation, SimulationState
from manip_sim.simulation.compiled_period import go_on, load, run_prepared
from manip_sim.validation import whole_number
from manip_sim.worlds.physics_threads import PhysicsThreads
from manip_sim.worlds.robot_in_worlds import RobotInWorlds
from manip_sim.worlds.rows import world_mask
from manip_sim.worlds.simulation_prototype import SimulationPrototype


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
        """Whether the physics of each world is on hold, shape (count,), a copy."""
        return np.array([simulation.diverged is not None for simulation in self.simulations])

    @property
    def reasons(self) -> list[str | None]:
        """Why the physics of each world is on hold, or None."""
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
        go_on(self._table, numbers, steps, self.simulations[0].physics.scratch)
        became = self._table[numbers, BECAME].tolist()
        _advance([self.simulations[number] for number, how in zip(numbers.tolist(), became)
                  if how != WENT_ON], steps)

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
    while prepared:
        sizes = prepared[0].physics.sizes  # A world may have other objects than the others.
        alike = [world for world in prepared if world.physics.sizes == sizes]
        prepared = [world for world in prepared if world.physics.sizes != sizes]
        run_prepared([world.periods.compiled.row for world in alike], alike[0].physics.scratch)
        for world in alike:
            with contextlib.suppress(DivergenceError):
                world.periods.end(steps)
    if failures:
        raise failures[0]
