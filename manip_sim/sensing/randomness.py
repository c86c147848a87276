# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Random numbers that depend on a seed, a name and a count only, not on earlier draws.

They come from Philox, which computes the numbers of any place in its sequence directly.
"""

from __future__ import annotations

import hashlib

import numpy as np

from manip_sim.arrays import FloatArray

#: Number of rows that are drawn at once.
_BLOCK = 256


def generator(seed: int, name: str, count: int = 0) -> np.random.Generator:
    """
    Return a generator whose numbers depend on nothing but its arguments.

    :param name: of what the numbers are for
    :param count: a whole number from 0, such as of steps
    """
    of_name = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], 'little')
    key = np.random.SeedSequence([seed, of_name]).generate_state(2, np.uint64)
    # The lower half of the counter is left to the numbers of this generator.
    return np.random.Generator(np.random.Philox(key=key, counter=[0, 0, count, 0]))


class NormalRows:
    """Rows of independent standard normal numbers, one for each count, and their sums."""

    def __init__(self, seed: int, name: str, width: int) -> None:
        self._seed, self._name, self._width = seed, name, width
        self._number, self._rows = -1, np.empty((0, width))
        #: Sums of the rows before a block, and within the one that was looked at last.
        self._walked, self._before = 0, np.zeros(width)
        self._sums: tuple[int, FloatArray] = (-1, self._rows)

    def _block(self, number: int) -> FloatArray:
        if number != self._number:
            random = generator(self._seed, self._name, number)
            self._rows = random.standard_normal((_BLOCK, self._width))
            self._number = number
        return self._rows

    def row(self, count: int) -> FloatArray:
        """Return the row of a count, shape (width,)."""
        number, place = divmod(count, _BLOCK)
        row: FloatArray = self._block(number)[place]
        return row

    def sum(self, count: int) -> FloatArray:
        """Return the sum of the rows before a count: a random walk, shape (width,)."""
        number, place = divmod(count, _BLOCK)
        if number < self._walked:
            self._walked, self._before = 0, np.zeros(self._width)
        while self._walked < number:
            self._before = self._before + self._block(self._walked).sum(axis=0)
            self._walked += 1
        if not place:
            return self._before
        if self._sums[0] != number:
            self._sums = number, np.cumsum(self._block(number), axis=0)
        result: FloatArray = self._before + self._sums[1][place - 1]
        return result
