# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The thread that owns a simulation: it waits, advances and calls observers.

Other threads wake it by its inbox and pass it functions by a queue of calls; a pacer knows when a
control period is due.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import CancelledError, Future
import contextlib
from dataclasses import dataclass
import math
import threading
import time
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from manip_sim.control.commands import Command, CommandHandle
from manip_sim.errors import CommandError, DivergenceError, SimulationEnded
from manip_sim.runtime.change_queue import ChangeQueue
from manip_sim.simulation import Simulation
from manip_sim.simulation.robot_spawning import RobotsPlan

T = TypeVar('T')
#: Is called with the simulation at the end of control periods, in the simulation's thread.
Observer = Callable[[Simulation], None]
#: Returns whether an observer has to be called.
Look = Callable[[], bool]
#: Period of checks which observers have to be called while the simulation runs, wall time [s].
_LOOK_S = 0.02
#: For how long ``free`` runs idle control periods at once, at least one of them, wall time [s].
_ROUND_S = 5e-4
#: Number of messages of a topic that are taken before a call that came after them.
_TAKEN_BEFORE_CALLS = 10
#: Period at which a state is repeated while the simulation does not advance, wall time [s].
_REPEAT_S = 0.1


@dataclass(frozen=True)
class _Entry:
    observer: Observer
    every: int
    look: Look | None


class Observers:
    """The observers of a simulation; those that nobody needs at present are not called."""

    def __init__(self) -> None:
        self._all: tuple[_Entry, ...] = ()
        self._present: tuple[_Entry, ...] = ()
        self._look_at = 0.0

    def add(self, observer: Observer, every: int, look: Look | None) -> None:
        """
        Add an observer; any thread may call this.

        :raises ValueError: if the divider is less than 1
        """
        if every < 1:
            raise ValueError(f'the divider of an observer must be 1 or more, got {every}')
        self._all = (*self._all, _Entry(observer, every, look))
        self.refresh()

    def remove(self, observer: Observer) -> None:
        """Call an observer no more; to be called where :meth:`show` is."""
        self._all = tuple(entry for entry in self._all if entry.observer != observer)
        self._present = tuple(entry for entry in self._present if entry.observer != observer)

    def refresh(self) -> None:
        """Check at the next state which observers have to be called; any thread may call this."""
        self._look_at = 0.0

    @property
    def absent(self) -> bool:
        """True if no observer had to be called at the last check, and no new one is requested."""
        return not self._present and self._look_at > 0.0

    def show(self, simulation: Simulation, number: int, now_s: float, look: bool) -> None:
        """
        Call the observers that have to be called.

        :param number: of the control period; observers are called at multiples of their divider
        :param now_s: monotonic wall time [s]
        :param look: whether to check which observers have to be called even if that is not due
        """
        if look or now_s >= self._look_at:
            # Set first, or a refresh() that comes meanwhile would be lost.
            self._look_at = now_s + _LOOK_S
            self._present = tuple(
                entry for entry in self._all if entry.look is None or entry.look())
        for entry in self._present:
            if number % entry.every == 0:
                entry.observer(simulation)


class Progress(NamedTuple):
    """
    Progress of the simulation.

    :ivar wall_s: monotonic wall time when the present state was last shown to observers [s]
    :ivar time_ns: simulation time then [ns]
    :ivar missed: control periods that were dropped because the machine could not keep up
    :ivar lost_s: simulation time that was lost with them [s]
    :ivar waits_for: by robot, the parts that lock-step waits for; only filled in when a state is
        repeated, or shown after a start or a reset
    """

    wall_s: float
    time_ns: int
    missed: int = 0
    lost_s: float = 0.0
    waits_for: Mapping[str, list[str]] = MappingProxyType({})


