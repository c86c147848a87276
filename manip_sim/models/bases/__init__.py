# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Bases: what an arm stands on. Every module of this folder is imported and its bases known."""

from __future__ import annotations

from typing import TYPE_CHECKING

from manip_sim.models.bases.no_actuation_base import NoActuationBase
from manip_sim.models.bases.null_mobile_base import NullMobileBase
from manip_sim.models.bases.null_mount import NullMount
from manip_sim.models.bases.omron_mobile_base import OmronMobileBase
from manip_sim.models.bases.rethink_minimal_mount import RethinkMinimalMount
from manip_sim.models.bases.rethink_mount import RethinkMount
from manip_sim.models.bases.robot_base_model import (
    BASES, MobileBaseModel, MountModel, RobotBaseModel)
from manip_sim.models.registry import import_submodules

import_submodules(__name__, __path__)


def base_names() -> list[str]:
    """Return the names that :func:`create_base` takes."""
    return BASES.names()


def create_base(name: str, idn: int | str = 0) -> RobotBaseModel:
    """
    Create a base by its name: that of its class, or of an entry point.

    :raises UnknownNameError: naming the nearest ones
    :raises ModelError: if it is one of another package and cannot be imported
    """
    return BASES.create(name, idn=idn)


if not TYPE_CHECKING:
    def __getattr__(name: str) -> type[RobotBaseModel]:
        return BASES.attribute(__name__, name)


__all__ = [
    'MobileBaseModel', 'MountModel', 'NoActuationBase', 'NullMobileBase', 'NullMount',
    'OmronMobileBase', 'RethinkMinimalMount', 'RethinkMount', 'RobotBaseModel', 'base_names',
    'create_base']
