# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Grippers and hands. Every module of this folder is imported and its grippers known."""

from __future__ import annotations

from manip_sim.models.grippers.gripper_model import GripperModel, GRIPPERS
from manip_sim.models.registry import import_submodules

import_submodules(__name__, __path__)


def gripper_names() -> list[str]:
    """Return the names that :func:`create_gripper` takes."""
    return GRIPPERS.names()


def create_gripper(name: str, idn: int | str = 0) -> GripperModel:
    """
    Create a gripper by its class name.

    :raises UnknownNameError: naming the nearest ones
    """
    return GRIPPERS.get(name)(idn=idn)  # type: ignore[call-arg]


def __getattr__(name: str) -> type[GripperModel]:
    if name in GRIPPERS.names():
        return GRIPPERS.get(name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


__all__ = ['GripperModel', 'create_gripper', 'gripper_names']
