# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Frames between a body and its parent, if several joints, or one off its origin, move it.

A URDF has one joint between two links, so there such a body comes after a chain of links,
``<joint>_link``. Here each of them has its pose in the body's parent.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


class JointFrames:
    """
    The frames of the joints of one body.

    :param model: the compiled ``mujoco.MjModel``
    :param body: id of the body
    :ivar joints: ids of the joints that have a frame; none if the body's own frame is enough
    """

    def __init__(self, model: mujoco.MjModel, body: int) -> None:
        self._model = model
        self._body = body
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints = list(range(first, first + count))
        kinds = {int(model.jnt_type[joint]) for joint in joints}
        if not joints or not kinds <= {_HINGE, _SLIDE}:
            joints = []
        elif int(model.jnt_type[joints[-1]]) == _SLIDE or not model.jnt_pos[joints[-1]].any():
            joints.pop()  # The frame of the last one is that of the body.
        self.joints = joints

    def poses(self, data: mujoco.MjData) -> list[tuple[FloatArray, FloatArray]]:
        """
        Return the poses of the frames in the body's parent.

        :param data: the ``mujoco.MjData``
        :returns: position [m], shape (3,), and quaternion w, x, y, z of each, in the order of
            :attr:`joints`
        """
        model, found = self._model, []
        position = np.array(model.body_pos[self._body])
        quat_wxyz = np.array(model.body_quat[self._body])
        for joint in self.joints:
            address, axis = int(model.jnt_qposadr[joint]), model.jnt_axis[joint]
            moved = float(data.qpos[address] - model.qpos0[address])
            if int(model.jnt_type[joint]) == _SLIDE:
                position = position + _turned(moved * axis, quat_wxyz)
                found.append((position, quat_wxyz))
                continue
            anchor, turn, turned = model.jnt_pos[joint], np.empty(4), np.empty(4)
            position = position + _turned(anchor, quat_wxyz)
            mujoco.mju_axisAngle2Quat(turn, axis, moved)
            mujoco.mju_mulQuat(turned, quat_wxyz, turn)
            quat_wxyz = turned
            found.append((position, quat_wxyz))
            position = position - _turned(anchor, quat_wxyz)
        return found


def _turned(vector: Any, quat_wxyz: FloatArray) -> FloatArray:
    result = np.empty(3)
    mujoco.mju_rotVecQuat(result, np.asarray(vector, dtype=float), quat_wxyz)
    return result
