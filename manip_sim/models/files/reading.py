# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read a robot, hand or base from a third-party file: one tree, named, with a start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.errors import UnknownNameError
from manip_sim.models.files.actuation import add_servos
from manip_sim.models.files.posing import choose_pose
from manip_sim.models.files.scenery import single_tree
from manip_sim.models.files.tree import BodyTree
from manip_sim.models.files.urdf import is_urdf, load_urdf
from manip_sim.models.loading import compile_spec, load_spec, name_unnamed_elements

_MIN_MASS_KG, _MIN_INERTIA = 1e-6, 1e-9
#: A free robot that starts farther below the floor than this is raised to it [m].
_BELOW_FLOOR_M = 0.05


@dataclass
class ModelFile:
    """
    A robot, hand or base as read from a file.

    :ivar file: where it was read from
    :ivar spec: the ``mujoco.MjSpec`` with one root body and no keyframes
    :ivar tree: of the compiled model as it was in the file
    :ivar start: where scalar joints start, by name [rad or m]
    :ivar inferred: what was inferred or left out, in sentences
    """

    file: Path
    spec: mujoco.MjSpec
    tree: BodyTree
    start: dict[str, float]
    inferred: list[str] = field(default_factory=list)


def read_model(file: Path, keyframes: Sequence[str] = ('home',), wanted: str | None = None,
               servos: bool = True) -> ModelFile:
    """
    Read a robot, hand or base.

    :param keyframes: the first of these that exists is the start, else the only keyframe of the
        file, else what :func:`choose_pose` returns
    :param wanted: a keyframe to take instead
    :param servos: give joints position servos if the file has no actuators
    :raises ModelError: if the file cannot be read, does not compile or is not one tree of bodies
    :raises UnknownNameError: if it lacks the keyframe in ``wanted``
    """
    spec, notes = load_urdf(file) if is_urdf(file) else (load_spec(file), [])
    name_unnamed_elements(spec)
    model = compile_alone(spec, str(file))
    key = _choose_key(model, keyframes, wanted, file)
    if key is None:
        qpos, why = choose_pose(model)
        notes += why
    else:
        qpos = model.key_qpos[key]
        notes += [f"start pose: keyframe '{model.key(key).name}'"] if wanted is None else []
    start = _start_of(model, qpos)
    notes += _place_root(spec, model, qpos)
    for old in list(spec.keys):
        spec.delete(old)
    if servos and not model.nu and start:
        notes += add_servos(spec, BodyTree(model))
        model = compile_alone(spec, str(file))
    # Sizes for the file's model alone; MuJoCo would warn in composing if those of parts differ.
    spec.njmax, spec.nconmax, spec.nkey = -1, -1, 0
    spec, changes = single_tree(spec, model, file)
    return ModelFile(file, spec, BodyTree(model), start, [*notes, *changes])


def compile_alone(spec: mujoco.MjSpec, name: str) -> Any:
    """
    Compile a part that may have no mass of its own.

    :returns: a new ``mujoco.MjModel``
    :raises ModelError: with MuJoCo's message
    """
    compiler = spec.compiler
    bounds = compiler.boundmass, compiler.boundinertia
    compiler.boundmass, compiler.boundinertia = _MIN_MASS_KG, _MIN_INERTIA
    try:
        return compile_spec(spec, name)
    finally:
        compiler.boundmass, compiler.boundinertia = bounds


def _choose_key(model: mujoco.MjModel, preferred: Sequence[str], wanted: str | None, file: Path
                ) -> int | None:
    names = [str(model.key(i).name) for i in range(model.nkey)]
    if wanted is not None:
        if wanted not in names:
            raise UnknownNameError(f'keyframe of {file}', wanted, names)
        return names.index(wanted)
    for name in preferred:
        if name in names:
            return names.index(name)
    return 0 if len(names) == 1 else None


def _start_of(model: mujoco.MjModel, qpos: FloatArray) -> dict[str, float]:
    """Return the positions of scalar joints in a pose, by name [rad or m]."""
    tree = BodyTree(model)
    return {str(model.joint(joint).name): float(qpos[model.jnt_qposadr[joint]])
            for joint in range(model.njnt) if tree.is_scalar(joint)}


def _place_root(spec: mujoco.MjSpec, model: mujoco.MjModel, qpos: FloatArray) -> list[str]:
    """Put free bodies where a pose has them, raised if far below the floor."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    lowest = float(shape_heights(model, data, collides)[:, 0].min(initial=0.0))
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).tolist()
    raised = -lowest if free and lowest < -_BELOW_FLOOR_M else 0.0
    for joint in free:
        body = spec.body(model.body(model.jnt_bodyid[joint]).name)
        address = int(model.jnt_qposadr[joint])
        body.pos = qpos[address:address + 3] + np.array([0.0, 0.0, raised])
        body.quat = qpos[address + 3:address + 7]
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    return [f'raised by {raised:.3f} m, so that it stands on the floor'] if raised else []


def shape_heights(model: mujoco.MjModel, data: mujoco.MjData, which: BoolArray | None = None
                  ) -> FloatArray:
    """
    Return the lowest and highest point of the bounding box of each shape but planes [m].

    :param data: after ``mj_kinematics``
    :param which: a mask of shapes, shape (ngeom,); None is all
    :returns: shape (n, 2)
    """
    upward = data.geom_xmat.reshape(-1, 9)[:, 6:9]
    middle = data.geom_xpos[:, 2] + (upward * model.geom_aabb[:, :3]).sum(axis=1)
    half = (np.abs(upward) * model.geom_aabb[:, 3:]).sum(axis=1)
    has_size = model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)
    counts = has_size if which is None else has_size & which
    heights: FloatArray = np.stack([middle - half, middle + half], axis=1)[counts]
    return heights
