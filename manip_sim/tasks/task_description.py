# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The description of a task in YAML or a mapping: keys, units and limits; it needs pydantic 2."""

from __future__ import annotations

from collections.abc import Mapping
import math
from pathlib import Path
from typing import Annotated, Any, Literal, Union

from manip_sim.errors import describe_choices, ModelError
from manip_sim.models.object_creation import create_object, ObjectModel
from manip_sim.models.placed_descriptions import Coordinate
from manip_sim.models.strict_descriptions import (
    BeforeValidator, checked, ConfigDict, Field, model_validator, Number, Strict, StrictBool)
from manip_sim.quoting import quoted, shown

_Positive = Annotated[Number, Field(gt=0.0, allow_inf_nan=False)]
#: A bound; infinite for none.
_Bound = Annotated[Number, Field()]
_Point = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]
_Bounds = Annotated[list[_Bound], Field(min_length=3, max_length=3)]
_Pair = Annotated[list[str], Field(min_length=2, max_length=2)]
#: Names of the end effector and the gripper of the task's arm in conditions.
END_EFFECTOR, GRIPPER = 'end_effector', 'gripper'


class _Fixed(Strict):
    model_config = ConfigDict(frozen=True)


class Condition(_Fixed):
    """
    What must hold for success.

    :ivar weight: of how nearly it holds, in the reward
    """

    weight: Annotated[Number, Field(gt=0.0, le=1e6, allow_inf_nan=False)] = 1.0

    @model_validator(mode='after')
    def _check_order(self) -> Condition:
        low, high = getattr(self, 'low', None), getattr(self, 'high', None)
        if low is not None and high is not None and not _ordered(low, high):
            raise ValueError("'low' must not be above 'high'")
        return self


class Distance(Condition):
    """
    Two things are near each other.

    :ivar distance: bodies, sites, or ``end_effector``
    :ivar below: what the distance between their origins must be below [m]
    :ivar axes: along which it is measured, such as ``xy``
    """

    distance: _Pair
    below: _Positive
    axes: Literal['xyz', 'xy', 'xz', 'yz', 'x', 'y', 'z'] = 'xyz'


class InBox(Condition):
    """
    A thing is in a box.

    :ivar position: a body, a site, or ``end_effector``
    :ivar low: least x, y, z in ``world`` [m], -.inf for none
    :ivar high: greatest x, y, z in ``world`` [m], .inf for none
    """

    position: str
    low: _Bounds = [-math.inf] * 3
    high: _Bounds = [math.inf] * 3


class Contact(Condition):
    """
    Two bodies touch.

    :ivar contact: bodies, or ``gripper``
    :ivar touch: whether they must touch, or must not
    """

    contact: _Pair
    touch: StrictBool = True

    @model_validator(mode='after')
    def _check_two(self) -> Contact:
        if self.contact[0] == self.contact[1]:
            raise ValueError("'contact' must be of two bodies")
        return self


class Held(Condition):
    """The gripper holds an object: two of its bodies touch it, and nothing else does."""

    held: str


class JointInRange(Condition):
    """
    A joint is in a range.

    :ivar low: least position [m or rad]
    :ivar high: greatest position [m or rad]
    """

    joint: str
    low: _Bound = -math.inf
    high: _Bound = math.inf


class Speed(Condition):
    """
    A body is slow.

    :ivar below: what its speed in ``world`` must be below [m/s]
    """

    speed: str
    below: _Positive


CONDITIONS: Mapping[str, type[Condition]] = {
    'distance': Distance, 'position': InBox, 'contact': Contact, 'held': Held,
    'joint': JointInRange, 'speed': Speed}


class Range(_Fixed):
    """
    Evenly distributed numbers.

    :ivar low: the least, a number or three, of at most 10 000 m or rad
    :ivar high: the greatest
    """

    low: Union[Coordinate, _Point]
    high: Union[Coordinate, _Point]

    @model_validator(mode='after')
    def _check(self) -> Range:
        if isinstance(self.low, list) != isinstance(self.high, list):
            raise ValueError("'low' and 'high' must both be numbers, or both three of them")
        if not _ordered(self.low, self.high):
            raise ValueError("'low' must not be above 'high'")
        return self


class Start(_Fixed):
    """
    Where a thing is at the start.

    :ivar position: x, y, z in ``world`` [m], or of a joint of one axis [m or rad]; a mapping with
        ``low`` and ``high`` draws it
    :ivar yaw: turn about z [rad], likewise
    """

    position: Any
    yaw: Any = 0.0


class Mark(_Fixed):
    """
    A mark that is only seen, and part of the observation.

    :ivar radius: of the sphere or disc [m]
    :ivar flat: whether it is a disc
    """

    name: str
    radius: Annotated[Number, Field(gt=0.0, le=10.0, allow_inf_nan=False)] = 0.02
    flat: StrictBool = False


