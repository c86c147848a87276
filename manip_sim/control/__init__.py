# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How robots follow commands: who owns which joint, modes, setpoints, grippers, end effectors."""
