# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Load the compiled laws before a command needs them, and compile them if need be."""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.control.law.approach import approach, follow_twist
from manip_sim.control.law.arm_records import Arm, ArmMotion, Goal, Motion, Spring, Velocities
from manip_sim.control.law.compiling import PLAIN
from manip_sim.control.law.finger_records import Fingers, Grip
from manip_sim.control.law.gripping import move_fingers
from manip_sim.control.law.joint_records import blank_state, Drives, records
from manip_sim.control.law.kept import note_that_all_are_kept
from manip_sim.control.law.operational_space import exert
from manip_sim.control.law.servo_rates import drive, find_rates
from manip_sim.control.law.setpoint_changes import place, ramp_to, set_velocity
from manip_sim.control.law.setpoint_motion import advance, advance_rows
from manip_sim.control.law.stepping import (
    addresses, may_step, notes_of, step_and_exert, step_as_planned)
from manip_sim.control.law.stream_goals import take_alone
from manip_sim.control.law.stream_timing import wait
from manip_sim.physics.physics import WorldArrays

#: Joints of an arm that nobody sees.
_COUNT = 6


def load_laws() -> None:
    """Load or compile what a simulation calls, in calls of no consequence; in any thread."""
    none, one, places = np.zeros(_COUNT), np.ones(_COUNT), np.arange(_COUNT)
    nowhere, no = np.full((_COUNT, _COUNT), -1), none > 0.0
    world = WorldArrays(none, none, none, none, none, np.zeros((_COUNT, 6)), np.zeros((1, 3)),
                        none.copy(), none.copy())
    state, ahead = blank_state(one), np.zeros((1, *blank_state(one).shape))
    joints, states, ends_s = records(state), records(ahead), np.ones(1)
    wait(joints, places, none, 0.01, 1.0, 0.0, False)
    advance(joints, states, 0.0, ends_s)
    advance_rows(joints[None], states[None], np.zeros(1), ends_s)
    drives = Drives(places, places, places, places, nowhere, one, one, one, none, no, no, one, one)
    drive(world, drives, joints, states, ends_s, np.empty((1, _COUNT)))
    find_rates(world, drives, joints, 1.0, one.copy(), none.copy())
    take_alone(joints, 0.0)
    set_velocity(joints, places, none)
    ramp_to(joints, places, none, 0.1, one)
    place(joints, places, none, none, none)
    jacobian, result = np.eye(_COUNT), Velocities.of(_COUNT)
    motion = ArmMotion(none, none, -one, one, one, one, none, none)
    approach(jacobian, none, motion, 0.1, 1.0, 1.0, none, none, False, 0.0, False, result)
    follow_twist(jacobian, none, motion, 0.1, False, result)
    arm = Arm(places, places, places, ~no, nowhere, -one, one, one, -one, one, none, none, 0)
    goal = Goal(np.zeros(3), np.eye(3), np.zeros(3), np.eye(3), none)
    spring = Spring(1.0, 1.0, 1.0, 1.0)
    exert(world, arm, np.zeros(3), np.eye(3), goal, none, spring, False, Motion.of(_COUNT))
    ends = np.zeros((_COUNT, 2))
    fingers = Fingers(places, places, no, no, one, ends, none, one, one, ends, ends, one, False)
    move_fingers(none, none, none, none.copy(), fingers,
                 Grip(none, ends > 0.0, no.copy(), none), False, 0.1)
    model = mujoco.MjModel.from_xml_string('<mujoco/>')
    data = mujoco.MjData(model)
    if may_step(data):  # In no step, so that nothing of this is used.
        notes, intervals = notes_of(data, np.zeros((0, 3), np.int64), 1), places[:0].copy()
        step_and_exert(*addresses(model, data), intervals, world, arm, np.zeros(3),
                       np.eye(3), goal, none, spring, False, Motion.of(_COUNT), places, one, notes)
        step_as_planned(*addresses(model, data), False, intervals, none, places,
                        np.zeros((1, _COUNT)), notes)
    if not PLAIN:
        note_that_all_are_kept()


if __name__ == '__main__':
    load_laws()
