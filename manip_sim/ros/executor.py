# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
An executor that outlives exceptions of callbacks, and work in threads that they await.

Failures and rejected messages are logged, bounded in lines, in length and in memory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator
from concurrent.futures import Future
import contextlib
import threading
import time
from typing import Any, TypeVar

from rclpy.context import Context
from rclpy.executors import (
    await_or_execute, ConditionReachedException, ExternalShutdownException, InvalidHandle,
    ShutdownException, SingleThreadedExecutor, TimeoutException)
from rclpy.node import Node
import rclpy.task

from manip_sim.errors import ManipSimError
from manip_sim.quoting import one_line

#: Least time between two warnings of one kind [s].
_PERIOD_S = 1.0
#: Topics times kinds of error are far fewer.
_MAX_KEYS = 1000


def kind_of(error: BaseException) -> str:
    """
    Return a key for the kind of an error: its class and the line that raised it.

    Unlike the text of the error, it does not depend on the received message.
    """
    place = error.__traceback__
    if place is None:
        return type(error).__name__
    while place.tb_next is not None:
        place = place.tb_next
    return f'{type(error).__name__} {place.tb_frame.f_code.co_filename}:{place.tb_lineno}'


class RejectionLog:
    """
    Warnings about messages, each kind of error of a topic once a second; any thread may use it.

    :param logger: the logger of the node
    :param clock: returns monotonic wall time [s]
    :ivar failed: how many ``callbacks``, ``publications`` and ``commands`` have failed, and how
        often received data could not be read, as ``takes``
    """

    def __init__(self, logger: Any, clock: Callable[[], float] = time.monotonic) -> None:
        self._logger = logger
        self._clock = clock
        self._lock = threading.Lock()
        self._logged_s: dict[tuple[str, str], float] = {}
        self._left_out: Counter[tuple[str, str]] = Counter()
        self.failed = Counter({'callbacks': 0, 'publications': 0, 'takes': 0})

    def warn(self, topic: str, kind: str, text: str) -> None:
        """
        Log a warning, unless the same kind was logged for this topic within the last second.

        The next warning of this kind says how many were left out.

        :param topic: topic or service; its name must not come from outside
        :param kind: what makes warnings alike, such as :func:`kind_of`; from a bounded set
        :param text: may contain what came from outside; line ends are escaped, it is shortened
        """
        key = (topic, kind)
        with self._lock:
            now_s = self._clock()
            if now_s - self._logged_s.get(key, -_PERIOD_S) < _PERIOD_S:
                self._left_out[key] += 1
                return
            left_out = self._left_out.pop(key, 0)
            self._logged_s.pop(key, None)
            self._logged_s[key] = now_s
            if len(self._logged_s) > _MAX_KEYS:
                oldest = next(iter(self._logged_s))
                del self._logged_s[oldest]
                self._left_out.pop(oldest, None)
        self._logger.warning(one_line(text) + (f' ({left_out} more before)' if left_out else ''))

    def failure(self, activity: str, topic: str, error: Exception) -> None:
        """
        Count an exception that nobody expected, and log it as :meth:`warn` does.

        :param activity: ``callbacks``, ``publications`` or ``commands``
        :param topic: topic or service that was served, or parts that were commanded
        """
        with self._lock:
            self.failed[activity] += 1
        self.warn(topic, kind_of(error), f'{topic}: {type(error).__name__}: {error}')

    def unreadable(self, topic: str) -> None:
        """
        Count received data that is not a message of its type, and log it as :meth:`warn` does.

        :param topic: topic or service that it came on
        """
        with self._lock:
            self.failed['takes'] += 1
        self.warn(topic, 'unreadable', f'{topic}: received data that cannot be read as a message '
                  'of its type')


T = TypeVar('T')
#: Name of the threads; one that runs when the process ends is abandoned.
BACKGROUND_THREAD = 'background'
#: Longest wait for clients at the end of a node, wall time [s].
_END_S = 1.0
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
    threading.Thread(target=run, name=BACKGROUND_THREAD, daemon=True).start()
    return outcome


