# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots and leader arms of LeRobot that are robots of a running node; it needs LeRobot."""

from lerobot_robot_manip_sim.leaders import (
    ManipSimLeader, ManipSimLeaderConfig, ManipSimSO101Leader, ManipSimSO101LeaderConfig)
from lerobot_robot_manip_sim.robots import (
    ManipSim, ManipSimCameraConfig, ManipSimConfig, ManipSimSO101Follower,
    ManipSimSO101FollowerConfig)

__all__ = ['ManipSim', 'ManipSimCameraConfig', 'ManipSimConfig', 'ManipSimLeader',
           'ManipSimLeaderConfig', 'ManipSimSO101Follower', 'ManipSimSO101FollowerConfig',
           'ManipSimSO101Leader', 'ManipSimSO101LeaderConfig']
