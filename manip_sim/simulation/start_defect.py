# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""One defect of the start of a robot, and its remedy."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StartDefect:
    """
    A defect in one sentence, and what to write instead.

    :ivar kind: ``overlap``, ``blocked``, ``range``, ``actuators``, ``undriven``,
        ``effort``, ``inertia``, ``control``, ``meshes`` or ``states``
    :ivar text: the defect, with the names of the compiled model
    :ivar remedy: what to write, with the names of the compiled model
    """

    kind: str
    text: str
    remedy: str
