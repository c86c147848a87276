# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Drawn by a seed: start positions, places of objects, and properties of a world, from YAML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import copy
from dataclasses import dataclass
from fnmatch import fnmatchcase
import math
import numbers
import os
from pathlib import Path
from types import MappingProxyType
from typing import Any, Union

import mujoco
import numpy as np
from numpy.typing import ArrayLike
import yaml

from manip_sim.arrays import FloatArray
from manip_sim.errors import describe_choices, ModelError, UnknownNameError
from manip_sim.models.object_model import ObjectModel
from manip_sim.models.user_files import read_yaml, StrictLoader
from manip_sim.quoting import format_value, quoted
from manip_sim.sensing.randomness import generator
from manip_sim.sensing.sensor_noise import QUANTITIES as PARAMETERS
from manip_sim.validation import check_kind, mapping, whole_number

TYPES = ('gaussian', 'uniform')
#: As in robosuite 1.5.2, ``initialization_noise='default'`` [rad or m].
DEFAULT_MAGNITUDE = 0.02


class InitializationNoise:
    """
    Noise on the start positions of a robot's own joints, as robosuite's ``initialization_noise``.

    Each robot gets its own numbers, which do not depend on the number of robots. robosuite draws
    again at each reset and ignores the joints' ranges; here a world has one start, and it is
    within the ranges.

    :param settings: ``type``, ``gaussian`` or ``uniform``, and ``magnitude``: the standard
        deviation, or the largest change either way [rad or m]; the defaults are ``gaussian``
        and 0.02
    :param seed: whole number from 0; None draws one
    :ivar seed: the seed that gives the same start again
    :raises ModelError: if a setting or the seed cannot be used
    """

    def __init__(self, settings: Mapping[str, Any], seed: int | None = None) -> None:
        mapping(settings, 'initialization_noise', "{'magnitude': 0.02}")
        for key in settings:
            if key not in ('type', 'magnitude'):
                raise UnknownNameError('key of initialization_noise', key, ('type', 'magnitude'))
        self.type = settings.get('type', TYPES[0])
        if self.type not in TYPES:
            raise UnknownNameError('type of initialization_noise', self.type, TYPES)
        magnitude = settings.get('magnitude', DEFAULT_MAGNITUDE)
        if (isinstance(magnitude, bool) or not isinstance(magnitude, numbers.Real)
                or not 0.0 <= float(magnitude) <= math.pi):
            raise ModelError('magnitude of initialization_noise must be a number from 0 to '
                             f'{math.pi:.4g}, got {format_value(magnitude)}')
        self.magnitude = float(magnitude)
        self.seed = checked_seed(seed)

    def with_seed(self, seed: int | None) -> InitializationNoise:
        """Return the same noise with another seed; None keeps this one."""
        if seed is None:
            return self
        other = copy.copy(self)
        other.seed = checked_seed(seed)
        return other

    def added(self, start: ArrayLike, ranges: ArrayLike, robot: int) -> FloatArray:
        """
        Return start positions with noise.

        :param start: of the joints [rad or m], shape (n,)
        :param ranges: of the joints [rad or m], infinite where there is none, shape (n, 2)
        :returns: a copy, within the ranges, shape (n,); if the magnitude is 0, not changed at all
        """
        values = np.array(start, dtype=float)
        if not self.magnitude:
            return values
        random = np.random.default_rng([self.seed, robot])
        noise = (random.standard_normal(values.shape) if self.type == 'gaussian'
                 else random.uniform(-1.0, 1.0, values.shape))
        low, high = np.reshape(ranges, (-1, 2)).T
        noisy: FloatArray = np.clip(values + self.magnitude * noise, low, high)
        return noisy


def checked_seed(seed: Any) -> int:
    """Return a seed; None draws one."""
    if seed is None:
        return int(np.random.SeedSequence().generate_state(1)[0])
    return whole_number(seed, 0, 'seed')


#: Greatest coordinate and distance [m].
_MOST = 1e4
#: Times that the objects of an area are placed again before it counts as too small.
_TRIES = 2000
_KEYS = ('objects', 'x', 'y', 'z', 'yaw', 'margin')
_HALF_TURN = math.pi / 2.0


