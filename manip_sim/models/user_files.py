# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Read files that users name, and their YAML, with one-line errors.

They are no devices, pipes or folders, and by request none that is private; YAML has plain values
only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import re
import shlex
import stat
from typing import Any

import yaml

from manip_sim.errors import ModelError
from manip_sim.quoting import format_value, one_line, quoted

#: Limits of the texts that one request reads, such as XML; one that is read twice counts twice.
_MAX_TEXTS, _MAX_TEXT_BYTES, _MAX_TAGS = 200, 3_000_000, 60_000
#: Largest file that a request reads [bytes]; all of them have at most twice as many.
_MAX_FILE_BYTES = 20_000_000
YAML_SUFFIXES, XACRO_SUFFIX = ('.yaml', '.yml'), '.xacro'
#: A xacro file with arguments.
_WITH_ARGUMENTS = re.compile(r'(.*?\.xacro)\s+(\S.*)', re.IGNORECASE | re.DOTALL)
_MAX_BYTES = 1_000_000
#: Longest YAML of a request, which is slow to read.
_MAX_REQUESTED = 50_000


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
    if file.suffix.lower() == XACRO_SUFFIX:
        return Path(file.stem).stem if file.stem.lower().endswith('.urdf') else file.stem
    return file.stem


def read_file(file: Path, kind: str) -> bytes:
    """
    Return the content of a file.

    :raises ModelError: if it is missing, not a regular file or not readable
    """
    with _explained(file, kind), open(opened(file), 'rb') as stream:
        return stream.read()


def check_file(file: Path, kind: str) -> None:
    """
    Check that a file can be read, without reading it.

    :raises ModelError: if it is missing, not a regular file or not readable
    """
    with _explained(file, kind):
        os.close(opened(file))


