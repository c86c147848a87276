# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read the node's parameters from a file as ROS 2 does, without ROS."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
import re
from typing import Any

from manip_sim.errors import ParameterError
from manip_sim.models.strict_yaml import read_yaml, StrictLoader
from manip_sim.quoting import quoted, quoted_names

#: The node's name with its namespace, unless it is started in another one.
NODE = '/manip_sim'
_PARAMETERS = 'ros__parameters'


class _Loader(StrictLoader):
    """Resolves the types of plain scalars as rcl_yaml_param_parser does."""

    yaml_implicit_resolvers: dict[str, Any] = {}


_Loader.add_implicit_resolver('tag:yaml.org,2002:bool', re.compile(
    r'(?:y|Y|yes|Yes|YES|n|N|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF)\Z'),
    list('yYnNtTfFoO'))
_Loader.add_implicit_resolver('tag:yaml.org,2002:int', re.compile(
    r'[-+]?(?:0x[0-9a-fA-F]+|[0-9]+)\Z'), list('-+0123456789'))
_Loader.add_implicit_resolver('tag:yaml.org,2002:float', re.compile(
    r'[-+]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|\.?inf|\.?nan)\Z',
    re.IGNORECASE), list('-+.0123456789iInN'))
_Loader.add_constructor('tag:yaml.org,2002:bool', lambda loader, node: (
    loader.construct_scalar(node)[0] in 'yYtT' or node.value.lower() == 'on'))
_Loader.add_constructor('tag:yaml.org,2002:float', lambda loader, node: float(
    loader.construct_scalar(node).lower().replace('.inf', 'inf').replace('.nan', 'nan')))


def read_parameters(file: Path) -> dict[str, Any]:
    """
    Return the parameters that a file has for the node, by name with dots.

    Where several sections are for it, later ones override earlier ones.

    :raises ModelError: if the file cannot be read, or is not plain YAML
    :raises ParameterError: if nothing in it is for the node, or a section is no mapping
    """
    sections = list(sections_of(read_yaml(file, _Loader)))
    if not any(matches(node, NODE) for node, _ in sections):
        has = f'is for {quoted_names([node for node, _ in sections])}' if sections else (
            f"has no key '{_PARAMETERS}' below the name of a node")
        raise ParameterError(f'{file} has no parameters for {NODE}, it {has}')
    found: dict[str, Any] = {}
    for node, parameters in sections:
        if matches(node, NODE):
            if not isinstance(parameters, dict):
                raise ParameterError(f'{file}: {quoted(node)}: {_PARAMETERS} must hold names and '
                                     'values')
            found.update(_flat(parameters))
    return found


def _flat(parameters: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in parameters.items():
        if isinstance(value, dict):
            yield from ((f'{name}.{below}', item) for below, item in _flat(value))
        else:
            yield name, value


def sections_of(content: Any) -> Iterator[tuple[str, Any]]:
    """Yield the node names and patterns of a parameters file, and what is below each."""
    def walk(content: Any, keys: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
        if isinstance(content, dict):
            for key, below in content.items():
                if key == _PARAMETERS:
                    yield '/'.join(keys), below
                else:
                    yield from walk(below, (*keys, str(key).strip('/')))
    yield from walk(content, ())


def matches(pattern: str, node_name: str) -> bool:
    """Return whether a node name, or a pattern with ``*`` and ``**``, stands for a node."""
    tokens = [token for token in pattern.split('/') if token]
    expression = ''.join('(/[^/]+)*' if token == '**'
                         else '/' + re.escape(token).replace(r'\*', '[^/]*') for token in tokens)
    return re.fullmatch(expression, node_name) is not None
