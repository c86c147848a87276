# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the page shows comes from a node over topics, and what people do goes back to it."""
