# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Models say what exists: MuJoCo and numpy only, no ROS and no stepping."""
