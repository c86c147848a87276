# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Check values with pydantic models, with one-line errors; the only import of pydantic."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, TypeVar

from manip_sim.errors import describe_choices, ModelError
from manip_sim.quoting import format_value, one_line, quoted

try:
    from pydantic import (
        AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator, StrictBool,
        StrictInt, ValidationError)
except ImportError as error:  # Ubuntu 24.04 has version 1, and all else works without it.
    raise ModelError('models and objects from files and descriptions need pydantic 2: '
                     f"pip install 'pydantic>=2' ({error})") from error

__all__ = ['AfterValidator', 'BeforeValidator', 'checked', 'ConfigDict', 'Field',
           'model_validator', 'Number', 'Strict', 'StrictBool', 'StrictInt', 'ValidationError']


class Strict(BaseModel):
    """A description with known keys only; pydantic compiles it when it is first used."""

    # Each process that imports descriptions would wait for all of them.
    model_config = ConfigDict(extra='forbid', defer_build=True)


M = TypeVar('M', bound=BaseModel)


def compile_descriptions(base: type[Strict] = Strict) -> None:
    """Compile all descriptions imported by now, in a process that can read no file later."""
    for kind in base.__subclasses__():
        kind.model_rebuild()
        compile_descriptions(kind)


def _number(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        hint = ', which YAML reads as a string: write 1.0e-3' if _is_exponent(value) else ''
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


#: A number, not given as a text or a bool; combine with ``pydantic.Field``.
Number = Annotated[float, BeforeValidator(_number)]


def checked(kind: type[M], values: Mapping[str, Any], where: str) -> M:
    """
    Return values as a pydantic model.

    :param kind: the model, which forbids extra keys
    :raises ModelError: on one line, naming the key that is unknown, missing or has a bad value
    """
    try:
        return kind.model_validate(dict(values))
    except ValidationError as errors:
        # A misspelt key also makes the right one missing; the error names the misspelt one.
        first = min(errors.errors(), key=lambda e: e['type'] != 'extra_forbidden')
        raise ModelError(f'{where}: {_explained(first, kind.model_fields)}') from None


def _explained(error: Any, keys: Iterable[str]) -> str:
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
    return one_line(f"'{key}'{number} {message}, got {format_value(error['input'])}")


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
    'int_type': lambda e: 'must be a whole number',
    'bool_type': lambda e: 'must be true or false',
    'string_type': lambda e: 'must be a string',
    'too_short': _length,
    'too_long': _length,
}
