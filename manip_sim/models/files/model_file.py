# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read a model file, MJCF or URDF, for the first time: one tree, named, with a start pose."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Union
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.actuators import SCALAR
from manip_sim.models.asset_files import infer_inertias_once
from manip_sim.models.couplings import JointCouplings
from manip_sim.models.files.actuation import add_servos, guess_efforts, report_efforts
from manip_sim.models.files.body_tree import BodyTree
from manip_sim.models.files.part_descriptions import Description
from manip_sim.models.files.scenery import (
    find_mocap_bodies, leave_out_dangling, MocapBodies, single_tree, touch_other_files)
from manip_sim.models.files.urdf import is_urdf, lighten, load_urdf, masses_from_shapes
from manip_sim.models.files.urdf_joints import support_couplings
from manip_sim.models.loading import (
    compile_alone, compile_copy, leave_out_visual, load_spec, name_unnamed_elements)
from manip_sim.models.untrusted_models import load_self_contained
from manip_sim.models.user_files import Files, stem_of
from manip_sim.quoting import one_line, pluralize, quoted


@dataclass
class ModelFile:
    """
    A robot, hand or base as read from a file.

    :ivar spec: the ``mujoco.MjSpec`` with one root body and no keyframes
    :ivar tree: of the compiled model as it was in the file
    :ivar start: where scalar joints start, by name [rad or m]
    :ivar inferred: the inferences and omissions, in sentences
    :ivar keyframes: positions of scalar joints by keyframe and name [rad or m]
    :ivar mocap: its mocap bodies, which the spec has no more, or None
    """

    file: Path
    spec: mujoco.MjSpec
    tree: BodyTree
    start: dict[str, float]
    inferred: list[str] = field(default_factory=list)
    keyframes: dict[str, dict[str, float]] = field(default_factory=dict)
    mocap: MocapBodies | None = None


def read_model(file: Path, description: Description, source: object,
               keyframes: Sequence[str] = ('home',), servos: bool = True,
               files: Files | None = None, visual: bool = True) -> ModelFile:
    """
    Read a robot, hand or base, and exclude collisions of links that overlap at its start.

    :param source: the file that the description was read from, for messages
    :param keyframes: the first of these that exists is the start, else the only keyframe of the
        file, else what :func:`choose_pose` returns, unless the description names a keyframe
    :param servos: give joints position servos if the file has no actuators
    :param visual: compile the shapes that only show something, which may be most of the model
    :raises ModelError: if the file cannot be read, does not compile or is not one tree of bodies,
        or a position of the description is outside its range
    :raises UnknownNameError: if it lacks the keyframe or a joint of the description
    """
    urdf, expects_meshes = is_urdf(file, files), description.meshes is None
    notes: list[str] = []
    if urdf:
        spec, notes = load_urdf(file, description.xacro_values, expects_meshes, files)
    elif files is None:
        spec = load_spec(file, notes)
        if not expects_meshes:
            notes = [str(note) for note in notes]
    else:
        spec = load_self_contained(file, files, as_robot=True).load_tried(notes)
    notes += [*_gravity_of_file(spec), *touch_other_files(spec), *leave_out_dangling(spec)]
    name_unnamed_elements(spec)
    for joint in spec.joints:  # MuJoCo would leave the rotor out of dof_invweight0 of some slides.
        joint.parent.simple = 0
    infer_inertias_once(spec)
    original, spec = spec, spec.copy()
    if not visual:
        leave_out_visual(original)
    model = compile_alone(original, str(file))
    del original
    if urdf:
        lighter = lighten(spec, model)
        model = compile_copy(spec, str(file), visual) if lighter else model
        notes += [*lighter, *masses_from_shapes(spec, model)]
    declared = getattr(description, 'start', None)
    keyframe = declared if isinstance(declared, str) else None
    key = _choose_key(model, keyframes, keyframe, file)
    if key is None:
        qpos, why = choose_pose(model)
    else:
        qpos = model.key_qpos[key]
        why = [f"start pose: keyframe '{model.key(key).name}'"] if keyframe is None else []
    mocap = find_mocap_bodies(spec, model, key)
    places, named = positions_of(model, qpos), keyframes_of(model)
    notes += _of_undeclared(why, places, declared)
    notes += _place_root(spec, model, qpos)
    for old in list(spec.keys):
        spec.delete(old)
    guesses = getattr(description, 'efforts', 'own') == 'guess'
    if guesses and model.nu:
        raise ModelError(f"'efforts: guess' of {source} is for files without actuators; "
                         f'{file} has {pluralize(model.nu, "actuator")}')
    if servos and not model.nu and places:
        if guesses:
            notes += guess_efforts(spec, model)
            model = compile_copy(spec, str(file), visual)
        else:
            notes += report_efforts(model, _declared_pose(model, qpos, declared))
        notes += add_servos(spec, BodyTree(model))
        if urdf:
            support_couplings(spec)
        model = compile_copy(spec, str(file), visual)
    # Sizes for the file's model alone; MuJoCo would warn in composing if parts differ.
    spec.njmax, spec.nconmax, spec.nkey = -1, -1, 0
    spec, changes = single_tree(spec, model, file)
    not_free = np.flatnonzero(model.jnt_type != int(mujoco.mjtJoint.mjJNT_FREE)).tolist()
    if any(spec.joint(model.joint(joint).name) is None for joint in not_free):
        model = compile_copy(spec, str(file), visual)
        places = {name: place for name, place in places.items() if spec.joint(name) is not None}
        named = {key: {name: place for name, place in there.items() if name in places}
                 for key, there in named.items()}
    tree = BodyTree(model)
    start = _start_pose(model, places, declared, source)
    notes += [*changes, *_exclude_overlaps(spec, model, start, file, urdf, files)]
    return ModelFile(file, spec, tree, start, notes, named, mocap)