def load_laws() -> None:
    """
    Load what a simulation calls of compiled code, or compile it, in any thread.

    :raises ManipSimError: if compiled control laws cannot be kept
    """
    # They import numba.
    from manip_sim.control.law import kept, loading
    from manip_sim.simulation import compiled_period
    try:
        loading.load_laws()
        compiled_period.load()
    except OSError as error:
        raise ManipSimError(f'cannot keep compiled control laws in {kept.laws_folder()}: '
                            f'{error.strerror}; set XDG_CACHE_HOME to another folder') from error


async def in_background(node: Node, work: Callable[[], T]) -> T:
    """
    Return the result of some work; to be awaited in a callback.

    :param node: its executor runs the callback
    :param work: is called in a thread of its own
    """
    # A future of rclpy, as a coroutine that yields anything else is gone on with at once in the
    # rclpy of Lyrical, again and again.
    known = rclpy.task.Future(executor=node.executor)

    def wake() -> None:
        with contextlib.suppress(InvalidHandle):  # The executor has ended.
            known.set_result(None)
            if node.executor is not None:
                node.executor.wake()
    outcome = begin(work, wake)
    await known
    return outcome.result()


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


def let_clients_know(node: Node) -> None:
    """Wait until clients have the results that are ready; another thread spins the node."""
    known = threading.Event()

    async def wait() -> None:
        await Rounds(node, RESULT_ROUNDS)
        known.set()
    if node.executor is not None:
        node.executor.create_task(wait)
        known.wait(_END_S)


class GuardedExecutor(SingleThreadedExecutor):
    """
    A single-threaded executor: a callback that raises is logged and counted, the next one runs.

    This holds for all callbacks, also within rclpy, such as of the parameter services. The client
    of a service that raised gets no answer. Data that cannot be read is logged and counted
    too: rclpy only shows that a subscription or service was ready and that nothing could be taken
    from it. Unreadable data that waits together counts once.

    :param context: the context of the nodes
    """

    def __init__(self, log: RejectionLog, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._log = log
        self._ending = False

    def spin(self) -> None:
        """Run callbacks until :meth:`end`, or until the context is shut down."""
        with contextlib.suppress(ExternalShutdownException):
            while self.context.ok() and not self._ending:
                self.spin_once()

    def end(self) -> None:
        """
        Let :meth:`spin` return after the present callback.

        Join the thread of :meth:`spin` before ``shutdown``, which would otherwise destroy what a
        running callback triggers at its end.
        """
        self._ending = True
        self.wake()

    def _is_ending(self) -> bool:
        # Not a function made for each call: with another one rclpy would forget ready entities.
        return self._ending

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for one callback and run it, as :meth:`run_one`."""
        self.run_one(timeout_sec)

    def run_one(self, timeout_s: float | None) -> bool:
        """
        Wait for one callback and run it.

        :param timeout_s: how long to wait [s]; None: until there is one
        :returns: whether there was one
        """
        try:
            task, entity, _ = self.wait_for_ready_callbacks(timeout_s, None, self._is_ending)
        except (ConditionReachedException, ShutdownException, TimeoutException):
            return False
        task()
        error = task.exception()
        if error is not None:
            _release(entity)
            self._log.failure('callbacks', _name_of(entity), error)
        return True

    def _take_subscription(self, sub: Any) -> Any:
        with contextlib.suppress(InvalidHandle), sub.handle:
            execute = super()._take_subscription(sub)
            if execute is None:
                self._log.unreadable(_name_of(sub))
            return execute
        return None

    def _take_service(self, srv: Any) -> Any:
        # Like rclpy's method, which does not report that there was no request.
        with contextlib.suppress(InvalidHandle), srv.handle:
            request, header = srv.handle.service_take_request(srv.srv_type.Request)
            if header is None:
                self._log.unreadable(_name_of(srv))
                return None

            async def execute() -> None:
                response = await await_or_execute(srv.callback, request, srv.srv_type.Response())
                srv.send_response(response, header)
            return execute
        return None


def _release(entity: Any) -> None:
    """Let executors wait again for an entity whose message could not even be taken."""
    if entity is None:
        return
    entity._executor_event = False
    if not entity.callback_group.can_execute(entity):
        entity.callback_group.ending_execution(entity)


def _name_of(entity: Any) -> str:
    for attribute in ('topic_name', 'srv_name'):
        name = getattr(entity, attribute, None)
        if isinstance(name, str):
            return name
    return 'a task' if entity is None else f'a {type(entity).__name__.lower()}'
