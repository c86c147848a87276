# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Control modes: what a number in a command for a joint means, and what moves the joint.

A mode is an object, which the controller, the parsers and the node ask; none of them compares
names. So another package adds a mode without any change here: by ``MODES.add``, or by an entry
point of the group ``manip_sim.modes``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
import logging
from typing import NamedTuple, Protocol

from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.servos import Servos
from manip_sim.control.user_laws import LAWS, PREFIX
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.quoting import one_line
from manip_sim.resources import Offer, offers

#: The fields of ``sensor_msgs/JointState`` that may hold commands.
FIELDS = ('position', 'velocity', 'effort')
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
