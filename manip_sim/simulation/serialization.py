# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Serialization of objects as plain data: numbers, texts, bytes, lists, dicts and arrays.

As JSON it may come from anybody. Reading it makes numbers, texts, arrays and containers, and
objects of the classes of this package that hold data; it runs no code of theirs, imports nothing
but laws of users that are installed here, by their names, and takes no more memory than the data.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections import deque
from collections.abc import Callable, Mapping
import dataclasses
import enum
from functools import lru_cache, partial
import json
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.control.commands import CommandHandle
from manip_sim.control.modes import Law, LAWS
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.quoting import quoted

#: Rooms whose classes can be written.
_ROOMS = ('manip_sim.control.', 'manip_sim.physics.', 'manip_sim.sensing.',
          'manip_sim.simulation.')
#: Kinds of numbers that an array may have.
KINDS = 'biuf'
#: Character of an array's type, then its shape, in which equal letters are equal lengths. A class
#: declares them in ``shapes`` for arrays that compiled code reads, which checks nothing.
Shape = tuple[str | int, ...]
_AS_IT_IS = frozenset((type(None), bool, int, float, str, bytes))
_CONTAINERS: Mapping[str, type] = {
    'l': list, 't': tuple, 'q': deque, 's': set, 'f': frozenset}
_KIND_OF = {kind: letter for letter, kind in _CONTAINERS.items()}


class Encoder:
    """
    Turns objects into plain data; an object that is met again is a reference by its number.

    Containers and arrays belong to the object that has them, and are written again in another.

    :param index_of: index of objects that the reader has too, by their ``id``
    :param digest: leave out what makes no difference to the future: attributes that their class
        names in ``undigested``, what became of commands, and types of NumPy's numbers
    :ivar met: the objects that were written, in their order, but those that compare by value
    """

    def __init__(self, index_of: Mapping[int, int], digest: bool = False) -> None:
        self._index_of, self._digest = index_of, digest
        self._number_of: dict[int, int] = {}
        self.met: list[object] = []

    def encode(self, value: Any) -> Any:
        """
        Return a value as plain data.

        :raises ModelError: if it is of a kind that cannot be written
        """
        kind = type(value)
        if kind in _AS_IT_IS:
            return value
        if kind is np.ndarray:
            if value.dtype.kind not in KINDS:
                raise ModelError(f'an array of {value.dtype} cannot be a part of a state')
            return value.copy()
        if kind is dict:
            return self._dict(value)
        letter, encode = _KIND_OF.get(kind), self.encode
        if letter is not None:
            items = [item if type(item) in _AS_IT_IS else encode(item) for item in value]
            return [letter, *(sorted(items, key=repr) if letter in 'sf' else items)]
        if id(value) in self._index_of:
            return ['@', self._index_of[id(value)]]
        return self._other(value)

    def members(self, owner: Any, names: Any) -> dict[str, Any]:
        """Return attributes of an object by name, without those that a digest leaves out."""
        left_out = getattr(owner, 'undigested', ()) if self._digest else ()
        encode, members = self.encode, {}
        for name in names:
            if name not in left_out:
                value = getattr(owner, name)
                members[name] = value if type(value) in _AS_IT_IS else encode(value)
        return members

    def _dict(self, value: dict[Any, Any]) -> Any:
        if all([type(key) is str for key in value]):
            return {key: self.encode(item) for key, item in value.items()}
        items = [[self.encode(key), self.encode(item)] for key, item in value.items()]
        return ['d', *(sorted(items, key=repr) if self._digest else items)]

    def _other(self, value: Any) -> Any:
        if isinstance(value, np.generic):
            if self._digest or value.dtype.kind not in KINDS:
                return self.encode(value.item())
            return ['n', value.dtype.str, value.tobytes()]
        if isinstance(value, enum.Enum):
            return ['e', _name(type(value)), value.name]
        if isinstance(value, Law):
            return ['w', value.name]
        if isinstance(value, tuple) and hasattr(value, '_fields'):
            return ['T', _name(type(value)), *map(self.encode, value)]
        if not _is_data(type(value)):
            raise ModelError(f'a {type(value).__name__} cannot be a part of a state')
        if _is_value(type(value)):
            return ['v', _name(type(value)), self.members(value, vars(value))]
        if self._digest and isinstance(value, CommandHandle) and not value.is_active:
            return 'ended'
        if id(value) in self._number_of:
            return ['#', self._number_of[id(value)]]
        self._number_of[id(value)] = len(self.met)
        self.met.append(value)
        return ['o', _name(type(value)), self.members(value, vars(value))]


