# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Environments of gymnasium for the tasks; the import registers them.

It needs the extra ``env``: ``pip install manip_sim[env]``.
"""

from __future__ import annotations

try:
    import gymnasium
except ImportError as error:
    raise ImportError("environments need gymnasium: pip install 'manip_sim[env]'") from error

from manip_sim.env.task_env import TaskEnv, TaskVectorEnv
from manip_sim.resources import PACKAGE
from manip_sim.tasks import task_names

#: The environment of any task, which it takes as ``task``, such as one of your own.
DESCRIBED = f'{PACKAGE}/Task-v0'


def env_id(task: str) -> str:
    """
    Return the name of a task's environment.

    :param task: such as ``pick_cube``
    """
    return f'{PACKAGE}/{"".join(word.capitalize() for word in task.split("_"))}-v0'


def register_tasks() -> None:
    """
    Register an environment for each task, also of other packages, and one for any.

    Call it again after defining a task of your own; registered environments stay.
    """
    environments = {DESCRIBED: {}, **{env_id(task): {'task': task} for task in task_names()}}
    for name, keywords in environments.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name, entry_point='manip_sim.env.task_env:TaskEnv',
                vector_entry_point='manip_sim.env.task_env:TaskVectorEnv',
                kwargs=keywords, nondeterministic=False)


register_tasks()

__all__ = ['TaskEnv', 'TaskVectorEnv', 'env_id', 'register_tasks']
