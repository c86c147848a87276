# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Wake-up of a thread by other threads, their calls, or messages in a subclass."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Future
import contextlib
import threading
from typing import TypeVar

from manip_sim.errors import SimulationEnded


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


T = TypeVar('T')


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
