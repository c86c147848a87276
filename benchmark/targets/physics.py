# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The bare physics: what MuJoCo alone does with the model that the node steps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import time

import mujoco
import numpy as np

from manip_sim.models import compose
from manip_sim.simulation import Simulation

#: The parts of a state from which MuJoCo goes on from an instant.
STATE = mujoco.mjtState.mjSTATE_INTEGRATION


def panda(timestep_s: float = 0.001) -> Simulation:
    """Return the world that the rows with the node use, as the node builds it."""
    simulation = Simulation(compose('Panda', timestep_s=timestep_s))
    simulation.advance(1)
    return simulation


class Bare:
    """
    MuJoCo's own data of the model of a simulation, at the state of that simulation.

    :param simulation: whose model is used
    """

    def __init__(self, simulation: Simulation) -> None:
        self.model = simulation.model
        self.data = mujoco.MjData(self.model)
        for field in ('qpos', 'qvel', 'act', 'ctrl'):
            getattr(self.data, field)[:] = getattr(simulation.data, field)
        mujoco.mj_forward(self.model, self.data)

    def make_motor(self, joint: str) -> None:
        """Let the control of a joint be its effort, as of the node in the mode ``effort``."""
        actuator = int(np.flatnonzero(
            self.model.actuator_trnid[:, 0] == self.model.joint(joint).id)[0])
        self.model.actuator_dyntype[actuator] = mujoco.mjtDyn.mjDYN_NONE
        self.model.actuator_actadr[actuator], self.model.actuator_actnum[actuator] = -1, 0
        self.model.actuator_gainprm[actuator] = np.eye(1, mujoco.mjNGAIN)
        self.model.actuator_biasprm[actuator] = 0.0

    def save(self, folder: Path) -> str:
        """Write model and state for the loops; return the path of the model."""
        path = folder / 'model.mjb'
        mujoco.mj_saveModel(self.model, str(path), None)
        state = np.zeros(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, self.data, state, STATE)
        state.tofile(path.with_suffix('.state'))
        return str(path)

    def steps_per_s(self, duration_s: float, steps: int,
                    clock: Callable[[], float] = time.perf_counter) -> float:
        """
        Step for a while.

        :param duration_s: how long [s]
        :param steps: of each call of ``mj_step``
        :param clock: ``time.thread_time`` where nothing else is measured beside it
        """
        model, data, done = self.model, self.data, 0
        begin = clock()
        while (now := clock()) - begin < duration_s:
            for _ in range(50):
                mujoco.mj_step(model, data, steps)
            done += 50 * steps
        return done / (now - begin)
