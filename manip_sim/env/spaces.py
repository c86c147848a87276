# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The spaces of actions and observations of an episode."""

from __future__ import annotations

import gymnasium
import numpy as np

from manip_sim.tasks import Episode
from manip_sim.tasks.observation import Observation


def action_space(episode: Episode) -> gymnasium.spaces.Box:
    """Return the space of an episode's actions, in their units."""
    low, high = episode.actions.bounds.T
    return gymnasium.spaces.Box(low, high, dtype=np.float64)


def observation_space(observation: Observation) -> gymnasium.Space[Observation]:
    """Return the space of observations."""
    return gymnasium.spaces.Dict({  # type: ignore[return-value]
        key: gymnasium.spaces.Box(0, 255, value.shape, np.uint8) if value.dtype == np.uint8 else
        gymnasium.spaces.Box(-np.inf, np.inf, value.shape, np.float64)
        for key, value in observation.items()})
