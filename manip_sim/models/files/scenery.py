# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Reduce a file with scenery, several roots or dangling references to one tree of bodies.

Mocap bodies of a robot's file move with the robot, and what they hold of it is known.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
import copy
from dataclasses import dataclass, replace
import re
from typing import Any
import warnings

import mujoco
import numpy as np

from manip_sim.algebra import relative_quat_wxyz
from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.couplings import tied_bodies
from manip_sim.models.files.body_tree import BodyTree
from manip_sim.models.spec_edits import attach, delete_elements, free_name, rename_body, TakenNames
from manip_sim.quoting import pluralize, quoted, quoted_names

_OBJ, _EQ = mujoco.mjtObj, mujoco.mjtEq
#: Elements that an equality constraint ties, by its tag, unless ``objtype`` names others.
_TIED = {int(_EQ.mjEQ_JOINT): _OBJ.mjOBJ_JOINT, int(_EQ.mjEQ_TENDON): _OBJ.mjOBJ_TENDON}
_OF_OBJTYPE = (int(_EQ.mjEQ_CONNECT), int(_EQ.mjEQ_WELD))
#: Number of positions of a joint by its type, one for others.
_POSITIONS = {int(mujoco.mjtJoint.mjJNT_FREE): 7, int(mujoco.mjtJoint.mjJNT_BALL): 4}
#: Remedy for a missing name.
_INCLUDED = 'if another file includes this one, load that'
_GROUND = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
#: Properties of a camera besides its name and pose.
_OF_CAMERA = ('mode', 'targetbody', 'fovy', 'resolution', 'sensor_size', 'focal_length',
              'focal_pixel', 'principal_length', 'principal_pixel', 'intrinsic', 'ipd', 'proj')
_WELD, _BODY = int(_EQ.mjEQ_WELD), int(_OBJ.mjOBJ_BODY)
#: Beginning of names of shapes and materials of mocap bodies, behind the robot's prefix.
_APART = 'mocap_'


def leave_out_dangling(spec: mujoco.MjSpec) -> list[str]:
    """
    Leave out what refers to elements that a file lacks, and keyframes of another size.

    That are sensors, equality constraints, excluded collisions, lights that follow a body, and
    materials. Cameras that follow one keep their pose. Actuators and tendons are not left out, as
    a robot does not move without them.

    :returns: a sentence for each kind
    """
    known = {int(kind): {element.name for element in elements} for kind, elements in (
        (_OBJ.mjOBJ_BODY, spec.bodies), (_OBJ.mjOBJ_XBODY, spec.bodies),
        (_OBJ.mjOBJ_MATERIAL, spec.materials), (_OBJ.mjOBJ_JOINT, spec.joints),
        (_OBJ.mjOBJ_GEOM, spec.geoms), (_OBJ.mjOBJ_SITE, spec.sites),
        (_OBJ.mjOBJ_CAMERA, spec.cameras), (_OBJ.mjOBJ_TENDON, spec.tendons),
        (_OBJ.mjOBJ_ACTUATOR, spec.actuators))}

    def lacking(kind: Any, *names: str) -> list[str]:
        return [name for name in names if name and name not in known.get(int(kind), names)]

    def of_equality(equality: Any) -> list[str]:
        kind = int(equality.type)
        tied = equality.objtype if kind in _OF_OBJTYPE else _TIED.get(kind, _OBJ.mjOBJ_UNKNOWN)
        return lacking(tied, equality.name1, equality.name2)

    body = _OBJ.mjOBJ_BODY
    cameras = [camera for camera in spec.cameras if lacking(body, camera.targetbody)]
    notes: list[str] = []
    for kind, elements, missing in (
            ('exclude', spec.excludes, lambda e: lacking(body, e.bodyname1, e.bodyname2)),
            ('equality constraint', spec.equalities, of_equality),
            ('sensor', spec.sensors, lambda e: (
                lacking(e.objtype, e.objname) + lacking(e.reftype, e.refname))),
            ('camera target', cameras, lambda e: lacking(body, e.targetbody)),
            ('light', spec.lights, lambda e: lacking(body, e.targetbody)),
            ('material', [*spec.geoms, *spec.sites],
             lambda e: lacking(_OBJ.mjOBJ_MATERIAL, e.material))):
        notes += _left_out(spec, kind, list(elements), missing)
    return notes + _left_out_keyframes(spec)


