# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Laws of users: functions that return the efforts of a part in each physics step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import dis
from functools import cached_property, update_wrapper
import inspect
import logging
import math
from numbers import Real
from typing import Any

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.quoting import format_value, one_line, quoted
from manip_sim.resources import Offer, offers

#: Names of the arguments of a law.
ARGUMENTS = ('t', 'q', 'v', 'bias', 'mass', 'jacobian', 'wrench', 'setpoint', 'parameters',
             'memory', 'effort')
#: Those that are computed only for laws that read them, in the order of the compiled law.
COSTLY = ('mass', 'jacobian', 'wrench')
#: Advice for a law that returns its efforts.
FILLS = 'it must return nothing, and fill effort, as by effort[:] = ...'
#: Start of the names of the control modes in which laws act.
PREFIX = 'law:'
#: Greatest number of floats that a law may remember.
_MOST_MEMORY = 100_000
#: Keywords of ``set_law`` beside the parameters.
_KEYWORDS = ('compiled', 'where')
_LOGGER = logging.getLogger('manip_sim.control')


class Law:
    """
    A law of control, which exerts the efforts of a part in each physics step.

    Called, it runs as plain Python.

    :param function: takes :data:`ARGUMENTS` and fills the last one; one that ``numba.njit`` has
        decorated is compiled again, with checks of bounds
    :param parameters: defaults by name, in the order in which the law gets them
    :param memory: how many floats it remembers from step to step, zero at first
    :param compiled: whether it is compiled, or runs as plain Python, which is slow
    :ivar name: of the function
    :ivar defaults: of the parameters, by name
    :ivar memory: number of floats
    :ivar is_compiled: whether it is compiled
    :ivar reads: which of :data:`COSTLY` it reads, shape (3,)
    :raises ModelError: if the function has another number of arguments or no name, or a default
        or the memory is not a number of its range
    """

    name: str

    def __init__(self, function: Callable[..., object],
                 parameters: Mapping[str, float] | None = None, memory: int = 0,
                 compiled: bool = True) -> None:
        function = getattr(function, 'py_func', function)  # Numba has decorated it.
        self.name = _checked_name(function)
        self.function = function
        self.defaults = _checked_parameters(self.name, parameters or {})
        if isinstance(memory, bool) or not isinstance(memory, int) or not (
                0 <= memory <= _MOST_MEMORY):
            raise ModelError(f"law '{self.name}': memory must be a whole number from 0 to "
                             f'{_MOST_MEMORY}, got {format_value(memory)}')
        self.memory, self.is_compiled = memory, bool(compiled)
        self.reads = _reads(function)
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> object:
        """Run the function as plain Python."""
        return self.function(*arguments)

    def __repr__(self) -> str:
        return f"<law '{self.name}'>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Let saved states refer to it by its name."""
        return _law_named, (self.name,)

    @cached_property
    def code(self) -> Any:
        """
        The compiled law.

        :raises ModelError: if it cannot be compiled
        """
        from manip_sim.control.law.seat import Code  # It imports numba.
        try:
            code = Code(self.function)
        except Exception as error:  # numba raises many kinds.
            raise ModelError(
                f"law '{self.name}' cannot be compiled: {_reason(error)}; with compiled=False it "
                'runs as plain Python') from error
        compiled: Any = code.function
        (signature,) = compiled.nopython_signatures
        if str(signature.return_type) != 'none':
            raise ModelError(
                f"law '{self.name}' returns a value, {signature.return_type}: {FILLS}")
        return code

    def checked(self, name: str, value: float) -> float:
        """
        Return a value for a parameter.

        :raises ModelError: if it is not a finite number
        :raises UnknownNameError: if the parameter is unknown
        """
        if name not in self.defaults:
            raise UnknownNameError(f"parameter of the law '{self.name}'", name, self.defaults)
        return _finite(self.name, name, value)

    def values(self, given: Mapping[str, float]) -> FloatArray:
        """
        Return all parameters, the defaults where none is given.

        :param given: by name
        :raises ModelError: if a value is not a finite number
        :raises UnknownNameError: if the parameter is unknown
        """
        values = {**self.defaults, **{name: self.checked(name, v) for name, v in given.items()}}
        return np.array([*values.values()], dtype=float)