class Pacer:
    """
    Absolute deadlines for control periods that are to run at a factor of real time.

    Errors do not add up: the n-th deadline is the anchor plus n periods. A change of the factor or
    a backlog of more than ``backlog_s`` sets a new anchor, so lost time is not made up for.

    :param period_s: length of a control period in simulation time [s]
    :param real_time_factor: simulation time per wall time
    :param now_s: the present wall time [s]
    :param backlog_s: how late a period may be before the backlog is dropped, wall time [s]
    :ivar real_time_factor: as given, or as :meth:`set_real_time_factor` has changed it
    :ivar lost_s: simulation time that was lost with the backlog so far [s]
    """

    def __init__(self, period_s: float, real_time_factor: float, now_s: float,
                 backlog_s: float = 0.1) -> None:
        self._period_s = period_s
        self._backlog_s = backlog_s
        self.real_time_factor = real_time_factor
        self.lost_s = 0.0
        self.restart(now_s)

    def restart(self, now_s: float) -> None:
        """Set a new anchor: the next period is due one period from now."""
        self._anchor_s = now_s
        self._count = 1

    def set_real_time_factor(self, factor: float, now_s: float) -> None:
        """Change the real-time factor from now on."""
        self.real_time_factor = factor
        self.restart(now_s)

    @property
    def missed(self) -> int:
        """Number of control periods that were dropped so far, rounded down."""
        return math.floor(self.lost_s / self._period_s + 1e-9)

    @property
    def deadline_s(self) -> float:
        """Wall time at which the next period is due [s]."""
        return self._anchor_s + self._count * self._period_s / self.real_time_factor

    def is_due(self, now_s: float) -> bool:
        """Return whether a period is due, and count it as begun if so."""
        late_s = now_s - self.deadline_s
        if late_s < 0.0:
            return False
        if late_s > self._backlog_s:
            self.lost_s += late_s * self.real_time_factor
            self.restart(now_s)
        else:
            self._count += 1
        return True


class Inbox:
    """A signal by which other threads wake the one that waits."""

    def __init__(self) -> None:
        #: Held while nobody has woken it.
        self._asleep = threading.Lock()
        self._asleep.acquire()

    def wake(self) -> None:
        """End the present wait, or the next one if nobody waits; any thread may call this."""
        with contextlib.suppress(RuntimeError):  # It is woken already.
            self._asleep.release()

    def wait(self, timeout_s: float) -> None:
        """
        Wait until there may be something to do.

        :param timeout_s: how long to wait at most [s]
        """
        self._asleep.acquire(timeout=max(0.0, timeout_s))

    def take(self, most: int) -> None:
        """
        Take the messages that have come, without waiting; here there are none.

        :param most: how many of each topic
        """


class CallQueue:
    """
    Functions that wait for the simulation's thread, in the order in which they came.

    :param inbox: wakes that thread
    """

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox
        self._lock = threading.Lock()
        self._waiting: list[tuple[Callable[[], object], Future[object]]] = []
        self._ended = False

    def __bool__(self) -> bool:
        """Return whether a function waits."""
        return bool(self._waiting)

    def run(self, function: Callable[[], T]) -> T:
        """
        Let the simulation's thread run a function, and wait until it has.

        :returns: what the function returns
        :raises Exception: what the function raises
        :raises SimulationEnded: if the simulation has ended, or ends before it runs the function
        """
        future: Future[T] = Future()
        with self._lock:
            if self._ended:
                raise SimulationEnded('the simulation has ended')
            self._waiting.append((function, future))  # type: ignore[arg-type]
        self._inbox.wake()
        try:
            return future.result()
        except CancelledError as error:
            raise SimulationEnded('the simulation has ended') from error

    def answer(self) -> None:
        """Run the functions that wait; called in the simulation's thread."""
        with self._lock:
            waiting, self._waiting = self._waiting, []
        for function, future in waiting:
            try:
                future.set_result(function())
            except Exception as error:
                future.set_exception(error)
            except BaseException as error:  # It ends the thread, for which nobody may wait then.
                for _, other in waiting:
                    if not other.done():
                        other.set_exception(error)
                raise

    def end(self) -> None:
        """Cancel the functions that wait, and accept no more."""
        with self._lock:
            self._ended = True
            waiting, self._waiting = self._waiting, []
        for _, future in waiting:
            future.cancel()


def _nothing() -> None:
    pass


