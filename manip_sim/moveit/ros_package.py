# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A ROS package that is written: its folder, and the files that build it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
import re
import shutil
import tempfile
from typing import Any
from xml.etree import ElementTree

import yaml

from manip_sim.errors import ModelError
from manip_sim.quoting import quoted

Settings = dict[str, Any]
_NAME = re.compile(r'[a-z][a-z0-9]*(_[a-z0-9]+)*')
#: What means the same in names of files, Python, XML and Markdown.
_ROBOT = re.compile(r'\w[\w .+-]*')

_PACKAGE = """<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>0.1.0</version>
  <description>{what}, written by manip_sim.</description>
  <maintainer email="you@example.com">you</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
{dependencies}
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""

_CMAKE = """cmake_minimum_required(VERSION 3.22)
project({package})
find_package(ament_cmake REQUIRED)
install(DIRECTORY {folders} DESTINATION share/${{PROJECT_NAME}})
{more}ament_package()
"""


def build_files(package: str, what: str, dependencies: Iterable[str], folders: Iterable[str],
                more: str = '') -> dict[str, str]:
    """
    Return ``package.xml`` and ``CMakeLists.txt``.

    :param what: beginning of its description
    :param dependencies: packages that it needs when it is used
    :param folders: that are installed
    :param more: further lines of ``CMakeLists.txt``
    """
    needed = '\n'.join(f'  <exec_depend>{name}</exec_depend>' for name in dependencies)
    return {
        'package.xml': _PACKAGE.format(package=package, what=what, dependencies=needed),
        'CMakeLists.txt': _CMAKE.format(package=package, folders=' '.join(folders), more=more)}


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """
    Write all files of a package, or none.

    :param folder: new or empty
    """
    with tempfile.TemporaryDirectory(dir=folder.parent) as unfinished:
        for name, content in files.items():
            file = Path(unfinished, folder.name, name)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        shutil.copytree(Path(unfinished, folder.name), folder, dirs_exist_ok=True)


def check_folder(folder: Path) -> None:
    """
    Check that a folder can become a package.

    :raises ModelError: if its name is that of no ROS package, or it is not empty
    """
    if not _NAME.fullmatch(folder.name):
        raise ModelError(f'{quoted(folder.name)} cannot be the name of a ROS package: it needs '
                         'lower-case letters, digits and single underscores, such as '
                         'panda_moveit_config')
    if not folder.parent.is_dir():
        raise ModelError(f'no such folder: {folder.parent}')
    if folder.exists() and not folder.is_dir():
        raise ModelError(f'{folder} is a file, give the name of a folder')
    if folder.is_dir() and any(folder.iterdir()):
        raise ModelError(f'{folder} is not empty: give a new folder, or remove it first')


def robot_in(urdf: str) -> str:
    """
    Return the name of the robot in a URDF, which becomes part of launch files.

    :raises ModelError: if it has characters that would end a string there
    """
    name = str(ElementTree.fromstring(urdf).get('name'))
    if not _ROBOT.fullmatch(name):
        raise ModelError(f'{quoted(name)} cannot name a robot in a ROS package: it needs letters, '
                         'digits, spaces, _, ., + and -; rename the file of the robot')
    return name


def as_yaml(contents: Mapping[str, Any]) -> dict[str, str]:
    """Return the text of YAML files, by path."""
    return {path: yaml.safe_dump(content, sort_keys=False) for path, content in contents.items()}