def _gravity_of_file(spec: mujoco.MjSpec) -> list[str]:
    """Return that gravity other than the usual one is left behind, in a sentence."""
    gravity = np.asarray(spec.option.gravity)
    if np.array_equal(gravity, mujoco.MjSpec().option.gravity):
        return []
    numbers = ' '.join(f'{number:g}' for number in gravity)
    return [f'left behind: the gravity of the file, {numbers} m/s^2; '
            f'<option gravity="{numbers}"/> in the MJCF file of an arena sets that of its worlds']


def _choose_key(model: mujoco.MjModel, preferred: Sequence[str], keyframe: str | None, file: Path
                ) -> int | None:
    names = [str(model.key(i).name) for i in range(model.nkey)]
    if keyframe is not None:
        if keyframe not in names:
            raise UnknownNameError(f'keyframe of {file}', keyframe, names)
        return names.index(keyframe)
    for name in preferred:
        if name in names:
            return names.index(name)
    return 0 if len(names) == 1 else None


def positions_of(model: mujoco.MjModel, qpos: FloatArray) -> dict[str, float]:
    """Return the positions of scalar joints in a pose, by name [rad or m]."""
    tree = BodyTree(model)
    return {str(model.joint(joint).name): float(qpos[model.jnt_qposadr[joint]])
            for joint in range(model.njnt) if tree.is_scalar(joint)}


def keyframes_of(model: mujoco.MjModel) -> dict[str, dict[str, float]]:
    """Return the positions of scalar joints in the keyframes that have a name [rad or m]."""
    return {str(model.key(key).name): positions_of(model, model.key_qpos[key])
            for key in range(model.nkey) if model.key(key).name}


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


