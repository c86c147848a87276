# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The thread that owns a simulation: it waits, advances and calls observers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
import contextlib
import threading
import time
from typing import Any, TypeVar

from manip_sim.errors import CommandError, DivergenceError
from manip_sim.runtime.calls import Calls
from manip_sim.runtime.inbox import Inbox
from manip_sim.runtime.noted_operations import NotedOperations
from manip_sim.runtime.observers import Look, Observer, Observers
from manip_sim.runtime.pacing import Pacer, Progress
from manip_sim.runtime.pending_commands import BusyParts, PendingCommands
from manip_sim.simulation import Simulation
from manip_sim.simulation.commands import Command, CommandHandle, Status
from manip_sim.simulation.robot_spawning import RobotsPlan
from manip_sim.simulation.surroundings import ARENA

T = TypeVar('T')
#: For how long ``free`` runs idle control periods at once, at least one of them, wall time [s].
_ROUND_S = 5e-4
#: How many messages of a topic are taken before a call that came after them.
_TAKEN_BEFORE_CALLS = 10
#: Period at which a state is repeated while the simulation does not advance, wall time [s].
_REPEAT_S = 0.1


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
    :param flush: waits until others have seen what observers passed on; called at the end of each
        :meth:`call` of another thread, in that thread
    :ivar journal: of what changes the simulation
    :ivar at_start: whether nothing has moved since the start or the last reset
    :ivar error: what ended the thread, or None
    """

    def __init__(self, simulation: Simulation, steps: int, stepping: str = 'realtime',
                 real_time_factor: float = 1.0,
                 lockstep_parts: Mapping[str, Iterable[str]] | None = None, paused: bool = False,
                 report_failure: Callable[[str, Exception], None] | None = None,
                 inbox: Inbox | None = None, flush: Callable[[], None] | None = None,
                 waits_for_arena: bool = False) -> None:
        self._simulation = simulation
        self._flush = flush
        self._steps = steps
        self._stepping = stepping
        self._report_failure = report_failure
        self._observers = Observers()
        # A stamp of zero means no stamp, so the first instant is that after one period.
        simulation.step_count = max(simulation.step_count, steps)
        self._commands = PendingCommands(
            simulation, (lockstep_parts or {}) if stepping == 'lockstep' else None)
        self._paused = paused
        self._stopping = False
        self._lock = threading.RLock()
        self._inbox = inbox or Inbox()
        self._calls = Calls(self._inbox)
        self._pacer = Pacer(steps * simulation.timestep_s, real_time_factor, time.monotonic())
        self._repeat_at = 0.0
        #: Whether observers are being called, and whether one has changed the state meanwhile.
        self._showing = self._show_again = False
        self._waits_for_arena = waits_for_arena
        #: For the next reset; None: the start stays.
        self._seed: int | None = None
        self._operations = NotedOperations(simulation, steps, self._report)
        self.journal = self._operations.journal
        #: When to pause [ns]; 0: never.
        self._pause_at_ns = 0
        #: How many control periods may be run at once if nothing but physics happens in them.
        self._at_once = 1
        self.progress = Progress(time.monotonic(), simulation.time_ns)
        self.at_start = True
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
        self._observers.add(observer, every, look)

    def unobserve(self, *observers: Observer) -> None:
        """
        Call functions no more; afterwards none of them runs.

        :param observers: that were given to :meth:`observe`
        """
        def remove() -> None:
            for observer in observers:
                self._observers.remove(observer)
        self.call(remove)

    def change_robots(self, plan: RobotsPlan) -> None:
        """
        Change the robots; lock-step waits for no part of a robot that comes.

        :param plan: as for ``Simulation.change_robots``
        """
        def change() -> None:
            self._simulation.change_robots(plan)
            self._commands.look_at_robots()
            self._observers.look_again()
        self.call(change, 'a robot came or went')

    def look_again(self) -> None:
        """Check at the end of the next control period which observers have to be called."""
        self._observers.look_again()

    def keep_busy(self, busy_parts: BusyParts) -> None:
        """
        Exempt parts from those that lock-step waits for, as it exempts parts with trajectories.

        :param busy_parts: returns these atomic parts of a robot, given by its name; called in the
            simulation's thread, must not call back
        """
        self._commands.keep_busy(busy_parts)

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
    def stepping(self) -> str:
        """``realtime``, ``free`` or ``lockstep``."""
        return self._stepping

    @property
    def period_s(self) -> float:
        """Length of a control period in simulation time [s]."""
        return self._steps * self._simulation.timestep_s

    @property
    def real_time_factor(self) -> float:
        """Simulation time per wall time that is requested in ``realtime``."""
        return self._pacer.real_time_factor

    @property
    def paused(self) -> bool:
        """Whether the simulation waits for :meth:`pause` or :meth:`step`."""
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
        :raises UnknownNameError: if there is no such robot
        """
        handles = self._commands.add(commands, stamp_ns, robot)
        if self._stepping == 'lockstep' and threading.current_thread() is not self._thread:
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
        return self.call(lambda: self._operations.run(operation, *arguments, using=using))

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
                    self.journal.unknown(unknown)
        if threading.current_thread() is self._thread:
            return function()
        with self._lock:
            if self._thread.ident is None and not self._stopping:
                return function()
        try:
            return self._calls.run(function)
        finally:
            if self._flush is not None:
                self._flush()

    def at_next_period(self, key: str, operation: str, *arguments: Any, stamp_ns: int = 0) -> None:
        """
        Let the simulation's thread run an operation before its next control period; do not wait.

        :param key: a later operation with the same key replaces one that waits; ``arena/<joint>``
            of a command for a joint of the arena
        :param operation: name of one of :class:`Operations`; what it raises is reported
        :param arguments: what JSON can hold
        :param stamp_ns: in lock-step, stamp of the state that it answers [ns]; 0: not given
        :raises CommandError: in lock-step, if that is not the present state
        """
        self._commands.check_stamp(stamp_ns)
        self._operations.add(key, operation, *arguments)

    @property
    def _misses_arena(self) -> bool:
        return self._waits_for_arena and not self._operations.awaits(f'{ARENA}/')

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
            if not self._paused:
                raise CommandError('the simulation is running: pause it first')
            if self._simulation.diverged is not None:
                raise CommandError(f'{self._simulation.diverged}; reset it first')
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
            self._operations.run('reset', self._seed, restart_time)
            self._commands.clear('the simulation was reset')
            self._operations.clear()
            self._seed = None
            self.at_start = True
            self._show_new()
        self.call(change)

    def _show_new(self) -> None:
        self._pacer.restart(time.monotonic())
        self._show()

    @property
    def objects(self) -> list[list[Any]]:
        """The objects, as :attr:`Operations.objects`."""
        return self._operations.operations.objects

    def restart_by(self, restart: Callable[[int | None], None]) -> None:
        """
        Let another function put the simulation back to its start at resets.

        :param restart: takes the seed of the start, or None to keep the start
        """
        self._operations.operations.restart = restart

    def set_seed(self, seed: int) -> None:
        """
        Draw the start anew at the next reset.

        :param seed: as for ``Simulation.reset``
        """
        self._seed = seed

    def save(self) -> str:
        """
        Save the present state in the only slot there is.

        :returns: its digest
        """
        digest: str = self.change('save')
        return digest

    def restore(self) -> str:
        """
        Continue from the saved state, and show it to the observers; simulation time goes on.

        Commands that run or wait are aborted.

        :returns: the digest of the state
        :raises CommandError: if none has been saved
        :raises ModelError: if objects have come or gone since
        """
        def change() -> str:
            digest: str = self._operations.run('restore')
            self._commands.clear('a saved state was restored')
            self._operations.clear()
            self.at_start = False
            self._show_new()
            return digest
        return self.call(change)

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
                if not held and self._commands.complete and not self._misses_arena:
                    return True
                if now >= self._repeat_at:
                    return False
                self._inbox.wait(self._repeat_at - now)
            elif self._stepping == 'free' or self._pacer.is_due(now):
                return True
            else:
                self._inbox.wait(self._pacer.deadline_s - now)
        return False

    @property
    def _missing(self) -> dict[str, list[str]]:
        return {**self._commands.missing, **({ARENA: [ARENA]} if self._misses_arena else {})}

    @property
    def _repeats(self) -> bool:
        """Whether the present state is repeated, because no period is due by itself."""
        return (self._paused or self._stepping == 'lockstep'
                or self._simulation.diverged is not None)

    def _period(self, most: int = 1) -> None:
        """Run a control period, or up to ``most`` while idle and without observers."""
        self._operations.run_waiting()
        # They may have been withdrawn meanwhile.
        taken = [(name, command) for name, command in self._commands.take()
                 if command.handle.is_active]
        self.journal.commands(taken)
        for name, command in taken:
            self._apply(name, command)
        pauses = self._pause_at_ns > self._simulation.time_ns
        with contextlib.suppress(DivergenceError):  # Observers see ``diverged``.
            if most > 1 and not pauses and self._observers.absent and self._simulation.idle:
                self._simulation.advance_idle(self._steps, most)
            else:
                most = 1
                self._simulation.advance(self._steps)
        self.journal.period()
        self.at_start = False
        if pauses and self._simulation.time_ns >= self._pause_at_ns:
            self._paused = True
        begin_s = self.progress.wall_s
        self._show(number=self._simulation.step_count // self._steps)
        if self._stepping == 'free':
            fitting = int(_ROUND_S * most / max(self.progress.wall_s - begin_s, 1e-6))
            self._at_once = max(1, min(fitting, 2 * self._at_once))

    def _apply(self, robot: str, command: Command) -> None:
        try:
            self._simulation.robots[robot].apply(command, period_s=self.period_s)
        except Exception as error:
            command.handle.end(Status.ABORTED, str(error))
            self._report(', '.join(sorted(command.parts)), error)

    def _report(self, what: str, error: Exception) -> None:
        if self._report_failure is not None:
            self._report_failure(what, error)

    def _show(self, number: int = 0) -> None:
        if self._showing:
            self._show_again = True
            return
        self._showing, self._show_again = True, False
        time_ns = self._simulation.time_ns
        self._commands.may_answer(time_ns)
        now = time.monotonic()
        waits = self._stepping == 'lockstep' and not number
        self.progress = Progress(now, time_ns, self._pacer.missed, self._pacer.lost_s,
                                 self._missing if waits else {})
        self._repeat_at = now + _REPEAT_S
        self._observers.show(self._simulation, number, now, look=self._repeats)
        self._showing = False
