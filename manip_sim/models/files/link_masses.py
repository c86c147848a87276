# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Masses and inertias that a URDF lacks, or that no body can have, made possible."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.quoting import quoted_names

#: Share of an effort limit that the weight may need in any pose; real arms are like this.
_SHARE = 0.5
#: Densities are not made smaller than by this factor.
_LEAST = 0.01
_POSES = 50
#: Of a moving link whose file gives none, and the least moment of inertia [kg, kg m^2].
_LEAST_KG, _LEAST_INERTIA = 1e-4, 1e-8
#: Of what a link is made whose mass alone is known [kg/m^3].
_DENSITY = 1000.0
#: Moments up to this one, or up to this share of the greatest, may be zero to MuJoCo [kg m^2].
_ZERO, _ZERO_SHARE = 1e-14, 1e-7
_PAIRS = [''.join(pair) for pair in combinations_with_replacement('xyz', 2)]


def masses_from_shapes(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[str]:
    """Say which moving links of a URDF have a mass that follows from their shapes."""
    return [f"link '{body.name}' has no <inertial>: {model.body(body.name).mass[0]:.4g} kg from "
            f'its collision shapes at {max(geom.density for geom in _colliding(body)):.4g} kg/m^3'
            for body in _guessed(spec, model)]


def lighten(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[str]:
    """
    Reduce the density of shapes that give a link its mass, if motors could not carry the links.

    Shapes for collisions are often thicker than the link, and there twice.
    """
    guessed = list(_guessed(spec, model))
    share = _carried_share(model, [model.body(body.name).id for body in guessed])
    for body in guessed if share < 1.0 else ():
        for geom in _colliding(body):
            geom.density *= share
    return ['links without <inertial> are lighter than their shapes at the usual density, so that '
            f'no pose needs more than {_SHARE:.0%} of an effort limit'] if share < 1.0 else []


def _guessed(spec: mujoco.MjSpec, model: mujoco.MjModel) -> Iterator[Any]:
    """Yield the bodies that move and whose mass follows from their shapes."""
    for body in spec.bodies[1:]:
        if (not body.explicitinertial and _colliding(body)
                and model.body_weldid[model.body(body.name).id]):
            yield body


def _colliding(body: Any) -> list[Any]:
    return [geom for geom in body.geoms if geom.contype or geom.conaffinity]


def _carried_share(model: mujoco.MjModel, guessed: list[int]) -> float:
    """Return by which factor some masses have to be smaller so that all effort limits carry."""
    limited = np.flatnonzero(model.jnt_actfrclimited)
    if not guessed or not len(limited):
        return 1.0
    dofs = model.jnt_dofadr[limited]
    room = _SHARE * np.abs(model.jnt_actfrcrange[limited]).max(axis=1)
    share = 1.0
    others = sorted(set(range(1, model.nbody)) - set(guessed))
    for data in _in_random_poses(model):
        known, made = (np.abs(_weight(model, data, bodies)[dofs]) for bodies in (others, guessed))
        heavy = (made > 0.0) & (known < room)
        share = float(np.min((room - known)[heavy] / made[heavy], initial=share))
    return max(share, _LEAST)


def greatest_weight(model: mujoco.MjModel) -> FloatArray:
    """Return the greatest effort that the weight of all bodies asks in any pose, shape (nv,)."""
    bodies = [*range(1, model.nbody)]
    weights = [np.abs(_weight(model, data, bodies)) for data in _in_random_poses(model)]
    greatest: FloatArray = np.max(weights, axis=0)
    return greatest


def _in_random_poses(model: mujoco.MjModel) -> Iterator[mujoco.MjData]:
    """Yield the same data again and again, in other poses."""
    free = np.flatnonzero(model.jnt_limited == 0)
    low, high = model.jnt_range.T.copy()
    low[free], high[free] = -np.pi, np.pi
    random, data = np.random.default_rng(0), mujoco.MjData(model)
    scalar = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    for _ in range(_POSES):
        data.qpos[model.jnt_qposadr[scalar]] = random.uniform(low, high)[scalar]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        yield data


def _weight(model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int]) -> FloatArray:
    """Return the effort that the weight of some bodies asks of the joints, shape (nv,)."""
    effort, jacobian = np.zeros(model.nv), np.empty((3, model.nv))
    for body in bodies:
        mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
        mass = model.body_mass[body] * (1.0 - model.body_gravcomp[body])
        effort -= mass * model.opt.gravity @ jacobian
    return effort


def make_physical(robot: ElementTree.Element) -> list[str]:
    """
    Make the masses of moving links positive and the moments of inertia of all links possible.

    An inertia matrix keeps its axes; a moment below the least becomes that. MuJoCo itself corrects
    moments of which one is greater than the sum of the others. Products that are missing are zero,
    missing moments those of a ball of water, and an ``<inertial>`` without mass is left out.

    :param robot: root of the URDF, changed in place; numbers that are none are left to MuJoCo
    :returns: a sentence for each kind of change
    """
    moved = {child.get('link') for joint in robot.iter('joint') if joint.get('type') != 'fixed'
             for child in joint.findall('child')}
    weightless, projected, balls, massless = [], [], [], []
    for link in robot.iter('link'):
        inertial = link.find('inertial')
        if inertial is None:
            continue
        mass, inertia = inertial.find('mass'), inertial.find('inertia')
        if mass is None:
            link.remove(inertial)
            massless.append(str(link.get('name')))
            continue
        if inertia is None:
            inertia = ElementTree.SubElement(inertial, 'inertia')
            balls.append(str(link.get('name')))
            _write(inertia, np.diag([_moment_of_ball(mass)] * 3))
        for pair in _PAIRS:
            inertia.attrib.setdefault(f'i{pair}', '0')
        try:
            moments, axes = np.linalg.eigh(_matrix(inertia))
            kilograms = float(mass.get('value', 0.0))
        except (ValueError, np.linalg.LinAlgError):
            continue
        name = str(link.get('name'))
        needs_mass = kilograms <= 0.0 and link.get('name') in moved
        if needs_mass:
            mass.set('value', repr(_LEAST_KG))
            weightless.append(name)
        zero = max(_ZERO, _ZERO_SHARE * moments.max())
        if moments.min() < 0.0 or (moments.min() <= zero and (kilograms > 0.0 or needs_mass)):
            _write(inertia, axes * np.maximum(moments, _LEAST_INERTIA) @ axes.T)
            projected.append(name)
    notes = []
    if massless:
        notes.append(f'left out: <inertial> without <mass>, of {quoted_names(massless)}')
    if balls:
        notes.append('the moment of inertia of a ball of water for links whose <inertial> has no '
                     f'<inertia>: {quoted_names(balls)}')
    if weightless:
        notes.append(f'{_LEAST_KG * 1e3:g} g for moving links of mass 0: '
                     f'{quoted_names(weightless)}')
    if projected:
        notes.append('moments of inertia that are not positive became '
                     f'{_LEAST_INERTIA:g} kg m^2: {quoted_names(projected)}')
    return notes


def _moment_of_ball(mass: ElementTree.Element) -> float:
    """Return the moment of inertia of a ball of a mass [kg m^2]; 0 if it is no positive number."""
    try:
        kilograms = max(float(mass.get('value', 0.0)), 0.0)
    except ValueError:
        return 0.0
    radius = (3.0 * kilograms / (4.0 * np.pi * _DENSITY)) ** (1.0 / 3.0)
    return float(0.4 * kilograms * radius**2)


def _matrix(inertia: ElementTree.Element) -> FloatArray:
    matrix = np.zeros((3, 3))
    for pair in _PAIRS:
        row, column = ('xyz'.index(letter) for letter in pair)
        matrix[row, column] = matrix[column, row] = float(inertia.get(f'i{pair}', 0.0))
    if not np.isfinite(matrix).all():
        raise ValueError('not finite')
    return matrix


def _write(inertia: ElementTree.Element, matrix: FloatArray) -> None:
    for pair in _PAIRS:
        row, column = ('xyz'.index(letter) for letter in pair)
        inertia.set(f'i{pair}', repr(float(matrix[row, column])))