@dataclass(frozen=True)
class Placement:
    """
    An area where objects are placed.

    Objects count as upright cylinders about their frames. No two of all areas overlap.

    :ivar low: least x and y of their frames in ``world`` [m]
    :ivar high: greatest x and y [m]
    :ivar z: height of the surface that they stand on in ``world`` [m]
    :ivar yaw: greatest turn about z to both sides [rad]
    :ivar margin: least distance between two objects [m]
    """

    name: str
    objects: tuple[str, ...]
    low: tuple[float, float]
    high: tuple[float, float]
    z: float
    yaw: float = math.pi
    margin: float = 0.0

    @property
    def values(self) -> dict[str, Any]:
        """The keys of a YAML file."""
        return {'objects': list(self.objects), 'x': [self.low[0], self.high[0]],
                'y': [self.low[1], self.high[1]], 'z': self.z, 'yaw': self.yaw,
                'margin': self.margin}


@dataclass(frozen=True)
class Extent:
    """
    The size of an object as it stands at the start.

    :ivar radius: of an upright cylinder about its frame that holds it [m]
    :ivar bottom: height of its lowest point above its frame, negative below [m]
    :ivar quat_wxyz: of its frame in ``world``
    """

    radius: float
    bottom: float
    quat_wxyz: FloatArray


def read_placements(areas: Any, source: str) -> list[Placement]:
    """Read areas by name."""
    if not isinstance(areas, Mapping):
        raise ModelError(f"{source}: 'placements' must hold areas by name, "
                         f'got {format_value(areas)}')
    return [_read(str(name), values, f'{source}: placement {quoted(name)}')
            for name, values in areas.items()]


def _read(name: str, values: Any, source: str) -> Placement:
    if not isinstance(values, Mapping):
        raise ModelError(f'{source} needs keys and values, got {format_value(values)}')
    for key in values:
        if key not in _KEYS:
            raise ModelError(f'{source}: unknown key {quoted(key)}: '
                             f'{describe_choices(key, _KEYS)}')
    objects = values.get('objects')
    if not isinstance(objects, list) or not objects or len(set(map(str, objects))) != len(objects):
        raise ModelError(f"{source}: 'objects' must be a list of names, each once, got "
                         f'{format_value(objects)}')
    spans = []
    for key in ('x', 'y'):
        span = values.get(key)
        if not isinstance(span, list) or len(span) != 2:
            raise ModelError(f"{source}: '{key}' must be [low, high] in m, "
                             f'got {format_value(span)}')
        low, high = (_number(number, key, source, -_MOST) for number in span)
        if low > high:
            raise ModelError(
                f"{source}: '{key}' must be [low, high] in m, got {format_value(span)}")
        spans.append((low, high))
    if 'z' not in values:
        raise ModelError(f"{source} needs 'z', the height of the surface in m")
    yaw = _number(values.get('yaw', math.pi), 'yaw', source, 0.0)
    return Placement(name, tuple(map(str, objects)), (spans[0][0], spans[1][0]),
                     (spans[0][1], spans[1][1]), _number(values['z'], 'z', source, -_MOST),
                     min(yaw, math.pi), _number(values.get('margin', 0.0), 'margin', source, 0.0))


def _number(value: Any, key: str, source: str, least: float) -> float:
    if (isinstance(value, bool) or not isinstance(value, (int, float))
            or not least <= value <= _MOST):
        raise ModelError(f"{source}: '{key}' needs numbers from {least:g} to {_MOST:g}, got "
                         f'{format_value(value)}')
    return float(value)


def check_placed(placements: Sequence[Placement], objects: Iterable[ObjectModel]) -> None:
    """Reject areas of objects that do not exist, are only seen, or are in two areas."""
    by_name = {item.name: item for item in objects}
    placed: set[str] = set()
    for placement in placements:
        for name in placement.objects:
            if name not in by_name:
                raise UnknownNameError(f'object of placement {quoted(placement.name)}', name,
                                       by_name)
            if by_name[name].visual:
                raise ModelError(f"placement {quoted(placement.name)}: '{name}' is only seen, "
                                 'and is not placed')
            if name in placed:
                raise ModelError(f"'{name}' is in two placements")
            placed.add(name)