def _left_out(spec: mujoco.MjSpec, kind: str, elements: list[Any],
              missing: Callable[[Any], list[str]]) -> Iterator[str]:
    """Leave out what refers to missing elements, and yield a sentence if there is any."""
    dangling = [(element, names) for element in elements if (names := missing(element))]
    if not dangling:
        return
    named = {name for _, of_element in dangling for name in of_element}
    yield (f'left out: {pluralize(len(dangling), kind)} with a reference to what is not in the '
           f'file: {quoted_names(sorted(named))}; {_INCLUDED}, else correct the name')
    for element, _ in dangling:
        if kind == 'material':
            element.material = ''
        elif kind == 'camera target':
            element.targetbody, element.mode = '', mujoco.mjtCamLight.mjCAMLIGHT_FIXED
        else:
            spec.delete(element)


def _left_out_keyframes(spec: mujoco.MjSpec) -> list[str]:
    """Leave out keyframes with the positions, and controls, of other joints or actuators."""
    positions = sum(_POSITIONS.get(int(joint.type), 1) for joint in spec.joints)
    notes = []
    for key in list(spec.keys):
        if len(key.qpos) not in (0, positions):
            notes.append(f'left out: keyframe {quoted(key.name)}, which has {len(key.qpos)} '
                         f'positions where the file has {positions}; {_INCLUDED}, or write '
                         "'start' in a YAML file")
            spec.delete(key)
        elif len(key.ctrl) not in (0, len(spec.actuators)):
            notes.append(f'left out: {len(key.ctrl)} controls of keyframe {quoted(key.name)}, as '
                         f'the file has {pluralize(len(spec.actuators), "actuator")}')
            key.ctrl = []
    return notes


