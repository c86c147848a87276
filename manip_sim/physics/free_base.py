# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Gravity compensation of robots with a free root, which have to carry their own weight.

MuJoCo compensates the weight of a body at all joints between it and the world, so also at the free
joint: the robot would float. Here the actuators of arms, torso and head carry what is mounted
beyond them, and the root and the legs carry that weight.
"""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from manip_sim.models.robots import RobotModel
from manip_sim.physics.physics import Physics

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
#: Subsystems with gravity compensation; what carries a robot, such as legs, has none.
_CARRIED = ('arm', 'torso', 'head')


def compensate_free_robots(spec: mujoco.MjSpec, robots: Iterable[RobotModel]) -> None:
    """
    Let actuators of robots with a free root carry what is mounted beyond them.

    :param spec: the ``mujoco.MjSpec`` of a world, changed in place; its model needs
        :class:`FreeRoots`
    :param robots: the robots in it
    """
    driven = {actuator.target for actuator in spec.actuators}
    for robot in robots:
        root = spec.body(robot.root_body)
        bodies = [root, *root.find_all(mujoco.mjtObj.mjOBJ_BODY)]
        if not any(int(joint.type) == _FREE for body in bodies for joint in body.joints):
            continue
        carried = {name for subsystem in _CARRIED for name in robot.joints_of(subsystem)} & driven
        for body in bodies:
            if any(joint.name in carried for joint in body.joints):
                for hanging in (body, *body.find_all(mujoco.mjtObj.mjOBJ_BODY)):
                    hanging.gravcomp = 1.0
                    for joint in hanging.joints:
                        joint.actgravcomp = True


class FreeRoots:
    """
    The weight of compensated links, given back to the joints of free robots that carry it.

    :param physics: of the world
    :param roots: names of the root bodies of the robots
    :ivar roots: the same; robots that come or go have to change it before the model is replaced
    :ivar is_needed: whether there is weight to give back
    """

    def __init__(self, physics: Physics, roots: Iterable[str]) -> None:
        self._physics, self.roots = physics, tuple(roots)
        physics.on_change(self._look_at_model)

    def _look_at_model(self) -> None:
        model, roots = self._physics.model, self.roots
        free_trees = {int(model.body_rootid[body]) for body in model.jnt_bodyid[
            model.jnt_type == _FREE]} & {int(model.body(root).id) for root in roots}
        joint = model.dof_jntid
        self._dofs = np.flatnonzero(
            np.isin(model.body_rootid[model.dof_bodyid], list(free_trees))
            & (model.jnt_actgravcomp[joint] == 0))
        self.is_needed = self._dofs.size > 0

    def apply(self) -> None:
        """Apply the weight as of the last ``mj_forward`` or step."""
        data = self._physics.data
        data.qfrc_applied[self._dofs] = -data.qfrc_gravcomp[self._dofs]
