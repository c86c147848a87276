# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Bases: what an arm stands on. Every module of this folder is imported and its bases known."""

from __future__ import annotations

from os import PathLike

from manip_sim.models.bases.robot_base_model import (
    BASES, MobileBaseModel, MountModel, RobotBaseModel)
from manip_sim.models.registry import import_submodules
from manip_sim.models.sources import find_source, names_in_folders

import_submodules(__name__, __path__)


def base_names() -> list[str]:
    """Return the names that :func:`create_base` takes, those of the user's folders too."""
    return sorted({*BASES.names(), *names_in_folders('bases')})


def create_base(name: str | PathLike[str], idn: int | str = 0) -> RobotBaseModel:
    """
    Create a base by its class name, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.sources.find_source`` takes
    :param idn: number or word in the prefix
    :raises UnknownNameError: naming the nearest ones
    :raises ModelError: if a file cannot be used
    """
    source = None if name in BASES.names() else find_source(name, 'bases')
    if source is None:
        return BASES.get(str(name), base_names())(idn=idn)  # type: ignore[call-arg]
    from manip_sim.models.files import load_base
    return load_base(source, idn)


def __getattr__(name: str) -> type[RobotBaseModel]:
    if name in BASES.names():
        return BASES.get(name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


__all__ = ['MobileBaseModel', 'MountModel', 'RobotBaseModel', 'base_names', 'create_base']
