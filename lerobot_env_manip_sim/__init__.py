# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Entry point of LeRobot's EnvHub: ``from lerobot_env_manip_sim import make_env``."""

from manip_sim.env.lerobot_env import make_env

__all__ = ['make_env']
