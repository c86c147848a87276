# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Bases: what an arm stands on. Every module of this folder is imported and its bases known."""

from __future__ import annotations

from manip_sim.models.bases.robot_base_model import (
    BASES, MobileBaseModel, MountModel, RobotBaseModel)
from manip_sim.models.registry import import_submodules

import_submodules(__name__, __path__)


def base_names() -> list[str]:
    """Return the names that :func:`create_base` takes."""
    return BASES.names()


def create_base(name: str, idn: int | str = 0) -> RobotBaseModel:
    """
    Create a base by its class name.

    :raises UnknownNameError: naming the nearest ones
    """
    return BASES.get(name)(idn=idn)  # type: ignore[call-arg]


def __getattr__(name: str) -> type[RobotBaseModel]:
    if name in BASES.names():
        return BASES.get(name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


__all__ = ['MobileBaseModel', 'MountModel', 'RobotBaseModel', 'base_names', 'create_base']
