# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The actuators of a gripper, and where their setpoints go, as the compiled law takes them."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.law.joint_records import readable

#: An actuator of a gripper: its id, its address in ``act`` where it integrates; gain of a servo
#: and its bias, constant and per length, 1 and 0 elsewhere; range of setpoints, their highest
#: speed, how far they are below and above the place at full force, and with the present limits of
#: force; setpoints that differ by less than the tolerance are the same; whether it has a setpoint,
#: and whether its control is the rate of that.
FINGER = np.dtype([
    *((name, np.int64) for name in ('id', 'activation')),
    *((name, np.float64) for name in (
        'gain', 'offset', 'per_length', 'low', 'high', 'speed', 'below', 'above', 'reach_below',
        'reach_above', 'tolerance')),
    *((name, np.bool_) for name in ('is_servo', 'integrates'))], align=True)
#: Flags of a gripper: setpoints move, or a finger that was sent to an end has yet to stop; the
#: goals are new; ``format_action`` will be called again; there are two independent fingers that
#: close on each other.
MOVES, TURNED, ACTS, PAIR = range(4)


class Grip(NamedTuple):
    """
    Where the setpoints of a gripper go; the law changes all but the first and the fourth.

    :ivar goal: shape (n,)
    :ivar to_end: whether each was sent to the lower and the upper end of its range, and its finger
        is not there, shape (n, 2)
    :ivar pressing: whether its finger has stopped before that, shape (n,)
    :ivar pace: of setpoints, at most [1/s], shape (n,)
    :ivar stopped: where the fingers were when all had come to rest, as setpoints, shape (n,)
    :ivar flags: by :data:`MOVES`, :data:`TURNED`, :data:`ACTS`, :data:`PAIR`, shape (4,)
    """

    goal: FloatArray
    to_end: BoolArray
    pressing: BoolArray
    pace: FloatArray
    stopped: FloatArray
    flags: NDArray[np.bool_]


class Gripper(NamedTuple):
    """
    A gripper.

    :ivar fingers: records of :data:`FINGER`, shape (n,)
    :ivar grip: where they go
    """

    fingers: NDArray[np.void]
    grip: Grip


@cache
def no_gripper() -> Gripper:
    """Return a gripper without fingers, which does nothing."""
    none = np.zeros(0)
    return Gripper(readable(np.zeros(0, FINGER)), Grip(
        none, np.zeros((0, 2), np.bool_), none > 0.0, none, none, np.zeros(4, np.bool_)))
