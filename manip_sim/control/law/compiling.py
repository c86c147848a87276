# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Compile control laws with numba, once for all copies of their sources, and give them arguments.

A call with 80 arrays costs 20 us, as much as two physics steps, because numba looks at each of
them. So arguments are rows of numbers: where their arrays are, and their shapes. A row is written
once, and again only where an array has been replaced; many worlds are as many rows, run in one
call. Compiled code has the address of a row, and reads from it the members that it uses.

Importing this module imports numba, which takes a while: only modules of this folder do, and
others import those where a law is first needed. With ``NUMBA_DISABLE_JIT=1`` the laws are plain
Python, with the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import hashlib
import logging
import operator
from pathlib import Path
from typing import Any, cast, TypeVar
from weakref import WeakValueDictionary

import numba
from numba import typeof, types
from numba.core import caching, cgutils, config
from numba.core.base import BaseContext
from numba.core.datamodel import models
from numba.core.imputils import lower_builtin, lower_getattr_generic
from numba.core.typing.templates import (
    AbstractTemplate, AttributeTemplate, infer_getattr, infer_global, signature)
from numba.extending import intrinsic, register_model
from numba.np import arrayobj
import numpy as np

from manip_sim.arrays import IntArray
from manip_sim.control.law.kept import laws_folder, takes_locators
from manip_sim.control.law.records import PLAIN

F = TypeVar('F', bound=Callable[..., Any])

_LOGGER = logging.getLogger(__name__)


if takes_locators():
    class SharedLocator(caching.UserProvidedCacheLocator):  # type: ignore[misc]
        """Locator of functions in a folder for one version of their sources and all copies."""

        @classmethod
        def get_suitable_cache_subpath(cls, py_file: str) -> str:
            """Return the folder of a source."""
            return Path(py_file).parent.name

        def get_source_stamp(self) -> str:
            """Return the same for each copy of a source."""
            return ''


@contextlib.contextmanager
def kept_in(folder: Path) -> Iterator[None]:
    """
    Let numba keep functions that are declared meanwhile in a folder.

    :param folder: for one version of their sources; copies of these share it
    """
    settings: Any = config
    kept = {'CACHE_DIR': str(folder)}
    if takes_locators():
        kept['CACHE_LOCATOR_CLASSES'] = f'{__name__}.SharedLocator'
    before = {name: getattr(settings, name) for name in kept}
    vars(settings).update(kept)
    try:
        yield
    finally:
        vars(settings).update(before)


_FOLDER = None if PLAIN else laws_folder()
if not PLAIN and (_FOLDER is None or next(_FOLDER.rglob('*.nbi'), None) is None):
    _LOGGER.warning('Compiling control laws, which takes about a minute, %s',
                    f'once: they are kept in {_FOLDER}' if _FOLDER else
                    'in every process: no folder for them can be written')


def compiled(function: F, inline: str = 'never') -> F:
    """
    Compile a function when it is called, without contraction or reordering of sums.

    Powers would have other last bits than in plain Python: laws multiply instead.

    :param inline: whether numba makes it a part of other functions, ``always`` or ``never``
    """
    with contextlib.nullcontext() if _FOLDER is None else kept_in(_FOLDER):
        return cast('F', numba.njit(
            cache=_FOLDER is not None, nogil=True, error_model='numpy', no_cfunc_wrapper=True,
            inline=inline)(function))


def inner(function: F) -> F:
    """Compile a function in the same way that only compiled functions call."""
    return cast('F', numba.njit(nogil=True, error_model='numpy', no_cfunc_wrapper=True,
                                no_cpython_wrapper=True)(function))


def inlined(function: F) -> F:
    """
    Compile a function into each of the few compiled functions that call it.

    Others are optimized once for themselves, and again with each caller up to the outermost one:
    the end of a chain of five long functions would be compiled five times.
    """
    return compiled(function, 'always')


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
        part = Part(self.kind)

        @intrinsic  # type: ignore[untyped-decorator]
        def read(_: Any, address: Any) -> Any:
            """Return the arguments of the row at an address."""
            def generate(context: BaseContext, builder: Any, __: Any, values: Any) -> Any:
                return builder.inttoptr(values[0], context.get_value_type(part))
            return part(address), generate
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


