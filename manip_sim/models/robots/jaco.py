# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Kinova Jaco with seven joints and a spherical wrist (j2s7s300)."""

from __future__ import annotations

from manip_sim.models.robots.pedestal_arm import PedestalArm


class Jaco(PedestalArm):
    """Seven-joint arm of carbon fibre with a spherical wrist."""

    _asset = 'jaco'
    _gripper = 'JacoThreeFingerGripper'
    _controller_config = 'default_jaco'
    _init_qpos = (3.192, 3.68, 0.0, 1.17, 0.05, 3.76, 3.142)
