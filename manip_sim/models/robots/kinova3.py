# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Kinova Gen3 with seven joints and vision module."""

from __future__ import annotations

import numpy as np

from manip_sim.models.robots.pedestal_arm import PedestalArm


class Kinova3(PedestalArm):
    """Seven-joint arm, four of them without end stops, 4 kg payload, 0.902 m reach."""

    _asset = 'kinova3'
    _gripper = 'Robotiq85Gripper'
    _controller_config = 'osc_pose'
    _init_qpos = (0.0, 0.65, 0.0, 1.89, 0.0, 0.6, -np.pi / 2.0)