def law(parameters: Mapping[str, float] | Callable[..., object] | None = None, memory: int = 0,
        compiled: bool = True) -> Any:
    """
    Make a function a law of control, as a decorator.

    The function is ``f(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory,
    effort)`` and fills ``effort``. It is called in each physics step for a part of n joints, with
    arrays of its own that it may change. ``mass``, ``jacobian`` and ``wrench`` are computed only
    for a law whose code mentions them, or which runs as plain Python:

    * ``t``: simulation time since the last reset [s]
    * ``q``, ``v``: positions [rad or m] and velocities of the joints, shape (n,)
    * ``bias``: Coriolis and centrifugal forces, and the weight unless gravity compensation carries
      it [N m or N], shape (n,); a declared payload is carried beside, and not a part of it
    * ``mass``: joint-space inertia [kg m^2 or kg], shape (n, n)
    * ``jacobian``: of ``grip_site`` in ``world``, linear rows first, shape (6, n); zero for a part
      without an end effector
    * ``wrench``: exerted by the world on the tool in the step before, force [N] and torque [N m]
      in ``ft_frame``, neither filtered nor tared, without a declared payload, shape (6,)
    * ``setpoint``: position, velocity and acceleration to follow, shape (n, 3)
    * ``parameters``: in the order of ``parameters``, shape (p,)
    * ``memory``: kept from step to step, saved, restored and part of digests, shape (m,)
    * ``effort``: to be filled, zero at first; clamped to the limits of the joints [N m or N],
      shape (n,)

    :param parameters: defaults by name
    :param memory: number of floats that the law remembers
    :param compiled: False lets it run as plain Python, so that it can be debugged
    :returns: a :class:`Law`
    :raises ModelError: as of :class:`Law`
    """
    if callable(parameters):
        return Law(parameters)

    def decorate(function: Callable[..., object]) -> Law:
        return Law(function, parameters, memory, compiled)
    return decorate


def law_of(given: Law | Callable[..., object]) -> Law:
    """
    Return a law, or make one of a function, which is compiled if ``numba.njit`` has decorated it.

    :raises ModelError: if it is neither, or has another number of arguments
    """
    if isinstance(given, Law):
        return given
    return Law(given, compiled=hasattr(given, 'py_func'))


class Laws(Mapping[str, Law]):
    """
    Laws by name: those that were used, and those that other packages offer.

    A package offers a law, or a plain function, as an entry point of the group
    ``manip_sim.laws``.
    """

    def __init__(self) -> None:
        self._laws: dict[str, Law] = {}

    def add(self, given: Law | Callable[..., object]) -> Law:
        """
        Add a law; a later one replaces one of the same name.

        :param given: a law, or a function, which runs as plain Python
        :returns: the law
        :raises ModelError: if it is neither, or has another number of arguments
        """
        added = law_of(given)
        self._laws[added.name] = added
        return added

    def __getitem__(self, name: str) -> Law:
        if name not in self._laws:
            offer = offers('manip_sim.laws').get(name)
            if offer is None:
                raise UnknownNameError('law', name, [*self])
            self._laws[name] = _loaded(offer)
        return self._laws[name]

    def __contains__(self, name: object) -> bool:
        """Return whether there is a law of a name; packages that offer some are not loaded."""
        return name in self._laws or name in offers('manip_sim.laws')

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*self._laws, *offers('manip_sim.laws')]))

    def __len__(self) -> int:
        return len([*iter(self)])


def _loaded(offer: Offer) -> Law:
    given = offer.load()
    try:
        loaded = law_of(given)
    except ModelError as error:
        raise ModelError(f'law {offer} cannot be used: {error}') from error
    if not isinstance(given, Law) and not loaded.is_compiled:
        _LOGGER.warning('law %s is a plain function and runs as Python in each physics step, '
                        'which is slow: decorate it with manip_sim.laws.law', offer)
    loaded.name = offer.name
    return loaded


#: The laws.
LAWS = Laws()


def _law_named(name: str) -> Law:
    return LAWS[name]


