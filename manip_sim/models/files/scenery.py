# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Reduce a file with a floor, lights, objects or several roots to one tree of bodies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
import warnings

import mujoco

from manip_sim.errors import ModelError
from manip_sim.models.files.frames import free_name
from manip_sim.models.files.tree import BodyTree
from manip_sim.models.spec_edits import delete_elements
from manip_sim.quoting import quoted_names

_GROUND = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
#: Links that are nearer to each other than this touch [m].
_TOUCHING_M = 1e-4
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def single_tree(spec: mujoco.MjSpec, model: mujoco.MjModel, file: object) -> tuple[Any, list[str]]:
    """
    Leave out what is not part of a robot or hand, and put the rest below one root body.

    Left out are lights, cameras and grounds of the world body, its other shapes and sites if the
    only root is free, mocap bodies, empty bodies, and free bodies without actuators if there are
    other roots.

    :param spec: the ``mujoco.MjSpec``, without keyframes; changed in place
    :param model: the same, compiled
    :param file: what it was read from, for messages
    :returns: the spec or, with a new root, another one, and a sentence for each change
    :raises ModelError: if no root remains, or one of several roots is free
    """
    notes = _leave_out(spec, BodyTree(model))
    world = spec.worldbody
    roots = list(world.bodies)
    if not roots:
        raise ModelError(f'{file} must have a body, found none')
    loose = [*world.geoms, *world.sites]
    free = [body for body in roots if _is_free(body)]
    if len(roots) == 1 and (free or not loose):
        delete_elements(spec, loose)
        if loose:
            notes.append(f'left out: {len(loose)} shapes and sites of the world body')
        return spec, notes
    if free:
        raise ModelError(f'{file} must have exactly one root body, found {len(roots)}, one of '
                         f'which is free: {quoted_names([body.name for body in roots])}')
    name = free_name({body.name for body in spec.bodies}, 'root')
    held = f' and {len(loose)} shapes and sites of the world body' if loose else ''
    notes.append(f"new root body '{name}' that holds "
                 f'{quoted_names([body.name for body in roots])}{held}')
    return _wrapped(spec, name), notes


def exclude_neighbours(spec: mujoco.MjSpec, model: mujoco.MjModel, start: Mapping[str, float]
                       ) -> list[str]:
    """
    Exclude collisions of links with the fixed links they move on, if they touch at the start.

    MuJoCo excludes collisions with a parent by itself, except with one that cannot move.

    :param spec: the ``mujoco.MjSpec``, changed in place
    :param model: the same, compiled
    :param start: where joints start, by name [rad or m]
    :returns: what was done, in sentences
    """
    data = mujoco.MjData(model)
    for joint, position in start.items():
        data.joint(joint).qpos[0] = position
    margins = model.geom_margin.copy()
    model.geom_margin[:] += _TOUCHING_M
    mujoco.mj_forward(model, data)
    model.geom_margin[:] = margins
    notes = []
    for contact in data.contact:
        fixed, other = sorted(model.geom_bodyid[contact.geom].tolist(),
                              key=lambda body: int(model.body_weldid[body]))
        mover = int(model.body_weldid[other])
        neighbours = mover and fixed and not model.body_weldid[fixed] and not model.body_weldid[
            model.body_parentid[mover]]
        if neighbours and contact.dist < _TOUCHING_M:
            names = [str(model.body(body).name) for body in (fixed, other)]
            what = f"'{names[0]}' and '{names[1]}' overlap at the start, so they do not collide"
            if what not in notes:
                spec.add_exclude(bodyname1=names[0], bodyname2=names[1])
                notes.append(what)
    return notes


def _leave_out(spec: mujoco.MjSpec, tree: BodyTree) -> list[str]:
    world, notes = spec.worldbody, []
    grounds = [geom for geom in world.geoms if int(geom.type) in _GROUND]
    objects = _objects(spec, tree)
    for what, elements in (('lights', list(world.lights)), ('cameras', list(world.cameras)),
                           ('grounds', grounds), ('bodies', objects)):
        names = [element.name for element in elements if element.name]
        if elements:
            notes.append(f'left out: {len(elements)} {what} of the world body'
                         + (f' ({quoted_names(names)})' if names else ''))
        if elements is not objects:
            delete_elements(spec, elements)
    for body in objects:
        spec.delete(body)
    return notes


def _objects(spec: mujoco.MjSpec, tree: BodyTree) -> list[Any]:
    """Return the root bodies that are not part of the robot or hand, unless all are."""
    model = tree.model
    driven = set().union(*(tree.driven(actuator) for actuator in range(model.nu)))
    objects, roots = [], list(spec.worldbody.bodies)
    for body in roots:
        below = sorted(tree.below(model.body(body.name).id))
        joints = tree.joints(below)
        empty = not joints and not model.body_geomnum[below].any()
        is_object = _is_free(body) and not driven.intersection(joints)
        if body.mocap or empty or (is_object and (driven or len(roots) > 1)):
            objects.append(body)
    return objects if len(objects) < len(roots) else []


def _is_free(body: Any) -> bool:
    return any(int(joint.type) == _FREE for joint in body.joints)


def _wrapped(spec: mujoco.MjSpec, name: str) -> Any:
    whole = mujoco.MjSpec()
    whole.modelname = spec.modelname
    whole.option = spec.option
    with warnings.catch_warnings():
        # MuJoCo 3.3 warns of the empty prefix; composing adds one later.
        warnings.simplefilter('ignore')
        whole.attach(spec, prefix='', frame=whole.worldbody.add_body(name=name).add_frame())
    return whole
