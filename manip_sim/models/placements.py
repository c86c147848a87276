# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Starts drawn from a seed: objects that do not overlap, and noise on joints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import copy
from dataclasses import dataclass
import math
import numbers
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import describe_choices, ModelError, UnknownNameError
from manip_sim.models.object_model import ObjectModel
from manip_sim.quoting import format_value, quoted
from manip_sim.sensing.randomness import generator
from manip_sim.validation import whole_number

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
        for key in settings:
            if key not in ('type', 'magnitude'):
                raise UnknownNameError('key of initialization_noise', key, ('type', 'magnitude'))
        self.type = settings.get('type', TYPES[0])
        if self.type not in TYPES:
            raise UnknownNameError('type of initialization_noise', self.type, TYPES)
        self.magnitude = _checked_magnitude(settings.get('magnitude', DEFAULT_MAGNITUDE))
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


def _checked_magnitude(magnitude: Any) -> float:
    if (isinstance(magnitude, bool) or not isinstance(magnitude, numbers.Real)
            or not 0.0 <= float(magnitude) <= math.pi):
        raise ModelError('magnitude of initialization_noise must be a number from 0 to '
                         f'{math.pi:.4g}, got {format_value(magnitude)}')
    return float(magnitude)


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
