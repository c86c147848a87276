# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots. Every module of this folder is imported and its robots known."""

from __future__ import annotations

from os import PathLike

from manip_sim.models.registry import import_submodules
from manip_sim.models.robots.manipulator_model import ManipulatorModel
from manip_sim.models.robots.robot_model import RobotModel, ROBOTS
from manip_sim.models.sources import find_source, names_in_folders

import_submodules(__name__, __path__)


def robot_names() -> list[str]:
    """Return the names that :func:`create_robot` takes, those of the user's folders too."""
    return sorted({*ROBOTS.names(), *names_in_folders('robots')})


def create_robot(name: str | PathLike[str], idn: int | str = 0, prefix: str = '') -> RobotModel:
    """
    Create a robot by its class name, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.sources.find_source`` takes
    :param idn: number or word in the prefix ``robot{idn}_``
    :param prefix: instead of that, the beginning of all names of the robot and of all that is
        mounted on it, such as ``left_`` (see :meth:`RobotModel.set_naming_prefix`)
    :raises UnknownNameError: naming the nearest ones
    :raises ModelError: if names cannot begin with the prefix, or a file cannot be used
    """
    source = None if name in ROBOTS.names() else find_source(name, 'robots')
    robot: RobotModel
    if source is None:
        robot = ROBOTS.get(str(name), robot_names())(idn=idn)  # type: ignore[call-arg]
    else:
        from manip_sim.models.files import load_robot
        robot = load_robot(source, idn)
    if prefix:
        robot.set_naming_prefix(prefix)
    return robot


def __getattr__(name: str) -> type[RobotModel]:
    if name in ROBOTS.names():
        return ROBOTS.get(name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


__all__ = ['ManipulatorModel', 'RobotModel', 'create_robot', 'robot_names']
