# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the folders of ROS packages that URDF and xacro name, installed or around a file."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import re

from manip_sim.errors import ModelError
from manip_sim.models.regular_files import Files
from manip_sim.resources import PACKAGE, share_directory

#: How many folders above a file may have packages in them that are called something else.
_LEVELS = 6
#: Largest ``package.xml`` that is read.
_MAX_BYTES = 1_000_000
_NAME = re.compile(r'<name>\s*(\S+?)\s*</name>')


def package_folders(package: str, file: Path, files: Files | None = None) -> Iterator[Path]:
    """
    Return the folders that may be meant by the name of a package, the likeliest first.

    :param file: that names it; a folder above it counts if it has the name, or its
        ``package.xml`` has
    """
    at = files or Files()
    if package == PACKAGE:  # A URDF that was written here.
        return iter([share_directory()])
    found = [Path(prefix) / 'share' / package for prefix in
             os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if prefix]
    for entry in os.environ.get('ROS_PACKAGE_PATH', '').split(os.pathsep):
        found += [Path(entry), Path(entry) / package] if entry else []
    above = file.resolve().parents
    for folder in above:
        found += [folder, folder / package]
    named = [folder for folder in found if at.is_folder(folder)
             and (folder.name == package or _own_name(folder, at) == package)]
    if files is not None:  # A request could make it look for any number of names.
        return iter(named)
    # Beside those above the file; far above it are no packages of the same repository.
    return iter(named or (other for folder in above[:_LEVELS] if at.is_folder(folder)
                          for other in at.listed(folder) if _own_name(other, at) == package))


def _own_name(folder: Path, files: Files) -> str | None:
    manifest = folder / 'package.xml'
    try:
        if not files.is_file(manifest):
            return None
        match = _NAME.search(
            files.read(manifest, 'package manifest', _MAX_BYTES).decode('utf-8'))
    except (ModelError, UnicodeDecodeError):
        return None
    return match[1] if match else None