class Decoder:
    """
    Makes objects of what :class:`Encoder` has written.

    :param fixed: the objects that both have, by index
    :ivar met: the objects that were made, in their order, but those that compare by value
    :ivar values: those
    """

    def __init__(self, fixed: list[object]) -> None:
        self.met: list[Any] = []
        self.values: list[Any] = []
        self._readers: dict[str, Callable[..., Any]] = {
            'a': _array_of, 'n': _number, 'e': _member, 'b': _bytes, 'w': _law,
            '@': lambda index: fixed[_natural(index)],
            '#': lambda number: self.met[_natural(number)],
            'T': self._named_tuple, 'd': self._dict, 'o': partial(self._made, self.met),
            'v': partial(self._made, self.values)}

    def decode(self, content: Any) -> Any:
        """
        Return the value.

        :param content: anything that JSON can hold
        :raises ModelError: if it is not of this format
        """
        try:
            return self._read(content)
        except ModelError:
            raise
        except (ValueError, TypeError, IndexError, KeyError, AttributeError, OverflowError,
                RecursionError, MemoryError) as error:
            raise ModelError(f'this is no value: {type(error).__name__}') from error

    def _read(self, content: Any) -> Any:
        kind, read = type(content), self._read
        if kind is np.ndarray:
            return content.copy()
        if kind is dict:
            return {name: item if (cls := type(item)) in _AS_IT_IS else
                    item.copy() if cls is np.ndarray else read(item)
                    for name, item in content.items()}
        if kind in _AS_IT_IS:
            return content
        container = _CONTAINERS.get(content[0])
        if container is None:
            return self._readers[content[0]](*content[1:])
        return container([item if type(item) in _AS_IT_IS else read(item)
                          for item in content[1:]])

    def _named_tuple(self, name: str, *items: Any) -> Any:
        cls = _found(name)
        if not issubclass(cls, tuple) or len(items) != len(getattr(cls, '_fields', ())):
            raise ModelError(f'{quoted(name)} is no tuple with that many names')
        return tuple.__new__(cls, map(self._read, items))

    def _dict(self, *items: Any) -> Any:
        return {self._read(key): self._read(item) for key, item in items}

    def _made(self, made: list[Any], name: str, members: dict[str, Any]) -> Any:
        cls, fields, shapes = _class(name)
        value: Any = object.__new__(cls)
        made.append(value)
        if members.keys() != fields:
            for key in members:
                if key.startswith('__') or key not in fields and hasattr(cls, key):
                    raise ModelError(
                        f'{quoted(name)} has no attribute {quoted(key)} that can be set')
            if not fields <= members.keys():
                raise ModelError(f'{quoted(name)} lacks attributes')
        restore = getattr(value, '__setstate__', vars(value).update)
        values = self._read(members)
        sizes: dict[Any, int] = {}
        for key, shape in shapes.items():
            if values[key] is not None and not _fits(values[key], shape, sizes):
                raise ModelError(f'{quoted(key)} of {quoted(name)} has another shape, or '
                                 'numbers of another kind')
        restore(values)
        return value


def to_json(plain: Any, sort_keys: bool = False) -> str:
    """Return plain data as JSON."""
    return json.dumps(plain, default=_as_json, separators=(',', ':'), sort_keys=sort_keys)


def _as_json(item: Any) -> Any:
    if isinstance(item, np.ndarray):
        return ['a', item.dtype.str, list(item.shape), _text(item.tobytes())]
    if isinstance(item, bytes):
        return ['b', _text(item)]
    raise TypeError(f'{type(item).__name__} is no plain data')


def _fits(array: Any, shape: Shape, sizes: dict[Any, int]) -> bool:
    """Return whether an array has a shape, and note the lengths that letters stand for."""
    if type(array) is not np.ndarray or array.dtype.char != shape[0] or (
            array.ndim != len(shape) - 1):
        return False
    for length, size in zip(array.shape, shape[1:]):
        if length != size and (
                type(size) is int or sizes.setdefault(size, length) != length):
            return False
    return True


