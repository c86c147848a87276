# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Notice laws of users that never return, which nothing else in the process can end."""

from __future__ import annotations

import logging
import os
import threading
import time
from typing import Protocol
import weakref

from manip_sim.arrays import IntArray

#: Longest time of a call of a law [s], and rate of the checks [1/s].
_PATIENCE_S, _RATE_HZ = 10, 1
#: Code with which the process ends, EX_SOFTWARE of sysexits.h.
_EXIT_CODE = 70
_LOGGER = logging.getLogger('manip_sim.control')


class _Called(Protocol):
    """
    A function that is called periodically.

    :ivar status: how often it was called, and whether it runs now
    :ivar is_compiled: whether it runs without Python
    """

    status: IntArray
    is_compiled: bool


class _Watchdog:
    """Looks at laws from a thread of its own, which begins with the first."""

    def __init__(self) -> None:
        self._names: weakref.WeakKeyDictionary[_Called, str] = weakref.WeakKeyDictionary()
        self._lock, self._process = threading.Lock(), 0

    def watch(self, law: _Called, name: str) -> None:
        """Look at a law from now on, as long as it exists."""
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


def _end_or_warn(law: _Called, name: str) -> None:
    if not law.is_compiled:
        _LOGGER.warning('%s has not returned for %d s', name, _PATIENCE_S)
        return
    _LOGGER.critical('%s has not returned for %d s: the process ends, as compiled code cannot be '
                     'interrupted', name, _PATIENCE_S)
    logging.shutdown()
    os._exit(_EXIT_CODE)


_WATCHDOG = _Watchdog()


def watch(law: _Called, name: str) -> None:
    """
    End the process, with a message, if a compiled law never returns; warn if it runs as Python.

    :param law: watched as long as it exists
    :param name: for the message
    """
    _WATCHDOG.watch(law, name)
