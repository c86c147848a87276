# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The actuators of a gripper, and where their setpoints go, as the compiled law takes them."""

from __future__ import annotations

from typing import NamedTuple

from manip_sim.arrays import BoolArray, FloatArray, IntArray


class Fingers(NamedTuple):
    """
    The actuators of a gripper.

    :ivar ids: of the actuators, shape (n,)
    :ivar activations: their addresses in ``act``, where they integrate, shape (n,)
    :ivar is_servo: whether an actuator has a setpoint, shape (n,)
    :ivar integrates: whether its control is the rate of its setpoint, shape (n,)
    :ivar gain: of servos, 1 elsewhere, shape (n,)
    :ivar bias: of servos, constant and per length, zero elsewhere, shape (n, 2)
    :ivar low: lowest setpoints, shape (n,)
    :ivar high: highest setpoints, shape (n,)
    :ivar speeds: of setpoints, at most [1/s], shape (n,)
    :ivar overtravel: how far they are below and above the place at full force, shape (n, 2)
    :ivar reach: the same with the present limits of force, shape (n, 2)
    :ivar tolerance: setpoints that differ by less are the same, shape (n,)
    :ivar pair: whether they are two independent fingers that close on each other
    """

    ids: IntArray
    activations: IntArray
    is_servo: BoolArray
    integrates: BoolArray
    gain: FloatArray
    bias: FloatArray
    low: FloatArray
    high: FloatArray
    speeds: FloatArray
    overtravel: FloatArray
    reach: FloatArray
    tolerance: FloatArray
    pair: bool


class Grip(NamedTuple):
    """
    Where the setpoints of a gripper go; the law changes the second and the third.

    :ivar goal: shape (n,)
    :ivar to_end: whether each was sent to the lower and the upper end of its range, and its finger
        is not there, shape (n, 2)
    :ivar pressing: whether its finger has stopped before that, shape (n,)
    :ivar pace: of setpoints, at most [1/s], shape (n,)
    """

    goal: FloatArray
    to_end: BoolArray
    pressing: BoolArray
    pace: FloatArray
