# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the folders of ROS packages that URDF and xacro name, installed or around a file."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import re

from manip_sim.resources import PACKAGE, share_directory

#: How many folders above a file may have packages in them that are called something else.
_LEVELS = 6
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
    above = file.resolve().parents
    for folder in above:
        found += [folder, folder / package]
    named = [folder for folder in found if folder.is_dir()
             and (folder.name == package or _own_name(folder) == package)]
    # Beside those above the file; far above it are no packages of the same repository.
    return iter(named or (other.parent for folder in above[:_LEVELS]
                          for other in sorted(folder.glob('*/package.xml'))
                          if _own_name(other.parent) == package))


def _own_name(folder: Path) -> str | None:
    try:
        match = _NAME.search((folder / 'package.xml').read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError):
        return None
    return match[1] if match else None
