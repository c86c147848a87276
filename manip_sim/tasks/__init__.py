# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Tasks: what a robot should do, how starts are drawn, when it is done; nothing needs ROS.

Every module here is imported, which registers its tasks.
"""

from __future__ import annotations

from typing import Any

from manip_sim.models.composing import DEFAULT, Gripper, Grippers, Robot
from manip_sim.models.registry import import_submodules
from manip_sim.tasks.episode import Episode, start
from manip_sim.tasks.expert import Expert
from manip_sim.tasks.joint_actions import ACTIONS
from manip_sim.tasks.latency import Latency
from manip_sim.tasks.pose_actions import PoseActions
from manip_sim.tasks.setting import Setting
from manip_sim.tasks.task import Task, TASKS

import_submodules(__name__, __path__)


def task_names() -> list[str]:
    """Return the names that :func:`create_task` takes, also those of other packages."""
    return TASKS.names()


def create_task(name: str, robot: Robot = 'Panda', gripper: Gripper | Grippers = DEFAULT,
                **composition: Any) -> Task:
    """
    Create a task by its name, such as ``pick_cube``.

    :param name: of the task
    :param robot: as for ``compose``
    :param gripper: as for ``compose``; ``default`` is the robot's own, unless the task needs
        another one
    :param composition: what else ``compose`` takes, such as ``cameras`` or ``timestep_s``
    :raises UnknownNameError: if there is no such task or part, naming the nearest ones
    :raises ModelError: if the robot cannot do the task, naming those that can
    """
    return TASKS.create(name, robot=robot, gripper=gripper, **composition)


__all__ = ['ACTIONS', 'Episode', 'Expert', 'Latency', 'PoseActions', 'Setting', 'Task',
           'create_task', 'start', 'task_names']
