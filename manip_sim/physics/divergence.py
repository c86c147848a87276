# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Detect that the physics has diverged, and restore the last good state."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray

#: A generalised velocity that no robot reaches [rad/s or m/s].
_ABSURD_VELOCITY = 1e4
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_KINDS = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADCTRL) + 1)


class DivergenceWatch:
    """
    A detector of divergence that keeps the last good state.

    :param model: the ``mujoco.MjModel``
    :param data: its ``mujoco.MjData``
    :ivar good: the last good state, every number that MuJoCo integrates
    :ivar warnings: how often MuJoCo has warned of bad numbers, by kind, a view
    :ivar warned: the same when the good state was remembered
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model = model
        self._data = data
        self.good: FloatArray = np.empty(mujoco.mj_stateSize(model, _STATE))
        # Views, which need not be fetched in each period.
        self._numbers = data.qpos, data.qvel, data.qacc
        self.warnings: NDArray[np.int32] = data.warning.number[_KINDS]
        self.warned: NDArray[np.int32] = self.warnings.copy()

    def remember(self) -> FloatArray:
        """Remember the present state as the good one, and return it."""
        mujoco.mj_getState(self._model, self._data, self.good, _STATE)
        self.warned[:] = self.warnings
        return self.good

    def reason(self) -> str | None:
        """Return why the present state has diverged, or None if it is good."""
        position, velocity, acceleration = self._numbers
        warns = self.warnings.tobytes() != self.warned.tobytes()
        if (velocity.dot(velocity) < _ABSURD_VELOCITY**2 and not warns
                and math.isfinite(position.dot(position) + acceleration.dot(acceleration))):
            return None
        if not all(np.isfinite(values).all() for values in self._numbers):
            return 'a position, velocity or acceleration is not finite'
        if np.abs(velocity).max(initial=0.0) > _ABSURD_VELOCITY:
            return f'a velocity is above {_ABSURD_VELOCITY:g}'
        if warns:
            return 'MuJoCo warns of a bad position, velocity, acceleration or control'
        return None

    def hold(self) -> None:
        """Restore the good state, at rest; ``mj_forward`` has to follow."""
        mujoco.mj_setState(self._model, self._data, self.good, _STATE)
        self._data.qvel[:] = 0.0