def opened(file: Path) -> int:
    """
    Return the descriptor of a file that is open for reading.

    :raises OSError: if it is missing, not a regular file or not readable
    """
    # Opening a device can change its state, so it is looked at before and after.
    _check_kind(os.stat(file).st_mode)
    descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _check_kind(os.fstat(descriptor).st_mode)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _check_kind(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(0, 'it is a folder')
    if not stat.S_ISREG(mode):
        raise OSError(0, 'it is a device or a pipe')


@contextmanager
def _explained(file: Path, kind: str) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError as error:
        raise ModelError(f'no such {kind}: {one_line(str(file))}') from error
    except (OSError, ValueError) as error:  # ValueError: a null character in the path.
        reason = getattr(error, 'strerror', None) or str(error)
        raise ModelError(f'cannot read {kind} {one_line(str(file))}: {reason}') from error


class Files:
    """
    The files that a model may be read from: all files that the user of the process may read.

    Others are for requests; where a parameter may be None, that stands for these.
    """

    #: Message on a file that is not found.
    rule = ''

    def read(self, file: Path, kind: str) -> bytes:
        """Return the content of a file, as :func:`read_file` does."""
        return read_file(file, kind)

    def first(self, places: Sequence[Path]) -> Path:
        """Return the first place where there is a file, or the first place if there is none."""
        return next((place for place in places if os.path.exists(place)), places[0])

    def is_file(self, path: Path) -> bool:
        """Return whether there is a file that may be read."""
        return path.is_file()

    def is_folder(self, path: Path) -> bool:
        """Return whether there is a folder whose files may be read."""
        return path.is_dir()

    def listed(self, folder: Path) -> list[Path]:
        """Return the entries of a folder, sorted; any of them may not be readable."""
        return sorted(folder.iterdir())


class AllowedRoots(Files):
    """
    Only the files that are below some folders, wherever symbolic links lead.

    :param folders: may be read, with all below them
    :param label: what the folders are, for messages, such as ``spawn_roots``
    :raises ModelError: if one is not a folder
    """

    def __init__(self, folders: Iterable[str | os.PathLike[str]], label: str) -> None:
        self._what = label
        self._given = [Path(folder).expanduser() for folder in folders]
        for folder in self._given:
            if not folder.is_dir():
                raise ModelError(f'no such folder in {label}: {one_line(str(folder))}')
        self._folders = [Path(os.path.realpath(folder)) for folder in self._given]
        self.rule = (f'; only files below {label} may be read: '
                     + ', '.join(one_line(str(folder)) for folder in self._given))

    def places(self, path: str) -> list[Path]:
        """Return where a path may lead: relative ones begin in each of the folders."""
        return [folder / path for folder in self._folders]

    def read(self, file: Path, kind: str) -> bytes:
        """
        Return the content of a file, as :func:`read_file` does, which must not be large.

        A file outside the folders is treated as one that does not exist.
        """
        with _explained(file, kind):
            self.check(file, kind)
            with open(opened(file), 'rb') as stream:
                # A link may have changed since; this is the file that is open.
                if not self._has(Path(f'/proc/self/fd/{stream.fileno()}')):
                    raise OSError(0, 'it has been moved')
                content = stream.read(_MAX_FILE_BYTES + 1)
            if len(content) > _MAX_FILE_BYTES:
                raise OSError(0, f'it has more than {_MAX_FILE_BYTES / 1e6:.0f} MB')
            return content

    def check(self, path: Path, kind: str) -> None:
        """Check that a path is below the folders, whether there is a file or not."""
        if not self._has(path):
            raise ModelError(
                f'{kind} {quoted(str(path), 200)} must not be read: only files below '
                f'{self._what} may be: {", ".join(one_line(str(f)) for f in self._given)}')

    def first(self, places: Sequence[Path]) -> Path:
        """Return the first place with a file that may be read, or else the first place."""
        return super().first([place for place in places if self._has(place)] or places[:1])

    def is_file(self, path: Path) -> bool:
        """Return whether there is a file that may be read."""
        return self._has(path) and os.path.isfile(path)

    def is_folder(self, path: Path) -> bool:
        """Return whether there is a folder whose files may be read."""
        return self._has(path / 'any file') and os.path.isdir(path)

    def found(self, suffixes: Sequence[str], most: int) -> list[Path]:
        """
        Return the files whose names end in a certain way, sorted in each folder.

        :param suffixes: such as ``.xml``
        :param most: number of files after which the search ends
        """
        files: list[Path] = []
        for top in self._folders:
            for folder, folders, names in os.walk(top):
                folders.sort()
                for name in sorted(names):
                    path = Path(folder, name)
                    if path.suffix in suffixes and self.is_file(path):
                        files.append(path)
                        if len(files) == most:
                            return files
        return files

    def _has(self, file: Path) -> bool:
        try:
            real = Path(os.path.realpath(file))
        except (OSError, ValueError):
            return False
        return any(folder in real.parents for folder in self._folders)


class CachedFiles(Files):
    """
    Files of one request, which are read once, so that nobody can change them in between.

    A copy, also in another process, has the contents read before, and reads nothing more.

    :param files: that are read; None: no more than what is held
    """

    def __init__(self, files: Files | None) -> None:
        self.rule = files.rule if files else ''
        self._files = files
        self._bytes = 0
        #: Bytes and tags of each text, as often as it was read.
        self._texts: list[tuple[int, int]] = []
        self._contents: dict[Path, bytes] = {}
        self._answers: dict[tuple[str, Path], Any] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs."""
        return {**self.__dict__, '_files': None}

    def read(self, file: Path, kind: str) -> bytes:
        """
        Return the content of a file, as at the first time.

        :raises ModelError: if it cannot be read, or a request needs too much
        """
        if file not in self._contents:
            if self._files is None:
                raise ModelError(f'{kind} {quoted(str(file), 200)} was not read before')
            self._contents[file] = self._files.read(file, kind)
            self._bytes += len(self._contents[file])
        content = self._contents[file]
        if self._files is not None and kind not in ('mesh file', 'texture file'):
            # Python reads it once more, which takes time and memory.
            self._texts.append((len(content), content.count(b'<')))
        sizes, tags = map(sum, zip((0, 0), *self._texts))
        if (len(self._texts) > _MAX_TEXTS or sizes > _MAX_TEXT_BYTES or tags > _MAX_TAGS
                or self._bytes > 2 * _MAX_FILE_BYTES):
            raise ModelError(
                f'a request may read at most {_MAX_TEXTS} texts of {_MAX_TEXT_BYTES / 1e6:.0f} MB '
                f'with {_MAX_TAGS} tags, and {2 * _MAX_FILE_BYTES / 1e6:.0f} MB of files')
        return content

    def first(self, places: Sequence[Path]) -> Path:
        """Return the first place with a file that may be read, or else the first place."""
        kept = next((place for place in places if place in self._contents), None)
        if kept is None:
            return places[0] if self._files is None else self._files.first(places)
        return kept

    def is_file(self, path: Path) -> bool:
        """Return whether there was a file that may be read."""
        return bool(self._asked('is_file', path, False))

    def is_folder(self, path: Path) -> bool:
        """Return whether there was a folder whose files may be read."""
        return bool(self._asked('is_folder', path, False))

    def listed(self, folder: Path) -> list[Path]:
        """Return the entries of a folder at the first reading."""
        entries: list[Path] = self._asked('listed', folder, [])
        return entries

    def named(self, name: Callable[[Path, bytes], str]) -> dict[str, Path]:
        """
        Return the files that were read, by other names.

        :param name: returns the name for a file and its content
        """
        return {name(file, content): file for file, content in self._contents.items()}

    def _asked(self, question: str, path: Path, unknown: Any) -> Any:
        if self._files is None:
            return self._answers.get((question, path), unknown)
        if (question, path) not in self._answers:
            self._answers[question, path] = getattr(self._files, question)(path)
        return self._answers[question, path]


class InMemoryFile(Files):
    """
    No file but a text that somebody sent in place of one.

    :ivar file: what to read it as
    """

    rule = '; a text must not name files, only a file below spawn_roots may'

    def __init__(self, text: str | bytes, name: str) -> None:
        self.content = text if isinstance(text, bytes) else text.encode(errors='replace')
        self.file = Path(name)

    def read(self, file: Path, kind: str) -> bytes:
        """
        Return the text.

        :raises ModelError: if a file is asked for
        """
        if file is not self.file:
            raise ModelError(f'{self.file} names the {kind} {quoted(str(file), 200)}'
                             + self.rule.replace(';', ':', 1))
        return self.content

    def first(self, places: Sequence[Path]) -> Path:
        """Return the first place."""
        return places[0]

    def is_file(self, path: Path) -> bool:
        """Return whether a path stands for the text."""
        return path == self.file

    def is_folder(self, path: Path) -> bool:
        """Return False: there is none."""
        return False

    def listed(self, folder: Path) -> list[Path]:
        """Return no entries."""
        return []


class StrictLoader(yaml.SafeLoader):  # type: ignore[misc]
    """
    PyYAML's safe loader without duplicate keys, tags, large integers, and aliases.

    Aliases make a small file huge. A tag on a value that it does not fit, and an integer of
    thousands of digits, fail in many ways, also where they are only shown.
    """

    def scan_anchor(self, kind: Any) -> Any:
        """Reject an anchor or alias."""
        token = super().scan_anchor(kind)
        raise yaml.YAMLError(f'anchors and aliases are not read, found {token.value!r} in '
                             f'line {token.start_mark.line + 1}')

    def scan_tag(self) -> Any:
        """Reject a tag."""
        token = super().scan_tag()
        raise yaml.YAMLError(f'tags are not read, found one in line {token.start_mark.line + 1}')

    def construct_yaml_int(self, node: Any) -> int:
        """Reject an integer that has more than 64 bits, as ROS does."""
        value: int = super().construct_yaml_int(node)
        if not -2**63 <= value < 2**63:
            raise yaml.YAMLError('integers have at most 64 bits, found a larger one in line '
                                 f'{node.start_mark.line + 1}')
        return value

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Reject keys that are not strings or occur twice."""
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise yaml.YAMLError(f'a key must be a string, got {key!r} in line '
                                     f'{key_node.start_mark.line + 1}')
            if key in seen:
                raise yaml.YAMLError(f'{quoted(key)} appears twice, again in line '
                                     f'{key_node.start_mark.line + 1}')
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


StrictLoader.add_constructor('tag:yaml.org,2002:int', StrictLoader.construct_yaml_int)


def read_yaml(file: str | os.PathLike[str], loader: type[StrictLoader] = StrictLoader
              ) -> dict[str, Any]:
    """
    Return the mapping that a YAML file holds.

    :param loader: decides the types of plain scalars
    :raises ModelError: if the file cannot be read, is larger than 1 MB, holds no mapping, or has
        tags, anchors, integers of more than 64 bits, or keys that are not strings or occur twice
    """
    path = Path(file)
    try:
        with open(opened(path), 'rb') as stream:
            content = stream.read(_MAX_BYTES + 1)
    except FileNotFoundError:
        raise ModelError(f'no such YAML file: {path}') from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path.
        raise ModelError(f'{one_line(str(path))} cannot be read: '
                         f'{getattr(error, "strerror", error)}') from error
    return parse_yaml(content, str(path), loader)


def parse_yaml(content: str | bytes, source: str, loader: type[StrictLoader] = StrictLoader
               ) -> dict[str, Any]:
    """Return the mapping that a text holds."""
    if len(content) > _MAX_BYTES:
        raise ModelError(f'{source} is larger than {_MAX_BYTES} bytes')
    try:
        values = yaml.load(content, Loader=loader)  # noqa: S506, a kind of SafeLoader
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        reason = ('it is nested too deeply' if isinstance(error, RecursionError) else
                  one_line(', '.join(part.strip() for part in str(error).splitlines())))
        raise ModelError(f'{source} is invalid or unsafe YAML: {reason}') from None
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ModelError(f'{source} must hold keys and values, got {format_value(values)}')
    return values


def parse_requested(content: bytes, source: str) -> dict[str, Any]:
    """Return the mapping that a text of a request holds, which must be short."""
    if len(content) > _MAX_REQUESTED:
        raise ModelError(f'{source} has {len(content)} bytes, and at most {_MAX_REQUESTED} are '
                         'read')
    return parse_yaml(content, source)
