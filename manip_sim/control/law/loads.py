# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Payloads of arms: what carries and moves them, as the inverse dynamics of their bodies."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.law.compiling import inner
from manip_sim.control.law.records import Arm, readable
from manip_sim.physics.physics import WorldArrays

#: A payload: the body that it moves with, the root of its tree, and its mass [kg].
LOAD = np.dtype([('body', np.int64), ('root', np.int64), ('mass', np.float64)], align=True)


class Loads(NamedTuple):
    """
    The payloads of a robot, and what else the dynamics of bodies needs.

    :ivar gravity: of the world, a view [m/s^2], shape (3,)
    :ivar rates: ``cdof_dot``, a view, shape (nv, 6)
    :ivar accelerations: ``qacc``, a view, shape (nv,)
    :ivar loads: records of :data:`LOAD`, shape (k,)
    :ivar places: centres of mass in the frames of the bodies [m], shape (k, 3)
    :ivar inertias: about these, in the axes of the bodies [kg m^2], shape (k, 3, 3)
    :ivar chains: degrees of freedom that move each, and then -1, shape (k, d)
    :ivar moved_by: whether a joint of the robot moves each, shape (k, n)
    """

    gravity: FloatArray
    rates: FloatArray
    accelerations: FloatArray
    loads: NDArray[np.void]
    places: FloatArray
    inertias: FloatArray
    chains: IntArray
    moved_by: BoolArray


def no_loads() -> Loads:
    """Return the payloads of a robot that has none."""
    none = np.zeros(0)
    return Loads(none, np.zeros((0, 6)), none, readable(np.zeros(0, LOAD)), np.zeros((0, 3)),
                 np.zeros((0, 3, 3)), np.zeros((0, 0), np.int64), np.zeros((0, 0), np.bool_))


@inner
def velocity_at(place: FloatArray, motion: FloatArray, center: FloatArray, i: int) -> float:
    """Return a component of the velocity of a place for a spatial motion about a centre."""
    one, two = (i + 1) % 3, (i + 2) % 3
    return float(motion[3 + i] + (
        motion[one] * (place[two] - center[two]) - motion[two] * (place[one] - center[one])))


@inner
def find_reaction(world: WorldArrays, loads: Loads, k: int, accelerations: FloatArray,
                  moves: bool, place: FloatArray, reaction: FloatArray) -> None:
    """
    Write where a payload is, and the force and torque there that carry and move it.

    :param accelerations: of all degrees of freedom [rad/s^2 or m/s^2], shape (nv,)
    :param moves: whether it moves; else these are those that carry its weight
    :param place: of its centre of mass in the world [m], shape (3,), written
    :param reaction: force [N] and torque about that [N m] in the world, shape (6,), written
    """
    load, lever, twist, change = loads.loads[k], np.empty(3), np.zeros(6), np.zeros(6)
    axes, center = world.kinematics.body_axes[load.body], world.kinematics.centers[load.root]
    for i in range(3):
        place[i] = world.kinematics.bodies[load.body, i]
        for j in range(3):
            place[i] += axes[i, j] * loads.places[k, j]
        reaction[i], reaction[3 + i] = -load.mass * loads.gravity[i], 0.0
        lever[i] = place[i] - center[i]
    if not moves:
        return
    for dof in loads.chains[k]:
        if dof >= 0:
            for i in range(6):
                motion = world.kinematics.motions[dof, i]
                twist[i] += motion * world.velocities[dof]
                change[i] += (loads.rates[dof, i] * world.velocities[dof]
                              + motion * accelerations[dof])
    _add_inertia(load.mass, loads.inertias[k], axes, lever, twist, change, reaction)


