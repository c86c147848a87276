# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The viewer: a page in the browser that shows a running node and lets people drive it."""
