# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Load robots, grippers, bases and arenas from third-party files, with a YAML description."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from manip_sim.models.files.file_arena import FileArena
from manip_sim.models.files.file_base import base_of_file, FileBase
from manip_sim.models.files.file_gripper import FileGripper
from manip_sim.models.files.file_robot import FileManipulator, FileRobot, plan_robot
from manip_sim.models.files.part_descriptions import (
    ArenaDescription, BaseDescription, find_model, GripperDescription, RobotDescription)


def load_robot(path: str | PathLike[str], idn: int | str = 0) -> FileRobot:
    """
    Load a robot from a file.

    :param path: an MJCF or URDF file, the YAML file that describes it, or their folder; or a name
        such as ``menagerie:NAME``
    :param idn: number or word in names, as in ``robot0_joint1``
    :returns: a ``ManipulatorModel`` if the robot has arms; its ``inferred`` lists inferences and
        omissions
    :raises ModelError: if something cannot be read or does not fit together
    :raises UnknownNameError: if the YAML file has a key or name that is not known
    """
    model, description, where = find_model(Path(path), RobotDescription, 'robot')
    plan = plan_robot(model, description, where)
    return (FileManipulator if plan.ends else FileRobot)(plan, idn)


def load_gripper(path: str | PathLike[str], idn: int | str = 0) -> FileGripper:
    """
    Load a gripper or hand from a file.

    :param path: an MJCF or URDF file, the YAML file that describes it, or their folder; or a name
        such as ``menagerie:NAME``
    :param idn: number or word in names, as in ``gripper0_right_finger``
    :raises ModelError: if something cannot be read or does not fit together
    :raises UnknownNameError: if the YAML file has a key or name that is not known
    """
    model, description, where = find_model(Path(path), GripperDescription, 'gripper')
    return FileGripper(model, description, where, idn)


def load_base(path: str | PathLike[str], idn: int | str = 0) -> FileBase:
    """
    Load a base from a file.

    :param path: an MJCF or URDF file, the YAML file that describes it, or their folder; or a name
        such as ``menagerie:NAME``
    :param idn: number or word in names, as in ``fixed_mount0_base``
    :returns: a ``MountModel``, or a ``MobileBaseModel`` if it has joints
    :raises ModelError: if something cannot be read or does not fit together
    :raises UnknownNameError: if the YAML file has a key or name that is not known
    """
    model, description, where = find_model(Path(path), BaseDescription, 'base')
    return base_of_file(model, description, where, idn)


def load_arena(path: str | PathLike[str]) -> FileArena:
    """
    Load an arena from a file; its names get no prefix.

    :param path: an MJCF file, the YAML file that describes it or consists of parts, or their
        folder
    :raises ModelError: if something cannot be read
    :raises UnknownNameError: if the YAML file has a key or name that is not known
    """
    model, description, where = find_model(Path(path), ArenaDescription, 'arena')
    return FileArena(model, description, where)


__all__ = ['FileArena', 'FileBase', 'FileGripper', 'FileManipulator', 'FileRobot', 'load_arena',
           'load_base', 'load_gripper', 'load_robot']
