# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Load the compiled laws before a command needs them, and compile them if need be."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import logging
import threading
import time

import mujoco
import numpy as np

from manip_sim.control.law.compiling import Row
from manip_sim.control.law.kept import all_are_kept, alone, note_that_all_are_kept
from manip_sim.control.law.leading import act
from manip_sim.control.law.loads import no_loads
from manip_sim.control.law.period import renew, renew_actions, renew_grips, run_rows, SCRATCH
from manip_sim.control.law.records import blank_state, PLAIN, readable, records, SERVO
from manip_sim.control.law.servo_rates import find_efforts_beside, find_rates
from manip_sim.control.law.setpoint_motion import advance, ramp_to, set_state, set_velocity
from manip_sim.control.law.streams import take_alone, wait
from manip_sim.physics.physics import WorldArrays

_LOGGER = logging.getLogger(__name__)
#: Time between two reports of a compilation that goes on [s].
_REPORT_S = 15.0
#: Joints of an arm that nobody sees.
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
    if PLAIN:
        return
    with contextlib.nullcontext() if all_are_kept() else _reports(), alone():
        _call_all()


@contextlib.contextmanager
def _reports() -> Iterator[None]:
    """Log how long a compilation has been going on, again and again."""
    begin_s, ended = time.monotonic(), threading.Event()

    def report() -> None:
        while not ended.wait(_REPORT_S):
            _LOGGER.warning('Control laws are still being compiled, for %.0f s now',
                            time.monotonic() - begin_s)

    thread = threading.Thread(target=report, name='reports', daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _call_all() -> None:
    """Call what a simulation calls, to no consequence."""
    none, one, places = np.zeros(_COUNT), np.ones(_COUNT), np.arange(_COUNT)
    nowhere = np.full((_COUNT, _COUNT), -1)
    model = mujoco.MjModel.from_xml_string(_WORLD)
    data = mujoco.MjData(model)
    world, joints = WorldArrays.of(data), records(blank_state(one))
    counts, nobody = np.zeros((2, _COUNT), np.int64), readable(np.zeros(0, SERVO))
    wait(joints, places, none, 0.01, 1.0, 0.0, False)
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
