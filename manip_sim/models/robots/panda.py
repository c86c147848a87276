# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Franka Emika Panda."""

from __future__ import annotations

import numpy as np

from manip_sim.models.robots.pedestal_arm import PedestalArm


class Panda(PedestalArm):
    """Seven-joint arm, 3 kg payload, 0.855 m reach."""

    _asset = 'panda'
    _gripper = 'PandaGripper'
    _controller_config = 'default_panda'
    _init_qpos = (0.0, np.pi / 16.0, 0.0, -np.pi / 2.0 - np.pi / 3.0, 0.0, np.pi - 0.2,
                  np.pi / 4.0)
