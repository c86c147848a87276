# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Draw positions, place objects and goals in a simulation, and tell which objects are held.

Only ``random()`` draws, with sums and products after it: the same bits with every NumPy.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
import math

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, wxyz_to_xyzw
from manip_sim.arrays import FloatArray
from manip_sim.models.arenas import Arena
from manip_sim.physics.entities import bodies_in_contact, pulling_bodies
from manip_sim.physics.poses_and_twists import Pose, Twist
from manip_sim.simulation import SimulatedRobot, Simulation

_GOAL_RGBA = (0.1, 0.8, 0.2, 0.5)


def draw(random: np.random.Generator, low: ArrayLike, high: ArrayLike) -> FloatArray:
    """
    Return numbers that are evenly distributed in a box.

    :param low: the least, shape (n,)
    :param high: the greatest, shape (n,)
    """
    lowest: FloatArray = np.asarray(low, dtype=float)
    highest: FloatArray = np.asarray(high, dtype=float)
    numbers: FloatArray = lowest + (highest - lowest) * random.random(len(lowest))
    return numbers


def draw_apart(random: np.random.Generator, count: int, half_area: Sequence[float],
               apart_m: float) -> FloatArray:
    """
    Return points about the origin that are at least a distance apart.

    :param half_area: half extents of the area along x and y [m]
    :param apart_m: least distance between two of them [m]
    :returns: shape (count, 2)
    """
    half = np.asarray(half_area, dtype=float)
    while True:
        numbers = draw(random, [-1.0] * 2 * count, [1.0] * 2 * count)
        points: FloatArray = numbers.reshape(count, 2) * half
        if all(length(points[i] - points[j]) >= apart_m for i in range(count) for j in range(i)):
            return points


def draw_yaw(random: np.random.Generator, most_rad: float) -> FloatArray:
    """
    Return a turn about z, almost evenly distributed, as a quaternion w, x, y, z.

    :param most_rad: greatest angle in both directions, below pi [rad]
    """
    # No sine is taken of a drawn number: its last bit may differ between processors.
    tangent = math.tan(most_rad / 2.0) * (2.0 * random.random() - 1.0)
    norm = math.sqrt(1.0 + tangent * tangent)
    return np.array([1.0 / norm, 0.0, 0.0, tangent / norm])


def place(simulation: Simulation, name: str, position: FloatArray,
          quat_wxyz: Sequence[float] | FloatArray = (1.0, 0.0, 0.0, 0.0)) -> None:
    """
    Place an object, at rest.

    :param name: of the free body
    :param position: of its frame in ``world`` [m], shape (3,)
    :param quat_wxyz: of its frame in ``world``
    """
    simulation.entities.place(simulation.data, name, Pose(position, wxyz_to_xyzw(quat_wxyz)),
                              Twist(np.zeros(3), np.zeros(3)))


def add_goal(arena: Arena, name: str, radius_m: float, flat: bool = False) -> None:
    """
    Add a mocap body to an arena that is only seen, such as the point to reach.

    :param name: of the body
    :param radius_m: of the sphere or disc [m]
    :param flat: whether it is a disc
    """
    shapes, size = mujoco.mjtGeom, [radius_m, 0.001, 0.0]
    body = arena.spec.worldbody.add_body(name=name, mocap=True)
    body.add_geom(name=f'{name}_visual', size=size, rgba=_GOAL_RGBA, contype=0, conaffinity=0,
                  type=shapes.mjGEOM_CYLINDER if flat else shapes.mjGEOM_SPHERE, group=2)


def move_mocap(simulation: Simulation, name: str, position: FloatArray,
               quat_wxyz: Sequence[float] | FloatArray = (1.0, 0.0, 0.0, 0.0)) -> None:
    """
    Move a mocap body; what follows from it in the data is computed later.

    :param name: of the body
    :param position: in ``world`` [m], shape (3,)
    :param quat_wxyz: in ``world``
    """
    mocap = int(simulation.model.body(name).mocapid[0])
    simulation.data.mocap_pos[mocap] = position
    simulation.data.mocap_quat[mocap] = quat_wxyz


def position_of(simulation: Simulation, body: str) -> FloatArray:
    """Return the position of a body in ``world`` [m], shape (3,), a copy."""
    return np.array(simulation.data.body(body).xpos)


def rotation_of(simulation: Simulation, body: str) -> FloatArray:
    """Return the rotation of a body in ``world``, shape (3, 3), a copy."""
    return np.array(simulation.data.body(body).xmat).reshape(3, 3)


def nearness(distance_m: float, scale_m: float = 0.1) -> float:
    """
    Return 1 for no distance, 1/2 at a scale, towards 0 far away.

    :param distance_m: [m]
    :param scale_m: [m]
    """
    return scale_m / (scale_m + distance_m)


def touching(simulation: Simulation, body: str) -> set[int]:
    """
    Return the ids of the bodies that touch an object, by the contacts that carry forces.

    :param body: of the object, which is one body
    """
    object_id = simulation.model.body(body).id
    _, pairs = bodies_in_contact(simulation.model, simulation.data)
    bodies: set[int] = set(pairs[pairs[:, 0] == object_id, 1].tolist())
    return bodies | set(pairs[pairs[:, 1] == object_id, 0].tolist())


def bodies_of_gripper(simulation: Simulation, robot: SimulatedRobot, arm: str) -> set[int]:
    """
    Return the ids of the bodies of a gripper.

    :param arm: such as ``right``
    """
    gripper = robot.parts[f'{arm}/gripper'].gripper
    assert gripper is not None
    return {int(simulation.model.body(name).id) for name in gripper.bodies}


def pressure(simulation: Simulation, bodies: Collection[int], on: Collection[str] = (),
             but: Collection[str] = ()) -> float:
    """
    Return the sum of the normal forces between bodies and others [N].

    :param bodies: ids of the bodies; forces between them do not count
    :param on: names of the others; none: all
    :param but: names of others that do not count
    """
    model, data = simulation.model, simulation.data
    total, force = 0.0, np.empty(6)
    used, pairs = bodies_in_contact(model, data)
    for number, (first, other) in zip(used.tolist(), pairs.tolist()):
        if (first in bodies) == (other in bodies):
            continue
        name = model.body(other if first in bodies else first).name
        if name not in but and (not on or name in on):
            mujoco.mj_contactForce(model, data, number, force)
            total += float(force[0])
    return total


def held_only_by(simulation: Simulation, body: str, robot: SimulatedRobot, arm: str) -> bool:
    """
    Return whether an arm holds an object: its gripper touches it, and nothing else does.

    Two bodies of the gripper have to touch it, or one that sucks it.

    :param body: of the object
    :param robot: that has the arm
    :param arm: such as ``right``
    """
    touched = touching(simulation, body)
    sucked = touched & pulling_bodies(simulation.model, simulation.data)
    return touched <= bodies_of_gripper(simulation, robot, arm) and (
        len(touched) >= 2 or bool(sucked))


def speed(simulation: Simulation, body: str) -> float:
    """Return how fast a body moves in ``world`` [m/s]."""
    velocity = np.empty(6)
    mujoco.mj_objectVelocity(simulation.model, simulation.data, int(mujoco.mjtObj.mjOBJ_BODY),
                             simulation.model.body(body).id, velocity, 0)
    return float(mujoco.mju_norm3(velocity[3:]))
