# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Laws of your own, which move a part of a robot in each physics step."""

from manip_sim.control.modes import law, Law, Laws, LAWS

__all__ = ['LAWS', 'Law', 'Laws', 'law']
