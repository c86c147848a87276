# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The connection to a node: its states for the page, and commands of people for the node."""
