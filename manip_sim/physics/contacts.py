# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Contacts of bodies, and their forces."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Contacts:
    """
    The contacts of one instant that carry a force, or may.

    :ivar position: in ``world`` [m], shape (n, 3)
    :ivar force: on :attr:`body`, in the axes of ``world`` [N], shape (n, 3)
    :ivar body: of the two that touch, the one that can move; if both can, the later one in the
        model, such as the object and not the gripper, shape (n,)
    """

    position: FloatArray
    force: FloatArray
    body: IntArray


def bodies_in_contact(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[IntArray, IntArray]:
    """
    Return the contacts of geoms that carry a force, or may, at the last ``mj_forward``.

    :param model: the ``mujoco.MjModel``
    :param data: its ``mujoco.MjData``
    :returns: their numbers, shape (n,), and the ids of the two bodies of each, shape (n, 2)
    """
    contact = data.contact
    # Contacts of geoms, as opposed to flexes, that are among the constraints.
    used = np.flatnonzero((contact.efc_address >= 0) & (contact.geom >= 0).all(axis=1))
    return used, model.geom_bodyid[contact.geom[used]].astype(np.int64).reshape(-1, 2)


def pulling_bodies(model: mujoco.MjModel, data: mujoco.MjData) -> set[int]:
    """
    Return the ids of the bodies that adhesion holds to what they touch, such as suction cups.

    :param model: the ``mujoco.MjModel``
    :param data: its ``mujoco.MjData``
    """
    pulls = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_BODY)) & (data.actuator_force > 0.0)
    bodies: set[int] = set(model.actuator_trnid[pulls, 0].tolist())
    return bodies


def read_contacts(model: mujoco.MjModel, data: mujoco.MjData) -> Contacts:
    """
    Return the contacts of geoms at the instant of the last ``mj_forward``, copies.

    :param model: the ``mujoco.MjModel``
    :param data: its ``mujoco.MjData``
    """
    contact = data.contact
    used, body = bodies_in_contact(model, data)
    local = np.empty((len(used), 6))
    for row, index in zip(local, used.tolist()):
        mujoco.mj_contactForce(model, data, index, row)
    # MuJoCo gives the force on the second body, in axes that are the rows of the contact frame.
    force = np.einsum('nij,ni->nj', contact.frame[used].reshape(-1, 3, 3), local[:, :3])
    first = (body[:, 0] > body[:, 1]) & (model.body_weldid[body[:, 0]] > 0)
    first |= model.body_weldid[body[:, 1]] == 0
    force[first] *= -1.0
    return Contacts(contact.pos[used], force, np.where(first, body[:, 0], body[:, 1]))
