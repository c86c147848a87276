# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Grippers and hands. Every module of this folder is imported and its grippers known."""

from __future__ import annotations

from os import PathLike

from manip_sim.models.grippers.gripper_model import GripperModel, GRIPPERS
from manip_sim.models.registry import import_submodules
from manip_sim.models.sources import find_source, names_in_folders

import_submodules(__name__, __path__)


def gripper_names() -> list[str]:
    """Return the names that :func:`create_gripper` takes, those of the user's folders too."""
    return sorted({*GRIPPERS.names(), *names_in_folders('grippers')})


def create_gripper(name: str | PathLike[str], idn: int | str = 0) -> GripperModel:
    """
    Create a gripper by its class name, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.sources.find_source`` takes
    :param idn: number or word in the prefix
    :raises UnknownNameError: naming the nearest ones
    :raises ModelError: if a file cannot be used
    """
    source = None if name in GRIPPERS.names() else find_source(name, 'grippers')
    if source is None:
        return GRIPPERS.get(str(name), gripper_names())(idn=idn)  # type: ignore[call-arg]
    from manip_sim.models.files import load_gripper
    return load_gripper(source, idn)


def __getattr__(name: str) -> type[GripperModel]:
    if name in GRIPPERS.names():
        return GRIPPERS.get(name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


__all__ = ['GripperModel', 'create_gripper', 'gripper_names']
