# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the folders of ROS packages that URDF and xacro name, installed or around a file."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import re

from manip_sim.resources import PACKAGE, share_directory

_NAME = re.compile(r'<name>\s*(\S+?)\s*</name>')


def package_folders(package: str, file: Path) -> Iterator[Path]:
    """
    Return the folders that may be meant by the name of a package, the likeliest first.

    :param file: that names it; a folder above it counts if it has the name, or its
        ``package.xml`` has
    """
    if package == PACKAGE:  # A URDF that was written here.
        return iter([share_directory()])
    found = [Path(prefix) / 'share' / package for prefix in
             os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if prefix]
    for entry in os.environ.get('ROS_PACKAGE_PATH', '').split(os.pathsep):
        found += [Path(entry), Path(entry) / package] if entry else []
    for folder in file.resolve().parents:
        found += [folder, folder / package]
    return (folder for folder in found if folder.is_dir()
            and (folder.name == package or _own_name(folder) == package))


def _own_name(folder: Path) -> str | None:
    try:
        match = _NAME.search((folder / 'package.xml').read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError):
        return None
    return match[1] if match else None