def _texted(value: object) -> object:
    if not isinstance(value, str) or not value.strip() or '\n' in value:
        raise ValueError('must be one line of text')
    return value


class TaskDescription(_Fixed):
    """
    A task; the lists are checked one by one.

    :ivar name: by default that of the file
    :ivar instruction: what to do, as one would say it
    :ivar horizon: an episode is over after this simulated time [s]
    :ivar arena: a name or file, or a mapping with ``name`` and parameters
    :ivar gripper: that replaces the robot's own
    :ivar grasps: whether the gripper must be able to grasp
    :ivar objects: as in files of objects
    :ivar goals: marks to reach
    :ivar start: by object, goal or joint, where it is at the start; what is not here is where
        the description of the object or the arena has it
    :ivar apart: least horizontal distance between all things whose start is drawn [m]
    :ivar success: conditions, all of which must hold
    :ivar reward: ``sparse``; ``dense``, how nearly the conditions hold; or a list of conditions
        that count beside them
    """

    name: Annotated[str, BeforeValidator(_texted)]
    instruction: Annotated[str, BeforeValidator(_texted)]
    horizon: _Positive
    arena: Union[str, dict[str, Any]] = 'table'
    gripper: str = 'default'
    grasps: StrictBool = True
    objects: list[Any] = []
    goals: list[Any] = []
    start: dict[str, Any] = {}
    apart: Annotated[Number, Field(ge=0.0, allow_inf_nan=False)] = 0.0
    success: Annotated[list[Any], Field(min_length=1)]
    reward: Union[Literal['sparse', 'dense'], list[Any]] = 'dense'


class Described:
    """
    A description whose parts have been checked.

    :param values: the keys of :class:`TaskDescription`
    :param folder: that files of objects are relative to
    :param name: if ``values`` has none
    :raises ModelError: on one line, with the nearest valid names
    :ivar values: as given, with the name and absolute paths: the same description from anywhere
    """

    def __init__(self, values: Mapping[str, Any], where: str, folder: Path = Path(),
                 name: str = '') -> None:
        self.values = {'name': name, **values} if name else dict(values)
        self.where = where
        self.about = checked(TaskDescription, self.values, where)
        self.values['objects'] = [_absolute(entry, folder) for entry in self.about.objects]
        self.objects = [_object(entry, f'{where}: object {number}')
                        for number, entry in enumerate(self.values['objects'], start=1)]
        self.goals = [checked(Mark, _mapping(entry, f'{where}: goal {number}'),
                              f'{where}: goal {number}')
                      for number, entry in enumerate(self.about.goals, start=1)]
        self.starts = {key: self._start(key, entry) for key, entry in self.about.start.items()}
        self.success = self._conditions('success', self.about.success)
        self.terms = [] if isinstance(self.about.reward, str) else self._conditions(
            'reward', self.about.reward)

    def _start(self, key: str, entry: Any) -> Start:
        where = f'{self.where}: start of {quoted(key)}'
        found = checked(Start, _mapping(entry, where), where)
        return Start.model_construct(position=_drawn(found.position, f'{where}: position'),
                                     yaw=_drawn(found.yaw, f'{where}: yaw'))

    def _conditions(self, key: str, entries: list[Any]) -> list[Condition]:
        found = []
        for number, entry in enumerate(entries, start=1):
            where = f'{self.where}: {key} {number}'
            kinds = [kind for kind in CONDITIONS if kind in _mapping(entry, where)]
            if len(kinds) != 1:
                got = next(iter(entry), '')
                raise ModelError(f'{where} must be one kind of condition, got {shown(entry)}: '
                                 f'{describe_choices(got, CONDITIONS)}')
            found.append(checked(CONDITIONS[kinds[0]], entry, where))
        return found


def _drawn(value: Any, where: str) -> Range:
    """Return a distribution; of numbers that are given, one without extent."""
    values = value if isinstance(value, Mapping) else {'low': value, 'high': value}
    return checked(Range, values, where)


def _absolute(entry: Any, folder: Path) -> Any:
    if isinstance(entry, dict) and isinstance(entry.get('file'), str):
        return {**entry, 'file': str((folder / entry['file']).resolve())}
    return entry


def _object(entry: Any, where: str) -> ObjectModel:
    try:
        return create_object(_mapping(entry, where))
    except ModelError as error:
        raise ModelError(str(error) if where in str(error) else f'{where}: {error}') from None


def _mapping(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ModelError(f'{where} must be keys and values, got {shown(value)}')
    return value


def _ordered(low: Any, high: Any) -> bool:
    pairs = zip(low, high) if isinstance(low, list) else [(low, high)]
    return all(least <= greatest for least, greatest in pairs)  # NaN is not.
