# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Create tasks by name, from YAML files and from descriptions."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any

from manip_sim.models.composing import DEFAULT, Gripper, Grippers, Robot
from manip_sim.models.strict_yaml import read_yaml
from manip_sim.tasks.task import Task, TASKS


def create_task(name: str | PathLike[str], robot: Robot = 'Panda',
                gripper: Gripper | Grippers = DEFAULT, *,
                description: Mapping[str, Any] | None = None, **composition: Any) -> Task:
    """
    Create a task by its name, such as ``pick_cube``, or from a YAML file.

    :param name: of the task, or path of a YAML file that describes one
    :param robot: as for ``compose``
    :param gripper: as for ``compose``; ``default`` is the robot's own, unless the task needs
        another one
    :param description: what a YAML file would hold, in place of one; ``name`` is for messages then
    :param composition: what else ``compose`` takes, such as ``cameras`` or ``timestep_s``
    :raises UnknownNameError: if there is no such task or part, naming the nearest ones
    :raises ModelError: if the robot cannot do the task, naming those that can, or something is
        wrong with a description, on one line
    """
    values = read_description(name) if description is None else description
    if values is None:
        return TASKS.create(str(name), robot=robot, gripper=gripper, **composition)
    # Imported late: it needs pydantic 2, which Ubuntu 24.04 does not have.
    from manip_sim.tasks.described_task import DescribedTask
    from manip_sim.tasks.task_description import Described
    where = f'task {name}' if description is not None else str(name)
    return DescribedTask(Described(values, where), robot, gripper, **composition)


def read_description(name: str | PathLike[str]) -> dict[str, Any] | None:
    """
    Return what the YAML file of a task holds, with the paths in it absolute.

    :param name: as for :func:`create_task`
    :returns: None if the task is a class
    :raises ModelError: if something is wrong with the file, on one line
    """
    file = TASKS.find_file(name)
    if file is None:
        return None
    from manip_sim.tasks.task_description import Described
    values = read_yaml(file)
    return Described(values, str(file), file.parent, file.stem).values
