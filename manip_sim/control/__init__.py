# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control of robots by commands: owners of joints, modes, setpoints, grippers, end effectors."""