@inner
def _add_inertia(mass: float, inertia: FloatArray, axes: FloatArray, lever: FloatArray,
                 twist: FloatArray, change: FloatArray, reaction: FloatArray) -> None:
    """
    Add the force and torque that accelerate a body.

    :param inertia: in its axes [kg m^2], shape (3, 3)
    :param lever: from the point of the spatial vectors to its centre of mass [m], shape (3,)
    :param twist: angular and linear velocity, shape (6,)
    :param change: of that in time, shape (6,)
    """
    speed, turned, spun = np.empty(3), np.zeros(3), np.zeros(3)
    for i in range(3):
        one, two = (i + 1) % 3, (i + 2) % 3
        speed[i] = twist[3 + i] + twist[one] * lever[two] - twist[two] * lever[one]
        along, about = 0.0, 0.0
        for j in range(3):
            along += axes[j, i] * change[j]
            about += axes[j, i] * twist[j]
        for j in range(3):
            turned[j] += inertia[j, i] * along
            spun[j] += inertia[j, i] * about
    momentum = np.zeros(3)
    for i in range(3):
        for j in range(3):
            reaction[3 + i] += axes[i, j] * turned[j]
            momentum[i] += axes[i, j] * spun[j]
    for i in range(3):
        one, two = (i + 1) % 3, (i + 2) % 3
        reaction[i] += mass * (
            change[3 + i] + change[one] * lever[two] - change[two] * lever[one]
            + twist[one] * speed[two] - twist[two] * speed[one])
        reaction[3 + i] += twist[one] * momentum[two] - twist[two] * momentum[one]


@inner
def find_inertia(world: WorldArrays, loads: Loads, arm: Arm, inertia: FloatArray) -> None:
    """
    Write the inertia of an arm with what it holds.

    :param inertia: of the joints of the arm [kg m^2, kg m or kg], shape (n, n), written
    """
    count, turned = len(arm.joints), np.zeros(3)
    for i in range(count):
        for j in range(count):
            inertia[i, j] = world.inertia[arm.places[i, j]] if arm.places[i, j] >= 0 else 0.0
    motions, place, reaction = np.zeros((count, 6)), np.empty(3), np.empty(6)
    for k in range(len(loads.loads)):
        load = loads.loads[k]
        find_reaction(world, loads, k, loads.accelerations, False, place, reaction)
        axes, center = world.kinematics.body_axes[load.body], world.kinematics.centers[load.root]
        for n in range(count):
            joint, moves = arm.joints[n], loads.moved_by[k, arm.joints[n].joint]
            motion = world.kinematics.motions[joint.dof]
            for i in range(3):
                motions[n, i] = motions[n, 3 + i] = 0.0
                if moves:
                    motions[n, i] = velocity_at(place, motion, center, i)
                    for j in range(3):
                        motions[n, 3 + i] += axes[j, i] * motion[j]
        for n in range(count):
            for i in range(3):
                turned[i] = 0.0
                for j in range(3):
                    turned[i] += loads.inertias[k, i, j] * motions[n, 3 + j]
            for m in range(count):
                for i in range(3):
                    inertia[n, m] += (load.mass * motions[n, i] * motions[m, i]
                                      + turned[i] * motions[m, 3 + i])


@inner
def carry(world: WorldArrays, loads: Loads, servos: Any, accelerations: FloatArray, moves: bool,
          efforts: FloatArray) -> None:
    """
    Add the efforts of joints that carry payloads, and move them if they move.

    :param servos: records, shape (n,)
    :param accelerations: of all degrees of freedom [rad/s^2 or m/s^2], shape (nv,)
    :param efforts: [N m or N], shape (n,), changed
    """
    place, reaction = np.empty(3), np.empty(6)
    for k in range(len(loads.loads)):
        find_reaction(world, loads, k, accelerations, moves, place, reaction)
        center = world.kinematics.centers[loads.loads[k].root]
        for n in range(len(servos)):
            if not loads.moved_by[k, n] or not servos[n].compensated:
                continue
            motion = world.kinematics.motions[servos[n].dof]
            for i in range(3):
                efforts[n] += (velocity_at(place, motion, center, i) * reaction[i]
                               + motion[i] * reaction[3 + i])
