# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The state of the objects that control robots: declared by their classes, pickled, and encoded.

What MuJoCo integrates, and what a whole state of a simulation consists of, is not known here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
import enum
import io
import pickle
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.control.commands import CommandHandle
from manip_sim.models.grippers import GripperModel
from manip_sim.models.mjcf import MujocoXMLModel

#: Remembered values of all objects with a state, and of grippers.
Content = tuple[list[dict[str, Any]], list[dict[str, Any]]]
#: Modules of the classes whose objects may have a state, or others that have one.
_ROOMS = ('manip_sim.control.', 'manip_sim.physics.', 'manip_sim.simulation.')
#: Types of values without identity, which cannot change.
_VALUES = (type(None), bool, int, float, str, bytes, enum.Enum, np.generic)


class ControlState:
    """
    The state of the objects that control robots.

    A class whose objects remember something from one control period to the next declares the
    names of these attributes in ``remembered``, and in ``undigested`` those of them on which the
    future does not depend, such as counts. Their values are numbers, texts, arrays, containers,
    commands, and objects that hold such values; all other attributes stay as they are at
    construction. Of grippers, whose ``format_action`` may have a state in classes of users too,
    all arrays and plain values belong to the state.

    :param roots: objects from which those with a state are reached through attributes and
        containers, between two control periods
    """

    def __init__(self, roots: Iterable[object]) -> None:
        self._owners: list[Any] = []
        self._grippers: list[GripperModel] = []
        #: Models of robots, to which commands refer.
        self._fixed: list[object] = []
        self._find(list(roots))
        self._index_of = {id(item): index for index, item in enumerate(self._fixed)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)  # In a copy, other objects are fixed.
        self._index_of = {id(item): index for index, item in enumerate(self._fixed)}

    def _find(self, left: list[Any]) -> None:
        seen: set[int] = set()
        while left:
            item = left.pop(0)
            if isinstance(item, _VALUES) or id(item) in seen:
                continue
            seen.add(id(item))
            if isinstance(item, Mapping):
                left += item.values()
            elif isinstance(item, (list, tuple, set, frozenset)):
                left += item
            elif isinstance(item, MujocoXMLModel):
                self._fixed.append(item)
                if isinstance(item, GripperModel):
                    self._grippers.append(item)
            elif type(item).__module__.startswith(_ROOMS) and hasattr(item, '__dict__'):
                left += vars(item).values()
                if hasattr(type(item), 'remembered'):
                    self._owners.append(item)

    def content(self) -> Content:
        """Return what all objects with a state remember, and grippers; no copies."""
        return [{name: getattr(owner, name) for name in owner.remembered}
                for owner in self._owners], [_numbers(gripper) for gripper in self._grippers]

    @property
    def fixed(self) -> list[object]:
        """The objects that a state refers to by index, the same in every simulation of a world."""
        return self._fixed

    @property
    def index_of(self) -> Mapping[int, int]:
        """The index of each fixed object, by its ``id``."""
        return self._index_of

    @property
    def layout(self) -> str:
        """The objects with a state, what they remember, and the models that it refers to."""
        return ' '.join([*(f'{type(owner).__qualname__}({",".join(owner.remembered)})'
                           for owner in self._owners),
                         *(type(item).__qualname__ for item in self._fixed)])

    def save(self) -> bytes:
        """Return the state, pickled."""
        file = io.BytesIO()
        _StatePickler(file, self._index_of).dump(self.content())
        return file.getvalue()

    def loaded(self, state: bytes) -> Content:
        """Return the content of what :meth:`save` has returned, here or in another process."""
        content: Content = _StateUnpickler(io.BytesIO(state), self._fixed).load()
        return content

    def replace(self, content: Content) -> None:
        """Restore a content, which nobody else may use then."""
        for owner, values in zip((*self._owners, *self._grippers), (*content[0], *content[1])):
            vars(owner).update(values)

    def encoded(self) -> Iterator[bytes]:
        """Yield the state in a form that depends on nothing else, for a digest."""
        encoder = _Encoder(self._index_of)
        for owner in self._owners:
            yield from encoder.members(owner)
        for gripper in self._grippers:
            yield from encoder.value(_numbers(gripper))


def _numbers(gripper: GripperModel) -> dict[str, Any]:
    """Return the attributes of a gripper that are arrays or plain values."""
    return {name: value for name, value in vars(gripper).items()
            if isinstance(value, (*_VALUES, np.ndarray))}


