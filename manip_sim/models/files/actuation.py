# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""One actuator for each joint of a robot from a file, and guesses of its effort."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.actuators import JOINT_TRANSMISSIONS, position_servos
from manip_sim.models.files.body_tree import BodyTree
from manip_sim.models.files.urdf import greatest_weight
from manip_sim.quoting import pluralize, quoted_names

#: Acceleration that a joint shall give its load beside the weight [rad/s^2 or m/s^2].
_ACCELERATION = 5.0
#: Share of a guessed limit that the weight and that acceleration need in the worst pose.
_SHARE = 0.5
#: Number of names that one sentence lists.
_LISTED = 8


def report_efforts(model: mujoco.MjModel, qpos: FloatArray) -> list[str]:
    """Return which joints cannot hold a pose by their effort limits, and the remedy, in words."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    limited = np.flatnonzero(model.jnt_actfrclimited)
    dofs = model.jnt_dofadr[limited]
    needed = np.abs(data.qfrc_bias - data.qfrc_passive)[dofs]
    weak = limited[needed > np.abs(model.jnt_actfrcrange[limited]).max(axis=1)]
    if not len(weak):
        return []
    names = quoted_names([str(model.joint(joint).name) for joint in weak], _LISTED)
    return [f'the effort limits of {pluralize(len(weak), "joint")} cannot hold the start pose: '
            f'{names}; if they are placeholders, efforts: guess in a YAML file replaces those '
            'that are too low']


def guess_efforts(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[str]:
    """
    Replace effort limits that cannot carry the links in some pose, and accelerate them a little.

    :param model: the spec, compiled
    :returns: which limits, in a sentence
    """
    limited = np.flatnonzero(model.jnt_actfrclimited)
    dofs = model.jnt_dofadr[limited]
    needed = greatest_weight(model)[dofs] + _ACCELERATION * model.dof_M0[dofs]
    replaced = []
    for joint, effort in zip(limited.tolist(), needed.tolist()):
        if effort > np.abs(model.jnt_actfrcrange[joint]).max():
            name = str(model.joint(joint).name)
            element: Any = spec.joint(name)
            limit = float(f'{effort / _SHARE:.2g}')
            before, element.actfrcrange = element.actfrcrange[1], [-limit, limit]
            replaced.append(f'{name} {before:g} to {limit:g}')
    return [f'effort limits are guesses where the file has less than the links weigh [N m or N]: '
            f'{", ".join(replaced)}'] if replaced else []


_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
#: Lag of an added servo [s]: damping over stiffness.
_LAG_S = 0.013
#: Acceleration that no robot's motor gives its own joint [rad/s^2 or m/s^2].
_ABSURD_ACCELERATION = 5000.0
#: A servo is stable at its force limit if its inertia over the damping is more than this [s].
_DAMPED_S = 0.002 / 1.5
#: Joints with a servo are not changed unless they are too light by more than this factor.
_MUCH_TOO_LIGHT = 4.0
#: Rotor inertia of an added servo [kg m^2 or kg]: this much per force, within limits.
_ARMATURE_PER_FORCE, _ARMATURE = 0.01, (0.001, 0.1)


def own_each_joint(spec: mujoco.MjSpec, tree: BodyTree, actuators: Collection[int]
                   ) -> tuple[set[str], list[str]]:
    """
    Leave each joint at most one actuator, a motor or a servo.

    An actuator of a fixed tendon over joints that equality constraints couple drives one of these
    joints instead. Of several on one joint a position servo is kept. An actuator that is neither
    motor nor servo of a joint is kept, but of no part. Too light joints get rotor inertia.

    :param actuators: ids of the actuators, except in hands
    :returns: names of the actuators that are of no part, and a sentence for each change
    """
    model, notes = tree.model, []
    others: set[str] = set()
    owner: dict[int, int] = {}
    for actuator in sorted(actuators, key=lambda a: not (
            _is_usable(model, a) and position_servos(model, a))):
        name = str(model.actuator(actuator).name)
        joint = _driven_joint(tree, actuator)
        if joint is None and int(model.actuator_trntype[actuator]) == _TENDON:
            joint = _drive_leader(spec, tree, actuator)
            if joint is not None:
                notes.append(f"actuator '{name}' drives joint '{model.joint(joint).name}' and "
                             'those that are tied to it, not their tendon')
        if joint is None or not _is_usable(model, actuator):
            others.add(name)
        elif joint in owner:
            spec.delete(spec.actuator(name))
            notes.append(f"actuator '{name}' is left out: joint '{model.joint(joint).name}' has "
                         f"'{model.actuator(owner[joint]).name}'")
        else:
            owner[joint] = actuator
    notes += _give_rotors(spec, model, owner)
    if others:
        notes.append(f"neither motors nor servos of one joint: actuators "
                     f"{', '.join(sorted(others))}; 'actuators/command' moves them")
    return others, notes


def _give_rotors(spec: mujoco.MjSpec, model: mujoco.MjModel, owner: Mapping[int, int]
                 ) -> list[str]:
    """Give rotor inertia to joints that have none and are too light for their motor or servo."""
    light = []
    for joint, actuator in owner.items():
        dof = int(model.jnt_dofadr[joint])
        bias, gear = model.actuator_biasprm[actuator, :3], model.actuator_gear[actuator, 0]
        if int(model.actuator_biastype[actuator]) == _AFFINE and bias.any():
            # Otherwise such a servo would have to be softened to be stable at its force limit.
            needed, times = _DAMPED_S * max(-bias[2], 0.0) * gear**2, _MUCH_TOO_LIGHT
        else:
            needed = _greatest_force(model, joint, actuator) / _ABSURD_ACCELERATION
            times = 1.0
        rotor = min(needed, _ARMATURE[1])
        if not model.dof_armature[dof] and rotor > times * model.dof_M0[dof]:
            spec.joint(model.joint(joint).name).armature = rotor
            light.append(str(model.joint(joint).name))
    return [f'rotor inertia added to joints that have none and are too light for their actuators: '
            f'{", ".join(light)}'] if light else []


def _greatest_force(model: mujoco.MjModel, joint: int, actuator: int) -> float:
    gear, gain = abs(model.actuator_gear[actuator, 0]), abs(model.actuator_gainprm[actuator, 0])
    limits = [np.inf]
    if model.actuator_forcelimited[actuator]:
        limits.append(gear * np.abs(model.actuator_forcerange[actuator]).max())
    if model.actuator_ctrllimited[actuator]:
        limits.append(gear * gain * np.abs(model.actuator_ctrlrange[actuator]).max())
    if model.jnt_actfrclimited[joint]:
        limits.append(np.abs(model.jnt_actfrcrange[joint]).max())
    return float(min(limits))


def _is_usable(model: mujoco.MjModel, actuator: int) -> bool:
    biases = (int(mujoco.mjtBias.mjBIAS_NONE), _AFFINE)
    return (int(model.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED)
            and int(model.actuator_plugin[actuator]) < 0
            and int(model.actuator_biastype[actuator]) in biases)


def _driven_joint(tree: BodyTree, actuator: int) -> int | None:
    if int(tree.model.actuator_trntype[actuator]) not in JOINT_TRANSMISSIONS:
        return None
    (joint,) = tree.driven(actuator)
    return joint if tree.is_scalar(joint) else None


def _drive_leader(spec: mujoco.MjSpec, tree: BodyTree, actuator: int) -> int | None:
    """Make an actuator drive a joint that determines its tendon's length; return the joint."""
    model = tree.model
    tendon = int(model.actuator_trnid[actuator, 0])
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    if any(int(model.wrap_type[w]) != int(mujoco.mjtWrap.mjWRAP_JOINT) for w in wraps):
        return None
    coefficients = {int(model.wrap_objid[w]): float(model.wrap_prm[w]) for w in wraps}
    for leader in coefficients:
        ratios = _ratios(model, leader)
        length = sum(coefficient * ratios[joint] for joint, coefficient in coefficients.items()
                     if joint in ratios)
        if set(coefficients) <= set(ratios) and length:
            element = spec.actuator(model.actuator(actuator).name)
            element.trntype = mujoco.mjtTrn.mjTRN_JOINT
            element.target = str(model.joint(leader).name)
            element.gear[0] *= length
            return leader
    return None


