# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Infer how a hand from a file is mounted on an arm, if its pose in the file is another."""

from __future__ import annotations

from collections.abc import Mapping
import itertools

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, product
from manip_sim.arrays import FloatArray
from manip_sim.models.files.fingers import Fingers
from manip_sim.models.files.hands import FoundHand
from manip_sim.models.files.tree import BodyTree

#: Fingers that reach less far give no direction [m].
_SHORT_M = 0.02
#: A palm may reach this far behind its mount, around the flange of the arm [m].
_BEHIND_MOUNT_M = 0.05


def place_root(spec: mujoco.MjSpec, position: ArrayLike, quat_wxyz: FloatArray) -> None:
    """Set the pose of the root body of a hand in the body that it is mounted on."""
    root = spec.worldbody.bodies[0]
    root.pos, root.quat = np.asarray(position, dtype=float), quat_wxyz
    root.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def stand_on_mount(spec: mujoco.MjSpec, tree: BodyTree, hand: FoundHand, start: Mapping[str, float]
                   ) -> list[str]:
    """
    Turn and move a hand whose root pose in the file is not that on an arm.

    Fingers that point more than 45 degrees away from the mount's z axis are turned to it by
    quarter turns, and a palm that reaches farther than 50 mm behind the mount is moved in front.

    :param spec: the ``mujoco.MjSpec``, changed in place
    :returns: what was done, in sentences
    """
    model, notes = tree.model, []
    reach = Fingers(tree, hand, start).grasp_point()
    size = length(reach)
    if size < _SHORT_M:
        return []
    position, quat = model.body_pos[1].copy(), model.body_quat[1].copy()
    if _rotated(quat, reach)[2] < size * np.sqrt(0.5):
        quat, position = _quarter_turn(reach), np.zeros(3)
        notes.append('mount: turned so that the fingers point along z')
    behind = -_lowest(tree, hand, quat) - position[2]
    if behind > _BEHIND_MOUNT_M:
        position[2] += behind
        notes.append(f'mount: {behind:.3f} m along z, so that the palm is in front of it')
    if notes:
        place_root(spec, position, quat)
    return notes


def _quarter_turn(reach: FloatArray) -> FloatArray:
    """Return the rotation w, x, y, z that turns the axis nearest to a direction to z."""
    axis = np.zeros(3)
    nearest = int(np.abs(reach).argmax())
    axis[nearest] = np.sign(reach[nearest])
    quat = np.empty(4)
    if axis[2] < 0.0:
        return np.array([0.0, 1.0, 0.0, 0.0])
    mujoco.mju_quatZ2Vec(quat, axis)
    mujoco.mju_negQuat(quat, quat.copy())
    return quat


def _rotated(quat: FloatArray, vector: FloatArray) -> FloatArray:
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.asarray(vector, dtype=float), quat)
    return turned


def _lowest(tree: BodyTree, hand: FoundHand, quat: FloatArray) -> float:
    """Return the lowest height of fixed shapes above the root, at most 0 [m]."""
    model = tree.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moved: set[int] = set().union(
        *(tree.below(int(model.jnt_bodyid[joint])) for joint in hand.joints))
    still = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) not in moved
             and (model.geom_contype[g] or model.geom_conaffinity[g])]
    back = np.empty(4)
    mujoco.mju_negQuat(back, model.body_quat[1])
    lowest = 0.0
    for geom in still:
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        for signs in itertools.product((-1.0, 1.0), repeat=3):
            corner = (product(data.geom_xmat[geom].reshape(3, 3), centre + half * np.array(signs))
                      + data.geom_xpos[geom] - model.body_pos[1])
            lowest = min(lowest, float(_rotated(quat, _rotated(back, corner))[2]))
    return lowest
