# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joint positions for a pose of the grip site, by damped least squares on a MuJoCo model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray

_DAMPING = 1e-3
_ITERATIONS = 500
#: Larger errors are scaled down to this in each iteration [m, rad].
_LARGEST_ERROR = 0.1
_TOLERANCE = 1e-5


class InverseKinematics:
    """
    Inverse kinematics of one arm.

    :param model: a ``mujoco.MjModel``, such as the one that the node publishes on ``~/mjcf``
    :param joints: names of the arm's joints
    :param site: name of the site that is to reach the pose
    :param others: positions of other joints of the model, by name [rad or m]
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[str], site: str,
                 others: Mapping[str, float]) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        for name, position in others.items():
            self._data.joint(name).qpos[0] = position
        self._qpos = np.array([model.joint(name).qposadr[0] for name in joints])
        self._dofs = np.array([model.joint(name).dofadr[0] for name in joints])
        self._range = np.array([
            joint.range if joint.limited[0] else (-np.inf, np.inf)
            for joint in map(model.joint, joints)])
        self._site = model.site(site).id

    @property
    def ranges(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest joint positions, within half a turn either way [rad], shape (n,)."""
        low, high = np.clip(self._range, -np.pi, np.pi).T
        return low, high

    def forward(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """
        Return the pose of the site.

        :param positions: of the joints [rad], shape (n,)
        :returns: position in ``world`` [m], shape (3,), and rotation matrix, shape (3, 3), copies
        """
        self._data.qpos[self._qpos] = positions
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        return (self._data.site_xpos[self._site].copy(),
                self._data.site_xmat[self._site].reshape(3, 3).copy())

    def solve(self, start: FloatArray, position: FloatArray, rotation: FloatArray) -> FloatArray:
        """
        Return joint positions that bring the site to a pose [rad], shape (n,).

        :param start: joint positions to start from [rad], shape (n,)
        :param position: of the site in ``world`` [m], shape (3,)
        :param rotation: rotation matrix of the site in ``world``, shape (3, 3)
        :raises ValueError: if the pose is not reached
        """
        joints = np.array(start, dtype=float)
        jacobian = np.zeros((6, self._model.nv))
        for _ in range(_ITERATIONS):
            here, turned = self.forward(joints)
            error = np.concatenate([position - here, _rotation_vector(rotation @ turned.T)])
            if np.abs(error).max() < _TOLERANCE:
                return joints
            mujoco.mj_jacSite(self._model, self._data, jacobian[:3], jacobian[3:], self._site)
            arm = jacobian[:, self._dofs]
            error /= max(1.0, np.abs(error).max() / _LARGEST_ERROR)
            step = arm.T @ np.linalg.solve(arm @ arm.T + _DAMPING * np.eye(6), error)
            joints = np.clip(joints + step, *self._range.T)
        raise ValueError('no joint positions found that bring the hand to '
                         f'({", ".join(f"{value:.3f}" for value in position)}) m')


def _rotation_vector(rotation: FloatArray) -> FloatArray:
    quat_wxyz, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(rotation).ravel())
    mujoco.mju_quat2Vel(vector, quat_wxyz, 1.0)
    return vector
