# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Identify friction, rotor inertia and payload of arms from recorded joint states."""