def single_tree(spec: mujoco.MjSpec, model: mujoco.MjModel, file: object) -> tuple[Any, list[str]]:
    """
    Leave out scenery around a robot or hand, and put the rest below one root body.

    Left out are lights and grounds of the world body, its cameras, other shapes and sites if the
    only root is free, mocap bodies (without a sentence), empty bodies, free bodies without
    actuators if there are other roots, roots without joints if only one other has some, roots
    that no actuator drives and nothing ties to another, beside a robot that floats or that is
    driven if none of their shapes collides, and, with their actuators, roots of which one body
    moves beside a robot that floats.

    :param spec: the ``mujoco.MjSpec``, without keyframes; changed in place
    :returns: the spec or, with a new root, another one, and a sentence for each change
    :raises ModelError: if no root remains, or one of several roots is free
    """
    cameras = [_CameraOfWorld(model, camera) for camera in spec.worldbody.cameras]
    notes = _leave_out(spec, BodyTree(model))
    world = spec.worldbody
    roots = list(world.bodies)
    if not roots:
        raise ModelError(f'{file} must have a body, found none; if other files include it, load '
                         'the one of the whole robot')
    loose = [*world.geoms, *world.sites]
    loose_counts = ' and '.join(pluralize(len(elements), noun) for noun, elements in (
        ('shape', world.geoms), ('site', world.sites)) if elements)
    free = [body for body in roots if _is_free(body)]
    # A camera that follows an omitted body has nothing to look at.
    cameras = [camera for camera in cameras
               if not camera.target or spec.body(camera.target) is not None]
    if cameras:
        names = quoted_names([camera.name for camera in cameras])
        notes.append(f'left out: {pluralize(len(cameras), "camera")} of the world body ({names})'
                     if free else
                     f'cameras of the world body on the root: {names}')
    if len(roots) == 1 and (free or not loose):
        delete_elements(spec, loose)
        if loose:
            notes.append(f'left out: {loose_counts} of the world body')
        if not free:
            root = model.body(roots[0].name)
            for camera in cameras:
                camera.add_to(roots[0], root.pos, root.quat)
        return spec, notes
    if free:
        raise ModelError(f'{file} must have exactly one root body, found {len(roots)}, '
                         f'{len(free)} of which are free: '
                         f'{quoted_names([body.name for body in roots])}; give each robot a file '
                         'of its own')
    name = free_name({body.name for body in spec.bodies}, 'root')
    held = f' and {loose_counts} of the world body' if loose else ''
    notes.append(f"new root body '{name}' that holds "
                 f'{quoted_names([body.name for body in roots])}{held}')
    whole = _wrapped(spec, name)
    for camera in cameras:
        camera.add_to(whole.body(name), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    return whole, notes


class _CameraOfWorld:
    """A camera of the world body, which moves to a root."""

    def __init__(self, model: mujoco.MjModel, camera: Any) -> None:
        self.name, self.target = str(camera.name), str(camera.targetbody)
        self._pose = model.camera(self.name).pos.copy(), model.camera(self.name).quat.copy()
        self._rest = {key: copy.copy(getattr(camera, key)) for key in _OF_CAMERA}

    def add_to(self, root: Any, position: FloatArray, quat_wxyz: FloatArray) -> None:
        """Add it to a root body that has a pose in the world."""
        back, pos, quat = np.empty(4), np.empty(3), np.empty(4)
        mujoco.mju_negQuat(back, quat_wxyz)
        mujoco.mju_rotVecQuat(pos, self._pose[0] - position, back)
        mujoco.mju_mulQuat(quat, back, self._pose[1])
        camera = root.add_camera(name=self.name, pos=pos, quat=quat)
        for key, value in self._rest.items():
            setattr(camera, key, value)


def _leave_out(spec: mujoco.MjSpec, tree: BodyTree) -> list[str]:
    world, notes = spec.worldbody, []
    grounds = [geom for geom in world.geoms if int(geom.type) in _GROUND]
    objects = _objects(spec, tree)
    notes += _keep_on_ground(spec, {geom.name for geom in grounds})
    for kind, elements in (('light', list(world.lights)), ('ground', grounds),
                           ('body', objects)):
        names = [element.name for element in elements if element.name]
        if elements is objects:  # Of mocap bodies, who reads the file says what becomes of them.
            names = [body.name for body in objects if not body.mocap]
        if names or (elements and elements is not objects):
            notes.append(f'left out: {pluralize(len(names) or len(elements), kind)} of the world '
                         'body' + (f' ({quoted_names(names)})' if names else ''))
        if elements is not objects:
            delete_elements(spec, elements)
    delete_elements(spec, list(world.cameras))
    for body in objects:
        spec.delete(body)
    for pair in list(spec.pairs):
        if spec.geom(pair.geomname1) is None or spec.geom(pair.geomname2) is None:
            spec.delete(pair)
    return notes


def touch_other_files(spec: mujoco.MjSpec) -> list[str]:
    """
    Leave out contact pairs with shapes that are not in the file, such as the ground of a scene.

    :returns: which shapes touch the arena instead, in a sentence
    """
    known = {geom.name for geom in spec.geoms}
    pairs = [pair for pair in spec.pairs if not {pair.geomname1, pair.geomname2} <= known]
    missing = {name for pair in pairs for name in (pair.geomname1, pair.geomname2)} - known
    notes = _keep_on_ground(spec, missing)
    delete_elements(spec, pairs)
    return notes + ([f'left out: {pluralize(len(pairs), "contact pair")} with shapes that are not '
                     f'in the file: {quoted_names(sorted(missing))}'] if pairs else [])


def _keep_on_ground(spec: mujoco.MjSpec, names: set[str]) -> list[str]:
    """Let shapes touch grounds of the arena that touch some of the file by contact pairs only."""
    kept = []
    for pair in spec.pairs:
        others = {pair.geomname1, pair.geomname2} - names
        if len(others) != 1:
            continue
        geom = spec.geom(others.pop())
        if geom is not None and not (geom.contype or geom.conaffinity):
            # Arenas have contype 1, so the shape meets them, but no shape like it.
            geom.conaffinity = 1
            geom.friction, geom.solref, geom.solimp = pair.friction[[0, 2, 3]], pair.solref, (
                pair.solimp)
            kept.append(geom.name)
    return [f'contact of {pluralize(len(kept), "shape")} with the arena, where contact pairs '
            f'named the ground: {quoted_names(kept)}'] if kept else []


def _objects(spec: mujoco.MjSpec, tree: BodyTree) -> list[Any]:
    """Return the root bodies that are not part of the robot or hand, unless all are."""
    model = tree.model
    driven = set().union(*(tree.driven(actuator) for actuator in range(model.nu)))
    objects, roots = [], list(spec.worldbody.bodies)
    articulated = [body for body in roots if any(
        map(tree.is_scalar, tree.joints(tree.below(model.body(body.name).id))))]
    floats = any(_is_free(body) and driven.intersection(
        tree.joints(tree.below(model.body(body.name).id))) for body in roots)
    for body in roots:
        below = sorted(tree.below(model.body(body.name).id))
        joints, shapes = tree.joints(below), [*body.geoms, *body.find_all('geom')]
        empty = not joints and not shapes
        is_drawn = shapes and not any(geom.contype or geom.conaffinity for geom in shapes)
        is_object = _is_free(body) and not driven.intersection(joints)
        # Some robots keep the joints that a variant lacks on bodies beside it.
        is_dummy = floats and not _is_free(body) and len({*model.jnt_bodyid[joints]}) == 1
        # A body that nothing drives, ties or touches marks a place, such as that of a hand.
        is_furniture = (not joints and (floats or len(articulated) == 1)) or (
            (floats or driven and is_drawn)
            and not driven.intersection(joints) and not _is_tied(model, below))
        if (body.mocap or empty or is_furniture or is_dummy
                or (is_object and (driven or len(roots) > 1))):
            objects.append(body)
    return objects if len(objects) < len(roots) else []


def _is_tied(model: mujoco.MjModel, bodies: list[int]) -> bool:
    """Return whether an equality constraint ties some of the bodies to others but the world."""
    inside = {0, *bodies}
    for equality, kind in enumerate(model.eq_type.tolist()):
        joints = model.eq_obj1id[equality], model.eq_obj2id[equality]
        if kind == int(_EQ.mjEQ_JOINT) and joints[1] >= 0:
            first, second = model.jnt_bodyid[[*joints]].tolist()
        elif kind in _OF_OBJTYPE:
            first, second = tied_bodies(model, equality)
        else:
            continue
        if (first in inside) != (second in inside):
            return True
    return False


def _is_free(body: Any) -> bool:
    return any(int(joint.type) == _FREE for joint in body.joints)


def _wrapped(spec: mujoco.MjSpec, name: str) -> Any:
    whole = mujoco.MjSpec()
    whole.modelname = spec.modelname
    whole.option = spec.option
    with warnings.catch_warnings():
        # MuJoCo 3.3 warns of the empty prefix; composing adds one later.
        warnings.simplefilter('ignore')
        attach(whole, spec, '', whole.worldbody.add_body(name=name).add_frame())
    return whole


@dataclass(frozen=True)
class Weld:
    """
    A weld constraint between a mocap body and another body.

    :ivar bodies: names in the file, in its order
    :ivar data: as compiled, with the relative pose, shape (11,)
    """

    name: str
    bodies: tuple[str, str]
    data: FloatArray
    active: bool
    solref: FloatArray
    solimp: FloatArray

    def rest_of_mocap(self, names: Collection[str], places: Mapping[str, FloatArray]
                      ) -> tuple[str, FloatArray]:
        """
        Return the mocap body of the weld, and its pose at which the weld is at rest, shape (7,).

        :param places: position and quaternion w, x, y, z of the other bodies, shape (7,)
        """
        # MuJoCo keeps the anchor in the second body, that in the first one, and the rotation from
        # the first to the second one.
        anchors, turn, whole = [self.data[3:6], self.data[:3]], self.data[6:10].copy(), np.empty(4)
        mocap = 0 if self.bodies[0] in names else 1
        place = places[self.bodies[1 - mocap]]
        if mocap == 0:
            mujoco.mju_negQuat(turn, turn.copy())
        mujoco.mju_mulQuat(whole, place[3:], turn)
        point, back = np.empty(3), np.empty(3)
        mujoco.mju_rotVecQuat(point, anchors[1 - mocap], place[3:])
        mujoco.mju_rotVecQuat(back, anchors[mocap], whole)
        return self.bodies[mocap], np.concatenate([place[:3] + point - back, whole])


@dataclass(frozen=True)
class MocapBodies:
    """
    The mocap bodies of a file.

    :ivar spec: the file with nothing else, not to be changed
    :ivar poses: position [m] and quaternion w, x, y, z at the start, by name, shape (7,)
    :ivar from_keyframe: whether a keyframe says where they start
    :ivar unheld: names of other bodies that constraints other than welds of bodies tie to them
    """

    spec: Any
    names: tuple[str, ...]
    poses: dict[str, FloatArray]
    welds: tuple[Weld, ...]
    from_keyframe: bool
    unheld: tuple[str, ...]

    def notes(self) -> list[str]:
        """Return what a user has to know of them, in sentences."""
        said = [f'mocap bodies: {quoted_names(list(self.names))}']
        held = sorted({body for weld in self.welds if weld.active
                       for body in weld.bodies if body not in self.names})
        if held:
            said.append(f'welds pull {quoted_names(held)} to mocap bodies, against commands of '
                        "joints; 'mocap: false' in a YAML file leaves these bodies out")
        if self.unheld:
            said.append('left out: constraints other than welds of bodies that tie '
                        f'{quoted_names(list(self.unheld))} to mocap bodies')
        return said

    def at_start(self, model: mujoco.MjModel, start: Mapping[str, float]) -> MocapBodies:
        """
        Return them where their welds are at rest when the robot starts, unless a keyframe says.

        :param start: where its scalar joints start, by name [rad or m]
        """
        if self.from_keyframe:
            return self
        data = mujoco.MjData(model)
        for joint, position in start.items():
            data.joint(joint).qpos[0] = position
        mujoco.mj_kinematics(model, data)
        places = {name: np.concatenate([data.body(name).xpos, data.body(name).xquat])
                  for weld in self.welds for name in weld.bodies if name not in self.names}
        return replace(self, poses={**self.poses, **dict(
            weld.rest_of_mocap(self.names, places) for weld in self.welds[::-1] if weld.active)})

    def left_out(self) -> list[str]:
        """Return that they are left out, in sentences."""
        return [f'left out: mocap bodies {quoted_names(list(self.names))}']

    def add_to(self, spec: mujoco.MjSpec, prefix: str, part: str, before: FloatArray,
               after: FloatArray) -> None:
        """
        Add them to a composition that has the robot.

        :param prefix: what the names of the robot begin with
        :param before: pose of the robot's root in its file, position and w, x, y, z, shape (7,)
        :param after: its pose in the composition
        """
        copied = self.spec.copy()
        TakenNames(spec).add(copied, prefix + _APART, part)
        attach(spec, copied, prefix + _APART, spec.worldbody.add_frame())
        for name in self.names:
            body = spec.body(prefix + _APART + name)
            rename_body(spec, body, prefix + _as_topic(name))
            body.pos, body.quat = _moved(self.poses[name], before, after)
            body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        for weld in self.welds:
            first, second = (prefix + (_as_topic(body) if body in self.names else body)
                             for body in weld.bodies)
            equality = spec.add_equality(
                type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1=first,
                name2=second, data=weld.data, active=weld.active, solref=weld.solref,
                solimp=weld.solimp)
            if weld.name:
                equality.name = prefix + weld.name


def find_mocap_bodies(spec: mujoco.MjSpec, model: mujoco.MjModel, key: int | None
                      ) -> MocapBodies | None:
    """
    Return the mocap bodies of a file, or None.

    :param key: id of the keyframe that the robot starts from, or None
    """
    bodies = {str(model.body(body).name): int(model.body_mocapid[body])
              for body in np.flatnonzero(model.body_mocapid >= 0).tolist()}
    if not bodies:
        return None
    poses = {}
    for name, mocap in bodies.items():
        position = model.body(name).pos if key is None else model.key_mpos[key].reshape(-1, 3)[
            mocap]
        quat = model.body(name).quat if key is None else model.key_mquat[key].reshape(-1, 4)[mocap]
        poses[name] = np.concatenate([position, quat])
    welds = tuple(Weld(
        str(model.equality(weld).name), (str(model.body(model.eq_obj1id[weld]).name),
                                         str(model.body(model.eq_obj2id[weld]).name)),
        model.eq_data[weld].copy(), bool(model.eq_active0[weld]), model.eq_solref[weld].copy(),
        model.eq_solimp[weld].copy()) for weld in range(model.neq) if _ties(model, weld))
    return MocapBodies(_alone(spec, set(bodies)), tuple(bodies), poses, welds, key is not None,
                       tuple(_unheld(model)))


def _unheld(model: mujoco.MjModel) -> list[str]:
    """Return which other bodies connect constraints and welds of sites tie to mocap bodies."""
    names = []
    for equality in np.flatnonzero(np.isin(model.eq_type, _OF_OBJTYPE)).tolist():
        others = [end for end in tied_bodies(model, equality) if model.body_mocapid[end] < 0]
        if len(others) == 1 and others[0] and not _ties(model, equality):
            names.append(str(model.body(others[0]).name))
    return names


def _ties(model: mujoco.MjModel, equality: int) -> bool:
    """Return whether an equality is a weld of a mocap body to a body that is not the world."""
    if int(model.eq_type[equality]) != _WELD or int(model.eq_objtype[equality]) != _BODY:
        return False
    ends = [int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])]
    mocap = [int(model.body_mocapid[end]) >= 0 for end in ends]
    return any(mocap) and not all(mocap) and all(ends)


