# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The actuators of a gripper, and where their setpoints go, as the compiled law takes them."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import BoolArray, FloatArray, IntArray
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
#: goals are new; an action will be taken again; there are two independent fingers that close on
#: each other; the law takes actions by a rule; Python has to look as soon as setpoints do not move
#: any more; another action has come in compiled code.
MOVES, TURNED, ACTS, PAIR, RULED, AWAITED, RENEWED = range(7)
#: Rate at which an action of a gripper is taken again and again, that of robosuite [Hz].
GRIPPER_RATE_HZ = 20.0


class Rule(NamedTuple):
    """
    Meaning of the actions of a gripper, see :class:`~manip_sim.models.grippers.ActionRule`.

    :ivar numbers: shape (m,), as ``commands``
    :ivar steps: shape (m,), or (0,)
    :ivar proportional: shape (1,)
    :ivar sources: shape (n,), as ``still``
    :ivar commands: the present ones, which the law changes
    """

    numbers: IntArray
    steps: FloatArray
    proportional: BoolArray
    sources: IntArray
    still: FloatArray
    commands: FloatArray


class Grip(NamedTuple):
    """
    Goals of the setpoints of a gripper, which the law changes.

    :ivar goal: shape (n,)
    :ivar to_end: whether each was sent to the lower and the upper end of its range, and its finger
        is not there, shape (n, 2)
    :ivar pressing: whether its finger has stopped before that, shape (n,)
    :ivar pace: of setpoints, at most [1/s], shape (n,)
    :ivar stopped: where the fingers were when all had come to rest, as setpoints, shape (n,)
    :ivar flags: by :data:`MOVES` and those that follow it, shape (7,)
    :ivar action: that is taken again and again, in [-1, 1], shape (dof,)
    :ivar call: simulation time when it is taken next, and half a physics step [s], shape (2,)
    :ivar rule: its meaning, if the law takes it
    """

    goal: FloatArray
    to_end: BoolArray
    pressing: BoolArray
    pace: FloatArray
    stopped: FloatArray
    flags: NDArray[np.bool_]
    action: FloatArray
    call: FloatArray
    rule: Rule


class Gripper(NamedTuple):
    """
    A gripper.

    :ivar fingers: records of :data:`FINGER`, shape (n,)
    :ivar grip: where they go
    """

    fingers: NDArray[np.void]
    grip: Grip


@cache
def no_rule() -> Rule:
    """Return the rule of a gripper whose actions Python takes."""
    none, nobody = np.zeros(0), np.zeros(0, np.int64)
    return Rule(nobody, none, none > 0.0, nobody, none, none)


@cache
def no_gripper() -> Gripper:
    """Return a gripper without fingers, which does nothing."""
    none = np.zeros(0)
    return Gripper(readable(np.zeros(0, FINGER)), Grip(
        none, np.zeros((0, 2), np.bool_), none > 0.0, none, none, np.zeros(7, np.bool_), none,
        np.zeros(2), no_rule()))
