# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Universal Robots UR5e."""

from __future__ import annotations

from manip_sim.models.robots.pedestal_arm import PedestalArm


class UR5e(PedestalArm):
    """Six-joint arm, 5 kg payload, 0.85 m reach."""

    _asset = 'ur5e'
    _gripper = 'Robotiq85Gripper'
    _controller_config = 'default_ur5e'
    _init_qpos = (-0.47, -1.735, 2.48, -2.275, -1.59, -1.991)
