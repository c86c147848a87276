# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots. Every module of this folder is imported and its robots known."""

from __future__ import annotations

from manip_sim.models.registry import import_submodules
from manip_sim.models.robots.manipulator_model import ManipulatorModel
from manip_sim.models.robots.robot_model import RobotModel, ROBOTS

import_submodules(__name__, __path__)


def robot_names() -> list[str]:
    """Return the names that :func:`create_robot` takes."""
    return ROBOTS.names()


def create_robot(name: str, idn: int | str = 0, prefix: str = '') -> RobotModel:
    """
    Create a robot by its class name.

    :param idn: number or word in the prefix ``robot{idn}_``
    :param prefix: instead of that, the beginning of all names of the robot and of all that is
        mounted on it, such as ``left_`` (see :meth:`RobotModel.set_naming_prefix`)
    :raises UnknownNameError: naming the nearest ones
    :raises ModelError: if names cannot begin with the prefix
    """
    robot = ROBOTS.get(name)(idn=idn)  # type: ignore[call-arg]
    if prefix:
        robot.set_naming_prefix(prefix)
    return robot


def __getattr__(name: str) -> type[RobotModel]:
    if name in ROBOTS.names():
        return ROBOTS.get(name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


__all__ = ['ManipulatorModel', 'RobotModel', 'create_robot', 'robot_names']