class Part(types.Type):  # type: ignore[misc]
    """
    The type of a nested tuple in a row, for compiled code no more than the address of its words.

    A tuple by value is taken apart at each call: a robot has some hundred arrays, and compiling
    that took a third of the time.

    :param kind: the type of the tuple, as numba has it
    :ivar kind: the same
    """

    def __init__(self, kind: Any) -> None:
        self.kind = kind
        # numba writes the names of types into those of functions.
        digest = hashlib.sha256(str(kind).encode()).hexdigest()[:12]
        super().__init__(f'Part{digest}')


register_model(Part)(models.OpaqueModel)


def _in_row(kind: Any) -> Any:
    """Return the type of a member of a tuple in a row."""
    return Part(kind) if isinstance(kind, types.BaseTuple) else kind


def _count_words(kind: Any) -> int:
    """Return how many words a value takes in a row."""
    if isinstance(kind, types.BaseTuple):
        return sum(map(_count_words, kind.types))
    return 1 + kind.ndim if isinstance(kind, types.Array) else 1


@infer_getattr
class _Attributes(AttributeTemplate):  # type: ignore[misc]
    """Types of the members of named tuples in a row."""

    key = Part

    def generic_resolve(self, part: Part, name: str) -> Any:
        """Return the type of a member."""
        return _in_row(part.kind.types[part.kind.fields.index(name)])


@lower_getattr_generic(Part)  # type: ignore[untyped-decorator]
def _read_attribute(context: BaseContext, builder: Any, part: Part, address: Any, name: str
                    ) -> Any:
    """Write code that reads a member of a named tuple in a row."""
    number = part.kind.fields.index(name)
    place = sum(map(_count_words, part.kind.types[:number]))
    return _read(context, builder, part.kind.types[number], address,
                 context.get_constant(types.intp, place))


@infer_global(operator.getitem)
class _Items(AbstractTemplate):  # type: ignore[misc]
    """Types of the members of tuples in a row that are all alike."""

    def generic(self, args: Any, _: Any) -> Any:
        """Return the type of a member."""
        part, index = args
        if isinstance(part, Part) and isinstance(index, types.Integer):
            return signature(_in_row(part.kind.dtype), part, types.intp)
        return None


@lower_builtin(operator.getitem, Part, types.Integer)  # type: ignore[untyped-decorator]
def _read_item(context: BaseContext, builder: Any, sig: Any, arguments: Any) -> Any:
    """Write code that reads a member of a tuple in a row."""
    kind = sig.args[0].kind.dtype
    size = context.get_constant(types.intp, _count_words(kind))
    return _read(context, builder, kind, arguments[0], builder.mul(arguments[1], size))


def _read(context: BaseContext, builder: Any, kind: Any, address: Any, place: Any) -> Any:
    """Write code that reads a value that begins some words after an address."""
    word = context.get_value_type(types.int64)
    words = builder.gep(builder.bitcast(address, word.as_pointer()), [place])
    if isinstance(kind, types.BaseTuple):
        return builder.bitcast(words, context.get_value_type(Part(kind)))
    number, *shape = [builder.load(cgutils.gep(builder, words, k))
                      for k in range(_count_words(kind))]
    if isinstance(kind, types.Float):
        return builder.bitcast(number, context.get_value_type(kind))
    if isinstance(kind, types.Integer):
        return number
    array = arrayobj.make_array(kind)(context, builder)
    item = context.get_constant(types.intp, _bytes_of(context, kind.dtype))
    strides = [item]
    for length in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], length))
    arrayobj.populate_array(
        array, data=builder.inttoptr(number, array.data.type), shape=shape, strides=strides,
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
