# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Load robots, grippers, bases and arenas from third-party files, with a YAML description."""

from __future__ import annotations

from collections.abc import Collection
from os import PathLike
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.arenas import Arena, create_arena, EmptyArena
from manip_sim.models.bases import MobileBaseModel, MountModel, RobotBaseModel
from manip_sim.models.files.actuation import own_each_joint
from manip_sim.models.files.body_tree import BodyTree
from manip_sim.models.files.file_gripper import FileGripper
from manip_sim.models.files.file_robot import FileManipulator, FileRobot, plan_robot
from manip_sim.models.files.model_file import keyframes_of, ModelFile, read_model, shape_heights
from manip_sim.models.files.part_descriptions import (
    ArenaDescription, BaseDescription, find_model, GripperDescription, RobotDescription)
from manip_sim.models.loading import compile_copy, compile_spec, load_spec, name_unnamed_elements
from manip_sim.models.object_creation import (
    check_object_names, create_described, FixtureModel, load_objects, ObjectModel)
from manip_sim.models.randomization import check_placed, read_placements
from manip_sim.models.robots.robot_model import RobotModel
from manip_sim.models.user_files import stem_of, YAML_SUFFIXES
from manip_sim.quoting import pluralize, quoted

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


def base_of_file(file: Path, description: BaseDescription, source: str, idn: int | str = 0
                 ) -> FileBase:
    """Create a base from a file and its description."""
    model_file = read_model(file, description, source, servos=False)
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
        raise UnknownNameError(f"body in 'support' of {source}", support, bodies)
    top = np.array(description.top) if description.top is not None else np.zeros(3)
    base = FileMobileBase(model_file, top, idn, loose)
    base.support_body = support
    base.sideways = description.sideways
    return base


def _top(model_file: ModelFile, model: mujoco.MjModel, description: BaseDescription) -> FloatArray:
    """Return where the robot stands: as declared, or on top of a base that is on a floor."""
    if description.top is not None:
        return np.array(description.top)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    heights = shape_heights(model, data)
    low, high = (heights[:, 0].min(), heights[:, 1].max()) if len(heights) else (0.0, 0.0)
    root_height = float(model.body_pos[1, 2])
    if high <= 0.0 or abs(low) > _ON_FLOOR_M or root_height < -_ON_FLOOR_M:
        return np.zeros(3)
    model_file.inferred.append(f'the robot stands on the highest point, {high:.3f} m')
    return np.array([0.0, 0.0, high - root_height])


class FileArena(Arena, registered=False):
    """
    The environment of the robots.

    :param file: MJCF; or a YAML file whose description names another arena, or only parts
    :param description: what the YAML file says
    :param source: the file that the description was read from, for messages
    :raises ModelError: if something cannot be read, or does not fit together
    :ivar inferred: the inferences and omissions, in sentences
    """

    def __init__(self, file: Path, description: ArenaDescription, source: str) -> None:
        self._description = description
        self._other: Arena | None = None
        self.inferred: list[str] = []
        for key, kind in (('xacro_args', 'xacro'), ('meshes', 'URDF')):
            if getattr(description, key):
                raise ModelError(f"{source}: '{key}' is for robots, grippers and bases in {kind}; "
                                 'an arena is MJCF')
        if file.suffix.lower() in YAML_SUFFIXES:
            self._other = (EmptyArena() if description.arena is None else
                           create_arena(description.arena, **description.parameters))
            self.inferred += getattr(self._other, 'inferred', [])
        elif description.arena is not None or description.parameters:
            raise ModelError(f"{source}: give 'model', or 'arena' with its 'parameters', not both")
        super().__init__(file)
        self.arena_name = file.stem  # type: ignore[misc]
        if self._other is not None:
            self._objects += self._other.objects
            self.placements += self._other.placements
        self._add_parts(Path(source).parent, source)

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.file.stem

    def _read(self) -> Any:
        if self._other is not None:
            self._keyframes = self._other._keyframes
            return self._other._spec.copy()
        spec = load_spec(self.file, self.inferred)
        name_unnamed_elements(spec)
        keys = list(spec.keys)
        if keys:
            self._keyframes = keyframes_of(compile_spec(spec, str(self.file)))
        for key in keys:
            spec.delete(key)
        unnamed = len(keys) - len(self._keyframes)
        if unnamed:
            self.inferred.append(f'left out: {pluralize(unnamed, "keyframe")} without a name')
        return spec

    def _add_parts(self, folder: Path, source: str) -> None:
        """Add the fixtures, objects and placements of the description."""
        for values in self._description.fixtures:
            fixture = create_described(values, FixtureModel, _named('fixture', values, source),
                                       folder)
            self.add_fixture(fixture)
            self.inferred += [f"'{fixture.name}': {said}" for said in fixture.inferred]
        for entry in self._description.objects:
            for item in (load_objects(folder / entry) if isinstance(entry, str) else [
                    create_described(entry, ObjectModel, _named('object', entry, source),
                                     folder)]):
                self.add_object(item)
        check_object_names(self._objects)
        self.placements += read_placements(self._description.placements, source)
        check_placed(self.placements, self._objects)

    @property
    def table_length_m(self) -> float:
        """Edge of the table along x [m], zero if there is none."""
        return 0.0 if self._other is None else self._other.table_length_m

    def robot_position(self, robot: RobotModel) -> FloatArray:
        """
        Return the place of a robot in ``world`` [m], shape (3,).

        :param robot: the robot to place
        """
        declared = robot.placement_in(self.arena_name)
        if declared is not None and not callable(declared):
            return np.array(declared)
        if self._description.robot_position is not None:
            return np.array(self._description.robot_position)
        return np.zeros(3) if self._other is None else self._other.robot_position(robot)


