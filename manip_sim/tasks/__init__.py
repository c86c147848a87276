# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Tasks: what a robot should do, how starts are drawn, when it is done; nothing needs ROS.

The modules of tasks are imported, which registers them.
"""

from __future__ import annotations

from manip_sim.tasks import cubes, fixtures, handling  # noqa: F401
from manip_sim.tasks.episode import Episode, interface_of, LateAnswers, Setting, start
from manip_sim.tasks.episode_actions import ACTIONS, PoseActions
from manip_sim.tasks.expert import Expert
from manip_sim.tasks.latency import AnswerTime, Latency
from manip_sim.tasks.task import create_task, Task, TASKS


def task_names() -> list[str]:
    """Return the names that :func:`create_task` takes, also of other packages."""
    return TASKS.names()


__all__ = ['ACTIONS', 'AnswerTime', 'Episode', 'Expert', 'LateAnswers', 'Latency', 'PoseActions',
           'Setting', 'Task', 'create_task', 'interface_of', 'start', 'task_names']
