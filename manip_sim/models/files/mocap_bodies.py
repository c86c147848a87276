# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The mocap bodies of a robot's file, and what they hold of the robot."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
import re
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.spec_edits import attach, delete_elements, rename_body, TakenNames
from manip_sim.quaternion import relative_quat_wxyz
from manip_sim.quoting import quoted_names

_WELD, _CONNECT = int(mujoco.mjtEq.mjEQ_WELD), int(mujoco.mjtEq.mjEQ_CONNECT)
_BODY = int(mujoco.mjtObj.mjOBJ_BODY)
#: Beginning of names of shapes and materials of mocap bodies, behind the robot's prefix.
_APART = 'mocap_'


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
    return MocapBodies(_alone(spec, set(bodies)), tuple(bodies), poses, tuple(
        _weld(model, equality) for equality in range(model.neq) if _ties(model, equality)),
        key is not None, tuple(_unheld(model)))


def _unheld(model: mujoco.MjModel) -> list[str]:
    """Return which other bodies connect constraints and welds of sites tie to mocap bodies."""
    names = []
    for equality in np.flatnonzero(np.isin(model.eq_type, (_WELD, _CONNECT))).tolist():
        ends = [int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])]
        if int(model.eq_objtype[equality]) != _BODY:
            ends = model.site_bodyid[ends].tolist()
        others = [end for end in ends if model.body_mocapid[end] < 0]
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


def _weld(model: mujoco.MjModel, equality: int) -> Weld:
    first, second = (str(model.body(int(body)).name) for body in (
        model.eq_obj1id[equality], model.eq_obj2id[equality]))
    return Weld(str(model.equality(equality).name), (first, second),
                model.eq_data[equality].copy(), bool(model.eq_active0[equality]),
                model.eq_solref[equality].copy(), model.eq_solimp[equality].copy())


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
