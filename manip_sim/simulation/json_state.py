# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The whole state of a simulation as JSON, from which another process continues to the bit.

It may come from anybody. Reading it makes numbers, texts, arrays and containers, and objects of
the classes of this package that hold data; it runs no code of theirs, imports nothing but laws of
users that are installed here, by their names, and takes no more memory than the text.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections import deque
from collections.abc import Callable, Iterable, Mapping
import dataclasses
from dataclasses import replace
import enum
import json
import math
import sys
from typing import Any, Literal
import weakref
import zlib

import numpy as np

from manip_sim.control.commands import CommandHandle
from manip_sim.control.user_laws import Law, LAWS
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.physics.robot_frames import Frame
from manip_sim.quoting import one_line, quoted
from manip_sim.simulation.control_state import is_foreign, owner_of
from manip_sim.simulation.saved_state import gains
from manip_sim.simulation.simulation import Simulation

#: Rooms whose classes can be written.
_ROOMS = ('manip_sim.control.', 'manip_sim.physics.', 'manip_sim.sensing.',
          'manip_sim.simulation.')
#: Kinds of numbers that an array may have.
_KINDS = 'biuf'
_MAX_DEPTH = 200


class Encoder:
    """
    Turns objects into what JSON can hold; an object that is met again is a reference.

    :param index_of: index of objects that the reader has too, by their ``id``
    :ivar met: the objects with an identity, in the order in which they were met
    """

    def __init__(self, index_of: Mapping[int, int]) -> None:
        self._index_of = index_of
        self._number_of: dict[int, int] = {}
        self.met: list[object] = []

    def encode(self, value: Any) -> Any:
        """
        Return a value as JSON.

        :raises ModelError: if it is of a kind that cannot be written
        """
        if value is None or type(value) in (bool, int, float, str):
            return value
        if id(value) in self._index_of:
            return ['@', self._index_of[id(value)]]
        if isinstance(value, np.generic):
            return ['n', value.dtype.str, _text(value.tobytes())]
        if isinstance(value, enum.Enum):
            return ['e', _name(type(value)), value.name]
        if type(value) is bytes:
            return ['b', _text(value)]
        if isinstance(value, slice):
            return ['c', *map(self.encode, (value.start, value.stop, value.step))]
        if isinstance(value, Law):
            return ['w', value.name]
        if type(value) is tuple:
            return ['t', *map(self.encode, value)]
        if isinstance(value, tuple) and hasattr(value, '_fields'):
            return ['T', _name(type(value)), *map(self.encode, value)]
        if type(value) is frozenset:
            return ['f', *sorted(map(self.encode, value), key=repr)]
        if id(value) in self._number_of:
            return ['#', self._number_of[id(value)]]
        self._number_of[id(value)] = len(self.met)
        self.met.append(value)
        return self._with_identity(value)

    def _with_identity(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return self._array(value)
        if type(value) is list:
            return ['l', *map(self.encode, value)]
        if type(value) is dict:
            return ['d', *([self.encode(k), self.encode(v)] for k, v in value.items())]
        if type(value) is set:
            return ['s', *sorted(map(self.encode, value), key=repr)]
        if type(value) is deque:
            return ['q', value.maxlen, *map(self.encode, value)]
        if _is_data(type(value)):
            return ['o', _name(type(value)),
                    {name: self.encode(member) for name, member in vars(value).items()}]
        raise ModelError(f'a {type(value).__name__} cannot be written as text')

    def _array(self, array: Any) -> Any:
        owner = owner_of(array)
        if array.dtype.kind not in _KINDS or is_foreign(array):
            raise ModelError(f'an array of {array.dtype} cannot be written as text')
        if owner is not array:
            start = array.__array_interface__['data'][0] - owner.__array_interface__['data'][0]
            return ['v', array.dtype.str, list(array.shape), self.encode(owner), start,
                    list(array.strides)]
        fortran = array.flags.f_contiguous and not array.flags.c_contiguous
        order: Literal['C', 'F'] = 'F' if fortran else 'C'
        return ['a', array.dtype.str, list(array.shape), _text(array.tobytes(order)), order]


class Decoder:
    """
    Makes objects of what :class:`Encoder` has written.

    :param fixed: what both have, by index
    :ivar met: the objects with an identity, in their order
    """

    def __init__(self, fixed: list[object]) -> None:
        self._fixed = fixed
        self.met: list[Any] = []
        self._depth = 0
        self._readers: dict[str, Callable[..., Any]] = {
            '@': self._reference, '#': self._again, 'n': _number, 'e': _member, 'b': _bytes,
            'c': lambda *found: slice(*map(self._read, found)), 'w': _law,
            't': lambda *found: tuple(map(self._read, found)), 'T': self._named_tuple,
            'f': lambda *found: frozenset(map(self._read, found)),
            'l': self._list, 'd': self._dict, 's': self._set, 'q': self._queue,
            'a': self._array, 'v': self._view, 'o': self._object}

    def decode(self, content: Any) -> Any:
        """
        Return the value.

        :param content: any JSON
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
        if content is None or type(content) in (bool, int, float, str):
            return content
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise ModelError('values are nested too deeply')
        kind, *arguments = content
        value = self._readers[kind](*arguments)
        self._depth -= 1
        return value

    def _reference(self, index: int) -> Any:
        return self._fixed[_natural(index)]

    def _again(self, number: int) -> Any:
        value = self.met[_natural(number)]
        if value is None:
            raise ModelError('a value contains itself')
        return value

    def _meet(self, value: Any) -> Any:
        self.met.append(value)
        return value

    def _named_tuple(self, name: str, *found: Any) -> Any:
        cls = _found(name)
        if not issubclass(cls, tuple) or len(found) != len(getattr(cls, '_fields', ())):
            raise ModelError(f'{quoted(name)} is no tuple with that many names')
        return tuple.__new__(cls, map(self._read, found))

    def _list(self, *found: Any) -> Any:
        value = self._meet([])
        value.extend(map(self._read, found))
        return value

    def _dict(self, *found: Any) -> Any:
        value = self._meet({})
        for key, content in found:
            name = self._read(key)
            value[name] = self._read(content)
        return value

    def _set(self, *found: Any) -> Any:
        value = self._meet(set())
        value.update(map(self._read, found))
        return value

    def _queue(self, most: int | None, *found: Any) -> Any:
        value = self._meet(deque(maxlen=None if most is None else _natural(most)))
        value.extend(map(self._read, found))
        return value

    def _array(self, dtype: str, shape: list[int], text: str,
               order: Literal['C', 'F']) -> Any:
        content = _bytes(text)
        kind, shape = _dtype(dtype), [_natural(count) for count in shape]
        if math.prod(shape) * kind.itemsize != len(content) or order not in ('C', 'F'):
            raise ModelError('an array has another size than its content')
        return self._meet(np.ndarray(
            shape, kind, bytearray(content), order=order).copy(order=order))

    def _view(self, dtype: str, shape: list[int], owner: Any, start: int, strides: list[int]
              ) -> Any:
        number = len(self.met)
        self.met.append(None)
        array = self._read(owner)
        if not isinstance(array, np.ndarray) or is_foreign(array):
            raise ModelError('a view of what is no array')
        # NumPy checks that it is inside of the array.
        view: Any = np.ndarray([_natural(count) for count in shape], _dtype(dtype), array.data,
                               _natural(start), strides)
        self.met[number] = view
        return view

    def _object(self, name: str, members: dict[str, Any]) -> Any:
        cls = _class(name)
        value = self._meet(object.__new__(cls))
        fields = ({field.name for field in dataclasses.fields(cls)}
                  if dataclasses.is_dataclass(cls) else None)
        found = {}
        for key, content in members.items():
            known = fields is not None and key in fields
            if key.startswith('__') or not known and hasattr(cls, key):
                raise ModelError(f'{quoted(name)} has no attribute {quoted(key)} that can be set')
            found[key] = self._read(content)
        if fields is not None and not fields <= members.keys():
            raise ModelError(f'{quoted(name)} lacks attributes')
        restore = getattr(value, '__setstate__', vars(value).update)
        restore(found)
        return value


def check_like(new: Any, old: Any) -> None:
    """
    Check that attributes that came from outside are such as objects have now.

    :param new: attributes by name
    :param old: the present attributes
    :raises ModelError: if one is missing, unknown or of another kind
    """
    if not isinstance(new, dict) or new.keys() != old.keys():
        raise ModelError('an object has other attributes than here')
    for name, value in new.items():
        now = old[name]
        if now is None or value is None or type(value) is type(now):
            alike = not isinstance(value, np.ndarray) or now is None or (
                value.dtype == now.dtype and value.ndim == now.ndim)
        else:
            numbers = (bool, int, float, np.generic)
            alike = (isinstance(value, numbers) and isinstance(now, numbers)
                     or type(value).__module__ == type(now).__module__)
        if not alike:
            raise ModelError(f'{quoted(name)} is a {type(value).__name__} and should be a '
                             f'{type(now).__name__}')


def _is_data(cls: type) -> bool:
    return cls.__module__.startswith(_ROOMS) and not issubclass(
        cls, (enum.Enum, BaseException, tuple, list, dict, set, frozenset, deque))


def _name(cls: type) -> str:
    return f'{cls.__module__}:{cls.__qualname__}'


def _found(name: str) -> Any:
    module, _, qualname = name.partition(':')
    if module.startswith(_ROOMS) and module in sys.modules:
        definition = getattr(sys.modules[module], qualname, None)
        if isinstance(definition, type) and definition.__module__ == module:
            return definition
    raise ModelError(f'there is no class {quoted(name)}')


def _class(name: str) -> type:
    cls: type = _found(name)
    if not _is_data(cls):
        raise ModelError(f'{quoted(name)} holds no data')
    return cls


def _law(name: str) -> Law:
    try:
        return LAWS[str(name)]
    except UnknownNameError as error:
        raise ModelError(f'the state was saved with a law that is not here: {error}') from error


def _member(name: str, member: str) -> Any:
    cls = _found(name)
    if not issubclass(cls, enum.Enum):
        raise ModelError(f'{quoted(name)} is no enumeration')
    return cls[member]


def _number(dtype: str, text: str) -> Any:
    (number,) = np.frombuffer(_bytes(text), _dtype(dtype))
    return number


def _dtype(text: str) -> np.dtype[Any]:
    kind = np.dtype(text) if isinstance(text, str) and len(text) <= 4 else None
    if kind is None or kind.kind not in _KINDS or kind.itemsize > 8:
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


_BYTES = ('physics', 'computed_from')
_NUMBERS = ('versions', 'model', 'step_count', 'control_steps', 'diverged', 'seed', 'layout')


class NumberedHandles:
    """
    Handles of commands by their numbers since the start, as long as something else has them.

    A journal and what repeats it number them alike.
    """

    def __init__(self) -> None:
        self._handles: weakref.WeakValueDictionary[int, CommandHandle] = (
            weakref.WeakValueDictionary())
        self._count = 0

    def add(self, handles: Iterable[CommandHandle]) -> None:
        """Give handles the next numbers."""
        for handle in handles:
            self._handles[self._count] = handle
            self._count += 1

    def get(self, number: int) -> CommandHandle | None:
        """Return the handle of a number, or None if nothing has it any more."""
        return self._handles.get(number)

    def numbers_of(self, wanted: CommandHandle) -> list[int]:
        """Return the numbers of a handle; one for each time that it was added."""
        return [number for number, handle in self._handles.items() if handle is wanted]


def plain_state(simulation: Simulation) -> tuple[dict[str, Any], list[CommandHandle]]:
    """
    Return the present state as JSON, and the handles of commands in it.

    :raises ModelError: if a user's class has a state that cannot be written
    """
    state = simulation.save()
    encoders = [Encoder(simulation.states.control.index_of) for _ in range(3)]
    control = [encoder.encode(part) for encoder, part in zip(encoders, _live(simulation))]
    plain = {name: getattr(state, name) for name in _NUMBERS}
    plain.update({name: b64encode(getattr(state, name)).decode() for name in _BYTES})
    plain.update(gains={name: b64encode(content).decode()
                        for name, content in state.gains.items()},
                 start=dict(state.start), drawn=dict(state.drawn), control=control,
                 robots=list(state.robots),
                 keyframe=state.keyframe)
    return plain, [met for met in encoders[0].met if isinstance(met, CommandHandle)]


def _live(simulation: Simulation) -> list[Any]:
    return [list(simulation.states.control.content()), [
        robot.sensing.save() for robot in simulation.robots.values()], simulation.pulls.state()]


def decoded(simulation: Simulation, content: Any) -> tuple[Any, list[CommandHandle]]:
    """
    Return a value that an :class:`Encoder` has written for a simulation, and handles in it.

    :raises ModelError: if it is none, or names bodies that are not there
    """
    decoder, model = Decoder(simulation.states.control.fixed), simulation.model
    value = decoder.decode(content)
    for item in decoder.met:
        # MuJoCo does not check them.
        if isinstance(item, Frame) and not (
                item.body in range(model.nbody)
                and (item.site is None or item.site in range(model.nsite))):
            raise ModelError('a frame of no body or site')
    return value, [met for met in decoder.met if isinstance(met, CommandHandle)]


def restore_plain(simulation: Simulation, content: Any) -> list[CommandHandle]:
    """
    Continue from a state.

    :param simulation: of an equal world
    :param content: what :func:`plain_state` has returned, or anything
    :returns: the handles of the commands in it, in the same order
    :raises ModelError: if it cannot be restored here; the simulation must not be used then
    """
    try:
        return _restore(simulation, content)
    except ModelError:
        raise
    except Exception as error:  # It may be anything.
        raise ModelError(f'the state cannot be used: {type(error).__name__} '
                         f'{one_line(str(error), 200)}') from error


def _restore(simulation: Simulation, content: Any) -> list[CommandHandle]:
    robots = [one_line(str(name), 80) for name in content['robots']]
    if robots != [*simulation.robots]:
        raise ModelError(f'the state was saved with the robots {", ".join(robots)}, now there are '
                         f'{", ".join(simulation.robots)}')
    if content['layout'] != simulation.states.control.layout:
        raise ModelError('control consists of other parts here, as with modes or grippers of '
                         'another package')
    (controls, grippers), sensing, pulls = (
        decoded(simulation, part)[0] for part in content['control'])
    for new, now in ((controls, simulation.states.control.content()[0]),
                     (grippers, simulation.states.control.content()[1]),
                     (sensing, [robot.sensing.save() for robot in simulation.robots.values()])):
        if len(new) != len(now):
            raise ModelError('control consists of other parts here')
        for values, present in zip(new, now):
            check_like(values, present)
    current = gains(simulation.model)
    saved = {name: b64decode(text, validate=True) for name, text in content['gains'].items()}
    if {name: len(value) for name, value in saved.items()} != {
            name: len(value) for name, value in current.items()}:
        raise ModelError('gains of another model')
    numbers: dict[str, Any] = {name: content[name] for name in _NUMBERS}
    state = replace(
        simulation.save(), gains=saved,
        start={str(name): float(value) for name, value in content['start'].items()},
        drawn=content['drawn'], keyframe=content['keyframe'], **numbers,
        physics=b64decode(content['physics'], validate=True),
        computed_from=b64decode(content['computed_from'], validate=True))
    if len(state.computed_from) != len(state.physics):
        raise ModelError('physics of another model')
    simulation.states.check(state)
    simulation.continue_from(state, (controls, grippers), sensing)
    simulation.pulls.set_state(pulls)
    again, handles = plain_state(simulation)
    if json.dumps(again) != json.dumps(content):
        differing = next(name for name in again if json.dumps(again[name]) != json.dumps(
            content.get(name)))
        raise ModelError(f'the state cannot be restored, {differing} differs')
    return handles


def check_sum(simulation: Simulation) -> int:
    """Return a check sum of the present positions and velocities."""
    data = simulation.data
    return zlib.crc32(data.qvel, zlib.crc32(data.qpos))
