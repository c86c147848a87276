# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""ROS packages that the node can do without: apt has them, pip does not."""

from __future__ import annotations

from collections.abc import Mapping
import importlib
from typing import Any

from manip_sim.ros_environment import apt_names


def import_optional(module: str) -> Any:
    """
    Import a module.

    :param module: such as ``tf2_msgs.msg``
    :returns: the module, or None if its package is not installed
    :raises ModuleNotFoundError: if the package is installed and needs another one that is not
    """
    package = module.partition('.')[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if str(error.name).partition('.')[0] != package:
            raise
        return None


def missing_note(missing: Mapping[str, str]) -> str:
    """
    Return the note of the packages that are not installed, on one line.

    :param missing: by package, such as ``tf2_msgs``, what does not exist without it
    """
    without = ', '.join(f'{what} ({package})' for package, what in missing.items())
    return (f'without packages that are not installed, there are no {without}; they are not '
            f'available from pip: apt install {apt_names(*missing)}, or build them')