def depth_in_floor(model: mujoco.MjModel, start: Mapping[str, float]) -> float:
    """
    Return how far a robot whose root is fixed reaches into the floor where it starts [m].

    It is 0 for one that floats, and if nothing that moves touches the floor and what does not move
    reaches no farther than the foot of an arm does, or is in it by less than half. Otherwise it
    ends just above the floor: wheels and feet of a robot that is fixed would rub on it.

    :param start: positions of scalar joints by name [rad or m]
    """
    if (model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).any():
        return 0.0
    data = mujoco.MjData(model)
    for name, position in start.items():
        data.joint(name).qpos[0] = position
    mujoco.mj_kinematics(model, data)
    colliding = ((model.geom_contype | model.geom_conaffinity) != 0) & (model.geom_bodyid != 0)
    moves = model.body_weldid[model.geom_bodyid] != 0
    moving, fixed = (shape_heights(model, data, colliding & which) for which in (moves, ~moves))
    sunk = (fixed[:, 0] < -_BELOW_FLOOR_M) & (fixed.mean(axis=1) < 0.0)
    blocked = (moving[:, 0] < _TOUCHES_FLOOR_M).any() or sunk.any()
    return _ABOVE_FLOOR_M - float(np.vstack([moving, fixed])[:, 0].min()) if blocked else 0.0


def shape_heights(model: mujoco.MjModel, data: mujoco.MjData, which: BoolArray | None = None
                  ) -> FloatArray:
    """
    Return the lowest and highest point of each shape but planes [m].

    :param data: after ``mj_kinematics``
    :param which: a mask of shapes, shape (ngeom,); None is all
    :returns: shape (n, 2)
    """
    has_size = model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)
    counts = has_size if which is None else has_size & which
    return np.array([_heights(model, data, geom) for geom in np.flatnonzero(counts).tolist()]
                    ).reshape(-1, 2)


