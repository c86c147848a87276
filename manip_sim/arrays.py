# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Names for the array types used in annotations, and slices for indices."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


def as_slice(indices: IntArray) -> slice | IntArray:
    """Return the slice that indices are, whose elements are found faster, or else themselves."""
    found = _slice_of(indices.tobytes())
    return indices if found is None else found


@lru_cache(maxsize=256)  # Of each robot; it is asked for twice in a control period.
def _slice_of(data: bytes) -> slice | None:
    indices = np.frombuffer(data, dtype=np.int64)
    if indices.size and np.array_equal(indices, np.arange(indices[0], indices[0] + len(indices))):
        return slice(int(indices[0]), int(indices[0]) + len(indices))
    return None
