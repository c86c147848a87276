# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Load a robot for somebody who is not trusted: from a file below some folders, or from a text.

All files are read first. Then the robot is loaded from their contents in another process, which
has little time and memory and cannot open files, and after that here.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import copy
from pathlib import Path
from typing import Any

import numpy as np

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.bases import base_names
from manip_sim.models.files.file_robot import FileManipulator, FileRobot, plan_robot
from manip_sim.models.files.model_file import disabled_pairs
from manip_sim.models.files.part_descriptions import find_model, RobotDescription
from manip_sim.models.files.urdf import hold_urdf, is_urdf
from manip_sim.models.grippers import gripper_names
from manip_sim.models.object_model import NOT_SPAWNED
from manip_sim.models.untrusted_models import (
    check_size, held_name, load_self_contained, MAX_ROBOT, run_limited)
from manip_sim.models.user_files import CachedFiles, Files, InMemoryFile
from manip_sim.models.world import DEFAULT, NONE
from manip_sim.quoting import one_line

#: Greatest number of degrees of freedom.
MAX_DOF = 100
#: CPU time for loading in another process [s].
MAX_CPU_S = 10


def load_requested(request: Path | InMemoryFile, files: Files, idn: int | str = 0) -> FileRobot:
    """
    Load a robot from a file that a request names, or from its text.

    Everything is as in ``load_robot``, but grippers and bases that its description names are of
    the catalogue, meshes are not converted, and xacro is not expanded.

    :param request: what :func:`find_model` takes, or a URDF or MJCF text
    :raises ModelError: on one line, if a file must not be or cannot be read, or it takes too long,
        is too large or is not a robot
    :raises UnknownNameError: if the description has a key or name that is not known
    """
    if isinstance(request, InMemoryFile):
        kept = CachedFiles(request)
        file, description, source = request.file, RobotDescription(), str(request.file)
    else:
        kept = CachedFiles(files)
        file, description, source = find_model(request, RobotDescription, 'robot', kept)
    _check_names(description, source)
    with _of_strangers(file):
        if is_urdf(file, kept):
            hold_urdf(file, description.xacro_values, kept)
            disabled_pairs(file, kept)
        else:
            load_self_contained(file, kept, as_robot=True)
    held = file, description, source, copy.copy(kept), idn
    run_limited(one_line(str(file), 200), _try, *held, max_cpu_s=MAX_CPU_S)
    return load_held(*held)


def _try(*held: Any) -> None:
    """Load a robot, which is not taken out of the process."""
    load_held(*held)


def load_held(file: Path, description: RobotDescription, source: str, files: CachedFiles,
              idn: int | str) -> FileRobot:
    """Load a robot from contents that were read before."""
    with _of_strangers(file):
        plan = plan_robot(file, description, source, files)
        robot = (FileManipulator if plan.ends else FileRobot)(plan, idn)
        robot.held_files = files.named(held_name)
        model = robot.compile()
    check_size(model, MAX_ROBOT, one_line(str(file), 200))
    if model.nv > MAX_DOF:
        raise ModelError(f'{one_line(str(file), 200)} has {model.nv} degrees of freedom, and at '
                         f'most {MAX_DOF} can be spawned')
    for size, kind in NOT_SPAWNED.items():
        if size != 'nmocap' and getattr(model, size, None):
            raise ModelError(f'{one_line(str(file), 200)}: what is spawned cannot have {kind}')
    return robot


@contextmanager
def _of_strangers(file: Path) -> Iterator[None]:
    """Compute with any numbers: those that are not finite in the end are rejected."""
    try:
        with np.errstate(all='ignore'):
            yield
    except (ArithmeticError, RecursionError, np.linalg.LinAlgError) as error:
        raise ModelError(f'{one_line(str(file), 200)} cannot be used, its numbers are too large '
                         f'or its bodies nested too deeply: {one_line(str(error))}') from error


def _check_names(description: RobotDescription, source: str) -> None:
    """Reject grippers and bases that are not of the catalogue: each would be a file to read."""
    grippers = [(f'arms.{side}.gripper', arm.gripper) for side, arm in description.by_arm.items()]
    for key, named, known in ((*entry, names) for entries, names in (
            (grippers, gripper_names), ([('base', description.base)], base_names))
            for entry in entries):
        if named is not None and named not in (names := [DEFAULT, NONE, *known()]):
            raise ModelError(f'{source}: {UnknownNameError(key, named, names)}; by request it is '
                             'one of the catalogue, with the folders of model_path')
