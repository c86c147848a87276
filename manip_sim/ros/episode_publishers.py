# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the start of the present episode, the task that is done in it, and the journal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import json
import time
from typing import Any

import mujoco
import numpy as np
from std_msgs.msg import String

from manip_sim.interface.topics import BY_NAME
from manip_sim.resources import package_version
from manip_sim.ros.feature import create_output, create_publisher, Feature, NodeContext
from manip_sim.simulation import Simulation
from manip_sim.tasks import start, Task

#: Of how many episodes the digests are kept for states that are restored.
_REMEMBERED = 1000
#: Interval at which new content is published, wall time [s].
_JOURNAL_S = 0.05


class EpisodePublisher(Feature):
    """
    A latched publisher of ``~/episode``: JSON, at the start and after each reset.

    It publishes after a restore, too, if that leads to another episode. Its keys are ``seed``,
    ``drawn`` (what ``randomization`` drew, by name, in SI units), ``versions`` of ``manip_sim``,
    ``mujoco`` and ``numpy``, ``digest`` of the start, and ``stamp_ns`` of the first states.

    :param context: with a thread that has not been started
    :param restart: puts the simulation to its start, from a seed or as it was
    :param joints_changed: is called in the simulation's thread when joints were drawn
    """

    def __init__(self, context: NodeContext, restart: Callable[[int | None], None],
                 joints_changed: Callable[[], None]) -> None:
        self._publisher = create_publisher(context, BY_NAME['~/episode'])
        self._simulation: Simulation = context.simulation
        self._restart_simulation, self._joints_changed = restart, joints_changed
        #: Digests of the starts of all episodes that may be in a saved state, by what they are of.
        self._digests: dict[str, str] = {}
        self._published: tuple[int, Any] | None = None
        self._refresh = context.thread.observers.refresh
        context.thread.changes.operations.restart = self._restart
        context.thread.observe(self._follow, look=self._is_another)

    def start(self) -> None:
        """
        Begin the first episode.

        It begins as all others: parameters do not undo draws, nor leave a change of mode behind.
        """
        self._restart(self._simulation.seed)

    def _restart(self, seed: int | None) -> None:
        self._restart_simulation(seed)
        if len(self._digests) >= _REMEMBERED:
            del self._digests[next(iter(self._digests))]
        self._digests[self._key()] = self._simulation.digest()
        # It is published with the first states, as their stamp is not known yet.
        self._published = None
        self._refresh()

    def _is_another(self) -> bool:
        """Return whether another episode has begun, or a state of another one was restored."""
        return (self._simulation.seed, self._simulation.randomized.drawn) != self._published

    def _follow(self, simulation: Simulation) -> None:
        if not self._is_another():
            return
        drawn = simulation.randomized.drawn
        self._published = simulation.seed, drawn
        self._publisher.publish(String(data=json.dumps({
            'seed': simulation.seed, 'drawn': drawn, 'versions': {
                'manip_sim': package_version(), 'mujoco': mujoco.mj_versionString(),
                'numpy': np.__version__},
            'digest': self._digests.get(self._key(), ''), 'stamp_ns': simulation.time_ns},
            allow_nan=False)))
        if any(name.startswith('joints/') for name in drawn):
            self._joints_changed()

    def _key(self) -> str:
        return repr((self._simulation.seed, self._simulation.randomized.drawn))


class TaskPublisher(Feature):
    """
    A latched publisher of ``~/task``: JSON, once for each instant.

    Its keys are ``task``, ``robot``, ``instruction``, ``seed`` of the start, ``stamp_ns`` of the
    instant, ``success``, ``reward``, and ``goal``, as the task has it. Resets draw the start of
    the task from the parameter ``seed``, where :meth:`restart` does them.

    :param context: with a thread that has not been started
    :param task: that is performed
    """

    def __init__(self, context: NodeContext, task: Task) -> None:
        self._publisher = create_publisher(context, BY_NAME['~/task'])
        self._task, self._simulation, self._thread = task, context.simulation, context.thread
        self._seen_ns = -1
        self.restart(context.parameters.value('seed'))
        # Changes by the task at the end of a period are in the states that are published.
        context.thread.observe(self._end_period)

    def restart(self, seed: int | None) -> None:
        """Begin the episode of a seed, or the same one again."""
        start(self._task, self._simulation, self.seed if seed is None else seed)

    @property
    def seed(self) -> int:
        """The seed of the present start."""
        return self._simulation.seed

    def _end_period(self, simulation: Simulation) -> None:
        if simulation.time_ns == self._seen_ns:
            return  # A state that is repeated.
        self._seen_ns = simulation.time_ns
        if not (self._thread.at_start or simulation.diverged):
            self._task.end_period(simulation)
        self._publisher.publish(String(data=json.dumps({
            'task': self._task.name, 'robot': self._task.robot.type_name,
            'instruction': self._task.instruction, 'seed': self.seed,
            'stamp_ns': simulation.time_ns, 'success': bool(self._task.success(simulation)),
            'reward': float(self._task.reward(simulation)),
            'goal': self._task.goal(simulation).tolist()})))


class JournalPublisher(Feature):
    """
    The publisher of ``~/journal``: JSON with the keys ``number``, from 0, and ``entries``.

    A :class:`~manip_sim.runtime.change_queue.Journal` makes the entries. It begins, with the
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
        if now_s >= self._published_s + _JOURNAL_S:
            self._published_s = now_s
            self._journal.flush()

    def _publish(self, entries: Sequence[Any]) -> None:
        self._output.publish(String(data=json.dumps({'number': self._number, 'entries': entries},
                                                    separators=(',', ':'))))
        self._number += 1

    def close(self) -> None:
        """Publish the remaining entries."""
        self._journal.end()