def _ratios(model: mujoco.MjModel, leader: int) -> dict[int, float]:
    """Return the velocity ratios of joints that are coupled to one linearly, itself included."""
    ratios, waiting = {leader: 1.0}, [leader]
    ties = np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT))
    while waiting:
        joint = waiting.pop()
        for tie in ties:
            follower, other = int(model.eq_obj1id[tie]), int(model.eq_obj2id[tie])
            constant = not model.eq_data[tie, 2:5].any() and model.eq_data[tie, 1]
            if not constant:
                continue
            for driver, another, ratio in ((other, follower, model.eq_data[tie, 1]),
                                           (follower, other, 1.0 / model.eq_data[tie, 1])):
                if driver == joint and another >= 0 and another not in ratios:
                    ratios[another] = ratios[joint] * float(ratio)
                    waiting.append(another)
    return ratios


def add_servos(spec: mujoco.MjSpec, tree: BodyTree) -> list[str]:
    """
    Add position servos to the joints of a model that has no actuators.

    Their force limits are the joints' limits. Of two joints that an equality constraint couples,
    the dependent one gets no servo.

    :returns: the changes, in sentences
    """
    model = tree.model
    followers = tree.followers()
    driven = [j for j in range(model.njnt) if tree.is_scalar(j) and j not in followers]
    for joint in driven:
        element = spec.joint(model.joint(joint).name)
        force = float(np.abs(model.jnt_actfrcrange[joint]).max()) if (
            model.jnt_actfrclimited[joint]) else 0.0
        if not model.dof_armature[model.jnt_dofadr[joint]]:
            element.armature = float(np.clip(force * _ARMATURE_PER_FORCE, *_ARMATURE)
                                     if force else 0.1 * _ARMATURE[1])
        inertia = model.dof_M0[model.jnt_dofadr[joint]] + element.armature
        stiffness = 4.0 * inertia / _LAG_S**2
        servo = spec.add_actuator(name=element.name, target=element.name,
                                  trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=stiffness, kv=stiffness * _LAG_S)
        if model.jnt_limited[joint]:
            servo.ctrlrange, servo.ctrllimited = model.jnt_range[joint], 1
        if force:
            servo.forcerange, servo.forcelimited = model.jnt_actfrcrange[joint], 1
    return [f'position servos on {pluralize(len(driven), "joint")}, with rotor inertia where '
            'there is none, because the file has no actuators'] if driven else []
