# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The KUKA LBR iiwa 7 R800."""

from __future__ import annotations

from manip_sim.models.robots.pedestal_arm import PedestalArm


class IIWA(PedestalArm):
    """Seven-joint arm, 7 kg payload, 0.8 m reach."""

    _asset = 'iiwa'
    _gripper = 'Robotiq140Gripper'
    _controller_config = 'default_iiwa'
    _init_qpos = (0.0, 0.65, 0.0, -1.89, 0.0, 0.6, 0.0)
