# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read YAML from users: plain values only, with one-line errors."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import yaml

from manip_sim.errors import ModelError
from manip_sim.models.regular_files import opened
from manip_sim.quoting import format_value, one_line, quoted

_MAX_BYTES = 1_000_000
#: Longest YAML of a request, which is slow to read.
_MAX_REQUESTED = 50_000


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


def parse_yaml(content: str | bytes, where: str, loader: type[StrictLoader] = StrictLoader
               ) -> dict[str, Any]:
    """Return the mapping that a text holds."""
    if len(content) > _MAX_BYTES:
        raise ModelError(f'{where} is larger than {_MAX_BYTES} bytes')
    try:
        values = yaml.load(content, Loader=loader)  # noqa: S506, a kind of SafeLoader
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        raise ModelError(f'{where} is invalid or unsafe YAML: {_on_one_line(error)}') from None
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ModelError(f'{where} must hold keys and values, got {format_value(values)}')
    return values


def parse_requested(content: bytes, where: str) -> dict[str, Any]:
    """Return the mapping that a text of a request holds, which must be short."""
    if len(content) > _MAX_REQUESTED:
        raise ModelError(f'{where} has {len(content)} bytes, and at most {_MAX_REQUESTED} are '
                         'read')
    return parse_yaml(content, where)


def _on_one_line(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return 'it is nested too deeply'
    return one_line(', '.join(part.strip() for part in str(error).splitlines()))
