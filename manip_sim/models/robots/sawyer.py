# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Rethink Robotics Sawyer."""

from __future__ import annotations

from manip_sim.models.robots.pedestal_arm import PedestalArm


class Sawyer(PedestalArm):
    """Seven-joint arm with a screen, 4 kg payload, 1.26 m reach."""

    _asset = 'sawyer'
    _gripper = 'RethinkGripper'
    _controller_config = 'default_sawyer'
    _init_qpos = (0.0, -1.18, 0.0, 2.18, 0.0, 0.57, -1.57)