def _heights(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[float, float]:
    """Return the lowest and highest point of a shape; for a height field, of its box."""
    upward, size = data.geom_xmat[geom, 6:9], model.geom_size[geom]
    middle, kinds = float(data.geom_xpos[geom, 2]), mujoco.mjtGeom
    kind, mesh = int(model.geom_type[geom]), int(model.geom_dataid[geom])
    if kind == int(kinds.mjGEOM_MESH) and mesh >= 0:
        first = int(model.mesh_vertadr[mesh])
        heights = model.mesh_vert[first:first + int(model.mesh_vertnum[mesh])] @ upward
        return middle + float(heights.min()), middle + float(heights.max())
    if kind == int(kinds.mjGEOM_SPHERE):
        half = size[0]
    elif kind == int(kinds.mjGEOM_CAPSULE):
        half = size[0] + size[1] * abs(upward[2])
    elif kind == int(kinds.mjGEOM_CYLINDER):
        half = size[0] * np.hypot(upward[0], upward[1]) + size[1] * abs(upward[2])
    elif kind == int(kinds.mjGEOM_ELLIPSOID):
        half = np.linalg.norm(size * upward)
    else:
        middle += float(upward @ model.geom_aabb[geom, :3])
        half = np.abs(upward) @ model.geom_aabb[geom, 3:]
    return middle - float(half), middle + float(half)


def _of_undeclared(notes: list[str], joints: Iterable[str],
                   declared: Union[str, Mapping[str, float], None]) -> list[str]:
    """Let notes of the start pose tell for which joints it was inferred."""
    if not isinstance(declared, Mapping) or not declared:
        return notes
    if set(joints) <= declared.keys():
        return []
    return [note.replace('start pose:', "start pose of joints that 'start' does not name:")
            for note in notes]


def _declared_pose(model: mujoco.MjModel, qpos: FloatArray,
                   declared: Union[str, Mapping[str, float], None]) -> FloatArray:
    """Return a pose in which joints are where a description has them, copied."""
    pose: FloatArray = qpos.copy()
    names = {str(model.joint(joint).name): joint for joint in range(model.njnt)}
    for name, position in declared.items() if isinstance(declared, Mapping) else ():
        if name in names:  # An unknown one is told later.
            pose[model.jnt_qposadr[names[name]]] = position
    return pose


def _start_pose(model: mujoco.MjModel, in_file: Mapping[str, float],
                declared: Union[str, Mapping[str, float], None], source: object
                ) -> dict[str, float]:
    """
    Return the start positions of scalar joints, by name [rad or m].

    :param declared: positions by joint [rad or m]; without one, a joint starts as in the file
    :raises UnknownNameError: if the joint is unknown
    :raises ModelError: if a position is outside the joint's range
    """
    start = dict(in_file)
    if declared is None or isinstance(declared, str):
        return start
    for name, position in declared.items():
        if name not in start:
            raise UnknownNameError(f"joint in 'start' of {source}", name, start)
        joint = model.joint(name)
        low, high = joint.range
        if joint.limited[0] and not low <= position <= high:
            raise ModelError(f"'start' of joint '{name}' in {source} must be within {low:g} to "
                             f'{high:g}, got {position:g}')
        start[name] = float(position)
    return start


def _exclude_overlaps(spec: mujoco.MjSpec, model: mujoco.MjModel, start: Mapping[str, float],
                      file: Path, urdf: bool, files: Files | None = None) -> list[str]:
    """
    Exclude collisions of links that overlap at the start.

    MuJoCo excludes collisions with a parent by itself, except with one that cannot move: links are
    excluded with the fixed links that they move on. A URDF has no place for exclusions: there all
    links that overlap are excluded, and the pairs of the SRDF beside the file.

    :param start: where joints start, by name [rad or m]
    :returns: the changes, in sentences
    """
    pairs, notes = disabled_pairs(file, files or Files()) if urdf else (set(), [])
    excluded = 0
    for first, second in sorted(pairs):
        if spec.body(first) is not None and spec.body(second) is not None:
            spec.add_exclude(bodyname1=first, bodyname2=second)
            excluded += 1
    if excluded:
        notes.append(f'left out: collisions of {pluralize(excluded, "pair")} of links, '
                     'as its SRDF says')
    for first, second in _overlapping(model, start, urdf):
        if _key(first, second) in pairs or spec.body(first) is None or spec.body(second) is None:
            continue
        pairs.add(_key(first, second))
        spec.add_exclude(bodyname1=first, bodyname2=second)
        notes.append(f"'{first}' and '{second}' overlap at the start, so they do not collide")
    return notes


def _key(first: str, second: str) -> tuple[str, str]:
    return (first, second) if first < second else (second, first)


def _overlapping(model: mujoco.MjModel, start: Mapping[str, float], everywhere: bool
                 ) -> Iterator[tuple[str, str]]:
    data = mujoco.MjData(model)
    for joint, position in start.items():
        data.joint(joint).qpos[0] = position
    margins = model.geom_margin.copy()
    model.geom_margin[:] += _TOUCHING_M
    mujoco.mj_forward(model, data)
    model.geom_margin[:] = margins
    for contact in data.contact:
        fixed, other = sorted(model.geom_bodyid[contact.geom].tolist(),
                              key=lambda body: int(model.body_weldid[body]))
        mover = int(model.body_weldid[other])
        neighbours = mover and fixed and not model.body_weldid[fixed] and not model.body_weldid[
            model.body_parentid[mover]]
        if (neighbours and contact.dist < _TOUCHING_M) or (
                everywhere and fixed and other and contact.dist < -_OVERLAPPING_M):
            yield model.body(fixed).name, model.body(other).name


def disabled_pairs(file: Path, files: Files) -> tuple[set[tuple[str, str]], list[str]]:
    """Return the pairs that the SRDF beside a URDF disables, and what to say of it."""
    srdf = file.with_name(f'{stem_of(file)}.srdf')
    if not files.is_file(srdf):
        return set(), []
    try:
        text = files.read(srdf, 'SRDF').decode('utf-8')
        if '<!ENTITY' in text:
            raise OSError('it declares entities')
        root = ElementTree.fromstring(text)
    except (OSError, ModelError, UnicodeDecodeError, ElementTree.ParseError) as error:
        return set(), [f'{quoted(srdf.name)} is ignored: {one_line(str(error))}']
    return {_key(pair.get('link1', ''), pair.get('link2', ''))
            for pair in root.iter('disable_collisions')}, []


#: A joint that is nearer to an end than this fraction of its range is at that end.
_AT_END = 0.05
#: Distance by which a joint at an end is moved, as a fraction of its range.
_INSIDE = 0.25
#: A pose is only better if the overlap of links is less by this much [m].
_BETTER_M = 1e-3
#: Positions that differ by less are the same [rad or m].
_SAME = 1e-6
#: A robot that starts farther below the floor than this is raised to it [m].
_BELOW_FLOOR_M = 0.05
#: A moving shape of a robot whose root is fixed touches the floor if it is lower than this, and is
#: raised to the other [m].
_TOUCHES_FLOOR_M, _ABOVE_FLOOR_M = 1e-6, 1e-3
#: Links that are nearer to each other than this touch [m].
_TOUCHING_M = 1e-4
#: Links of a URDF that overlap by more than this at the start are drawn so [m].
_OVERLAPPING_M = 1e-3


def choose_pose(model: mujoco.MjModel) -> tuple[FloatArray, list[str]]:
    """
    Return a pose with joints inside their ranges and little overlap of links.

    Three are tried: zero, with the middle of the range for joints that cannot be at zero; zero,
    with joints moved away from the ends of their ranges; and the middle of all ranges. The first
    one is taken unless another one has less overlap.

    :returns: ``qpos``, shape (nq,), and the changes, in sentences
    """
    zero, moved, _ = _with(model, lambda value, low, high: value if low <= value <= high
                           else (low + high) / 2.0)
    notes = [f'start pose: zero, and the middle of the range for {", ".join(moved)}'
             if moved else 'start pose: zero']
    best, overlap = zero, _overlap(model, zero)
    for choose, wording in (
            (_away_from_ends, 'zero, with joints away from the ends of their ranges'),
            (lambda value, low, high: (low + high) / 2.0, 'the middle of all ranges')):
        if overlap > 0.0:
            pose, _, possible = _with(model, choose)
            if possible and _overlap(model, pose) < overlap - _BETTER_M:
                best, overlap, notes = pose, _overlap(model, pose), [
                    f'start pose: {wording}, because links overlap at zero']
    return best, notes


def _away_from_ends(value: float, low: float, high: float) -> float:
    span = high - low
    if value < low + _AT_END * span:
        return low + _INSIDE * span
    if value > high - _AT_END * span:
        return high - _INSIDE * span
    return value


def _with(model: mujoco.MjModel, choose: Callable[[float, float, float], float]
          ) -> tuple[FloatArray, list[str], bool]:
    """
    Return a pose with limited joints where a function puts them.

    Joints that others drive follow them, but not out of their ranges.

    :returns: ``qpos``, names of those that the function moved, and whether all could follow
    """
    scalar = [joint for joint in range(model.njnt) if int(model.jnt_type[joint]) in SCALAR]
    places = {joint: float(model.qpos0[model.jnt_qposadr[joint]]) for joint in scalar}
    moved = []
    for joint in scalar:
        if model.jnt_limited[joint]:
            before = places[joint]
            places[joint] = choose(before, *map(float, model.jnt_range[joint]))
            if places[joint] != before:
                moved.append(str(model.joint(joint).name))
    ties = np.flatnonzero((model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT))
                          & (model.eq_active0 != 0) & (model.eq_obj2id >= 0))
    followers = set(model.eq_obj1id[ties].tolist())
    followed = JointCouplings(model, scalar).follow(
        {joint: place for joint, place in places.items() if joint not in followers})
    possible = True
    for joint in followers & set(followed):
        limits = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
        places[joint] = float(np.clip(followed[joint], *limits))
        possible = possible and abs(places[joint] - followed[joint]) < _SAME
    qpos: FloatArray = model.qpos0.copy()
    qpos[model.jnt_qposadr[list(places)]] = list(places.values())
    return qpos, moved, possible


def _overlap(model: mujoco.MjModel, qpos: FloatArray) -> float:
    """Return the sum of the penetration depths of pairs of bodies, without the world [m]."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    deepest: dict[tuple[int, ...], float] = {}
    for contact in data.contact:
        if min(contact.geom) >= 0:
            pair = tuple(sorted(model.geom_bodyid[contact.geom].tolist()))
            deepest[pair] = max(deepest.get(pair, 0.0), -float(contact.dist))
    return float(np.sum([depth for (first, _), depth in deepest.items() if first]))
