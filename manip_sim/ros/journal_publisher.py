# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish on ``~/journal`` what changes the simulation, so that records can repeat it."""

from __future__ import annotations

from collections.abc import Sequence
import json
import time
from typing import Any

from std_msgs.msg import String

from manip_sim.interface.topics import BY_NAME
from manip_sim.ros.episode_publishers import TaskPublisher
from manip_sim.ros.feature import Feature
from manip_sim.ros.lazy_publishers import create_output
from manip_sim.ros.node_context import NodeContext
from manip_sim.simulation import Simulation

#: How often what has come is published, wall time [s].
_EVERY_S = 0.05


class JournalPublisher(Feature):
    """
    The publisher of ``~/journal``: JSON with the keys ``number``, from 0, and ``entries``.

    The entries are those of :class:`manip_sim.runtime.journal.Journal`. It begins, with the
    present state, for each new subscriber, and ends when the last one has gone.

    :param context: with all parameters declared
    :param task: that is served, or None
    """

    def __init__(self, context: NodeContext, task: TaskPublisher | None) -> None:
        self._output = create_output(context, BY_NAME['~/journal'])
        self._operations = context.thread.changes.operations
        self._journal = context.thread.changes.journal
        # Those that change while the node runs are in the state, too.
        self._parameters = context.parameters.values
        self._task = task
        self._subscribers = self._number = 0
        self._published_s = 0.0
        context.thread.observe(self._follow, look=self._look)

    def _look(self) -> bool:
        if self._journal.active and not self._output.has_subscribers:
            self._journal.end()
            self._subscribers = 0
        return self._output.has_subscribers

    def _follow(self, simulation: Simulation) -> None:
        count = self._output.subscribers
        if count > self._subscribers or self._journal.incomplete:
            self._journal.begin({
                'parameters': self._parameters,
                'objects': self._operations.objects,
                'task_seed': None if self._task is None else self._task.seed}, self._publish)
        self._subscribers = count
        now_s = time.monotonic()
        if now_s >= self._published_s + _EVERY_S:
            self._published_s = now_s
            self._journal.flush()

    def _publish(self, entries: Sequence[Any]) -> None:
        self._output.publish(String(data=json.dumps({'number': self._number, 'entries': entries},
                                                    separators=(',', ':'))))
        self._number += 1

    def close(self) -> None:
        """Publish what is left."""
        self._journal.end()
