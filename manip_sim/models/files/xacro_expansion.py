# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Expand xacro files into URDF, with the arguments that somebody who starts a robot gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
import re
import shlex
import threading
from typing import Any

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.files.package_folders import package_folders
from manip_sim.quoting import one_line, quoted

SUFFIX = '.xacro'
_WITH_ARGUMENTS = re.compile(r'(.*?\.xacro)\s+(\S.*)', re.IGNORECASE | re.DOTALL)
_UNDEFINED = re.compile(r'Undefined substitution argument (\w+)')
#: xacro keeps the files and arguments that it works with in its module.
_ONE_FILE = threading.Lock()


def split_arguments(name: str) -> tuple[str, dict[str, str]]:
    """
    Return a path and the arguments behind it, as in ``arm.urdf.xacro prefix:=left_ reach:=0.8``.

    :raises ModelError: if something behind the path is not ``name:=value``
    """
    match = _WITH_ARGUMENTS.fullmatch(name)
    if match is None:
        return name, {}
    file, rest = match.groups()
    arguments: dict[str, str] = {}
    try:
        for word in shlex.split(rest):
            key, sign, value = word.partition(':=')
            if not (sign and key.isidentifier()):
                raise ValueError(f'{quoted(word)} is not name:=value')
            if key in arguments:
                raise ValueError(f'{quoted(key)} is given twice')
            arguments[key] = value
    except ValueError as error:
        raise ModelError(f'arguments of {one_line(file, 200)}: {error}') from error
    return file, arguments


def stem_of(file: Path) -> str:
    """Return the name of a file without its suffix, and without ``.urdf`` before ``.xacro``."""
    if file.suffix.lower() == SUFFIX:
        return Path(file.stem).stem if file.stem.lower().endswith('.urdf') else file.stem
    return file.stem


class _Arguments(dict[str, str]):
    """Arguments that remember which names xacro asked for."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__(given)
        self.known: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.known.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.known.add(name)
        return super().__getitem__(name)


def expanded(file: Path, arguments: Mapping[str, str]) -> str:
    """
    Return the URDF that a xacro file makes.

    ``$(find PACKAGE)`` is looked up as ``package://`` is. The file may read others and compute,
    so it must be one that the user of the process has chosen.

    :raises ModelError: with xacro's message, or if xacro is not installed
    :raises UnknownNameError: if the file has no such argument
    """
    try:
        from xacro import process_file, substitution_args
    except ImportError as error:
        raise ModelError(f'{file} needs xacro: pip install xacro, or apt install '
                         'ros-jazzy-xacro') from error
    given = _Arguments(arguments)
    with _ONE_FILE, _finding(substitution_args, file):
        try:
            text = str(process_file(str(file), mappings=given).toxml())
        except Exception as error:  # Expressions in the file may raise anything.
            raise ModelError(_explained(file, error)) from error
    for name in arguments:
        if name not in given.known:
            raise UnknownNameError(f'argument of {file}', name, sorted(given.known))
    return text


def _explained(file: Path, error: Exception) -> str:
    message = one_line(str(error) or type(error).__name__, 300)
    missing = _UNDEFINED.search(message)
    hint = f": give it, as in '{file.name} {missing[1]}:=VALUE', or by xacro_args in the YAML " \
        f'file' if missing else ''
    return f'{file} cannot be expanded by xacro: {message}{hint}'


@contextmanager
def _finding(substitution: Any, file: Path) -> Iterator[None]:
    """Let xacro find packages that are not installed, too: in folders above the file."""
    def find(package: str) -> str:
        folder = next(package_folders(package, file), None)
        if folder is None:
            raise ModelError(f'package {quoted(package)} is neither in AMENT_PREFIX_PATH or '
                             'ROS_PACKAGE_PATH nor a folder above the file')
        return str(folder)

    before, substitution._eval_find = substitution._eval_find, find
    try:
        yield
    finally:
        substitution._eval_find = before
