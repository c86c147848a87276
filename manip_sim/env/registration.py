# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The names of environments: ``manip_sim/PickCube-v0`` for the task ``pick_cube``."""

from __future__ import annotations

import gymnasium

from manip_sim.resources import PACKAGE
from manip_sim.tasks import task_names

#: The environment of any task, which it takes as ``task``, such as a YAML file.
DESCRIBED = f'{PACKAGE}/Task-v0'


def env_id(task: str) -> str:
    """
    Return the name of a task's environment.

    :param task: such as ``pick_cube``
    """
    return f'{PACKAGE}/{"".join(word.capitalize() for word in task.split("_"))}-v0'


def register_tasks() -> None:
    """
    Register an environment for each task, also those of other packages, and one for any.

    Call it again after defining a task of your own; what is registered already stays.
    """
    if DESCRIBED not in gymnasium.registry:
        gymnasium.register(
            id=DESCRIBED, entry_point='manip_sim.env.task_env:TaskEnv',
            vector_entry_point='manip_sim.env.task_vector_env:TaskVectorEnv',
            nondeterministic=False)
    for task in task_names():
        if env_id(task) not in gymnasium.registry:
            gymnasium.register(
                id=env_id(task), entry_point='manip_sim.env.task_env:TaskEnv',
                vector_entry_point='manip_sim.env.task_vector_env:TaskVectorEnv',
                kwargs={'task': task}, nondeterministic=False)
