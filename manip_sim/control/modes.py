# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Control modes: what a number in a command for a joint means, and what moves the joint.

A mode is an object, which the controller, the parsers and the node ask; none of them compares
names. So another package adds a mode without any change here: by ``MODES.add``, or by an entry
point of the group ``manip_sim.modes``. In some modes a law of a user moves the joints: a function
that returns the efforts of a part in each physics step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
import dis
from functools import cached_property, update_wrapper
import inspect
import logging
import math
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.servos import Servos
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.quoting import format_value, one_line, quoted
from manip_sim.resources import Offer, offers
from manip_sim.validation import finite_or_nan

#: The fields of ``sensor_msgs/JointState`` that may hold commands.
FIELDS = ('position', 'velocity', 'effort')
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


class Arrival(NamedTuple):
    """
    Time and count of a command, from which streams of commands are recognized.

    :ivar period_s: length of a control period [s]
    :ivar messages: how many messages came since the last command, of which this is the last
    :ivar sent_s: when it was sent, by any clock [s]; 0: unknown
    """

    period_s: float
    messages: int
    sent_s: float


class Joints(Protocol):
    """Motions of joints that a mode can ask for; all values have the shape of ``indices``."""

    def go_to(self, indices: IntArray, position: FloatArray, arrival: Arrival) -> None:
        """Let setpoints come to a position, or follow a stream of positions [rad or m]."""

    def go_at(self, indices: IntArray, velocity: FloatArray, arrival: Arrival) -> None:
        """Let setpoints come to a velocity, or follow a stream of them [rad/s or m/s]."""

    def exert(self, indices: IntArray, effort: FloatArray) -> None:
        """Exert an effort, and no longer follow setpoints [N m or N]."""


class ControlMode(ABC):
    """
    Meaning of the commands of a joint.

    :cvar name: value of the parameter ``control_mode.<part>``
    :cvar field: that holds the commands, one of :data:`FIELDS`, and command interface of
        ros2_control
    :cvar units: of commands, for a hinge and for a slide joint
    :cvar timeout_s: how long the last command lasts without a fresh one, unless the user says how
        long [s]; 0 for no timeout
    :cvar ends: whether a command is done when its setpoints rest; otherwise it lasts
    :cvar follows_trajectories: whether trajectories may move the setpoints
    :cvar takes_twists: whether the twist of a mobile base may move them
    :cvar exerts_at_end_effector: whether Cartesian commands are followed by efforts on the
        measured joints (operational space control), and not by setpoints
    :cvar integrates: whether servos take away errors that remain, with an integral gain
    :cvar law: name of the law in :data:`~manip_sim.laws.LAWS` that exerts the efforts in each
        physics step, and gets the setpoints; None for the servos of the model
    """

    name: str
    field: str
    units: tuple[str, str]
    timeout_s = 0.2
    ends = follows_trajectories = takes_twists = exerts_at_end_effector = integrates = False
    law: str | None = None

    def ranges(self, servos: Servos) -> FloatArray:
        """Return the ranges that actions of all joints span, SI units, shape (n, 2)."""
        return servos.ranges[self.field]

    def clamps(self, servos: Servos) -> FloatArray:
        """Return the ranges to which commands of all joints are clamped, shape (n, 2)."""
        return self.ranges(servos)

    def gains(self, joints: Sequence[str]) -> tuple[ArrayLike, ArrayLike] | None:
        """
        Return what the servos of joints have in this mode, or None for what the model says.

        :param joints: their names
        :returns: stiffness [N m/rad or N/m] and damping [N m s/rad or N s/m], each a number for
            all or one for each joint
        """
        return None

    @abstractmethod
    def command(self, joints: Joints, indices: IntArray, values: FloatArray, arrival: Arrival
                ) -> None:
        """
        Begin to carry out a command.

        :param indices: of the joints that it is for, shape (k,)
        :param values: within :meth:`clamps`, shape (k,)
        """


class Position(ControlMode):
    """Joints go to positions."""

    name, field, units, timeout_s = 'position', 'position', ('rad', 'm'), 0.0
    ends = follows_trajectories = integrates = True

    def clamps(self, servos: Servos) -> FloatArray:
        """Return the ranges of the joints, infinite where they have none, shape (n, 2)."""
        return servos.position_clamp()

    def command(self, joints: Joints, indices: IntArray, values: FloatArray, arrival: Arrival
                ) -> None:
        """Let setpoints go there, or follow a stream."""
        joints.go_to(indices, values, arrival)


class Velocity(ControlMode):
    """Joints keep velocities, and brake before the ends of their ranges."""

    name, field, units = 'velocity', 'velocity', ('rad/s', 'm/s')
    takes_twists = integrates = True

    def command(self, joints: Joints, indices: IntArray, values: FloatArray, arrival: Arrival
                ) -> None:
        """Let setpoints come to the velocity, or follow a stream."""
        joints.go_at(indices, values, arrival)


