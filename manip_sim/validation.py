# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Check and clamp numbers from users, with uniform messages; the caller says what they are for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
import math
from numbers import Real
import sys
from typing import Any, cast, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, KindError, ManipSimError, ModelError
from manip_sim.quoting import format_value, pluralize

_Item = TypeVar('_Item')
#: Greatest difference of the square of a quaternion's norm from one, as in tf2's ``BufferCore``.
_NORM_TOLERANCE = 1e-2


def as_numbers(values: ArrayLike, label: str, error: type[ManipSimError] = ModelError
               ) -> FloatArray:
    """
    Return numbers as an array of their own shape, always a copy.

    :raises ManipSimError: that exception, if they are not numbers
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind in 'SUc':
            raise TypeError('text, or complex')
        return np.array(array, dtype=float)
    except (OverflowError, TypeError, ValueError) as cause:
        raise error(f'{label} must be numbers, got {values!r:.60}') from cause


def finite_numbers(values: ArrayLike, length: int, label: str,
                   error: type[ManipSimError] = ModelError) -> FloatArray:
    """
    Return numbers as an array of shape (length,), always a copy.

    :raises ManipSimError: that exception, if they are not ``length`` finite numbers
    """
    array = as_numbers(values, label, error)
    if array.shape == (length,) and np.isfinite(array).all():
        return array
    if array.shape != (length,):
        got = str(array.size) if array.ndim == 1 else f'the shape {array.shape}'
        raise error(f'{label} must have {pluralize(length, "number")}, got {got}')
    bad = int(np.flatnonzero(~np.isfinite(array))[0])
    raise error(f'{label} must be finite, got {array[bad]} at index {bad}')


#: ``as_numbers`` and ``finite_numbers`` for numbers of commands: they raise ``CommandError``.
command_numbers = partial(as_numbers, error=CommandError)
finite_command_numbers = partial(finite_numbers, error=CommandError)


def check_kind(value: object, kinds: type | tuple[type, ...], label: str, expected: str) -> None:
    """
    Reject a value of another kind.

    :param expected: what it should be, for the message
    :raises KindError: if it is of none of the kinds
    """
    if not isinstance(value, kinds):
        raise KindError(f'{label} must be {expected}, got {format_value(value)}')


def flag(value: object, label: str) -> bool:
    """
    Return a value that is true or false.

    :raises KindError: if it is any other
    """
    check_kind(value, (bool, np.bool_), label, 'true or false')
    return bool(value)


def listed(values: Iterable[_Item], label: str, expected: str = 'a list') -> list[_Item]:
    """
    Return the items of a list or of another iterable.

    :param expected: what it should be, for the message
    :raises KindError: if it is none, or a text or a mapping, whose items are parts of one
    """
    try:
        if not isinstance(values, (str, bytes, Mapping)):
            return list(values)
    except TypeError:
        pass
    raise KindError(f'{label} must be {expected}, got {format_value(values)}')


def mapping(value: object, label: str, example: str) -> Mapping[str, Any]:
    """
    Return a mapping.

    :param example: of what it should be, for the message
    :raises KindError: if it is none
    """
    check_kind(value, Mapping, label, f'a mapping, such as {example}')
    return cast('Mapping[str, Any]', value)


def unit_quaternion(values: ArrayLike, label: str) -> FloatArray:
    """
    Return a quaternion with unit norm, shape (4,), a copy.

    :raises ModelError: if it is not four finite numbers, all are zero, or its norm is infinite
    """
    quat = finite_numbers(values, 4, label)
    norm = math.hypot(*quat)  # The norm of numpy warns of an overflow.
    if not norm > 0.0:
        raise ModelError(f'{label} must not be zero')
    if not norm < math.inf:
        raise ModelError(f'{label} must have a finite norm')
    return quat / norm


def norm_of_unit_quaternion(quat_xyzw: Sequence[float], label: str,
                            error: type[Exception] = ModelError) -> float:
    """
    Return the norm of a quaternion x, y, z, w that is of length 1 but for rounding.

    :param quat_xyzw: finite numbers, shape (4,)
    :raises Exception: that exception, if it is of another length
    """
    norm = math.hypot(*quat_xyzw)  # The norm of numpy warns of an overflow.
    if abs(norm * norm - 1.0) > _NORM_TOLERANCE:
        raise error(f'{label} must be a quaternion x, y, z, w of length 1, got {list(quat_xyzw)} '
                    f'of length {norm:g}')
    return norm


def whole_number(value: object, least: int, label: str, error: type[ManipSimError] = ModelError
                 ) -> int:
    """
    Return a whole number.

    :raises ManipSimError: that exception, if it is not a whole number from there
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise error(f'{label} must be a whole number from {least}, got {format_value(value)}')
    return int(value)


