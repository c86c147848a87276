# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Random start positions of robots, reproducible by a seed."""

from __future__ import annotations

from collections.abc import Mapping
import copy
import math
import numbers
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.quoting import shown
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
                         f'{math.pi:.4g}, got {shown(magnitude)}')
    return float(magnitude)


def checked_seed(seed: Any) -> int:
    """Return a seed; None draws one."""
    if seed is None:
        return int(np.random.SeedSequence().generate_state(1)[0])
    return whole_number(seed, 0, 'seed')