def extents(model: mujoco.MjModel, names: Iterable[str]) -> dict[str, Extent]:
    """
    Return the sizes of objects as they stand at the start, by name.

    :param model: compiled, with the objects as free bodies
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return {name: _extent(model, data, name) for name in names}


def _extent(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> Extent:
    root = model.body(name).id
    geoms = np.flatnonzero(model.body_rootid[model.geom_bodyid] == root)
    touching = geoms[(model.geom_contype[geoms] | model.geom_conaffinity[geoms]) != 0]
    frame, signs = data.xpos[root], np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1)
                                              for z in (-1, 1)])
    radius, bottom = 0.0, 0.0
    for geom in (touching if len(touching) else geoms).tolist():
        box = model.geom_aabb[geom]
        corners = (box[:3] + signs * box[3:]) @ data.geom_xmat[geom].reshape(3, 3).T + (
            data.geom_xpos[geom] - frame)
        radius = max(radius, float(np.sqrt((corners[:, :2]**2).sum(axis=1)).max()))
        bottom = min(bottom, float(corners[:, 2].min()))
    return Extent(radius, bottom, np.array(data.xquat[root]))


def draw_places(placements: Sequence[Placement], sizes: Mapping[str, Extent], seed: int
                ) -> dict[str, tuple[FloatArray, FloatArray]]:
    """
    Return positions in ``world`` [m] and orientations w, x, y, z by object.

    :raises ModelError: if the objects of an area do not fit into it
    """
    poses: dict[str, tuple[FloatArray, FloatArray]] = {}
    taken: list[tuple[float, float, float]] = []
    for placement in placements:
        random = generator(seed, f'placement {placement.name}')
        new = next((new for new in (_try(placement, sizes, taken, random) for _ in range(_TRIES))
                    if new is not None), None)
        if new is None:
            raise ModelError(f'placement {quoted(placement.name)}: no room for '
                             f'{", ".join(placement.objects)} without overlap in {_TRIES} '
                             'tries: make the area larger or the margin smaller')
        for name, (x, y) in zip(placement.objects, new):
            size = sizes[name]
            taken.append((x, y, size.radius))
            turned = np.empty(4)
            mujoco.mju_mulQuat(turned, _turn(random, placement.yaw), size.quat_wxyz)
            poses[name] = np.array([x, y, placement.z - size.bottom]), turned
    return poses


def _try(placement: Placement, sizes: Mapping[str, Extent],
         taken: Sequence[tuple[float, float, float]], random: np.random.Generator
         ) -> list[tuple[float, float]] | None:
    """Return places of all objects of an area; None if two overlap."""
    placed: list[tuple[float, float, float]] = []
    for name in placement.objects:
        x, y = (low + (high - low) * random.random()
                for low, high in zip(placement.low, placement.high))
        radius = sizes[name].radius
        for other_x, other_y, other in (*taken, *placed):
            apart = radius + other + placement.margin
            if (x - other_x)**2 + (y - other_y)**2 < apart * apart:
                return None
        placed.append((x, y, radius))
    return [(x, y) for x, y, _ in placed]


def _turn(random: np.random.Generator, most: float) -> FloatArray:
    """
    Return an evenly distributed turn about z as a quaternion w, x, y, z.

    Only sums, products and square roots follow a draw, so its bits are equal on every processor.

    :param most: greatest angle to both sides, up to pi [rad]
    """
    if most <= _HALF_TURN:
        steepest = math.tan(most / 2.0)
        while True:
            slope = steepest * (2.0 * random.random() - 1.0)
            if random.random() * (1.0 + slope * slope) <= 1.0:
                return np.array([1.0, 0.0, 0.0, slope]) / math.sqrt(1.0 + slope * slope)
    while True:
        w, z = random.random(), 2.0 * random.random() - 1.0
        if 0.01 < w * w + z * z <= 1.0 and abs(z) <= (w * math.tan(most / 2.0)):
            return np.array([w, 0.0, 0.0, z]) / math.sqrt(w * w + z * z)


ABSOLUTE, SCALE, OFFSET = 'absolute', 'scale', 'offset'
#: The group of parameters of the node, which have no quantity.
OF_NODE = 'parameters'
#: The group of areas where objects are placed, which have rules of their own.
PLACEMENTS = 'placements'


@dataclass(frozen=True)
class Quantity:
    """
    A property that can be drawn.

    :ivar meaning: what it is, with its unit
    :ivar length: of its value; 1 for a number
    :ivar low: least value of each number
    :ivar high: greatest value of each number
    :ivar ways: how a draw may change it
    """

    meaning: str
    length: int = 1
    low: float = 0.0
    high: float = math.inf
    ways: tuple[str, ...] = (ABSOLUTE, SCALE, OFFSET)


_ANY: Mapping[str, Any] = {'length': 3, 'low': -math.inf}
_TURN = Quantity('rotation vector in its own axes [rad]', 3, -math.pi, math.pi, (OFFSET,))
_LEAST = 1e-9
#: Properties that can be drawn, by group and name.
GROUPS: Mapping[str, Mapping[str, Quantity]] = MappingProxyType({
    'bodies': {
        'mass': Quantity('mass [kg]; the inertia changes in proportion', low=_LEAST),
        'position': Quantity('position in its parent, of a free body at the start in `world` [m]',
                             **_ANY),
        'orientation': _TURN},
    'geoms': {
        'friction': Quantity('coefficient of sliding friction'),
        'torsional_friction': Quantity('coefficient of torsional friction [m]'),
        'rolling_friction': Quantity('coefficient of rolling friction [m]'),
        'size': Quantity("MuJoCo's size: radius, half length or half extents [m]", 3, _LEAST),
        'color': Quantity('red, green and blue', 3, 0.0, 1.0)},
    'joints': {
        'damping': Quantity('damping [N m s/rad or N s/m]'),
        'friction': Quantity('dry friction [N m or N]'),
        'armature': Quantity('reflected inertia of the motor [kg m^2 or kg]')},
    'lights': {
        'position': Quantity('position in its body [m]', **_ANY),
        'direction': Quantity('direction in its body, of any length', 3, -math.inf, math.inf,
                              (ABSOLUTE, OFFSET)),
        'diffuse': Quantity('red, green and blue of the diffuse light', 3, 0.0, 1.0),
        'ambient': Quantity('red, green and blue of the ambient light', 3, 0.0, 1.0),
        'specular': Quantity('red, green and blue of the specular light', 3, 0.0, 1.0)},
    'cameras': {
        'position': Quantity('position in its body [m]', **_ANY),
        'orientation': _TURN},
    OF_NODE: {name: Quantity(f'{found.meaning} [{found.unit}]', 1, 0.0, found.maximum, (ABSOLUTE,))
              for name, found in PARAMETERS.items()}})
DISTRIBUTIONS = ('uniform', 'normal', 'log_uniform', 'choice')
_Lines = Mapping[tuple[str, ...], int]


@dataclass(frozen=True)
class Rule:
    """
    A distribution of a property of all elements whose names match a pattern.

    :ivar group: one of :data:`GROUPS`
    :ivar pattern: of names, with ``*``, ``?`` and ``[...]`` as a shell has them
    :ivar way: ``absolute``, ``scale`` or ``offset``
    :ivar distribution: one of :data:`DISTRIBUTIONS`
    :ivar numbers: its two parameters, or its choices, as rows of numbers
    :ivar where: file and line, for messages
    """

    group: str
    pattern: str
    quantity: str
    way: str
    distribution: str
    numbers: tuple[tuple[float, ...], ...]
    where: str

    def draw(self, seed: int, key: str) -> FloatArray:
        """
        Return a draw, which depends on its arguments only.

        :param key: of the drawn quantity, unique in its world
        :returns: one number for all, or one for each number of the quantity
        """
        random = generator(seed, f'randomization {key}')
        if self.distribution == 'choice':
            return np.array(self.numbers[random.integers(len(self.numbers))])
        first, second = np.array(self.numbers)
        if self.distribution == 'normal':
            return np.asarray(first + second * random.standard_normal(len(first)))
        if self.distribution == 'log_uniform':
            # math, as logarithms of NumPy differ between its releases; both ends are included.
            return np.array([
                min(max(math.exp(math.log(low) + (math.log(high) - math.log(low)) * share), low),
                    high) for low, high, share in zip(first, second, random.random(len(first)))])
        return np.asarray(first + (second - first) * random.random(len(first)))

    def matches(self, name: str) -> bool:
        """Return whether the pattern matches a name."""
        if self.group == OF_NODE:  # Of one robot, or of all.
            return name == self.pattern or name.endswith(f'.{self.pattern}')
        return fnmatchcase(name, self.pattern)

    def key(self, name: str) -> str:
        """Return ``group/name/quantity`` of an element; parameters have no quantity."""
        return '/'.join([self.group, name, *[self.quantity] * (self.group != OF_NODE)])

    def applied(self, value: FloatArray, drawn: FloatArray) -> FloatArray:
        """
        Return a value after a draw, within what the quantity may be.

        :param value: without it, shape (n,)
        :param drawn: one number, or n
        :raises ModelError: if there are other numbers of draws than numbers of the value
        """
        if len(drawn) not in (1, len(value)):
            raise ModelError(f'{self.where}: {self.quantity} of {quoted(self.pattern)} has '
                             f'{len(value)} numbers, got {len(drawn)}')
        new: FloatArray = (
            np.broadcast_to(drawn, value.shape) if self.way == ABSOLUTE else
            value * drawn if self.way == SCALE else value + drawn)
        limits = GROUPS[self.group][self.quantity]
        return np.asarray(np.minimum(np.maximum(new, limits.low), limits.high))


class Randomization:
    """
    Distributions of properties, drawn at each reset with a seed.

    Where several rules are for the same property of the same element, the last one counts.

    :param given: a YAML file, or what it would hold
    :raises ModelError: if something cannot be used, naming the file and the line
    :ivar given: what the file holds, as plain data
    :ivar rules: in the order of the file
    :ivar placements: areas where objects are placed
    """

    def __init__(self, given: RandomizationLike) -> None:
        self.given: Mapping[str, Any]
        self.rules: tuple[Rule, ...]
        self.placements: tuple[Placement, ...]
        if isinstance(given, Randomization):
            self.given, self.rules = given.given, given.rules
            self.placements = given.placements
            return
        lines: _Lines = {}
        name = 'randomization'
        check_kind(given, (Mapping, str, os.PathLike), name, 'a mapping or a YAML file')
        if isinstance(given, Mapping):
            self.given = dict(given)
        else:
            name = os.fspath(given)
            self.given = read_yaml(name)
            lines = _lines_of(name)
        self.placements = tuple(read_placements(self.given.get(PLACEMENTS, {}), name))
        self.rules = tuple(_Reader(name, lines).rules(
            {group: rules for group, rules in self.given.items() if group != PLACEMENTS}))

    def with_placements(self, placements: Iterable[Placement]) -> Randomization:
        """Return the same with more areas where objects are placed, before its own."""
        new = Randomization(self)
        new.placements = (*placements, *self.placements)
        new.given = {**self.given, PLACEMENTS: {
            placement.name: placement.values for placement in new.placements}}
        return new

    def resolve(self, names: Mapping[str, Iterable[str]], strict: bool = True
                ) -> dict[str, Rule]:
        """
        Return the rule of each property that is drawn, by ``group/name/quantity``.

        :param strict: whether a pattern must match one
        :raises ModelError: if a pattern matches none, naming the nearest
        """
        rules: dict[str, Rule] = {}
        for rule in self.rules:
            known = [name for name in names[rule.group] if name]
            matching = [name for name in known if rule.matches(name)]
            if not matching and strict:
                kind = _SINGULAR[rule.group]
                raise ModelError(f'{rule.where}: no {kind} matches {quoted(rule.pattern)}: '
                                 f'{describe_choices(rule.pattern, known)}')
            for name in matching:
                rules[rule.key(name)] = rule
        return rules


RandomizationLike = Union[str, 'os.PathLike[str]', Mapping[str, Any], Randomization]
_SINGULAR = {'bodies': 'body', 'geoms': 'geom', 'joints': 'joint', 'lights': 'light',
             'cameras': 'camera', OF_NODE: 'parameter'}


def _lines_of(file: str) -> dict[tuple[str, ...], int]:
    """Return the line of each key of a YAML file, by the keys that lead to it."""
    lines: dict[tuple[str, ...], int] = {}

    def walk(node: Any, path: tuple[str, ...]) -> None:
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                keys = (*path, str(key.value))
                lines[keys] = key.start_mark.line + 1
                walk(value, keys)
    walk(yaml.compose(Path(file).read_bytes(), Loader=StrictLoader), ())
    return lines


class _Reader:
    """Checks what a file holds."""

    def __init__(self, name: str, lines: _Lines) -> None:
        self._name, self._lines = name, lines

    def _where(self, *path: str) -> str:
        line = self._lines.get(path)
        return self._name if line is None else f'{self._name}, line {line}'

    def _known(self, kind: str, key: Any, known: Iterable[str], *path: str) -> None:
        if key not in (choices := list(known)):
            raise ModelError(f'{self._where(*path)}: unknown {kind} {quoted(key)}: '
                             f'{describe_choices(key, choices)}')

    def _mapping(self, value: Any, need: str, *path: str) -> Mapping[str, Any]:
        if not isinstance(value, Mapping) or not value:
            raise ModelError(f'{self._where(*path)}: {need}, got {format_value(value)}')
        return value

    def rules(self, groups: Mapping[str, Any]) -> Iterable[Rule]:
        """Yield the rules."""
        for group, patterns in groups.items():
            self._known('group', group, (*GROUPS, PLACEMENTS), group)
            for pattern, inner in self._mapping(
                    patterns, f'{group} needs names and what is drawn', group).items():
                if group == OF_NODE:
                    # With several robots, the name of one comes first.
                    name = next((name for name in PARAMETERS if pattern == name
                                 or str(pattern).endswith(f'.{name}')), None)
                    if name is None:
                        self._known('parameter', pattern, PARAMETERS, group, pattern)
                    yield self._rule(group, pattern, str(name), inner, (group, pattern))
                    continue
                for quantity, spec in self._mapping(
                        inner, f'{quoted(pattern)} needs quantities and their distributions',
                        group, pattern).items():
                    path = group, pattern, quantity
                    self._known(f'quantity of {group}', quantity, GROUPS[group], *path)
                    yield self._rule(group, pattern, quantity, spec, path)

    def _rule(self, group: str, pattern: str, quantity: str, spec: Any, path: tuple[str, ...]
              ) -> Rule:
        need = f'{quantity} needs one distribution: {", ".join(DISTRIBUTIONS)}'
        way, inner = ABSOLUTE, self._mapping(spec, need, *path)
        if len(inner) == 1 and next(iter(inner)) in (SCALE, OFFSET):
            way = next(iter(inner))
            path = *path, way
            inner = self._mapping(inner[way], need, *path)
        if len(inner) != 1:
            raise ModelError(f'{self._where(*path)}: {need}, got {format_value(dict(inner))}')
        kind, numbers = next(iter(inner.items()))
        self._known('distribution', kind, (*DISTRIBUTIONS, *(SCALE, OFFSET) * (way == ABSOLUTE)),
                    *path, kind)
        limits, place = GROUPS[group][quantity], self._where(*path, kind)
        if way not in limits.ways:
            raise ModelError(f'{place}: {quantity} of {group} can be drawn as '
                             f'{" or ".join(limits.ways)}, not as {way}')
        rows = self._numbers(kind, numbers, limits, place)
        _check(kind, way, rows, limits, f'{place}: {quantity}, {kind}')
        return Rule(group, pattern, quantity, way, kind, rows, place)

    def _numbers(self, kind: str, numbers: Any, limits: Quantity, place: str
                 ) -> tuple[tuple[float, ...], ...]:
        """Return the parameters of a distribution as rows of the same length."""
        if not isinstance(numbers, (list, tuple)) or (
                not numbers if kind == 'choice' else len(numbers) != 2):
            form = ('a list with choices' if kind == 'choice' else
                    '[mean, standard deviation]' if kind == 'normal' else '[low, high]')
            raise ModelError(f'{place}: {kind} needs {form}, got {format_value(numbers)}')
        rows = []
        for number in numbers:
            row = number if isinstance(number, (list, tuple)) else [number]
            for value in row:
                if (isinstance(value, bool) or not isinstance(value, (int, float))
                        or not abs(value) <= mujoco.mjMAXVAL):
                    raise ModelError(f'{place}: {kind} needs numbers within {mujoco.mjMAXVAL:g}, '
                                     f'got {format_value(value)}')
            if len(row) != 1 and (len(row) > limits.length or not row):
                raise ModelError(f'{place}: {kind} needs a number or a list of up to '
                                 f'{limits.length}, got {format_value(number)}')
            rows.append(tuple(float(value) for value in row))
        if len({len(row) for row in rows}) != 1:
            raise ModelError(f'{place}: {kind} needs numbers or lists of one length, got '
                             f'{format_value(numbers)}')
        return tuple(rows)


def _check(kind: str, way: str, rows: tuple[tuple[float, ...], ...], limits: Quantity,
           place: str) -> None:
    """Reject distributions that make no sense."""
    if kind in ('uniform', 'log_uniform'):
        for low, high in zip(*rows):
            if low > high:
                raise ModelError(f'{place}: low must not be above high, got [{low:g}, {high:g}]')
    if kind == 'log_uniform' and min(rows[0]) <= 0.0:
        raise ModelError(f'{place}: low must be above 0, got {min(rows[0]):g}')
    if kind == 'normal' and min(rows[1]) < 0.0:
        raise ModelError(f'{place}: a standard deviation must be at least 0, got '
                         f'{min(rows[1]):g}')
    named = rows[:1] if kind == 'normal' else rows
    least, most = min(min(row) for row in named), max(max(row) for row in named)
    if way == ABSOLUTE and (least < limits.low or most > limits.high):
        raise ModelError(f'{place}: values must be from {limits.low:g} to {limits.high:g}, got '
                         f'{least if least < limits.low else most:g}')
    if way == SCALE and limits.low >= 0.0 and least < 0.0:
        raise ModelError(f'{place}: factors must be at least 0, got {least:g}')
