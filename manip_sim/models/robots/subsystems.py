# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tell from a name, or from the joint it drives, what belongs to arm, base, torso, head, legs."""

from __future__ import annotations

import re
from typing import Any

import mujoco

SUBSYSTEMS = ('arm', 'base', 'torso', 'head', 'legs')
#: In the order in which names are looked at; what fits none is arm.
KEYWORDS = {'torso': 'torso', 'mobile': 'base', 'head': 'head', 'leg': 'legs'}
_WORD = re.compile(r'[A-Z]?[a-z]+|[A-Z]+(?![a-z])')


def classify(name: str) -> str:
    """
    Return the subsystem that an unprefixed name tells of.

    The reference's keywords torso, mobile, head and leg decide in this order, but only as whole
    words, in any case: ``head_pan`` is of the head, ``overhead_joint`` of the arm.
    """
    words = {word.lower() for word in _WORD.findall(name)}
    for keyword, subsystem in KEYWORDS.items():
        if keyword in words or subsystem in words - {'base'}:
            return subsystem
    return 'arm'


def driven_joint(model: Any, actuator: int) -> str | None:
    """
    Return the name of the joint that an actuator drives, or None.

    :param model: a ``mujoco.MjModel``
    :param actuator: number of the actuator
    """
    kind = int(model.actuator_trntype[actuator])
    if kind not in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)):
        return None
    name: str = model.joint(int(model.actuator_trnid[actuator, 0])).name
    return name