def is_frozen(item: object, compares: bool = False) -> bool:
    """
    Return whether an object is of a frozen dataclass.

    :param compares: whether only one with ``eq`` counts, whose objects are values
    """
    parameters = getattr(type(item), '__dataclass_params__', None)
    return parameters is not None and parameters.frozen and (parameters.eq or not compares)


def owner_of(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array that an array is a view of, or itself."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def is_foreign(array: NDArray[Any]) -> bool:
    """Return whether an array is a view into ``MjData`` or ``MjModel``."""
    return type(owner_of(array).base).__name__ == 'PyCapsule'


def _view(owner: NDArray[Any], offset: int, shape: tuple[int, ...], strides: tuple[int, ...],
          kind: str) -> NDArray[Any]:
    return np.ndarray(shape, kind, owner.data, offset, strides)


class ViewPickler(pickle.Pickler):
    """A pickler that keeps views views of the same array."""

    def reducer_override(self, item: object) -> Any:
        """Return how a view is made of the array that it is a view of."""
        if not isinstance(item, np.ndarray):
            return NotImplemented
        owner = owner_of(item)
        if owner is item:
            return NotImplemented
        if is_foreign(owner):
            raise pickle.PicklingError('a view into MjData that is not there from the start')
        offset = (item.__array_interface__['data'][0] - owner.__array_interface__['data'][0])
        return _view, (owner, offset, item.shape, item.strides, item.dtype.str)


class _StatePickler(ViewPickler):
    """A pickler that refers to fixed objects."""

    def __init__(self, file: io.BytesIO, index_of: Mapping[int, int]) -> None:
        super().__init__(file, protocol=5)
        self._index_of = index_of

    def persistent_id(self, item: object) -> int | None:
        return self._index_of.get(id(item))


class _StateUnpickler(pickle.Unpickler):
    """A reader of what :class:`_StatePickler` has written."""

    def __init__(self, file: io.BytesIO, fixed: list[object]) -> None:
        super().__init__(file)
        self._fixed = fixed

    def persistent_load(self, index: int) -> object:
        return self._fixed[index]


class _Encoder:
    """Turns objects into bytes that are the same in each process, whatever was read or ended."""

    def __init__(self, index_of: Mapping[int, int]) -> None:
        self._index_of = index_of
        self._number_of: dict[int, int] = {}

    def members(self, owner: object) -> Iterator[bytes]:
        """Yield the attributes of an object, by name."""
        yield type(owner).__qualname__.encode()
        left_out = getattr(owner, 'undigested', ())
        for name in getattr(owner, 'remembered', None) or sorted(vars(owner)):
            if name not in left_out:
                yield name.encode()
                yield from self.value(getattr(owner, name))

    def value(self, value: Any) -> Iterator[bytes]:
        """Yield a value."""
        if isinstance(value, np.generic):
            value = value.item()  # Releases of NumPy write them in different ways.
        if id(value) in self._index_of and not isinstance(value, _VALUES):
            yield b'@%d' % self._index_of[id(value)]
        elif isinstance(value, np.ndarray):
            yield f'{value.dtype.str}{value.shape}'.encode()
            yield value.tobytes()
        elif isinstance(value, float):
            yield struct.pack('<d', value)
        elif isinstance(value, _VALUES):
            yield f'{type(value).__name__} {value!r}'.encode()
        elif isinstance(value, Mapping):
            yield b'{%d' % len(value)
            for key, content in sorted(value.items(), key=lambda item: repr(item[0])):
                yield from self.value(key)
                yield from self.value(content)
        elif isinstance(value, (set, frozenset)):
            yield b'<%d' % len(value)
            yield from sorted(b''.join(self.value(member)) for member in value)
        elif isinstance(value, (list, tuple, deque)):
            yield b'[%d' % len(value)
            for member in value:
                yield from self.value(member)
        elif isinstance(value, CommandHandle) and not value.is_active:
            yield b'ended'
        elif is_frozen(value, compares=True):
            # Among several equal objects the choice makes no difference.
            yield from self.members(value)
        elif id(value) in self._number_of:
            yield b'#%d' % self._number_of[id(value)]
        else:
            self._number_of[id(value)] = len(self._number_of)
            yield from self.members(value)
