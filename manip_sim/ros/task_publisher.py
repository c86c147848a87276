# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Serve a task: its starts at resets, and success and reward on ``~/task``."""

from __future__ import annotations

import json
from typing import Any

from std_msgs.msg import String

from manip_sim.interface.topics import BY_NAME
from manip_sim.ros.outputs import create_publisher
from manip_sim.simulation import Simulation
from manip_sim.tasks import start, Task


class TaskPublisher:
    """
    A latched publisher of ``~/task``: JSON, once for each instant.

    Its keys are ``task``, ``robot``, ``instruction``, ``seed`` of the start, ``stamp_ns`` of the
    instant, ``success``, ``reward``, and ``goal``, as the task has it. Resets draw the start of
    the task from the parameter ``seed``, where :meth:`restart` does them.

    :param node: the node, whose thread has not been started
    :param task: what is done
    :ivar seed: of the present start
    """

    def __init__(self, node: Any, task: Task) -> None:
        self._publisher = create_publisher(node, BY_NAME['~/task'])
        self._task, self._simulation, self._thread = task, node.simulation, node.thread
        self.seed: int = node.declared.value('seed')
        self._seen_ns = -1
        self.restart(None)
        # What the task changes at the end of a period is in the states that are published.
        node.thread.observe(self._end_period)

    def restart(self, seed: int | None) -> None:
        """Begin the episode of a seed, or the same one again."""
        own = self.seed if seed is None else seed
        start(self._task, self._simulation, own)
        self.seed = own

    def _end_period(self, simulation: Simulation) -> None:
        if simulation.time_ns == self._seen_ns:
            return  # A state that is repeated.
        self._seen_ns = simulation.time_ns
        if not (self._thread.at_start or simulation.diverged):
            self._task.end_period(simulation)
        self._publisher.publish(String(data=json.dumps({
            'task': self._task.name, 'robot': self._task.robot.name,
            'instruction': self._task.instruction, 'seed': self.seed,
            'stamp_ns': simulation.time_ns, 'success': self._task.success(simulation),
            'reward': self._task.reward(simulation),
            'goal': self._task.goal(simulation).tolist()})))
