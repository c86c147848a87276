# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Environments of gymnasium for the tasks; the import registers them.

It needs the extra ``env``: ``pip install manip_sim[env]``.
"""

from manip_sim.env.registration import env_id, register_tasks
from manip_sim.env.task_env import TaskEnv
from manip_sim.env.task_vector_env import TaskVectorEnv

register_tasks()

__all__ = ['TaskEnv', 'TaskVectorEnv', 'env_id', 'register_tasks']
