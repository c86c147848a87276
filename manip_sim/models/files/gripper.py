# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A hand or gripper from a file of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco

from manip_sim.models.files.description import GripperDescription
from manip_sim.models.files.fingers import Fingers
from manip_sim.models.files.frames import quat_wxyz_of
from manip_sim.models.files.hand_model import fill_control_ranges, HandFromFile
from manip_sim.models.files.hands import FoundHand
from manip_sim.models.files.mounting import place_root, stand_on_mount
from manip_sim.models.files.reading import compile_alone, read_model
from manip_sim.models.files.start import start_pose
from manip_sim.models.files.tree import BodyTree

_KEYFRAMES = ('home', 'open', 'rest')


class FileGripper(HandFromFile, registered=False):
    """
    A hand or gripper.

    :param file: MJCF or URDF
    :param description: what the YAML file says
    :param where: the file that the description was read from, for messages
    :param idn: number or word in names
    :raises ModelError: if the file or what the description says of it cannot be used
    """

    def __init__(self, file: Path, description: GripperDescription, where: str,
                 idn: int | str = 0) -> None:
        self._description: GripperDescription = description
        self._where = where
        self._important_geoms = {**type(self)._important_geoms, **description.geoms_by_role}
        super().__init__(file, idn=idn)
        tree, hand = _whole(self._own_model)
        self._set_closing(Fingers(tree, hand, self._start), list(hand.actuators))

    @property
    def name(self) -> str:
        """Name of the file and idn, such as ``right_hand0``."""
        return f'{self.file.stem}{self.idn}'

    def _read(self) -> Any:
        declared = self._description
        keyframe = declared.start if isinstance(declared.start, str) else None
        model_file = read_model(self.file, _KEYFRAMES, keyframe)
        self.inferred = model_file.inferred
        self._start = start_pose(model_file, declared.start, self._where)
        spec = model_file.spec
        if declared.mount is not None:
            place_root(spec, declared.mount.position, quat_wxyz_of(declared.mount.orientation))
        elif spec.body('eef') is None:
            self.inferred += stand_on_mount(spec, *_whole(compile_alone(spec, str(self.file))),
                                            self._start)
        model = compile_alone(spec, str(self.file))
        tree, hand = _whole(model)
        self.inferred += fill_control_ranges(spec, model, list(hand.actuators))
        if declared.grasp_point is not None or spec.body('eef') is None:
            taken = {site.name for site in spec.sites}
            prefix = 'grasp_' if taken & set(self._important_sites.values()) else ''
            self._add_grasp_frame(spec, tree, hand, prefix)
        return spec

    def _prepare_spec(self, spec: mujoco.MjSpec) -> None:
        if not self._has_grasp_frame:
            super()._prepare_spec(spec)


def _whole(model: mujoco.MjModel) -> tuple[BodyTree, FoundHand]:
    """Return a model as a tree and as a hand of all below its root body."""
    tree = BodyTree(model)
    return tree, FoundHand(1, tuple(range(model.njnt)), tuple(range(model.nu)))
