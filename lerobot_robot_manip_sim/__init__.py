# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots and leader arms of LeRobot that are robots of a running node, and environments."""

from lerobot_env_manip_sim.configs import ManipSimEnvConfig
from lerobot_robot_manip_sim.leaders import (
    ManipSimLeader, ManipSimLeaderConfig, ManipSimSO101Leader, ManipSimSO101LeaderConfig)
from lerobot_robot_manip_sim.robots import (
    ManipSim, ManipSimCameraConfig, ManipSimConfig, ManipSimSO101Follower,
    ManipSimSO101FollowerConfig)

__all__ = ['ManipSim', 'ManipSimCameraConfig', 'ManipSimConfig', 'ManipSimEnvConfig',
           'ManipSimLeader', 'ManipSimLeaderConfig', 'ManipSimSO101Follower',
           'ManipSimSO101FollowerConfig', 'ManipSimSO101Leader', 'ManipSimSO101LeaderConfig']