class Effort(ControlMode):
    """Joints exert efforts, to which gravity compensation is added; held until the first."""

    name, field, units = 'effort', 'effort', ('N m', 'N')
    exerts_at_end_effector = True

    def command(self, joints: Joints, indices: IntArray, values: FloatArray, arrival: Arrival
                ) -> None:
        """Exert the effort until the next command."""
        joints.exert(indices, values)


class Impedance(Position):
    """
    Joints are pulled to positions as by springs with dampers, whose gains commands change.

    The gains are taken from the model until a command changes them.
    """

    name, integrates = 'impedance', False


class LawMode(Position):
    """
    A law of a user exerts efforts in each physics step; joints are to go to positions.

    :param law: its name
    """

    integrates = False

    def __init__(self, law: str) -> None:
        self.law = law
        self.name = f'{PREFIX}{law}'


class Modes(Mapping[str, ControlMode]):
    """
    Control modes by name: those that were added, those that other packages offer, and laws.

    A package offers a class that takes no arguments, as an entry point of the group
    ``manip_sim.modes``. One that cannot be used is logged, and does not hide the others. The name
    of the mode in which a law acts is ``law:`` and that of the law.

    :param modes: that are there at first
    """

    def __init__(self, *modes: ControlMode) -> None:
        self._modes: dict[str, ControlMode] = {}
        self._laws: dict[str, LawMode] = {}
        self._offers: set[Offer] = set()
        for mode in modes:
            self.add(mode)

    def add(self, mode: ControlMode) -> None:
        """
        Add a mode.

        :raises ModelError: if it is not a mode with a name and a field, or its name is taken
        """
        if not isinstance(mode, ControlMode):
            raise ModelError(f'a control mode must derive from ControlMode, got {mode!r:.60}')
        name, field = (getattr(mode, attribute, None) for attribute in ('name', 'field'))
        if not (isinstance(name, str) and name.isidentifier()):
            raise ModelError(f'the name of a control mode must be a word, got {name!r:.60}')
        if field not in FIELDS:
            raise UnknownNameError(f"field for commands in '{name}' mode", field, FIELDS)
        if name in self._modes:
            raise ModelError(f"there is a control mode '{name}' already")
        self._modes[name] = mode

    def _add_offers(self) -> None:
        for offer in offers('manip_sim.modes').values():
            if offer in self._offers:
                continue
            self._offers.add(offer)
            try:
                self.add(_create(offer))
            except ModelError as error:
                _LOGGER.warning('control mode %s cannot be used: %s', offer, error)

    def __getitem__(self, name: str) -> ControlMode:
        if not isinstance(name, str):
            raise UnknownNameError('control mode', repr(name), self._modes)
        # Of a part in which a law acts, the mode is asked for again and again.
        if name in self._laws:
            return self._laws[name]
        if name not in self._modes:
            self._add_offers()
        if name.startswith(PREFIX) and name[len(PREFIX):] in LAWS:
            return self._laws.setdefault(name, LawMode(name[len(PREFIX):]))
        if name not in self._modes:
            raise UnknownNameError('control mode', name, [*self])
        return self._modes[name]

    def __iter__(self) -> Iterator[str]:
        self._add_offers()
        return iter([*self._modes, *(f'{PREFIX}{law}' for law in LAWS)])

    def __len__(self) -> int:
        return len(list(iter(self)))


def _create(offer: Offer) -> ControlMode:
    create = offer.load()
    try:
        mode: ControlMode = create()
    except Exception as error:  # A class of another package may raise anything.
        raise ModelError(f'{type(error).__name__}: {one_line(str(error))}') from error
    return mode


def names_of_modes(able: Callable[[ControlMode], bool]) -> str:
    """Return the names of modes with an ability, such as ``position or impedance``."""
    return ' or '.join(name for name, mode in MODES.items() if able(mode))


POSITION, VELOCITY, EFFORT, IMPEDANCE = Position(), Velocity(), Effort(), Impedance()
#: The control modes.
MODES = Modes(POSITION, VELOCITY, EFFORT, IMPEDANCE)


def default_mode(part: str) -> str:
    """Return the control mode in which a part starts: mobile bases are driven by velocity."""
    return (VELOCITY if part == 'base' else POSITION).name


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
        self.defaults = _checked_parameters(
            self.name, {} if parameters is None else parameters)
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
    number = finite_or_nan(value)
    if math.isnan(number):
        raise ModelError(f"law '{law_name}': {name} must be a finite number, "
                         f'got {format_value(value)}')
    return number


def _reason(error: Exception) -> str:
    """Return what an error of numba says, without the steps of its compiler."""
    lines = [line.strip() for line in str(error).splitlines()]
    kept = [line for line in lines if line and not line.startswith(
        ('Failed in nopython', 'During:', 'This error', '- ', 'For more', 'https:'))]
    # The first place that Numba names is in the law, the others are in this package.
    places = [number for number, line in enumerate(kept) if line.startswith('File ')]
    return one_line(f'{type(error).__name__}: {" ".join(kept[:[*places, None, None][1]])}')
