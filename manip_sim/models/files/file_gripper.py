# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A hand or gripper from a file of its own, and its place on a mount."""

from __future__ import annotations

from collections.abc import Mapping
import itertools
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, product
from manip_sim.arrays import FloatArray
from manip_sim.models.files.body_tree import BodyTree
from manip_sim.models.files.fingers import digest_of, Fingers, once
from manip_sim.models.files.found_hands import FoundHand
from manip_sim.models.files.mount_frames import quat_wxyz_of
from manip_sim.models.files.hand_model import fill_control_ranges, HandFromFile
from manip_sim.models.files.model_file import read_model
from manip_sim.models.files.part_descriptions import GripperDescription
from manip_sim.models.files.xacro_expansion import stem_of
from manip_sim.models.loading import compile_copy
from manip_sim.models.spec_edits import delete_elements

#: Fingers that reach less far give no direction [m].
_SHORT_M = 0.02
#: A palm may reach this far behind its mount, around the flange of the arm [m].
_BEHIND_MOUNT_M = 0.05
_KEYFRAMES = ('home', 'open', 'rest')


def place_root(spec: mujoco.MjSpec, position: ArrayLike, quat_wxyz: FloatArray) -> None:
    """Set the pose of the root body of a hand in the body that it is mounted on."""
    root = spec.worldbody.bodies[0]
    root.pos, root.quat = np.asarray(position, dtype=float), quat_wxyz
    root.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _let_arm_carry(spec: mujoco.MjSpec) -> list[str]:
    """Remove the free joint of a hand, and its pose in the air; return that in a sentence."""
    free = [joint for joint in spec.worldbody.bodies[0].joints
            if int(joint.type) == int(mujoco.mjtJoint.mjJNT_FREE)]
    if not free:
        return []
    delete_elements(spec, free)
    place_root(spec, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    return ['left out, as the arm carries the hand: the free joint of its root']


def stand_on_mount(spec: mujoco.MjSpec, tree: BodyTree, hand: FoundHand, start: Mapping[str, float]
                   ) -> list[str]:
    """
    Turn and move a hand whose root pose in the file is not that on an arm.

    Fingers that point more than 45 degrees away from the mount's z axis are turned to it by
    quarter turns, and a palm that reaches farther than 50 mm behind the mount is moved in front.

    :returns: the changes, in sentences
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


class FileGripper(HandFromFile, registered=False):
    """
    A hand or gripper.

    :param file: MJCF or URDF
    :param description: what the YAML file says
    :param where: the file that the description was read from, for messages
    :param idn: number or word in names
    :raises ModelError: if the file or what the description says of it cannot be used
    """

    _refers_to_all = True  # As it was read with ``read_model``.

    def __init__(self, file: Path, description: GripperDescription, where: str,
                 idn: int | str = 0) -> None:
        self._description: GripperDescription = description
        self._where = where
        self._important_geoms = {**type(self)._important_geoms, **description.geoms_by_role}
        super().__init__(file, idn=idn)
        tree, hand = _whole(self._own_model)
        fingers = Fingers(tree, hand, self._start)
        key = digest_of(self._own_model) + repr(sorted(self._start.items())).encode()
        self._try_closing(self._actuators, lambda names: once(
            key + repr(names).encode(), lambda: fingers.closing(names)))
        self._set_closing(list(hand.actuators), fingers.out_of_touch)

    @property
    def name(self) -> str:
        """Name of the file and idn, such as ``right_hand0``."""
        return f'{stem_of(self.file)}{self.idn}'

    def _read(self) -> Any:
        declared = self._description
        model_file = read_model(self.file, declared, self._where, _KEYFRAMES)
        self.inferred = model_file.inferred
        if model_file.mocap is not None:
            self.inferred += model_file.mocap.left_out()
        self._keyframes = model_file.keyframes
        self._start = model_file.start
        spec = model_file.spec
        self.inferred += _let_arm_carry(spec)
        if declared.mount is not None:
            place_root(spec, declared.mount.position, quat_wxyz_of(declared.mount.orientation))
        elif spec.body('eef') is None:
            self.inferred += stand_on_mount(spec, *_whole(compile_copy(spec, str(self.file))),
                                            self._start)
        model = compile_copy(spec, str(self.file))
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
