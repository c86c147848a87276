# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Check and clamp numbers that come from outside."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError
from manip_sim.models import validation


def finite_numbers(values: ArrayLike, length: int, what: str) -> FloatArray:
    """
    Return numbers of a command as an array of shape (length,), a copy.

    :param what: what they are, for the message
    :raises CommandError: if they are no numbers, not as many, or one is not finite
    """
    return validation.finite_numbers(values, length, what, CommandError)


def clamp(values: FloatArray, ranges: FloatArray) -> tuple[FloatArray, int]:
    """
    Bring numbers into their ranges.

    :param ranges: lowest and highest value, shape (2,), or (n, 2) for values of shape (..., n)
    :returns: the numbers in range, and how many were not
    """
    inside = np.clip(values, ranges[..., 0], ranges[..., 1])
    return inside, int(np.count_nonzero(inside != values))
