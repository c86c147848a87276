# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Records of episodes and of nodes in MCAP files, as rosbag2 reads them.

They need the extra ``records``; only what records a running node needs ROS.
"""

from manip_sim.records.recorder import EpisodeRecorder

__all__ = ['EpisodeRecorder']
