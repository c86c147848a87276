# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""ROS packages that the node can do without: apt has them, pip does not."""

from __future__ import annotations

import importlib
from typing import Any


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


def missing_note(package: str, without: str) -> str:
    """
    Return the note of a package that is not installed.

    :param package: such as ``tf2_msgs``
    :param without: what does not exist without it
    """
    return (f'no {without}: {package} is not installed; it is not available from pip: '
            f'apt install ros-jazzy-{package.replace("_", "-")}, or build it')
