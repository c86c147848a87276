# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control laws: plain scalar functions, compiled by numba, with the same bits as plain Python."""
