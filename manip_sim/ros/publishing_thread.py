# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A thread that publishes, so that a publication that waits in DDS holds up nothing else."""

from __future__ import annotations

from collections.abc import Callable
from queue import SimpleQueue
import threading

#: Period at which who waits checks whether the thread still runs [s].
_WATCH_S = 0.5


class PublishingThread:
    """
    A thread that publishes messages in the order in which they are added.

    What is published, and in which order, is as without it. rclpy would keep Python's global lock
    while it publishes; :func:`manip_sim.rclpy_internals.publish_bytes` does not.

    :param most: publications that may wait, from 2; who adds more has to wait for earlier ones
    """

    def __init__(self, most: int) -> None:
        self._half = most // 2
        self._waiting: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name='publishing')
        self._begun = self._ended = False
        self._lock = threading.Lock()
        #: How many were added, and what is set when those up to the last multiple of half are out.
        self._count = 0
        self._published = threading.Event()
        self._published.set()

    def add(self, publish: Callable[[], object]) -> None:
        """
        Let the thread publish; any thread may call this.

        :param publish: publishes one message, and raises nothing
        """
        if not self._begun:
            with self._lock:
                if not (self._begun or self._ended):
                    self._thread.start()
                    self._begun = True
        if self._ended:
            publish()
            return
        self._waiting.put(publish)
        self._count += 1
        if self._count % self._half == 0:
            before, self._published = self._published, self._mark()
            self._wait(before)

    def _mark(self) -> threading.Event:
        """Return what is set when all that was added before has been published."""
        done = threading.Event()
        self._waiting.put(done.set)
        return done

    def _wait(self, done: threading.Event) -> None:
        while not done.wait(_WATCH_S) and self.is_alive:
            pass

    def flush(self) -> None:
        """Wait until all that was added before has been published."""
        if self._begun and not self._ended and threading.current_thread() is not self._thread:
            self._wait(self._mark())

    @property
    def is_alive(self) -> bool:
        """Whether the thread has not ended unexpectedly."""
        return not self._begun or self._ended or self._thread.is_alive()

    def stop(self) -> None:
        """Publish what waits, and end; what is added later is published by the caller."""
        with self._lock:
            begun, self._ended = self._begun and not self._ended, True
        if begun:
            self._waiting.put(None)
            self._thread.join()

    def _run(self) -> None:
        while (publish := self._waiting.get()) is not None:
            publish()
