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


async def in_background(node: Node, work: Callable[[], T]) -> T:
    """
    Return the result of some work; to be awaited in a callback.

    :param node: its executor runs the callback
    :param work: is called in a thread of its own
    """
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:  # It is raised in the callback.
            outcome.set_exception(error)
        if node.executor is not None:
            with contextlib.suppress(InvalidHandle):  # The executor has ended.
                node.executor.wake()
    threading.Thread(target=run, name=THREAD_NAME, daemon=True).start()
    return await _Outcome(outcome)


class _Outcome:
    """An awaitable that lets the executor run other callbacks until some work is done."""

    def __init__(self, outcome: Future[Any]) -> None:
        self._outcome = outcome

    def __await__(self) -> Generator[None, None, Any]:
        while not self._outcome.done():
            yield
        return self._outcome.result()