def _named(kind: str, values: dict[str, Any], source: str) -> str:
    name = values.get('name')
    return f'{source}: {kind} {"without a name" if name is None else quoted(name)}'


def load_robot(path: str | PathLike[str], idn: int | str = 0) -> FileRobot:
    """
    Load a robot from a file.

    :param path: an MJCF or URDF file, the YAML file that describes it, or their folder; or a name
        such as ``menagerie:NAME``
    :param idn: number or word in names, as in ``robot0_joint1``
    :returns: a ``ManipulatorModel`` if the robot has arms; its ``inferred`` lists inferences and
        omissions
    :raises ModelError: if something cannot be read or does not fit together
    :raises UnknownNameError: if the YAML file has a key or name that is not known
    """
    model, description, source = find_model(Path(path), RobotDescription, 'robot')
    plan = plan_robot(model, description, source)
    return (FileManipulator if plan.ends else FileRobot)(plan, idn)


def load_gripper(path: str | PathLike[str], idn: int | str = 0) -> FileGripper:
    """
    Load a gripper or hand from a file.

    :param path: an MJCF or URDF file, the YAML file that describes it, or their folder; or a name
        such as ``menagerie:NAME``
    :param idn: number or word in names, as in ``gripper0_right_finger``
    :raises ModelError: if something cannot be read or does not fit together
    :raises UnknownNameError: if the YAML file has a key or name that is not known
    """
    model, description, source = find_model(Path(path), GripperDescription, 'gripper')
    return FileGripper(model, description, source, idn)


def load_base(path: str | PathLike[str], idn: int | str = 0) -> FileBase:
    """
    Load a base from a file.

    :param path: an MJCF or URDF file, the YAML file that describes it, or their folder; or a name
        such as ``menagerie:NAME``
    :param idn: number or word in names, as in ``fixed_mount0_base``
    :returns: a ``MountModel``, or a ``MobileBaseModel`` if it has joints
    :raises ModelError: if something cannot be read or does not fit together
    :raises UnknownNameError: if the YAML file has a key or name that is not known
    """
    model, description, source = find_model(Path(path), BaseDescription, 'base')
    return base_of_file(model, description, source, idn)


def load_arena(path: str | PathLike[str]) -> FileArena:
    """
    Load an arena from a file; its names get no prefix.

    :param path: an MJCF file, the YAML file that describes it or consists of parts, or their
        folder
    :raises ModelError: if something cannot be read
    :raises UnknownNameError: if the YAML file has a key or name that is not known
    """
    model, description, source = find_model(Path(path), ArenaDescription, 'arena')
    return FileArena(model, description, source)


__all__ = ['FileArena', 'FileBase', 'FileGripper', 'FileManipulator', 'FileRobot', 'load_arena',
           'load_base', 'load_gripper', 'load_robot']
