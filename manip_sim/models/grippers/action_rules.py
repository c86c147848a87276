# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The meaning of the actions of a gripper as numbers, which compiled code can follow."""

from __future__ import annotations

from typing import NamedTuple

from manip_sim.arrays import BoolArray, FloatArray, IntArray


class ActionRule(NamedTuple):
    """
    The meaning of the actions of a gripper of the catalogue.

    Its commands are the numbers of an action, or change by a step with each call of
    ``format_action``; each actuator follows one of them, or stays.

    :ivar numbers: which number of an action each command follows, shape (m,)
    :ivar steps: change of each command in a call with an action of 1, shape (m,); empty where
        actions are commands
    :ivar proportional: whether the magnitude of actions counts, or the sign alone, shape (1,)
    :ivar sources: which command each actuator follows, -1 for one that stays, shape (nu,)
    :ivar still: command of each actuator that stays, shape (nu,)
    """

    numbers: IntArray
    steps: FloatArray
    proportional: BoolArray
    sources: IntArray
    still: FloatArray
