# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The look of a simulation at an instant: copied quickly, and shown later in any thread."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.cameras import camera_names
from manip_sim.physics.object_spawning import compile_visual, WorldPlan
from manip_sim.simulation.episode_start import apply_to_model, Sample
from manip_sim.simulation.simulation import Simulation


@dataclass(frozen=True, eq=False)
class Snapshot:
    """
    The visible state of a world at one instant; copies.

    :ivar plan: what the world is compiled from
    :ivar time_ns: simulation time [ns]
    :ivar qpos: positions, shape (nq,)
    :ivar mocap_pos: of mocap bodies [m], shape (nmocap, 3)
    :ivar mocap_quat: of mocap bodies, as w, x, y, z, shape (nmocap, 4)
    :ivar drawn: what differs from the plan in this episode, by name
    """

    plan: WorldPlan
    time_ns: int
    qpos: FloatArray
    mocap_pos: FloatArray
    mocap_quat: FloatArray
    drawn: Sample

    def shows_the_same_as(self, other: Snapshot) -> bool:
        """Return whether another one is of the same instant and the same state."""
        return (self.time_ns == other.time_ns and self.plan is other.plan
                and self.drawn is other.drawn
                and np.array_equal(self.qpos, other.qpos)
                and np.array_equal(self.mocap_pos, other.mocap_pos)
                and np.array_equal(self.mocap_quat, other.mocap_quat))


def take_snapshot(simulation: Simulation) -> Snapshot:
    """Copy the visible state at present; call it where the simulation may be used."""
    data = simulation.data
    return Snapshot(simulation.plan, simulation.time_ns, data.qpos.copy(), data.mocap_pos.copy(),
                    data.mocap_quat.copy(), simulation.randomized.drawn)


class VisibleWorld:
    """
    A world with its visual geoms, in the state of a snapshot; nothing moves by itself.

    :param plan: what it is compiled from
    :ivar plan: the same
    :ivar model: its own ``mujoco.MjModel``
    :ivar cameras: names of its cameras
    :ivar data: the ``mujoco.MjData``: positions of bodies, geoms, lights and cameras
    :raises ModelError: with MuJoCo's message, if MuJoCo cannot compile it
    """

    def __init__(self, plan: WorldPlan) -> None:
        self.plan = plan
        self.model: Any = compile_visual(plan)
        self.data: Any = mujoco.MjData(self.model)
        self.cameras = camera_names(self.model)
        self._drawn: Sample = {}
        self._nominal = self.model

    def show(self, snapshot: Snapshot) -> None:
        """
        Show the state of a snapshot.

        :param snapshot: of the same plan
        """
        model, data = self.model, self.data
        if snapshot.drawn is not self._drawn and (snapshot.drawn or self._drawn):
            if self._nominal is model:
                self._nominal = copy.copy(model)
            apply_to_model(model, self._nominal, snapshot.drawn, self._drawn)
            self._drawn = snapshot.drawn
        data.qpos[:] = snapshot.qpos
        data.mocap_pos[:] = snapshot.mocap_pos
        data.mocap_quat[:] = snapshot.mocap_quat
        # Velocities, contacts and forces are not computed, as they are not visible.
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        mujoco.mj_flex(model, data)
        mujoco.mj_tendon(model, data)
