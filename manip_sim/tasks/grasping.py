# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Contacts of an object, and the arm that holds it, by the contacts of the physics."""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np

from manip_sim.physics.entities import bodies_in_contact, pulling_bodies
from manip_sim.simulation import SimulatedRobot, Simulation


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
