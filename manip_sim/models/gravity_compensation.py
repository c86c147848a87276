# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Let actuators carry the weight of robots and of mounted parts, by MuJoCo's ``gravcomp``.

MuJoCo compensates the weight of a body at all joints between it and the world, so also at a free
joint: the robot would float. So the actuators of arms, torso and head of a robot with a free root
carry the parts beyond them, and the root and the legs carry that weight.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import mujoco

from manip_sim.models.robots import RobotModel

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
#: Subsystems with gravity compensation; what carries a robot, such as legs, has none.
_CARRIED = ('arm', 'torso', 'head')


def compensate_mounted_robots(spec: mujoco.MjSpec, robots: Iterable[RobotModel]) -> None:
    """
    Let actuators of robots without a free root carry their links, and parts mounted on them.

    :param spec: the ``mujoco.MjSpec`` of a world, changed in place
    :param robots: the robots in it
    """
    for _, bodies in _robots(spec, robots, free=False):
        for body in bodies:
            if body.gravcomp:  # Not the actuators carry it, but what the file stands for.
                continue
            body.gravcomp = 1.0
            for joint in body.joints:
                joint.actgravcomp = True


def compensate_free_robots(spec: mujoco.MjSpec, robots: Iterable[RobotModel]) -> None:
    """
    Let actuators of robots with a free root carry the parts beyond them.

    :param spec: the ``mujoco.MjSpec`` of a world, changed in place; its model needs
        ``FreeRoots`` in each step
    :param robots: the robots in it
    """
    driven = {actuator.target for actuator in spec.actuators}
    for robot, bodies in _robots(spec, robots, free=True):
        carried = {name for subsystem in _CARRIED for name in robot.joints_of(subsystem)} & driven
        for body in bodies:
            if any(joint.name in carried for joint in body.joints):
                for hanging in (body, *body.find_all(mujoco.mjtObj.mjOBJ_BODY)):
                    hanging.gravcomp = 1.0
                    for joint in hanging.joints:
                        joint.actgravcomp = True


def _robots(spec: mujoco.MjSpec, robots: Iterable[RobotModel], free: bool
            ) -> Iterator[tuple[RobotModel, list[mujoco.MjsBody]]]:
    """Yield robots with a free root, or without, and all bodies below their roots."""
    for robot in robots:
        root = spec.body(robot.root_body)
        # Also bodies that composing added.
        bodies = [root, *root.find_all(mujoco.mjtObj.mjOBJ_BODY)]
        if any(int(joint.type) == _FREE for body in bodies for joint in body.joints) == free:
            yield robot, bodies