def _checked_name(function: Callable[..., object]) -> str:
    name = getattr(function, '__name__', type(function).__name__)  # Or that of its class.
    if not callable(function) or not (isinstance(name, str) and name.isidentifier()):
        raise ModelError(f'a law must be a function with a name, got {format_value(function)}')
    signature = inspect.signature(function)
    try:
        signature.bind(*ARGUMENTS)
    except TypeError as error:
        raise ModelError(f"law '{name}' must take {len(ARGUMENTS)} arguments, "
                         f'{", ".join(ARGUMENTS)}: {error}') from error
    for argument, expected in zip(signature.parameters, ARGUMENTS):
        if argument != expected and argument in ARGUMENTS:
            raise ModelError(f"law '{name}' must take {', '.join(ARGUMENTS)}, in this order: "
                             f"'{argument}' is in the place of '{expected}'")
    if _loses_efforts(function):
        raise ModelError(f"law '{name}' gives its last argument another value, which is lost: "
                         f'{FILLS}')
    return name


def _loses_efforts(function: Callable[..., object]) -> bool:
    """Return whether a law assigns to its last argument, other than in place as by ``+=``."""
    code: Any = getattr(function, '__code__', None)
    if not inspect.iscode(code) or code.co_argcount != len(ARGUMENTS):
        return False
    effort, in_place = code.co_varnames[len(ARGUMENTS) - 1], False
    for instruction in dis.get_instructions(code):
        if instruction.opname.startswith('STORE_FAST') and not in_place:
            stored = instruction.argval
            if isinstance(stored, tuple):  # Some instructions name two variables.
                stored = stored[:1] if instruction.opname.endswith('LOAD_FAST') else stored
            else:
                stored = (stored,)
            if effort in stored:
                return True
        in_place = instruction.opname.startswith('INPLACE') or (
            instruction.opname == 'BINARY_OP' and instruction.argrepr.endswith('='))
    return False


def _reads(function: Callable[..., object]) -> BoolArray:
    """Return whether a law reads :data:`COSTLY` arguments, as far as its code tells."""
    code: Any = getattr(function, '__code__', None)
    names = code.co_varnames[:code.co_argcount] if inspect.iscode(code) else ()
    if len(names) != len(ARGUMENTS) or code.co_flags & inspect.CO_VARARGS:
        return np.ones(len(COSTLY), dtype=bool)
    named = [instruction.argval for instruction in dis.get_instructions(code)]
    # Some instructions name two variables.
    used = {name for item in named for name in (item if isinstance(item, tuple) else [item])
            if isinstance(name, str)}
    return np.array([names[ARGUMENTS.index(name)] in used for name in COSTLY])


def _checked_parameters(law_name: str, given: Mapping[str, float]) -> dict[str, float]:
    if not isinstance(given, Mapping):
        raise ModelError(f"law '{law_name}': parameters must be a dict of defaults by name, got "
                         f'{format_value(given)}')
    for name in given:
        if not (isinstance(name, str) and name.isidentifier()):
            raise ModelError(f"law '{law_name}': the name of a parameter must be a word, got "
                             f'{quoted(name)}')
        if name in _KEYWORDS:
            raise ModelError(f"law '{law_name}': a parameter cannot be named '{name}', which "
                             'set_law takes itself')
    return {name: _finite(law_name, name, value) for name, value in given.items()}


def _finite(law_name: str, name: str, value: float) -> float:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real) or not (
            math.isfinite(value)):
        raise ModelError(f"law '{law_name}': {name} must be a finite number, "
                         f'got {format_value(value)}')
    return float(value)


def _reason(error: Exception) -> str:
    """Return what an error of numba says, without the steps of its compiler."""
    lines = [line.strip() for line in str(error).splitlines()]
    kept = [line for line in lines if line and not line.startswith(
        ('Failed in nopython', 'During:', 'This error', '- ', 'For more', 'https:'))]
    # The first place that Numba names is in the law, the others are in this package.
    places = [number for number, line in enumerate(kept) if line.startswith('File ')]
    return one_line(f'{type(error).__name__}: {" ".join(kept[:[*places, None, None][1]])}')
