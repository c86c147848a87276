# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A mount or a mobile base from a file."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import UnknownNameError
from manip_sim.models.bases import MobileBaseModel, MountModel, RobotBaseModel
from manip_sim.models.files.actuation import own_each_joint
from manip_sim.models.files.body_tree import BodyTree
from manip_sim.models.files.model_file import ModelFile, read_model, shape_heights
from manip_sim.models.files.part_descriptions import BaseDescription
from manip_sim.models.files.xacro_expansion import stem_of
from manip_sim.models.loading import compile_copy

#: A base whose lowest point is at most so far from z = 0 stands on the floor [m].
_ON_FLOOR_M = 0.02


class FileBase(RobotBaseModel, registered=False):
    """
    A base that a robot stands on.

    :param model_file: the file as read
    :param top: where the robot stands, in the frame of the root body [m], shape (3,)
    :param idn: number or word in names
    :param loose: names of actuators that are not of the base's joints
    :ivar inferred: the inferences and omissions, in sentences
    """

    inferred: list[str]

    _refers_to_all = True  # As it was read with ``read_model``.

    def __init__(self, model_file: ModelFile, top: FloatArray, idn: int | str = 0,
                 loose: Collection[str] = ()) -> None:
        self._model_file, self._loose_actuators = model_file, loose
        x, y, z = top.tolist()
        self._top_offset = (x, y, z)
        self.inferred = model_file.inferred
        if model_file.mocap is not None:
            self.inferred += model_file.mocap.left_out()
        self._keyframes = model_file.keyframes
        super().__init__(model_file.file, idn=idn)

    def _read(self) -> Any:
        return self._model_file.spec

    def _record(self) -> None:
        super()._record()
        self._actuators = [name for name in self._actuators if name not in self._loose_actuators]

    @property
    def name(self) -> str:
        """Name of the file and idn."""
        return f'{stem_of(self.file)}{self.idn}'


class FileMount(FileBase, MountModel, registered=False):
    """A mount without joints."""


class FileMobileBase(FileBase, MobileBaseModel, registered=False):
    """A base with joints."""

    @property
    def bottom_offset(self) -> FloatArray:
        """
        From the root to the floor [m], shape (3,), a copy.

        The root of a free base stands above z = 0 of its file.
        """
        free = any(int(joint.type) == int(mujoco.mjtJoint.mjJNT_FREE)
                   for joint in self._root().joints)
        return -self.base_offset if free else self.base_offset


def base_of_file(file: Path, description: BaseDescription, where: str, idn: int | str = 0
                 ) -> FileBase:
    """Create a base from a file and its description."""
    model_file = read_model(file, description, where, servos=False)
    model = compile_copy(model_file.spec, str(file))
    tree = BodyTree(model)
    if model.njnt == 0:
        return FileMount(model_file, _top(model_file, model, description), idn)
    loose, notes = own_each_joint(model_file.spec, tree, range(model.nu))
    model_file.inferred += notes
    bodies = [tree.name(body) for body in range(1, model.nbody)]
    support = description.support or ('support' if 'support' in bodies else None)
    if support is None:
        ends = tree.ends(range(model.njnt))
        support = tree.name(ends[0]) if len(ends) == 1 else bodies[0]
        model_file.inferred.append(f"the robot stands on body '{support}'")
    if support not in bodies:
        raise UnknownNameError(f"body in 'support' of {where}", support, bodies)
    top = np.array(description.top) if description.top is not None else np.zeros(3)
    base = FileMobileBase(model_file, top, idn, loose)
    base.support_body = support
    base.sideways = description.sideways
    return base


def _top(model_file: ModelFile, model: mujoco.MjModel, description: BaseDescription) -> FloatArray:
    """Return where the robot stands: as declared, or on top of a base that is on a floor."""
    if description.top is not None:
        return np.array(description.top)
    low, high = _extent(model)
    root_height = float(model.body_pos[1, 2])
    if high <= 0.0 or abs(low) > _ON_FLOOR_M or root_height < -_ON_FLOOR_M:
        return np.zeros(3)
    model_file.inferred.append(f'the robot stands on the highest point, {high:.3f} m')
    return np.array([0.0, 0.0, high - root_height])


def _extent(model: mujoco.MjModel) -> tuple[float, float]:
    """Return the lowest and highest point of all shapes at the start [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    heights = shape_heights(model, data)
    return (float(heights[:, 0].min()), float(heights[:, 1].max())) if len(heights) else (0., 0.)
