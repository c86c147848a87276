# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots. Every module here is imported, which registers its robots."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

from manip_sim.models.registry import import_submodules
from manip_sim.models.robots.catalogue_robots import (
    Baxter, FR3, GR1, IIWA, Jaco, Kinova3, Panda, PandaOmron, Sawyer, SO101, Tiago, UR5e,
    XArm7)
from manip_sim.models.robots.manipulator_model import ManipulatorModel
from manip_sim.models.robots.robot_model import RobotModel, ROBOTS

import_submodules(__name__, __path__)


def robot_names() -> list[str]:
    """Return the names that :func:`create_robot` takes, also those in the user's folders."""
    return ROBOTS.all_names()


def create_robot(name: str | PathLike[str], idn: int | str = 0, prefix: str = '') -> RobotModel:
    """
    Create a robot by its name, that of its class or of an entry point, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.sources.find_source`` takes
    :param idn: number or word in the prefix ``robot{idn}_``
    :param prefix: that the names of the robot and of everything mounted on it get instead, such
        as ``left_`` (see :meth:`RobotModel.set_naming_prefix`)
    :raises UnknownNameError: if the robot is unknown, naming the nearest ones
    :raises ModelError: if names cannot begin with the prefix, a file cannot be used, or the robot
        of another package cannot be imported
    """
    file = ROBOTS.find_file(name)
    robot = ROBOTS.create(str(name), idn=idn) if file is None else ROBOTS.load_file(file, idn)
    if prefix:
        robot.set_naming_prefix(prefix)
    return robot


if not TYPE_CHECKING:
    def __getattr__(name: str) -> type[RobotModel]:
        return ROBOTS.attribute(__name__, name)


__all__ = [
    'Baxter', 'FR3', 'GR1', 'IIWA', 'Jaco', 'Kinova3', 'ManipulatorModel', 'Panda', 'PandaOmron',
    'RobotModel', 'SO101', 'Sawyer', 'Tiago', 'UR5e', 'XArm7', 'create_robot', 'robot_names']
