# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Grippers and hands. Every module here is imported, which registers its grippers."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

from manip_sim.models.grippers.catalogue_grippers import (
    FourierLeftHand, FourierRightHand, JacoThreeFingerDexterousGripper, JacoThreeFingerGripper,
    NullGripper, PalGripper, PandaGripper, RethinkGripper, Robotiq140Gripper, Robotiq85Gripper,
    RobotiqThreeFingerDexterousGripper, RobotiqThreeFingerGripper, SO101Gripper, VacuumGripper,
    WipingGripper)
from manip_sim.models.grippers.gripper_model import ActionRule, GripperModel, GRIPPERS
from manip_sim.models.registry import import_submodules

import_submodules(__name__, __path__)


def gripper_names() -> list[str]:
    """Return the names that :func:`create_gripper` takes, also those in the user's folders."""
    return GRIPPERS.all_names()


def create_gripper(name: str | PathLike[str], idn: int | str = 0) -> GripperModel:
    """
    Create a gripper by its name, that of its class or of an entry point, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.registry.find_source`` takes
    :param idn: number or word in the prefix
    :raises UnknownNameError: if the gripper is unknown, naming the nearest ones
    :raises ModelError: if a file cannot be used, or the gripper of another package cannot be
        imported
    """
    return GRIPPERS.create_or_load(name, idn=idn)


if not TYPE_CHECKING:
    def __getattr__(name: str) -> type[GripperModel]:
        return GRIPPERS.attribute(__name__, name)


__all__ = [
    'ActionRule', 'FourierLeftHand', 'FourierRightHand', 'GripperModel',
    'JacoThreeFingerDexterousGripper', 'JacoThreeFingerGripper', 'NullGripper', 'PalGripper',
    'PandaGripper', 'RethinkGripper',
    'Robotiq140Gripper', 'Robotiq85Gripper', 'RobotiqThreeFingerDexterousGripper',
    'RobotiqThreeFingerGripper', 'SO101Gripper', 'VacuumGripper', 'WipingGripper',
    'create_gripper', 'gripper_names']
