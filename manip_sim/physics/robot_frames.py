# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Frames that Cartesian commands may refer to: the world and the links of a robot."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import CommandError, describe_choices
from manip_sim.frame_names import FrameNames
from manip_sim.quoting import quoted

WORLD = 'world'


@dataclass(frozen=True)
class Frame:
    """
    A body, or a site on it.

    :ivar name: in the model
    :ivar body: id of the body
    :ivar site: id of the site, or None
    """

    name: str
    body: int
    site: int | None = None

    @property
    def number(self) -> tuple[int, int]:
        """The id of the site or the body, and 1 if it is a site."""
        return (self.body, 0) if self.site is None else (self.site, 1)

    def rebind(self, model: mujoco.MjModel) -> None:
        """Take over the ids in another model, in which the frame is the same."""
        if self.site is None:
            body = int(model.body(self.name).id)
        else:
            site = int(model.site(self.name).id)
            object.__setattr__(self, 'site', site)
            body = int(model.site_bodyid[site])
        object.__setattr__(self, 'body', body)

    def pose(self, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """
        Return position [m], shape (3,), and rotation matrix, shape (3, 3), in the world, copies.

        :param data: the ``mujoco.MjData`` after ``mj_kinematics``
        """
        position, rotation = self.view(data)
        return position.copy(), rotation.copy()

    def view(self, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """
        Return the same as views, which change when the frame moves.

        :param data: the ``mujoco.MjData`` after ``mj_kinematics``
        """
        if self.site is not None:
            return data.site_xpos[self.site], data.site_xmat[self.site].reshape(3, 3)
        return data.xpos[self.body], data.xmat[self.body].reshape(3, 3)

    def jacobian(self, model: mujoco.MjModel, data: mujoco.MjData, dofs: slice | IntArray
                 ) -> FloatArray:
        """
        Return the Jacobian of its position and rotation in the world, shape (6, n).

        :param data: the ``mujoco.MjData`` after ``mj_kinematics`` and ``mj_comPos``
        :param dofs: addresses of the joints in ``qvel``, shape (n,)
        """
        jacobian = np.empty((6, model.nv))
        if self.site is None:
            mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], self.body)
        else:
            mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], self.site)
        return np.ascontiguousarray(jacobian[:, dofs])


class RobotFrames:
    """
    The frames of a robot by the names that they have in TF.

    :param model: the compiled ``mujoco.MjModel``
    :param bodies: names of its links
    :param sites: names of frames on links, such as ``gripper0_right_grip_site``
    """

    def __init__(self, model: mujoco.MjModel, bodies: Iterable[str], sites: Iterable[str]) -> None:
        self._frames, names = {WORLD: Frame(WORLD, 0)}, FrameNames(model)
        for name in bodies:
            body = int(model.body(name).id)
            self._frames[names.bodies[body]] = Frame(name, body)
        for name in sites:
            site = int(model.site(name).id)
            self._frames[names.sites[site]] = Frame(name, int(model.site_bodyid[site]), site)

    def rebind(self, model: mujoco.MjModel) -> None:
        """Take over the ids of all frames in another model."""
        for frame in self._frames.values():
            frame.rebind(model)

    def find(self, name: str, what: str) -> Frame:
        """
        Return a frame.

        :param name: of the frame; empty for ``world``
        :param what: what needs it, for the message
        :raises CommandError: naming the nearest frames if there is none of this name
        """
        frame = self._frames.get(name or WORLD)
        if frame is None:
            raise CommandError(f'{what}: unknown frame {quoted(name)}: '
                               f'{describe_choices(name, self._frames)}')
        return frame
