# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The command ``manip_sim``: list parts; describe, check, export and render worlds; no ROS."""
