# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A page for the browser that shows a running node and lets people drive it."""
