# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Load the compiled laws before a command needs them, and compile them if need be."""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.control.law.joint_records import (
    blank_state, PLAIN, readable, records, SERVO)
from manip_sim.control.law.kept import alone, note_that_all_are_kept
from manip_sim.control.law.leading import act
from manip_sim.control.law.loads import no_loads
from manip_sim.control.law.period import (
    renew, renew_actions, renew_grips, run_rows, SCRATCH)
from manip_sim.control.law.rows import Row
from manip_sim.control.law.servo_rates import find_efforts_beside, find_rates
from manip_sim.control.law.setpoint_changes import ramp_to, set_state, set_velocity
from manip_sim.control.law.setpoint_motion import advance
from manip_sim.control.law.stream_goals import take_alone
from manip_sim.control.law.stream_timing import wait, wait_in_worlds
from manip_sim.physics.physics import WorldArrays

#: RobotJoints of an arm that nobody sees.
_COUNT = 6
#: A world in which nothing happens, as no step is made in it.
_WORLD = """
<mujoco>
  <worldbody>
    <body><joint/><geom size="1"/><site/></body>
  </worldbody>
</mujoco>
"""


def load_laws() -> None:
    """Load or compile what a simulation calls, in any thread; another process may compile it."""
    if not PLAIN:
        with alone():
            _call_all()


def _call_all() -> None:
    """Call what a simulation calls, to no consequence."""
    none, one, places = np.zeros(_COUNT), np.ones(_COUNT), np.arange(_COUNT)
    nowhere = np.full((_COUNT, _COUNT), -1)
    model = mujoco.MjModel.from_xml_string(_WORLD)
    data = mujoco.MjData(model)
    world, joints = WorldArrays.of(data), records(blank_state(one))
    counts, nobody = np.zeros((2, _COUNT), np.int64), readable(np.zeros(0, SERVO))
    wait(joints, places, none, 0.01, 1.0, 0.0, False)
    wait_in_worlds(places[:0].copy(), places, np.zeros((0, _COUNT)), none, 1.0, 0.0, False)
    advance(joints, counts, 0.0, 1.0)
    find_efforts_beside(world, nobody, joints[:0], no_loads(), none, none)
    find_rates(world, nobody, nowhere, joints[:0], none, 1.0, none, none)
    take_alone(joints, 0.0)
    set_velocity(joints, places, none)
    ramp_to(joints, places, none, 0.1, one)
    set_state(joints, places, none, none)
    act(world.kinematics, 0, 1, 0, 1, none, none.copy(), np.eye(3))
    nowhere_yet, nobody_yet = np.zeros((0, 5), np.int64), places[:0].copy()
    run_rows(nobody_yet, nowhere_yet, nobody_yet, 1, Row(SCRATCH).address)
    renew(nowhere_yet, nobody_yet, nobody_yet, places, np.zeros((0, _COUNT)), 0.01, False)
    renew_actions(nowhere_yet, nobody_yet, nobody_yet, places, np.zeros((0, _COUNT)))
    renew_grips(nobody_yet, nobody_yet, 0, np.zeros((0, _COUNT)))
    note_that_all_are_kept()


if __name__ == '__main__':
    load_laws()
