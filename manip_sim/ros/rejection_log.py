# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Log rejections and failures: bounded in lines, in length and in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import threading
import time
from typing import Any

from manip_sim.quoting import one_line

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

    def failure(self, what: str, topic: str, error: Exception) -> None:
        """
        Count an exception that nobody expected, and log it as :meth:`warn` does.

        :param what: ``callbacks``, ``publications`` or ``commands``
        :param topic: topic or service that was served, or parts that were commanded
        """
        with self._lock:
            self.failed[what] += 1
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
