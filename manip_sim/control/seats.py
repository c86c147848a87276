# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The laws of users that move parts of a robot: their parameters, memory and failures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, Sequence
import logging
import os
import threading
import time
from typing import Any
import weakref

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.cartesian.kinematic_chains import Arms, Payloads
from manip_sim.control.law.records import PLAIN
from manip_sim.control.modes import COSTLY, FILLS, Law
from manip_sim.control.servos import Servos
from manip_sim.derived import Derived
from manip_sim.errors import ModelError
from manip_sim.physics.parts import EndEffectorReader
from manip_sim.physics.physics import Physics
from manip_sim.physics.robot_frames import Frame
from manip_sim.physics.uncollected_forces import has_fluid
from manip_sim.quoting import one_line

#: Longest time of a call of a law [s], and rate of the checks [1/s].
_PATIENCE_S, _RATE_HZ = 10, 1
#: Code with which the process ends, EX_SOFTWARE of sysexits.h.
_EXIT_CODE = 70
_LOGGER = logging.getLogger('manip_sim.control')
_NOBODY = np.zeros(0, np.int64)
#: Status of a law of which an effort is not finite, see :mod:`manip_sim.control.law.seat`.
_NOT_FINITE = 2
#: Where the wrench is in the costly arguments of a law.
_WRENCH = COSTLY.index('wrench')


class SeatState:
    """
    A law in the seat of a part.

    :param law: of the user
    :param parameters: of the law, shape (p,)
    :param compiled: whether it is compiled
    :ivar name: of the law
    :ivar memory: of the law, shape (m,)
    :ivar wrench: on the tool in the last step, see :func:`manip_sim.laws.law`, shape (6,)
    :ivar acts: False while a reflex has stopped the part
    :ivar status: of calls and of failure, as the compiled law has it, shape (3,)
    """

    def __init__(self, law: Law, parameters: FloatArray, compiled: bool) -> None:
        self.law, self.name, self.is_compiled = law, law.name, compiled
        self.parameters, self.memory = parameters, np.zeros(law.memory)
        self.wrench, self.status = np.zeros(6), np.zeros(3, np.int64)
        self.acts = True

    @property
    def undigested(self) -> tuple[str, ...]:
        """Attributes that are no state or make no difference, as a wrench that no law reads."""
        return ('law', 'is_compiled', 'status', *(() if self.law.reads[_WRENCH] else ('wrench',)))

    def restart(self) -> None:
        """Forget all but the parameters, and act."""
        self.memory[:] = self.wrench[:] = self.status[2] = 0
        self.acts = True

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        lengths = {'parameters': len(self.law.defaults), 'memory': self.law.memory,
                   'wrench': 6, 'status': 3}
        if any([np.shape(state[name]) != (length,) for name, length in lengths.items()]):
            raise ModelError(f"the state was saved with another law '{self.name}'")


class LawParameters(MutableMapping[str, float]):
    """
    The parameters of a law that moves a part, by name; a new value acts from the next step on.

    :param find: returns the seats of the same law; reading returns the value of the first
    """

    def __init__(self, find: Callable[[], Sequence[SeatState]]) -> None:
        self._find = find

    @property
    def _law(self) -> Law:
        return self._find()[0].law

    def checked(self, name: str, value: float) -> float:
        """
        Return a value for a parameter.

        :raises ModelError: if it is not a finite number
        :raises UnknownNameError: if the parameter is unknown
        """
        return self._law.checked(name, value)

    def __getitem__(self, name: str) -> float:
        self.checked(name, 0.0)
        return float(self._find()[0].parameters[[*self].index(name)])

    def __setitem__(self, name: str, value: float) -> None:
        value = self.checked(name, value)
        for seat in self._find():
            seat.parameters[[*self].index(name)] = value

    def __delitem__(self, name: str) -> None:
        raise TypeError('a parameter of a law cannot be deleted')

    def __iter__(self) -> Iterator[str]:
        return iter(self._law.defaults)

    def __len__(self) -> int:
        return len(self._law.defaults)

    def __repr__(self) -> str:
        return f"<parameters of the law '{self._law.name}': {dict(self)}>"


class _Watchdog:
    """
    Notices laws that never return, which nothing else in the process can end.

    It looks at them from a thread of its own, which begins with the first.
    """

    def __init__(self) -> None:
        self._names: weakref.WeakKeyDictionary[SeatState, str] = weakref.WeakKeyDictionary()
        self._lock, self._process = threading.Lock(), 0

    def watch(self, law: SeatState, name: str) -> None:
        """
        End the process if a compiled law never returns; warn if it runs as Python.

        :param law: watched as long as it exists
        :param name: for the message
        """
        with self._lock:
            self._names[law] = name
            if self._process != os.getpid():  # A fork has no thread.
                self._process = os.getpid()
                threading.Thread(target=self._look, name='manip_sim_laws', daemon=True).start()

    def _look(self) -> None:
        stuck: dict[int, tuple[int, int]] = {}
        while True:
            time.sleep(1.0 / _RATE_HZ)
            with self._lock:
                laws = [*self._names.items()]
            before, stuck = stuck, {}
            for law, name in laws:
                calls, inside, *_ = law.status.tolist()
                last, times = before.get(id(law), (-1, 0))
                # Looks are counted, as the process itself may have been stopped.
                if inside:
                    stuck[id(law)] = calls, times + 1 if calls == last else 0
                    if stuck[id(law)][1] == _PATIENCE_S * _RATE_HZ:
                        _end_or_warn(law, name)
            del laws