class SimulationThread:
    """
    A thread that runs a simulation.

    :param simulation: used by this thread alone while it runs
    :param steps: physics steps of a control period
    :param stepping: ``realtime``, ``free`` or ``lockstep``
    :param real_time_factor: for ``realtime``
    :param lockstep_parts: by robot, the parts that must have had a command in ``lockstep``
    :param paused: whether to begin paused and wait for :meth:`pause` or :meth:`step`
    :param report_failure: is called in this thread with what failed, such as the parts of a
        command, and the exception
    :param inbox: what the thread waits for besides deadlines; may bring commands
    :param waits_for_arena: whether ``lockstep`` needs a command for joints of the arena, too
    :param take: waits until commands that have come are here; called at the beginning of each
        :meth:`call` of another thread, in that thread
    :param flush: waits until others have seen what observers passed on; called at the end of each
        :meth:`call` of another thread, in that thread
    :ivar stepping: as given
    :ivar period_s: length of a control period in simulation time [s]
    :ivar changes: commands and operations, and their journal
    :ivar observers: that are called
    :ivar next_seed: draws the start anew at the next reset; None: the start stays
    :ivar at_start: whether nothing has moved since the start or the last reset
    :ivar restarted: is called after each :meth:`reset` and :meth:`restore`, by their caller
    :ivar error: what ended the thread, or None
    """

    def __init__(self, simulation: Simulation, steps: int, stepping: str = 'realtime',
                 real_time_factor: float = 1.0,
                 lockstep_parts: Mapping[str, Iterable[str]] | None = None, paused: bool = False,
                 report_failure: Callable[[str, Exception], None] | None = None,
                 inbox: Inbox | None = None, take: Callable[[], None] | None = None,
                 flush: Callable[[], None] | None = None, waits_for_arena: bool = False) -> None:
        self._simulation = simulation
        self._take, self._flush = take or _nothing, flush or _nothing
        self._steps = steps
        self.period_s = steps * simulation.timestep_s
        self.stepping = stepping
        self.observers = Observers()
        # A stamp of zero means no stamp, so the first instant is that after one period.
        simulation.step_count = max(simulation.step_count, steps)
        self.changes = ChangeQueue(
            simulation, steps, (lockstep_parts or {}) if stepping == 'lockstep' else None,
            waits_for_arena, report_failure or (lambda failed, error: None))
        self._paused = paused
        self._stopping = False
        self._lock = threading.RLock()
        self._inbox = inbox or Inbox()
        self._calls = CallQueue(self._inbox)
        self._pacer = Pacer(self.period_s, real_time_factor, time.monotonic())
        self._repeat_at = 0.0
        #: Observers are being called; one of them has changed the state meanwhile.
        self._showing = self._show_again = False
        self.next_seed: int | None = None
        #: When to pause [ns]; 0: never.
        self._pause_at_ns = 0
        #: Number of control periods that may run at once if nothing but physics happens in them.
        self._at_once = 1
        self.progress = Progress(time.monotonic(), simulation.time_ns)
        self.at_start = True
        self.restarted = _nothing
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name='physics')

    def is_due(self, every: int) -> bool:
        """
        Return whether the present state is one of every so many, or is held and so repeated.

        In lock-step a state is repeated until it is answered, whether it is due or not.

        :param every: a number of control periods
        """
        held = self.paused or self.at_start or self._simulation.diverged is not None
        return held or self._simulation.step_count // self._steps % every == 0

    def observe(self, observer: Observer, every: int = 1, look: Look | None = None) -> None:
        """
        Call a function at the end of control periods from now on.

        It sees each period whose number, counted from the beginning of simulation time, is a
        multiple of ``every``; the state after a start or a reset and repeated states in any case.
        It may use all methods but :meth:`step`, and must not wait for another thread that does.

        :param observer: is called in the simulation's thread, which waits for it
        :param every: divider of the control periods, 1 or more
        :param look: returns in the simulation's thread whether the observer has to be called; it
            is asked before each state while the simulation is paused, diverged or in lock-step,
            else every 20 ms; None: always call
        :raises ValueError: if the divider is less than 1
        """
        self.observers.add(observer, every, look)

    def unobserve(self, *observers: Observer) -> None:
        """
        Call functions no more; afterwards none of them runs.

        :param observers: that were given to :meth:`observe`
        """
        def remove() -> None:
            for observer in observers:
                self.observers.remove(observer)
        self.call(remove)

    def change_robots(self, plan: RobotsPlan, event: str = 'a robot came or went') -> None:
        """
        Change the robots; lock-step waits for no part of a robot that comes.

        :param plan: as for ``Simulation.change_robots``
        :param event: for records, which cannot repeat it
        """
        def change() -> None:
            self._simulation.change_robots(plan)
            self.changes.commands.sync_robots()
            self.observers.refresh()
        self.call(change, event)

    def start(self) -> None:
        """Start the thread; it first shows the observers the present state."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; calls that wait are cancelled."""
        self._stopping = True
        self._inbox.wake()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join()
        self._calls.end()

    @property
    def real_time_factor(self) -> float:
        """Simulation time per wall time that is requested in ``realtime``."""
        return self._pacer.real_time_factor

    @property
    def paused(self) -> bool:
        """True if the simulation waits for :meth:`pause` or :meth:`step`."""
        return self._paused

    def submit(self, commands: Iterable[Command], stamp_ns: int = 0, robot: str | None = None
               ) -> list[CommandHandle]:
        """
        Hand over validated commands; the next control period uses them.

        :param commands: validated, for one robot
        :param stamp_ns: in lock-step, stamp of the state that they answer, else when they were
            sent, by any clock [ns]; 0: not given
        :param robot: its name; None: the only robot
        :returns: the handle of each command
        :raises CommandError: if a command was made for another robot; in lock-step, if that is not
            the present state, or if all commands for it have come already
        :raises UnknownNameError: if the robot is unknown
        """
        handles = self.changes.commands.add(commands, stamp_ns, robot)
        if self.stepping == 'lockstep' and threading.current_thread() is not self._thread:
            self._inbox.wake()
        return handles

    def change(self, operation: str, *arguments: Any, using: Any = None) -> Any:
        """
        Run an operation in the simulation's thread as :meth:`call`; records can repeat it.

        :param operation: name of one of :class:`Operations`
        :param arguments: what JSON can hold
        :param using: what the operation would make of its arguments, if that is there already
        :returns: what the operation returns
        :raises ManipSimError: if it cannot be done
        :raises SimulationEnded: as :meth:`call`
        """
        return self.call(lambda: self.changes.run(operation, *arguments, using=using))

    def call(self, function: Callable[[], T], unknown: str = '') -> T:
        """
        Run a function in the simulation's thread, between two control periods.

        Before the thread has been started, and in the thread itself, such as in an observer, the
        function runs at once.

        :param function: takes nothing; may change the simulation by :meth:`change`
        :param unknown: what else it changes in the simulation, which no record can repeat
        :returns: what the function returns
        :raises Exception: what the function raises
        :raises SimulationEnded: if the simulation has ended, or ends before it runs the function
        """
        if unknown:
            changing = function

            def function() -> T:
                try:
                    return changing()
                finally:
                    self.changes.journal.unknown(unknown)
        if threading.current_thread() is self._thread:
            return function()
        with self._lock:
            if self._thread.ident is None and not self._stopping:
                return function()
        self._take()
        try:
            return self._calls.run(function)
        finally:
            self._flush()

    def pause(self, paused: bool) -> None:
        """
        Pause or resume the simulation; wall time that passed meanwhile is not made up for.

        :param paused: whether to pause
        """
        def change() -> None:
            if self._paused and not paused:
                self._pacer.restart(time.monotonic())
            self._paused = paused
        self.call(change)

    def pause_at(self, time_s: float) -> None:
        """
        Pause at the end of the first control period that reaches a time.

        :param time_s: simulation time [s]; one that has passed, such as 0, has no effect
        """
        self._pause_at_ns = round(time_s * 1e9)

    def step(self) -> None:
        """
        Advance by one control period and show the observers its state.

        :raises CommandError: if the simulation is not paused, or has diverged, or in an observer
        """
        def advance() -> None:
            if self._showing:
                raise CommandError('an observer cannot step the simulation')
            if self._simulation.diverged is not None:
                raise CommandError(f'{self._simulation.diverged}; reset it first')
            if not self._paused:
                raise CommandError('the simulation is running: pause it first')
            self._period()
        self.call(advance)

    def reset(self, restart_time: bool = False) -> None:
        """
        Put the simulation back to its start, abort all commands, show the observers the state.

        Where an observer does this, the start is shown as soon as all observers have been called.

        :param restart_time: whether simulation time begins again, as at the start, or goes on
        :raises ModelError: if the start cannot be drawn from a new seed; then nothing changes
        """
        def change() -> None:
            self.changes.run('reset', self.next_seed, restart_time)
            self.changes.clear('the simulation was reset')
            self.next_seed = None
            self.at_start = True
            self._show_new()
        self.call(change)
        self.restarted()

    def _show_new(self) -> None:
        self._pacer.restart(time.monotonic())
        self._show()

    def restore(self) -> str:
        """
        Continue from the saved state, and show it to the observers; simulation time goes on.

        Commands that run or wait are aborted.

        :returns: the digest of the state
        :raises CommandError: if none has been saved
        :raises ModelError: if objects have come or gone since
        """
        def change() -> str:
            digest: str = self.changes.run('restore')
            self.changes.clear('a saved state was restored')
            self.at_start = False
            self._show_new()
            return digest
        restored = self.call(change)
        self.restarted()
        return restored

    def set_real_time_factor(self, factor: float) -> None:
        """
        Change the speed of the simulation from now on.

        :param factor: simulation time per wall time, above 0
        """
        self.call(lambda: self._pacer.set_real_time_factor(factor, time.monotonic()))

    # ------------------------------------------------------------------ in the thread

    def _run(self) -> None:
        try:
            self._show()
            self._pacer.restart(time.monotonic())
            while True:
                due = self._wait()
                if self._stopping:
                    return
                if self._calls:
                    # Commands that came before a call are taken before it.
                    self._inbox.take(_TAKEN_BEFORE_CALLS)
                    self._calls.answer()
                    due = False  # The period may have lost its commands: look again.
                if due and not self._paused:
                    self._period(most=self._at_once)
                elif self._show_again or self._repeats and time.monotonic() >= self._repeat_at:
                    self._show()
        except BaseException as error:  # The main thread has to learn of it.
            self.error = error
            self._stopping = True
            self._calls.end()

    def _wait(self) -> bool:
        """Wait until there is something to do; return whether a control period is due."""
        while not (self._stopping or self._calls or self._show_again):
            now = time.monotonic()
            if self._repeats:
                held = self._paused or self._simulation.diverged is not None
                if not held and self.changes.complete:
                    return True
                if now >= self._repeat_at:
                    return False
                self._inbox.wait(self._repeat_at - now)
            elif self.stepping == 'free' or self._pacer.is_due(now):
                return True
            else:
                self._inbox.wait(self._pacer.deadline_s - now)
        return False

    @property
    def _repeats(self) -> bool:
        """True if the present state is repeated, because no period is due by itself."""
        return (self._paused or self.stepping == 'lockstep'
                or self._simulation.diverged is not None)

    def _period(self, most: int = 1) -> None:
        """Run a control period, or up to ``most`` while idle and without observers."""
        self.changes.take_effect()
        pauses = self._pause_at_ns > self._simulation.time_ns
        with contextlib.suppress(DivergenceError):  # Observers see ``diverged``.
            if not (most > 1 and not pauses and self.observers.absent and self._simulation.idle):
                most = 1
            for _ in range(most):
                self._simulation.advance(self._steps)
        self.changes.journal.period()
        self.at_start = False
        if pauses and self._simulation.time_ns >= self._pause_at_ns:
            self._paused = True
        begin_s = self.progress.wall_s
        self._show(number=self._simulation.step_count // self._steps)
        if self.stepping == 'free':
            fitting = int(_ROUND_S * most / max(self.progress.wall_s - begin_s, 1e-6))
            self._at_once = max(1, min(fitting, 2 * self._at_once))

    def _show(self, number: int = 0) -> None:
        if self._showing:
            self._show_again = True
            return
        self._showing, self._show_again = True, False
        time_ns = self._simulation.time_ns
        self.changes.commands.may_answer(time_ns)
        now = time.monotonic()
        waits = self.stepping == 'lockstep' and not number
        self.progress = Progress(now, time_ns, self._pacer.missed, self._pacer.lost_s,
                                 self.changes.missing if waits else {})
        self._repeat_at = now + _REPEAT_S
        self.observers.show(self._simulation, number, now, look=self._repeats)
        self._showing = False
