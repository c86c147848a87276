# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Rendering says how a model looks: OpenGL without a screen, images, depth, intrinsics."""