def _end_or_warn(law: SeatState, name: str) -> None:
    if not law.is_compiled:
        _LOGGER.warning('%s has not returned for %d s', name, _PATIENCE_S)
        return
    _LOGGER.critical('%s has not returned for %d s: the process ends, as compiled code cannot be '
                     'interrupted', name, _PATIENCE_S)
    logging.shutdown()
    os._exit(_EXIT_CODE)


_WATCHDOG = _Watchdog()


class Seats:
    """
    The seats of a robot in which laws of users are.

    :param physics: of the world
    :param servos: of all driven joints
    :param indices: of the joints, by part
    :param tips: readers of end effectors, by the part that ends in each
    :param arms: joints of parts as the law reads them
    :ivar of: the laws in the seats, by part
    """

    remembered = ('of',)

    def __init__(self, physics: Physics, servos: Servos, indices: Mapping[str, IntArray],
                 tips: Mapping[str, EndEffectorReader], arms: Arms) -> None:
        self._physics, self._servos, self._indices, self._tips = physics, servos, indices, tips
        self.of: dict[str, SeatState] = {}
        self._arms, self._derived = arms, Derived()
        physics.on_change(self._derived.clear)

    @property
    def runs_python(self) -> bool:
        """True if any law runs as plain Python."""
        return any([seat.acts and not seat.is_compiled for seat in self.of.values()])

    def act_on(self, indices: IntArray) -> bool:
        """Return whether a law moves any of some joints."""
        return any([seat.acts and bool(np.isin(indices, self._indices[part]).any())
                    for part, seat in self.of.items()])

    def check(self, law: Law, compiled: bool) -> None:
        """
        Check that a law can act, and compile it.

        :raises ModelError: if it cannot be compiled, or the integrator of the world has no place
            between the halves of a step
        """
        if int(self._physics.model.opt.integrator) == int(mujoco.mjtIntegrator.mjINT_RK4):
            raise ModelError(f"law '{law.name}': with the integrator RK4 no law can act in each "
                             'step; use Euler, implicit or implicitfast')
        if compiled and not PLAIN:
            _ = law.code

    def sit(self, part: str, law: Law, parameters: FloatArray, compiled: bool) -> None:
        """Put a law in the seat of a part, in place of the one before."""
        self.of[part] = SeatState(law, parameters, compiled and not PLAIN)
        self._derived.of.pop(part, None)

    def rise(self, parts: Iterable[str]) -> None:
        """Take the laws of parts from their seats."""
        for part in parts:
            self.of.pop(part, None)

    def failures(self) -> dict[str, str]:
        """Return why laws have failed, by part."""
        return {part: f"the law '{seat.name}' {self._failure(part, seat)}"
                for part, seat in self.of.items() if seat.acts and seat.status[2]}

    def _failure(self, part: str, seat: SeatState) -> str:
        arguments, reason = self._room(part).of['arguments'], self._room(part).of.get('reason')
        effort = arguments.effort
        worst = np.flatnonzero(~np.isfinite(effort))
        if seat.status[2] == _NOT_FINITE and worst.size:
            return f'gives an effort that is not finite: effort[{worst[0]}] is {effort[worst[0]]}'
        # Compiled code cannot say what it has raised, but plain Python does the same.
        try:
            if reason is None:
                _run(seat.law, type(arguments)(*[array.copy() for array in arguments]))
        except Exception as error:
            return _raised(error)
        return reason or 'has raised an exception'

    # ------------------------------------------------------------------ in compiled code

    def rows(self, setpoints: Any, efforts: FloatArray, payloads: Payloads) -> IntArray:
        """
        Return the addresses of the rows of the laws that act.

        :param setpoints: records of the joints of the robot
        :param efforts: of these joints [N m or N]
        :param payloads: of the arms
        """
        if not self.of:
            return _NOBODY
        acting = [state for state in self.of.values() if state.acts]
        return self._derived.made_of(
            self._write_rows, setpoints, efforts, payloads, payloads.loads, self._physics.arrays,
            self._servos.records, *acting)

    def _write_rows(self, setpoints: Any, efforts: FloatArray, payloads: Payloads, *_: Any
                    ) -> IntArray:
        """Write the rows of the laws that act, and return their addresses."""
        from manip_sim.control.law.compiling import Row  # It imports numba.
        from manip_sim.control.law.seat import SEAT
        rows = []
        for part, seat in self._seats(setpoints, efforts, payloads).items():
            made = self._room(part).of
            row = made['row'] = made.get('row') or Row(SEAT)
            row.write(seat)
            rows.append(row.address)
        return np.array(rows, np.int64)

    def _room(self, part: str) -> Derived:
        """Return the arrays made for a part."""
        room: Derived = self._derived.of.setdefault(part, Derived())
        return room

    def _seats(self, setpoints: Any, efforts: FloatArray, payloads: Payloads) -> dict[str, Any]:
        """Return the arguments of the laws that act, by part."""
        return {part: self._seat(part, state, setpoints, efforts, payloads)
                for part, state in self.of.items() if state.acts}

    def _seat(self, part: str, state: SeatState, setpoints: Any, efforts: FloatArray,
              payloads: Payloads) -> Any:
        from manip_sim.control.law.seat import Arguments, Seat  # It imports numba.
        room, indices = self._room(part), self._indices[part]
        if room.of.get('state') is not state:  # That of a restored state is another one.
            room.of.clear()
            room.of.update(
                state=state, forces=self._physics.data.cfrc_ext, others=np.zeros(6),
                starts=np.zeros((len(indices), 2)),
                reads=state.law.reads if state.is_compiled else np.ones(len(COSTLY), dtype=bool),
                code=state.law.code.address if state.is_compiled else 0,
                arguments=Arguments.of(
                    len(indices), state.parameters, state.memory, state.wrench))
            _WATCHDOG.watch(state, f"the law '{state.name}' of {part}")
        made = room.of
        return Seat(made['code'], self._physics.arrays, made['forces'], made['others'], setpoints,
                    efforts, room.made_of(self._joints, part, self._servos.records,
                                          payloads.loads_of(indices)),
                    made['starts'], made['arguments'], made['reads'], state.status)

    def _joints(self, part: str, servos: Any, loads: Any) -> Any:
        from manip_sim.control.law.seat import SeatJoints  # It imports numba.
        model, tip, place = self._physics.model, None, np.full(5, -1, np.int64)
        reader, indices = self._tips.get(part), self._indices[part]
        if reader is not None:
            site, tool = model.site(reader.grip_site), reader.external
            tip = Frame(site.name, int(site.bodyid[0]), int(site.id))
            place[:] = (site.id, tool.site, tool.bodies.start, tool.bodies.stop,
                        model.body_rootid[tool.bodies.start])
        return SeatJoints(self._arms.arm(tip, indices), servos[indices], place, loads)

    # ------------------------------------------------------------------ one step after another

    def begin(self, now_s: float, steps: int, setpoints: Any, efforts: FloatArray,
              payloads: Payloads) -> None:
        """
        Begin an interval whose steps Python runs, after its beginning in compiled code.

        :param now_s: simulation time since the last reset [s]
        :param steps: of the physics in it
        :param setpoints: records of the joints of the robot
        :param efforts: of these joints [N m or N]
        :param payloads: of the arms
        """
        seats = self._seats(setpoints, efforts, payloads)
        self._derived.of['interval'] = [now_s, steps, 0, seats]

    def exert(self) -> None:
        """Let laws exert their efforts, after ``mj_step1``."""
        from manip_sim.control.law.seat import CALLS, FAILED, INSIDE, sense, settle
        interval = self._derived.of['interval']
        begin_s, steps, number, seats = interval
        for part, seat in seats.items():
            if not seat.status[FAILED]:
                sense(seat, begin_s + number * self._servos.step_s, number / steps)
                seat.status[CALLS] += 1
                seat.status[INSIDE] = 1
                self._call(part, seat)
                seat.status[INSIDE] = 0
                if not seat.status[FAILED]:
                    settle(seat)
        interval[2] += 1

    def _call(self, part: str, seat: Any) -> None:
        from manip_sim.control.law.seat import FAILED, RAISED  # It imports numba.
        state = self.of[part]
        try:
            _run(state.law.code.function if state.is_compiled else state.law, seat.arguments)
        except Exception as error:  # A law of a user may raise anything.
            seat.status[FAILED] = RAISED
            self._room(part).of['reason'] = _raised(error)

    def feel(self) -> None:
        """Note the wrenches on tools, after a step."""
        from manip_sim.control.law.seat import feel  # It imports numba.
        model, data = self._physics.model, self._physics.data
        for part, seat in self._derived.of['interval'][3].items():
            if part in self._tips:
                uncollected = self._tips[part].external.uncollected
                if not uncollected.is_empty or has_fluid(model.opt):
                    seat.others[:] = uncollected.wrench(model, data)
                feel(seat)


def _run(function: Callable[..., object], arguments: Any) -> None:
    """
    Call a law with its arguments; a division by zero is infinite, as it is compiled.

    :raises TypeError: if it returns something
    """
    with np.errstate(all='ignore'):
        returned = function(float(arguments.t[0]), *arguments[1:])
    if returned is not None:
        raise TypeError(f'it returns a value, {type(returned).__name__}: {FILLS}')


def _raised(error: Exception) -> str:
    return f'has raised {type(error).__name__}: {one_line(str(error))}'
