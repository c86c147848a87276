# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Arguments of laws as rows of numbers: where their arrays are, and their shapes.

A call with 80 arrays costs 20 us, as much as two physics steps, because numba looks at each of
them. A row is written once, and again only where an array has been replaced; many worlds are as
many rows, run in one call.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from weakref import WeakValueDictionary

from numba import typeof, types
from numba.core import cgutils
from numba.core.base import BaseContext
from numba.extending import intrinsic
from numba.np import arrayobj
import numpy as np

from manip_sim.arrays import IntArray
from manip_sim.control.law.joint_records import PLAIN


class Layout:
    """
    The places of the arguments of a law in a row.

    :param example: a tuple of parts: nested named tuples of contiguous arrays, integers of 64 bits
        and floats
    :ivar kind: their type, as numba has it
    :ivar size: numbers of a row
    """

    def __init__(self, example: Any) -> None:
        self.kind = typeof(example)
        self._make = getattr(type(example), '_make', tuple)
        self._parts: list[tuple[slice, list[tuple[Any, int]]]] = []
        self.size = 0
        for part in example:
            kinds = [_kind_of(leaf) for leaf in leaves(part)]
            begin, self.size = self.size, self.size + sum(1 + max(axes, 0) for _, axes in kinds)
            self._parts.append((slice(begin, self.size), kinds))

    def write(self, words: IntArray, number: int, part: Any) -> None:
        """
        Write a part into a row; somebody has to keep its arrays while that is used.

        :param words: the row, shape (size,)
        :param number: of the part
        :raises TypeError: if anything in it is of another type than in the example
        """
        place, kinds = self._parts[number]
        words[place] = [word for kind, leaf in zip(kinds, leaves(part), strict=True)
                        for word in _words_of(leaf, kind)]

    def reader(self) -> Any:
        """Return a function for compiled code that makes arguments from the address of a row."""
        if PLAIN:
            return lambda address: self._make(_ROWS[address].parts)
        kind = self.kind

        @intrinsic  # type: ignore[untyped-decorator]
        def read(_: Any, address: Any) -> Any:
            """Return the arguments of the row at an address."""
            def generate(context: BaseContext, builder: Any, __: Any, values: Any) -> Any:
                words = builder.inttoptr(
                    values[0], context.get_value_type(types.int64).as_pointer())
                return _Reader(context, builder, words).read(kind)
            return kind(address), generate
        return read


def leaves(part: Any) -> Iterator[Any]:
    """Yield the arrays and numbers of nested tuples, in their order."""
    if isinstance(part, tuple):
        for member in part:
            yield from leaves(member)
    else:
        yield part


def _kind_of(leaf: Any) -> tuple[Any, int]:
    """Return the type of a number and -1, or that of the elements of an array and its axes."""
    if not isinstance(leaf, np.ndarray):
        return type(leaf), -1
    if not (leaf.flags.c_contiguous and leaf.flags.writeable):
        raise TypeError('an array in a row of a law is not contiguous, or cannot be written')
    return leaf.dtype, leaf.ndim


def _words_of(leaf: Any, wanted: tuple[Any, int]) -> tuple[int, ...]:
    kind = _kind_of(leaf)
    if kind != wanted:
        raise TypeError(f'expected {wanted} in a row of a law, got {kind}')
    if isinstance(leaf, np.ndarray):
        return leaf.ctypes.data, *leaf.shape
    return (int(np.array(leaf).view(np.int64)),)


class _Reader:
    """
    Writes code that reads arguments from a row.

    :param words: where the row begins
    """

    def __init__(self, context: BaseContext, builder: Any, words: Any) -> None:
        self._context, self._builder, self._words = context, builder, words
        self._place = 0

    def _word(self) -> Any:
        address = cgutils.gep(self._builder, self._words, self._place)
        self._place += 1
        return self._builder.load(address)

    def read(self, kind: Any) -> Any:
        """Return the next argument."""
        if isinstance(kind, types.Array):
            return self._array(kind)
        if isinstance(kind, types.Float):
            return self._builder.bitcast(self._word(), self._context.get_value_type(kind))
        if isinstance(kind, types.Integer):
            return self._word()
        return self._context.make_tuple(self._builder, kind, [self.read(one) for one in kind])

    def _array(self, kind: Any) -> Any:
        context, builder = self._context, self._builder
        array = arrayobj.make_array(kind)(context, builder)
        address, shape = self._word(), [self._word() for _ in range(kind.ndim)]
        item = context.get_constant(types.intp, _bytes_of(context, kind.dtype))
        strides = [item]
        for length in shape[:0:-1]:
            strides.insert(0, builder.mul(strides[0], length))
        arrayobj.populate_array(
            array, data=builder.inttoptr(address, array.data.type), shape=shape, strides=strides,
            itemsize=item, meminfo=None)
        return array._getvalue()


def _bytes_of(context: BaseContext, kind: Any) -> int:
    if isinstance(kind, types.Record):
        return int(kind.size)
    return int(context.get_abi_sizeof(context.get_data_type(kind)))


class Row:
    """
    Arguments of a law, and their row, in which only parts are written anew that are others.

    :param layout: of the arguments
    :ivar address: of the row
    :ivar parts: that were written last
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._words: IntArray = np.zeros(layout.size, np.int64)
        self.address = int(self._words.ctypes.data)
        self.parts: list[Any] = []
        _ROWS[self.address] = self

    def write(self, parts: tuple[Any, ...]) -> None:
        """Write the parts that are not those that were written last."""
        kept = self.parts or [None] * len(parts)
        for number, part in enumerate(parts):
            if part is not kept[number]:
                self._layout.write(self._words, number, part)
        self.parts = list(parts)


#: The rows by their addresses, where laws as plain Python read their arguments.
_ROWS: WeakValueDictionary[int, Row] = WeakValueDictionary()
