# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What the catalogue tests share: the shipped names, robosuite's figures, robots at rest.

The figures of ``test/data`` are those of robosuite 1.5.2 and of datasheets, never our own output.
"""

from __future__ import annotations

from functools import cache
import json
from pathlib import Path

import mujoco
import numpy as np

from manip_sim.models import bases, compose, compose_robot, grippers, robots

DATA = Path(__file__).resolve().parent.parent / 'data'


def shipped(module, names):
    """Return the names whose classes are part of the package, not of another test."""
    return [name for name in names if getattr(module, name).__module__.startswith('manip_sim.')]


ROBOTS = shipped(robots, robots.robot_names())
GRIPPERS = shipped(grippers, grippers.gripper_names())
BASES = shipped(bases, bases.base_names())


@cache
def figures(file):
    """Return a file of ``test/data``, such as ``robots/Panda.json``."""
    return json.loads((DATA / file).read_text())


def robots_with_figures():
    """Return the shipped robots that robosuite has too."""
    return [name for name in ROBOTS if (DATA / 'robots' / f'{name}.json').is_file()]


def equipped(name, base='default', gripper='default'):
    """Return a new robot on a base and with grippers on all arms."""
    return compose_robot(name, gripper, base)


class AtRest:
    """
    A robot with its default base and grippers in an arena, where its joints start.

    :ivar model: the ``mujoco.MjModel``
    :ivar data: its ``mujoco.MjData``; the servos hold the pose
    """

    def __init__(self, name, arena='empty'):
        self.world = compose(name, arena=arena)
        (self.robot,) = self.world.robots
        self.model = self.world.compile()
        self.data = mujoco.MjData(self.model)
        for joint, position in self.world.init_qpos().items():
            self.data.joint(joint).qpos = position
        self.data.ctrl[:] = holding_ctrl(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)

    def joint_ids(self, names):
        """Return the ids of joints."""
        return np.array([self.model.joint(name).id for name in names], dtype=int)


def is_position_servo(model):
    """Tell which actuators hold a position, shape (nu,)."""
    return model.actuator_biasprm[:, 1] < 0.0


def holding_ctrl(model, data):
    """Return the commands with which position servos hold the joints where they are."""
    ctrl = np.zeros(model.nu)
    for actuator in np.flatnonzero(is_position_servo(model)):
        ctrl[actuator] = data.qpos[model.jnt_qposadr[model.actuator_trnid[actuator, 0]]]
    low, high = model.actuator_ctrlrange.T
    limited = model.actuator_ctrllimited.astype(bool)
    return np.where(limited, np.clip(ctrl, low, high), ctrl)


def warnings_of(data):
    """Return the names of the warnings that MuJoCo has raised."""
    return [warning.name for warning in mujoco.mjtWarning.__members__.values()
            if warning.name != 'mjNWARNING' and data.warning[int(warning)].number]


def support(model, geom, direction):
    """
    Return how far a primitive shape reaches along a direction of its body's frame [m].

    :param geom: id of a box, sphere, capsule, cylinder or ellipsoid
    :param direction: unit vector in the frame of the geom's body, shape (3,)
    """
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    local = rotation.reshape(3, 3).T @ direction
    size = model.geom_size[geom]
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name
    reach = {
        'mjGEOM_BOX': lambda: np.abs(local) @ size,
        'mjGEOM_SPHERE': lambda: size[0],
        'mjGEOM_CAPSULE': lambda: size[0] + abs(local[2]) * size[1],
        'mjGEOM_CYLINDER': lambda: size[0] * np.hypot(*local[:2]) + abs(local[2]) * size[1],
        'mjGEOM_ELLIPSOID': lambda: np.linalg.norm(local * size),
    }[kind]()
    return float(model.geom_pos[geom] @ direction + reach)


def colliding_geoms(model):
    """Return the ids of the geoms that can collide."""
    return np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