def finite_or_nan(value: object) -> float:
    """Return a finite real number, and NaN for anything else."""
    try:
        if isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    except OverflowError:  # A whole number may be greater than any double.
        pass
    return math.nan


def positive_number(value: Any, label: str, error: type[ManipSimError] = ModelError,
                    or_zero: bool = False) -> float:
    """
    Return a number above 0.

    :param or_zero: whether 0 is allowed too
    :raises ManipSimError: that exception, if it is not such a finite number
    """
    number = finite_or_nan(value)
    if not (number > 0.0 or or_zero and number == 0.0):
        raise error(f'{label} must be positive and finite{", or 0" if or_zero else ""}, '
                    f'got {format_value(value)}')
    return number


def start_by_joint(part: str, joints: list[str], qpos: Any) -> dict[str, float]:
    """
    Return the start positions of joints, by name [rad or m].

    :param qpos: one number for each joint, or None for no start
    :raises ModelError: if there is not one finite number for each joint
    """
    if qpos is None:
        return {}
    values = finite_numbers(qpos, len(joints), f'init_qpos of {part}')
    return dict(zip(joints, values.tolist()))


def whole_nanoseconds(timestep_s: float) -> float:
    """
    Return a timestep if stamps, which count nanoseconds, do not drift from it.

    :raises ModelError: if it is not a positive whole number of nanoseconds, naming the nearest
    """
    check_kind(timestep_s, Real, 'a timestep', 'a number')
    number_s = finite_or_nan(timestep_s)
    if not 1e-9 <= number_s <= sys.float_info.max / 1e9:
        raise ModelError('a timestep must be positive and finite, got '
                         f'{format_value(timestep_s)} s')
    nanoseconds = number_s * 1e9
    if abs(nanoseconds - round(nanoseconds)) > 1e-5:
        raise ModelError('a timestep must be a whole number of nanoseconds, got '
                         f'{number_s!r} s; the nearest is {round(nanoseconds) / 1e9:.9f}')
    return number_s


def steps_of(period_s: float, timestep_s: float) -> int | None:
    """Return the number of timesteps of a period, or None if it is not whole within 1e-6."""
    steps = period_s / timestep_s
    whole = max(1, round(steps))
    return whole if abs(steps - whole) <= 1e-6 * whole else None


def fitting_timestep(period_s: float, timestep_s: float) -> float | None:
    """
    Return the longest timestep of whole nanoseconds of which a period is a whole number.

    :param timestep_s: the longest that is allowed [s]
    :returns: [s]; None if nanoseconds are too coarse
    """
    steps = max(1, math.ceil(period_s / timestep_s - 1e-6))
    fitted_s = round(period_s / steps * 1e9) / 1e9
    return fitted_s if fitted_s and steps_of(period_s, fitted_s) else None


def nearest_rates(rate_hz: float, timestep_s: float) -> list[float]:
    """Return the rates next to another one whose periods are whole numbers of timesteps [Hz]."""
    steps = int(1.0 / (rate_hz * timestep_s))
    return [1.0 / (n * timestep_s) for n in (steps + 1, steps) if n > 0]


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
