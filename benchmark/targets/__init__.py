# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The measurements of ``bench.py``: one module for each row, and what they share."""
