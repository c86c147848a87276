# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Bases: what a robot stands on. Every module here is imported, which registers its bases."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

from manip_sim.models.bases.catalogue_bases import (
    NoActuationBase, NullMobileBase, NullMount, OmronMobileBase, PMB2Base,
    RethinkMinimalMount, RethinkMount)
from manip_sim.models.bases.robot_base_model import (
    BASES, MobileBaseModel, MountModel, RobotBaseModel)
from manip_sim.models.registry import import_submodules

import_submodules(__name__, __path__)


def base_names() -> list[str]:
    """Return the names that :func:`create_base` takes, also those in the user's folders."""
    return BASES.all_names()


def create_base(name: str | PathLike[str], idn: int | str = 0) -> RobotBaseModel:
    """
    Create a base by its name, that of its class or of an entry point, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.sources.find_source`` takes
    :param idn: number or word in the prefix
    :raises UnknownNameError: if the base is unknown, naming the nearest ones
    :raises ModelError: if a file cannot be used, or the base of another package cannot be imported
    """
    file = BASES.find_file(name)
    if file is None:
        return BASES.create(str(name), idn=idn)
    return BASES.load_file(file, idn)


if not TYPE_CHECKING:
    def __getattr__(name: str) -> type[RobotBaseModel]:
        return BASES.attribute(__name__, name)


__all__ = [
    'MobileBaseModel', 'MountModel', 'NoActuationBase', 'NullMobileBase', 'NullMount',
    'OmronMobileBase', 'PMB2Base', 'RethinkMinimalMount', 'RethinkMount',
    'RobotBaseModel', 'base_names', 'create_base']