def check_like(new: Any, old: Any, shapes: bool = False) -> None:
    """
    Check that attributes that came from outside are such as objects have now.

    :param new: attributes by name
    :param old: the present attributes
    :param shapes: whether arrays must have the same shapes, as compiled code reads them
    :raises ModelError: if one is missing, unknown or of another kind
    """
    if not isinstance(new, dict) or new.keys() != old.keys():
        raise ModelError('an object has other attributes than here')
    for name, value in new.items():
        now = old[name]
        kind = type(value)
        if kind is type(now):
            alike = kind is not np.ndarray or (
                value.dtype == now.dtype and value.ndim == now.ndim
                and (not shapes or value.shape == now.shape))
        else:
            numbers = (bool, int, float, np.generic)
            alike = (now is None or value is None
                     or isinstance(value, numbers) and isinstance(now, numbers)
                     or kind.__module__ == type(now).__module__)
        if not alike and kind is type(now):
            raise ModelError(f'{quoted(name)} has another shape, or numbers of another kind')
        if not alike:
            raise ModelError(f'{quoted(name)} is a {kind.__name__} and should be a '
                             f'{type(now).__name__}')


def _is_value(cls: type) -> bool:
    """Return whether objects of a class are of a frozen dataclass and compare by value."""
    parameters = getattr(cls, '__dataclass_params__', None)
    return parameters is not None and parameters.frozen and parameters.eq


def _is_data(cls: type) -> bool:
    return cls.__module__.startswith(_ROOMS) and not issubclass(
        cls, (enum.Enum, BaseException, tuple, list, dict, set, frozenset, deque))


def _name(cls: type) -> str:
    return f'{cls.__module__}:{cls.__qualname__}'


@lru_cache
def _found(name: str) -> Any:
    module, _, qualname = name.partition(':')
    if module.startswith(_ROOMS) and module in sys.modules:
        definition = getattr(sys.modules[module], qualname, None)
        if isinstance(definition, type) and definition.__module__ == module:
            return definition
    raise ModelError(f'there is no class {quoted(name)}')


@lru_cache
def _class(name: str) -> tuple[type, frozenset[str], Mapping[str, Shape]]:
    """Return a class by its name, and the attributes and shapes that its objects must have."""
    cls: type = _found(name)
    if not _is_data(cls):
        raise ModelError(f'{quoted(name)} holds no data')
    fields = dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ()
    shapes = [vars(base).get('shapes', {}) for base in reversed(cls.__mro__)]
    return cls, frozenset(field.name for field in fields), {
        key: shape for of_class in shapes for key, shape in of_class.items()}


def _law(name: str) -> Law:
    try:
        return LAWS[str(name)]
    except UnknownNameError as error:
        raise ModelError(f'the state was saved with a law that is not here: {error}') from error


def _member(name: str, member: str) -> Any:
    module, _, qualname = name.partition(':')
    cls: Any = sys.modules[module]
    for part in qualname.split('.'):  # It may be of a class of a user.
        cls = vars(cls)[part]
    if not isinstance(cls, enum.EnumMeta):
        raise ModelError(f'{quoted(name)} is no enumeration')
    return cls[member]


def _array_of(dtype: str, shape: list[int], text: str) -> NDArray[Any]:
    return np.frombuffer(_bytes(text), _dtype(dtype)).reshape([*map(_natural, shape)]).copy()


def _number(dtype: str, content: Any) -> Any:
    (number,) = np.frombuffer(
        content if type(content) is bytes else _bytes(*content[1:]), _dtype(dtype))
    return number


def _dtype(text: str) -> np.dtype[Any]:
    kind = np.dtype(text) if isinstance(text, str) and len(text) <= 4 else None
    if kind is None or kind.kind not in KINDS or kind.itemsize > 8:
        raise ModelError('an array of what are no numbers')
    return kind


def _natural(number: Any) -> int:
    if type(number) is not int or number < 0:
        raise ModelError('a count or an index is no natural number')
    return number


def _text(content: bytes) -> str:
    return b64encode(content).decode()


def _bytes(text: str) -> bytes:
    return b64decode(text, validate=True)
