# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands for the end effector of an arm: poses, twists and abstract actions of ``grip_site``."""
