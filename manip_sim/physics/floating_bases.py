# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The weight of compensated links, which robots with a free root have to carry themselves."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from manip_sim.arrays import IntArray
from manip_sim.physics.physics import Physics

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class FloatingBases:
    """
    The weight of compensated links, given back to the joints of free robots that carry it.

    :param physics: of the world
    :param roots: names of the root bodies of the robots
    :ivar roots: the same; robots that come or go have to change it before the model is replaced
    :ivar dofs: degrees of freedom with weight to give back, shape (k,)
    """

    dofs: IntArray

    def __init__(self, physics: Physics, roots: Iterable[str]) -> None:
        self._physics, self.roots = physics, tuple(roots)
        physics.on_change(self._rebind)

    def _rebind(self) -> None:
        model, roots = self._physics.model, self.roots
        free_trees = {int(model.body_rootid[body]) for body in model.jnt_bodyid[
            model.jnt_type == _FREE]} & {int(model.body(root).id) for root in roots}
        joint = model.dof_jntid
        self.dofs = np.flatnonzero(
            np.isin(model.body_rootid[model.dof_bodyid], list(free_trees))
            & (model.jnt_actgravcomp[joint] == 0))

    def apply(self) -> None:
        """Apply the weight as of the last ``mj_forward`` or step."""
        data = self._physics.data
        data.qfrc_applied[self.dofs] = -data.qfrc_gravcomp[self.dofs]
