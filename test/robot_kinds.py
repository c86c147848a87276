# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots that differ in kind, for tests of what does not depend on the data of a single robot."""

from __future__ import annotations

from itertools import product
from typing import Any

from manip_sim.models.robots import robot_names

#: One arm; base, torso and head; legs and hands; six joints; joints without ends; two arms.
KINDS = ('Panda', 'Tiago', 'GR1', 'UR5e', 'Jaco', 'Baxter')


def all_and_kinds(first: Any, *others: Any, kinds: tuple[str, ...] = KINDS[:3]
                  ) -> list[tuple[str, Any]]:
    """Return each robot of the catalogue with the first value, and some with each other one."""
    return [*product(robot_names(), [first]), *product(kinds, others)]
