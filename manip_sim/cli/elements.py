# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Actuators, sensors, frames and cameras of a compiled model, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.quaternion import wxyz_to_xyzw
from manip_sim.models.robots import RobotModel

_TARGET = {
    int(mujoco.mjtTrn.mjTRN_JOINT): 'joint', int(mujoco.mjtTrn.mjTRN_JOINTINPARENT): 'joint',
    int(mujoco.mjtTrn.mjTRN_TENDON): 'tendon', int(mujoco.mjtTrn.mjTRN_SITE): 'site',
    int(mujoco.mjtTrn.mjTRN_SLIDERCRANK): 'site', int(mujoco.mjtTrn.mjTRN_BODY): 'body'}
Row = dict[str, Any]


def actuator_rows(model: mujoco.MjModel, part_of: Mapping[str, str]) -> list[Row]:
    """
    Return the actuators as the files define them.

    :param part_of: the part of each actuator that is wanted
    """
    rows = []
    for name, part in part_of.items():
        index = int(model.actuator(name).id)
        kind = _TARGET[int(model.actuator_trntype[index])]
        target = int(model.actuator_trnid[index, 0])
        rows.append({
            'name': name, 'part': part, 'type': _servo_type(model, index), 'drives': kind,
            'target': getattr(model, kind)(target).name,
            'control': _limits(model.actuator_ctrllimited, model.actuator_ctrlrange, index),
            'force': _limits(model.actuator_forcelimited, model.actuator_forcerange, index)})
    return rows


def _limits(limited: Any, ranges: Any, index: int) -> list[float] | None:
    return [float(value) for value in ranges[index]] if limited[index] else None


def _servo_type(model: mujoco.MjModel, index: int) -> str:
    fixed = int(model.actuator_gaintype[index]) == int(mujoco.mjtGain.mjGAIN_FIXED)
    bias = int(model.actuator_biastype[index])
    stiffness, damping = -model.actuator_biasprm[index, 1:3]
    if fixed and bias == int(mujoco.mjtBias.mjBIAS_AFFINE) and stiffness > 0.0:
        return 'position servo'
    if fixed and bias == int(mujoco.mjtBias.mjBIAS_AFFINE) and damping > 0.0:
        return 'velocity servo'
    return 'motor' if fixed and bias == int(mujoco.mjtBias.mjBIAS_NONE) else 'other'


def sensor_rows(model: mujoco.MjModel, robot: RobotModel) -> list[Row]:
    """Return the sensors of a robot and of all that is mounted on it."""
    rows = []
    for part in _parts(robot):
        for name in part.sensors:
            index = int(model.sensor(name).id)
            kind = int(model.sensor_objtype[index])
            element = int(model.sensor_objid[index])
            rows.append({
                'name': name,
                'type': mujoco.mjtSensor(int(model.sensor_type[index])).name[7:].lower(),
                'of': mujoco.mj_id2name(model, kind, element) if element >= 0 else None,
                'length': int(model.sensor_dim[index])})
    return rows


def frame_rows(model: mujoco.MjModel, data: mujoco.MjData, robot: RobotModel) -> list[Row]:
    """Return the bodies of a robot and the sites with a role, with their poses in ``world``."""
    rows = []
    below = np.zeros(model.nbody, dtype=bool)
    below[model.body(robot.root_body).id] = True
    for body in range(1, model.nbody):
        below[body] |= below[model.body_parentid[body]]
    for body in np.flatnonzero(below).tolist():
        rows.append({
            'name': model.body(body).name, 'kind': 'body',
            'parent': model.body(int(model.body_parentid[body])).name,
            'mass_kg': float(model.body_mass[body]),
            'position_m': data.xpos[body].tolist(),
            'quat_xyzw': wxyz_to_xyzw(data.xquat[body]).tolist()})
    for name in dict.fromkeys(site for part in _parts(robot) for site in _important(part)):
        site, quat = int(model.site(name).id), np.empty(4)
        mujoco.mju_mat2Quat(quat, data.site_xmat[site])
        rows.append({
            'name': name, 'kind': 'site',
            'parent': model.body(int(model.site_bodyid[site])).name, 'mass_kg': None,
            'position_m': data.site_xpos[site].tolist(),
            'quat_xyzw': wxyz_to_xyzw(quat).tolist()})
    return rows


def _important(part: MujocoXMLModel) -> list[str]:
    """Return the sites of a part that have a role, with the ``ft_frame`` of its sensors."""
    names = list(part.important_sites.values())
    frame = part.correct_naming('ft_frame')
    return [frame, *names] if frame in part.sites else names


def camera_rows(model: mujoco.MjModel) -> list[Row]:
    """Return the cameras of a model."""
    rows = []
    for camera in range(model.ncam):
        width, height = model.cam_resolution[camera].tolist()
        rows.append({
            'name': model.camera(camera).name,
            'body': model.body(int(model.cam_bodyid[camera])).name,
            'fovy_rad': float(np.radians(model.cam_fovy[camera])),
            # A camera without a resolution of its own has one of 1 x 1.
            'resolution': [width, height] if width > 1 and height > 1 else None})
    return rows


def _parts(robot: RobotModel) -> list[MujocoXMLModel]:
    return [robot, *robot.models]
