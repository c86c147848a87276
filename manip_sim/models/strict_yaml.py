# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read YAML that somebody else wrote: plain values only, each key checked, errors of one line."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
import os
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ValidationError
import yaml

from manip_sim.errors import describe_choices, ModelError
from manip_sim.quoting import one_line, quoted, shown

_MAX_BYTES = 1_000_000
M = TypeVar('M', bound=BaseModel)


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """PyYAML's safe loader, without what makes a small file large, and without equal keys."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) or getattr(event, 'anchor', None) is not None:
            raise yaml.YAMLError(f'anchors and aliases are not read, found {event.anchor!r} in '
                                 f'line {event.start_mark.line + 1}')
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise yaml.YAMLError(f'a key must be a text, got {key!r} in line '
                                     f'{key_node.start_mark.line + 1}')
            if key in seen:
                raise yaml.YAMLError(f'{quoted(key)} is there twice, again in line '
                                     f'{key_node.start_mark.line + 1}')
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


def read_yaml(file: str | os.PathLike[str]) -> dict[str, Any]:
    """
    Return the mapping that a YAML file holds.

    :raises ModelError: if the file cannot be read, is larger than 1 MB, or holds something else:
        tags of objects, anchors, keys that are there twice
    """
    path = Path(file)
    try:
        with path.open('rb') as stream:
            content = stream.read(_MAX_BYTES + 1)
    except FileNotFoundError:
        raise ModelError(f'no such YAML file: {path}') from None
    except OSError as error:
        raise ModelError(f'{path} cannot be read: {error.strerror}') from error
    return parse_yaml(content, str(path))


def parse_yaml(content: str | bytes, where: str) -> dict[str, Any]:
    """
    Return the mapping that a text holds.

    :param where: what it is, for messages
    :raises ModelError: as :func:`read_yaml` does
    """
    if len(content) > _MAX_BYTES:
        raise ModelError(f'{where} is larger than {_MAX_BYTES} bytes')
    try:
        values = yaml.load(content, Loader=_Loader)  # noqa: S506, a kind of SafeLoader
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ModelError(f'{where} is not YAML that is read here: {_on_one_line(error)}') from None
    if not isinstance(values, dict):
        raise ModelError(f'{where} must hold keys and values, got {shown(values)}')
    return values


def _on_one_line(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return 'it is nested too deeply'
    return one_line(', '.join(part.strip() for part in str(error).splitlines()))


def _number(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        hint = ', which YAML takes for a text: write 1.0e-3' if _is_exponent(value) else ''
        raise ValueError(f'must be a number{hint}')
    try:
        return float(value)
    except OverflowError:
        raise ValueError('must be finite') from None


def _is_exponent(value: object) -> bool:
    try:
        return isinstance(value, str) and float(value) is not None
    except ValueError:
        return False


#: A number that is not given as a text or truth value; combine with ``pydantic.Field``.
Number = Annotated[float, BeforeValidator(_number)]


def checked(kind: type[M], values: Mapping[str, Any], where: str) -> M:
    """
    Return values as a pydantic model.

    :param kind: the model, which forbids extra keys
    :param values: by key
    :param where: file and object that have the values, for the message
    :raises ModelError: of one line, naming the key that is unknown, missing or has a bad value
    """
    try:
        return kind.model_validate(dict(values))
    except ValidationError as errors:
        # A misspelt key is also a missing one; what is said first is what was written.
        first = min(errors.errors(), key=lambda e: e['type'] != 'extra_forbidden')
        raise ModelError(f'{where}: {_told(first, kind.model_fields)}') from None


def _told(error: Any, keys: Iterable[str]) -> str:
    place = [str(part) for part in error['loc']]
    key = place[0] if place else ''
    if error['type'] == 'extra_forbidden':
        return f'unknown key {quoted(key)}: {describe_choices(key, keys)}'
    if error['type'] == 'missing':
        return f"needs '{key}'"
    message = _MESSAGES.get(error['type'], _own_message)(error)
    if not key:
        return one_line(message)
    number = f'[{place[1]}]' if len(place) > 1 and place[1].isdigit() else ''
    return one_line(f"'{key}'{number} {message}, got {shown(error['input'])}")


def _own_message(error: Any) -> str:
    reason = error.get('ctx', {}).get('error')
    return str(reason) if reason is not None else str(error['msg'])


def _length(error: Any) -> str:
    context = error['ctx']
    bound = f'at least {context["min_length"]}' if 'min_length' in context else (
        f'at most {context["max_length"]}')
    return f'must have {bound} of them'


_MESSAGES: dict[str, Callable[[Any], str]] = {
    'greater_than': lambda e: f'must be above {e["ctx"]["gt"]:g}',
    'greater_than_equal': lambda e: f'must be at least {e["ctx"]["ge"]:g}',
    'less_than_equal': lambda e: f'must be at most {e["ctx"]["le"]:g}',
    'finite_number': lambda e: 'must be finite',
    'literal_error': lambda e: f'must be {e["ctx"]["expected"]}',
    'list_type': lambda e: 'must be a list',
    'string_type': lambda e: 'must be a text',
    'too_short': _length,
    'too_long': _length,
}
