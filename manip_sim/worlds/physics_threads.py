# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Threads that compute the physics of several worlds at once, without Python's global lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
import os

from manip_sim.errors import ModelError


class PhysicsThreads:
    """
    The calling thread and some others, which share the work.

    :param count: number of threads, the calling one included; None for one per processor that
        this process may use
    :ivar count: number of threads
    :raises ModelError: if it is no whole number from 1
    """

    def __init__(self, count: int | None) -> None:
        if count is None:
            count = _processors()
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise ModelError(f'threads must be a whole number from 1, or None, got {count!r}')
        self.count = count
        self._others = (
            ThreadPoolExecutor(count - 1, 'manip_sim_worlds') if count > 1 else None)

    def run(self, work: Sequence[Callable[[], None]]) -> None:
        """Call functions, each in any of the threads, and return when all have returned."""
        shares = [work[begin::self.count] for begin in range(self.count)]
        if self._others is None or len(work) < 2:
            _call(work)
            return
        waiting = [self._others.submit(_call, share) for share in shares[1:] if share]
        _call(shares[0])
        for share in waiting:
            share.result()

    def close(self) -> None:
        """End the other threads."""
        if self._others is not None:
            self._others.shutdown()


def _call(work: Sequence[Callable[[], None]]) -> None:
    for function in work:
        function()


def _processors() -> int:
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
