# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Work that takes long, in a thread of its own, while the executor runs other callbacks."""

from __future__ import annotations

from collections.abc import Callable, Generator
from concurrent.futures import Future
import contextlib
import threading
from typing import Any, TypeVar

from rclpy.executors import InvalidHandle
from rclpy.node import Node

T = TypeVar('T')
#: Name of the threads; one that runs when the process ends is abandoned.
THREAD_NAME = 'background'
#: Rounds of the executor until clients of goals have their results: ends of goals, results and
#: their answers each take one.
RESULT_ROUNDS = 6


def begin(work: Callable[[], T], at_end: Callable[[], None] = lambda: None) -> Future[T]:
    """
    Begin some work in a thread of its own.

    :param at_end: is called when the outcome is known
    """
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:  # It is raised by whoever asks for the result.
            outcome.set_exception(error)
        at_end()
    threading.Thread(target=run, name=THREAD_NAME, daemon=True).start()
    return outcome


async def in_background(node: Node, work: Callable[[], T]) -> T:
    """
    Return the result of some work; to be awaited in a callback.

    :param node: its executor runs the callback
    :param work: is called in a thread of its own
    """
    def wake() -> None:
        if node.executor is not None:
            with contextlib.suppress(InvalidHandle):  # The executor has ended.
                node.executor.wake()
    return await _Outcome(begin(work, wake))


class _Outcome:
    """An awaitable that lets the executor run other callbacks until some work is done."""

    def __init__(self, outcome: Future[Any]) -> None:
        self._outcome = outcome

    def __await__(self) -> Generator[None, None, Any]:
        while not self._outcome.done():
            yield
        return self._outcome.result()


class Rounds:
    """
    An awaitable that lets the executor run what else is ready before a coroutine goes on.

    :param count: how often
    """

    def __init__(self, node: Node, count: int = 1) -> None:
        self._node, self._count = node, count

    def __await__(self) -> Generator[None, None, None]:
        for _ in range(self._count):
            # An executor goes on with tasks that it has begun only when something wakes it.
            executor = self._node.executor
            if executor is not None:
                executor.wake()
            yield
