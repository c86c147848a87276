# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Poses of the bodies of a model from positions of joints, and their names on the page."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.quaternion import matrix_of
from manip_sim.viewer.page.plain_text import plain

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
#: A node has one list of joints for each robot; another may send many.
_MAX_KNOWN = 100


class Kinematics:
    """
    The kinematics of a model.

    :ivar data: its ``mujoco.MjData``, current after :meth:`compute`
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self._scalar = {model.joint(i).name: int(model.jnt_qposadr[i]) for i in range(model.njnt)
                        if int(model.jnt_type[i]) in _SCALAR}
        self._free = {model.body(int(model.jnt_bodyid[i])).name: int(model.jnt_qposadr[i])
                      for i in range(model.njnt) if int(model.jnt_type[i]) == _FREE}
        self._known: dict[tuple[str, ...], tuple[list[int], list[int]]] = {}
        self.compute()

    @property
    def scalar_joints(self) -> list[str]:
        """The joints that :meth:`set_joints` takes."""
        return list(self._scalar)

    @property
    def free_bodies(self) -> list[str]:
        """The bodies that :meth:`place` takes."""
        return list(self._free)

    def set_joints(self, names: Sequence[str], positions: Sequence[float] | FloatArray
                   ) -> None:
        """
        Set the positions of scalar joints.

        :param names: those that the model does not have are ignored
        :param positions: [rad or m]
        """
        key = tuple(names)
        if key not in self._known:
            if len(self._known) >= _MAX_KNOWN:
                self._known.clear()
            rows = [i for i, name in enumerate(key) if name in self._scalar]
            self._known[key] = rows, [self._scalar[key[i]] for i in rows]
        rows, addresses = self._known[key]
        self.data.qpos[addresses] = np.asarray(positions, dtype=float)[rows]

    def place(self, body: str, position: FloatArray, quat_wxyz: FloatArray) -> None:
        """Set the pose of a free body in ``world`` [m]; other bodies are ignored."""
        address = self._free.get(body)
        if address is not None:
            self.data.qpos[address:address + 3] = position
            self.data.qpos[address + 3:address + 7] = quat_wxyz

    def compute(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)


#: Scale of the font of 12 pixels; width of a character and height of a line in it [pixels].
_SCALE, _CHARACTER, _LINE = 0.8, 5.8, 15.0
#: Least time between two arrangements [s]; a change that is not sent [pixels].
_PERIOD_S, _SAME = 0.1, 0.5
#: A label that is nearer to the camera, or behind it, is not shown [m].
_NEAREST_M = 0.05


def arrange(corners: FloatArray, widths: FloatArray) -> FloatArray:
    """
    Return where labels do not overlap: each moved up or down by as few lines as possible.

    :param corners: left upper corners of labels, to the right and down [pixels], shape (n, 2)
    :param widths: of the labels [pixels], shape (n,)
    :returns: the corners that are free, shape (n, 2)
    """
    places = corners.copy()
    count = len(places)
    lines = sorted(range(-count, count + 1), key=abs)
    done = np.zeros(count, dtype=bool)
    for i in np.argsort(corners[:, 1], kind='stable').tolist():
        x = places[i, 0]
        beside = done & (places[:, 0] < x + widths[i]) & (x < places[:, 0] + widths)
        taken = places[beside, 1]
        places[i, 1] += _LINE * next(n for n in lines if not (
            np.abs(taken - places[i, 1] - _LINE * n) < _LINE).any())
        done[i] = True
    return places


class BodyLabels:
    """
    The names of the bodies that have joints.

    :param server: the ``viser.ViserServer``
    :param model: that has the bodies
    """

    def __init__(self, server: Any, model: mujoco.MjModel) -> None:
        self._server = server
        self._bodies = sorted(set(model.jnt_bodyid.tolist()))
        self._names = [plain(model.body(body).name) for body in self._bodies]
        self._widths = np.array([_CHARACTER * (len(name) + 1) for name in self._names])
        self._shown = False
        self._due_s = -math.inf
        #: By browser: its labels, and where they were last.
        self._labels: dict[int, tuple[list[Any], FloatArray]] = {}

    def show(self, shown: bool) -> None:
        """Show or hide the names, from the next :meth:`update` on."""
        self._shown, self._due_s = shown, -math.inf
        if not shown:
            for labels, _ in self._labels.values():
                for label in labels:
                    label.remove()
            self._labels = {}

    def update(self, now_s: float, posture: Kinematics) -> None:
        """Place the labels beside their bodies as each browser sees them; wall time [s]."""
        if not self._shown or now_s < self._due_s or not self._bodies:
            return
        self._due_s = now_s + _PERIOD_S
        clients = self._server.get_clients()
        self._labels = {
            number: labels for number, labels in self._labels.items() if number in clients}
        points = posture.data.xpos[self._bodies]
        for number, client in clients.items():
            if number not in self._labels:
                self._labels[number] = [client.scene.add_label(
                    f'/labels/{i}', name, font_screen_scale=_SCALE)
                    for i, name in enumerate(self._names)], np.full((len(points), 2), np.inf)
            self._place(number, client.camera, points)

    def _place(self, number: int, camera: Any, points: FloatArray) -> None:
        axes = matrix_of(camera.wxyz)  # To the right, down, ahead.
        places = (points - camera.position) @ axes
        seen = places[:, 2] > _NEAREST_M
        scale = np.where(seen, places[:, 2], 1.0) * (
            2.0 * math.tan(camera.fov / 2.0) / max(1, camera.image_height))  # [m per pixel]
        corners = places[:, :2] / scale[:, None]
        labels, before = self._labels[number]
        if np.abs(corners - before).max() < _SAME:
            return
        moved = arrange(corners, np.where(seen, self._widths, 0.0)) - corners
        self._labels[number] = labels, corners
        for i, label in enumerate(labels):
            label.visible = bool(seen[i])
            label.position = points[i] + scale[i] * (axes[:, :2] @ moved[i])