def _alone(spec: mujoco.MjSpec, names: set[str]) -> Any:
    """Return a copy of a spec that has some bodies of the world, what they show, and no more."""
    alone = spec.copy()
    world = alone.worldbody
    delete_elements(alone, [*alone.keys, *alone.sensors])
    delete_elements(alone, [*world.geoms, *world.sites, *world.cameras, *world.lights])
    for body in list(world.bodies):
        if body.name not in names:
            alone.delete(body)
    delete_elements(alone, [*alone.equalities, *alone.excludes, *alone.pairs, *alone.actuators,
                            *alone.tendons])
    shapes = alone.geoms
    meshes = {geom.meshname for geom in shapes}
    materials = {element.material for element in [*shapes, *alone.sites]}
    textures = {texture for material in alone.materials if material.name in materials
                for texture in material.textures}
    for elements, used in ((alone.meshes, meshes), (alone.materials, materials),
                           (alone.textures, textures),
                           (alone.hfields, {g.hfieldname for g in shapes}),
                           (alone.skins, set()), (alone.flexes, set())):
        delete_elements(alone, [element for element in elements if element.name not in used])
    return alone


def _as_topic(name: str) -> str:
    """Return a name with underscores for what names of topics cannot have."""
    return re.sub('[^A-Za-z0-9_]', '_', name)


def _moved(pose: FloatArray, before: FloatArray, after: FloatArray
           ) -> tuple[FloatArray, FloatArray]:
    """Return the position and quaternion of a pose that moves with a body."""
    back, pos, quat = np.empty(4), np.empty(3), np.empty(4)
    mujoco.mju_negQuat(back, before[3:])
    mujoco.mju_rotVecQuat(pos, pose[:3] - before[:3], back)
    mujoco.mju_rotVecQuat(pos, pos.copy(), after[3:])
    mujoco.mju_mulQuat(quat, after[3:], relative_quat_wxyz(before[3:], pose[3:]))
    return pos + after[:3], quat
