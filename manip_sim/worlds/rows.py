# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Check values for several worlds: arrays with a leading axis, and masks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.clamping import command_numbers
from manip_sim.errors import CommandError
from manip_sim.quoting import format_value


def world_mask(where: ArrayLike | None, count: int) -> BoolArray:
    """
    Return a mask of worlds.

    :param where: a truth value for each world, or None for all worlds
    :returns: shape (count,)
    :raises CommandError: if it has another shape or type
    """
    if where is None:
        return np.ones(count, dtype=bool)
    try:
        mask = np.asarray(where)
    except ValueError as error:
        raise CommandError(f'where must be {count} truth values, one for each world, got '
                           f'{format_value(where)}') from error
    if mask.shape != (count,) or mask.dtype != np.bool_:
        raise CommandError(f'where must be {count} truth values, one for each world, got '
                           f'{mask.dtype} of shape {mask.shape}')
    return mask


def as_batch(values: ArrayLike, count: int, what: str) -> FloatArray:
    """
    Return numbers with a leading axis of worlds.

    :param what: noun for them, for the message
    :returns: shape (count, ...), a copy
    :raises CommandError: if they are not numbers, or not one row for each world
    """
    numbers = command_numbers(values, what)
    if numbers.ndim == 0 or len(numbers) != count:
        raise CommandError(f'{what} must have a leading axis of {count}, one row for each world, '
                           f'got the shape {numbers.shape}')
    return numbers
