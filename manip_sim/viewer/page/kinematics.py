# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Where the bodies of a model are, from the positions of joints and of free bodies."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
#: A node has one list of joints for each robot; another may send many.
_MAX_KNOWN = 100


class Kinematics:
    """
    The kinematics of a model.

    :ivar data: its ``mujoco.MjData``, current after :meth:`compute`
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self._scalar = {model.joint(i).name: int(model.jnt_qposadr[i]) for i in range(model.njnt)
                        if int(model.jnt_type[i]) in _SCALAR}
        self._free = {model.body(int(model.jnt_bodyid[i])).name: int(model.jnt_qposadr[i])
                      for i in range(model.njnt) if int(model.jnt_type[i]) == _FREE}
        self._known: dict[tuple[str, ...], tuple[list[int], list[int]]] = {}
        self.compute()

    @property
    def scalar_joints(self) -> list[str]:
        """The joints that :meth:`set_joints` takes."""
        return list(self._scalar)

    @property
    def free_bodies(self) -> list[str]:
        """The bodies that :meth:`place` takes."""
        return list(self._free)

    def set_joints(self, names: Sequence[str], positions: Sequence[float] | FloatArray
                   ) -> None:
        """
        Set the positions of scalar joints.

        :param names: those that the model does not have are ignored
        :param positions: [rad or m]
        """
        key = tuple(names)
        if key not in self._known:
            if len(self._known) >= _MAX_KNOWN:
                self._known.clear()
            rows = [i for i, name in enumerate(key) if name in self._scalar]
            self._known[key] = rows, [self._scalar[key[i]] for i in rows]
        rows, addresses = self._known[key]
        self.data.qpos[addresses] = np.asarray(positions, dtype=float)[rows]

    def place(self, body: str, position: FloatArray, quat_wxyz: FloatArray) -> None:
        """Set the pose of a free body in ``world`` [m]; other bodies are ignored."""
        address = self._free.get(body)
        if address is not None:
            self.data.qpos[address:address + 3] = position
            self.data.qpos[address + 3:address + 7] = quat_wxyz

    def compute(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)
