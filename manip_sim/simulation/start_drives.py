# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find joints that nothing drives, that several actuators drive, or whose actuator is too weak."""

from __future__ import annotations

from collections.abc import Iterator
import copy

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray
from manip_sim.models.mechanism import actuated_joints, moved_joints
from manip_sim.models.robots.subsystems import driven_joint
from manip_sim.models.setpoint_activation import position_servos
from manip_sim.physics.actuator_properties import effort_range
from manip_sim.quoting import quoted_names
from manip_sim.simulation.start_defect import StartDefect
from manip_sim.simulation.start_remedies import remedies_for

#: A force nearer to its limit than this fraction of it is at the limit.
_AT_LIMIT = 1e-6
#: Number of names that one sentence lists.
_LISTED = 8
_FREE, _HINGE = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_HINGE)
_BALL = int(mujoco.mjtJoint.mjJNT_BALL)
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)


def find_drive_defects(model: mujoco.MjModel, data: mujoco.MjData, of_robots: BoolArray,
                       urdf: tuple[str, ...] = ()) -> Iterator[StartDefect]:
    """
    Yield the defects of the actuators of robots.

    :param model: the compiled ``mujoco.MjModel``
    :param data: the ``mujoco.MjData`` at the start, after ``mj_forward``; only read
    :param of_robots: whether each body is of a robot, shape (nbody,)
    :param urdf: what the names of elements from URDF files begin with
    """
    joints = [joint for joint in np.flatnonzero(of_robots[model.jnt_bodyid]).tolist()
              if int(model.jnt_type[joint]) != _FREE]
    drivers = _drivers(model, joints)
    yield from _shared(model, drivers)
    yield from _undriven(model, joints, urdf)
    alone = {joint: actuators[0] for joint, actuators in drivers.items() if len(actuators) == 1
             and int(model.jnt_type[joint]) != _BALL}
    weak = list(_too_weak(model, data, alone, urdf))
    yield from (defect for _, defect in weak)
    yield from _at_full_force(model, data, set(joints), {joint for joint, _ in weak})


def _drivers(model: mujoco.MjModel, joints: list[int]) -> dict[int, list[int]]:
    """Return the actuators that act on each joint alone, not through a tendon or a site."""
    drivers: dict[int, list[int]] = {}
    for actuator in range(model.nu):
        driven = actuated_joints(model, actuator)
        if driven_joint(model, actuator) is not None and driven[0] in joints:
            drivers.setdefault(driven[0], []).append(actuator)
    return drivers


def _shared(model: mujoco.MjModel, drivers: dict[int, list[int]]) -> Iterator[StartDefect]:
    for joint, actuators in drivers.items():
        if len(actuators) > 1:
            names = [model.actuator(actuator).name for actuator in actuators]
            yield StartDefect(
                'actuators', f"joint '{model.joint(joint).name}' is driven by {len(names)} "
                f'actuators, {quoted_names(names)}',
                f'leave one of them in <actuator>: delete {quoted_names(names[1:])}')


def _undriven(model: mujoco.MjModel, joints: list[int], urdf: tuple[str, ...]
              ) -> Iterator[StartDefect]:
    moved = moved_joints(model)
    names = [model.joint(joint).name for joint in joints if joint not in moved]
    if names:
        is_single = len(names) == 1
        yield StartDefect(
            'undriven', f'{"joint" if is_single else "joints"} {quoted_names(names, _LISTED)} '
            f'{"has" if is_single else "have"} no actuator, and no spring or coupling to a joint '
            f'that has one: nothing holds {"it" if is_single else "them"}',
            remedies_for(names[0], urdf).drive(names))


def _too_weak(model: mujoco.MjModel, data: mujoco.MjData, drivers: dict[int, int],
              urdf: tuple[str, ...]) -> Iterator[tuple[int, StartDefect]]:
    """Yield the joints whose actuator cannot hold the start pose, and their defects."""
    if not drivers:
        return
    joints, actuators = np.array(list(drivers)), np.array(list(drivers.values()))
    dofs = model.jnt_dofadr[joints]
    at_rest = copy.copy(data)
    at_rest.qvel[:] = 0.0
    mujoco.mj_forward(model, at_rest)
    needed = at_rest.qfrc_bias[dofs] - at_rest.qfrc_passive[dofs]
    # Gravity compensation by the actuators counts against the force limit of the joint alone.
    beside = (model.jnt_actgravcomp[joints] != 0) & (model.jnt_actfrclimited[joints] == 0)
    needed -= np.where(beside, at_rest.qfrc_gravcomp[dofs], 0.0)
    limits = effort_range(model, joints, actuators)
    excess = np.maximum(limits[:, 0] - needed, needed - limits[:, 1])
    for index in np.flatnonzero(excess > _AT_LIMIT * np.abs(needed)).tolist():
        joint, limit = int(joints[index]), limits[index]
        effort, name = float(needed[index]), model.joint(joint).name
        there = limit[1] if effort > 0.0 else limit[0]
        unit = _unit(model, joint)
        enough, remedies = float(f'{1.1 * abs(effort):.2g}'), remedies_for(name, urdf)
        yield joint, StartDefect(
            'effort', f"joint '{name}' needs {effort:.4g} {unit} to keep its start pose, its "
            f"actuator '{model.actuator(int(actuators[index])).name}' has {there:.4g} {unit}",
            f'start where the joint carries less ({remedies.pose}), or {remedies.limit(enough)}')


def _at_full_force(model: mujoco.MjModel, data: mujoco.MjData, joints: set[int], reported: set[int]
                   ) -> Iterator[StartDefect]:
    """Yield the servos whose control is so far from the start that they exert their full force."""
    is_servo = (model.actuator_forcelimited != 0) & position_servos(model, np.arange(model.nu))
    for actuator in np.flatnonzero(is_servo).tolist():
        driven = actuated_joints(model, actuator)
        if not joints.intersection(driven) or reported.intersection(driven):
            continue
        force = float(data.actuator_force[actuator])
        limit = model.actuator_forcerange[actuator]
        if not (np.abs(limit - force) <= _AT_LIMIT * np.abs(limit)).any() or force == 0.0:
            continue
        name, unit = model.actuator(actuator).name, _unit(model, driven[0])
        there = _control_without_force(model, actuator, float(data.actuator_length[actuator]))
        yield StartDefect(
            'effort', f"actuator '{name}' starts with its full force of {force:.4g} {unit}: its "
            f'control is {float(data.ctrl[actuator]):.4g}'
            + ('' if there is None else f', at {there:.4g} it would exert none'),
            ('' if there is None else f'write {there:.4g} for it into ctrl of the keyframe, or ')
            + 'start the joint where the control holds it')


def _control_without_force(model: mujoco.MjModel, actuator: int, length: float) -> float | None:
    """Return the control in range at which a servo exerts no force at rest, or None."""
    if int(model.actuator_dyntype[actuator]) == _INTEGRATOR:
        return None
    constant, slope = model.actuator_biasprm[actuator, :2]
    control = float(-(constant + slope * length) / model.actuator_gainprm[actuator, 0])
    low, high = model.actuator_ctrlrange[actuator]
    limited = bool(model.actuator_ctrllimited[actuator])
    return control if not limited or low <= control <= high else None


def _unit(model: mujoco.MjModel, joint: int) -> str:
    return 'N m' if int(model.jnt_type[joint]) in (_HINGE, _BALL) else 'N'
