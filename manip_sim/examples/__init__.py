# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Controllers that use the node through its topics alone."""
