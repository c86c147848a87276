# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Check and clamp numbers that come from outside."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError
from manip_sim.validation import as_numbers, finite_numbers


#: ``as_numbers`` and ``finite_numbers`` for numbers of commands: they raise ``CommandError``.
command_numbers = partial(as_numbers, error=CommandError)
finite_command_numbers = partial(finite_numbers, error=CommandError)


def numbers_of(text: str) -> list[float]:
    """
    Return the numbers of a text such as ``[1, 2.5]``, in brackets or without.

    :raises ValueError: if it is something else
    """
    inner = text[1:-1] if text.startswith('[') and text.endswith(']') else text
    return [float(word) for word in inner.split(',')]


def clamp(values: FloatArray, ranges: FloatArray) -> tuple[FloatArray, int]:
    """
    Clamp numbers to their ranges.

    :param ranges: lowest and highest value, shape (2,), or (n, 2) for values of shape (..., n)
    :returns: the numbers in range, and how many were not
    """
    inside = np.minimum(np.maximum(values, ranges[..., 0]), ranges[..., 1])
    return inside, int(np.count_nonzero(inside != values))


def clamped_example(names: Sequence[str], values: FloatArray, inside: FloatArray) -> str:
    """
    Describe the first number that was clamped.

    :param names: of the columns of the values
    :param values: before clamping, shape (n,) or (n_points, n)
    :param inside: the clamped values
    :returns: such as ``joint1 from 9 to 2.8973``; empty if all are in range
    """
    clamped = inside != values
    if not np.count_nonzero(clamped):
        return ''
    place = tuple(np.argwhere(clamped)[0])
    return f'{names[place[-1]]} from {values[place]:g} to {inside[place]:g}'


def action_example(numbers: FloatArray, inside: FloatArray) -> str:
    """Return the :func:`clamped_example` of an action, whose numbers have no names."""
    return clamped_example([f'data[{i}]' for i in range(len(numbers))], numbers, inside)
