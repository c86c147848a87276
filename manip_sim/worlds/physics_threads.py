# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Threads that compute the physics of several worlds at once, without Python's global lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait

from manip_sim.startup import processors
from manip_sim.validation import whole_number


class PhysicsThreads:
    """
    The calling thread and some others, which share the work.

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
