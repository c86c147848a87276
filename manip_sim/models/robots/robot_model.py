# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Common parts of all robots: the names of them, and the declarations of each."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from os import PathLike
from pathlib import Path
import re
from types import MappingProxyType
from typing import Any, Union

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import quat_wxyz_from_rpy, xyzw_to_wxyz
from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, KindError, ModelError, UnknownNameError
from manip_sim.models.actuators import FrictionLaw, JOINT_TRANSMISSIONS, SCALAR
from manip_sim.models.bases import MobileBaseModel, MountModel, RobotBaseModel
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.registry import Registry
from manip_sim.models.spec_edits import rename_body, rotate_actuators, TakenNames
from manip_sim.validation import finite_numbers, mapping

#: Body on a mobile base that has the contents of the root.
_MANIPULATOR_MOUNT = 'manipulator_mount'
#: A position [m], or a function that takes the length of the table [m] and returns one.
Position = tuple[float, float, float]
Placement = Union[Position, Callable[[float], Position]]
SUBSYSTEMS = ('arm', 'base', 'torso', 'head', 'legs', 'other')
#: In the order in which they are tried; a name without any of them is arm.
KEYWORDS = {'torso': 'torso', 'mobile': 'base', 'head': 'head', 'leg': 'legs'}
#: Types of the joints that actuators of parts drive.
_WORD = re.compile(r'[A-Z]?[a-z]+|[A-Z]+(?![a-z])')


def _sorted(kind: str, subsystem: str, doc: str) -> Any:
    """Return a property: the joints or actuators of a subsystem, a copy."""
    def names(robot: RobotModel) -> list[str]:
        return list(getattr(robot, f'_{kind}_of')[subsystem])
    return property(names, doc=doc)


class RobotModel(MujocoXMLModel, ABC):
    """
    A robot without grippers, and the base that it stands on. Prefix ``robot{idn}_``.

    Another prefix, set by :meth:`set_naming_prefix`, also applies to everything
    mounted on the robot: with ``left_`` the base has ``left_base_``, a gripper ``left_gripper_``,
    or on two arms ``left_gripper_right_`` and ``left_gripper_left_``.

    :param fname: path of an MJCF file with one root body
    :param idn: number or word in names, as in ``robot0_joint1``
    :raises ModelError: if the file has no root body or several
    :ivar held_files: the files whose contents its spec holds, by their names in the spec
    """

    _prefix_word = 'robot'
    held_files: Mapping[str, Path] = MappingProxyType({})
    #: Point that stands on a base or the floor, in the frame of the root [m]; None: it is the
    #: origin of the file's world.
    _foot_offset: tuple[float, float, float] | None = None
    #: True if the gains of servos are upper bounds, to be lowered to what suits the timestep. If
    #: not, they are kept, except where the servo would not be stable.
    gains_are_highest = False

    #: Subsystem by raw joint name, which takes precedence over the name.
    _subsystem_of_joint: Mapping[str, str] = {}
    _joints_of: dict[str, list[str]]
    _actuators_of: dict[str, list[str]]

    arm_joints: list[str] = _sorted(
        'joints', 'arm', 'Joints of the arms, in the order of the file.')
    base_joints: list[str] = _sorted('joints', 'base', 'Joints that move the whole robot.')
    torso_joints: list[str] = _sorted('joints', 'torso', 'Joints of the torso.')
    head_joints: list[str] = _sorted('joints', 'head', 'Joints of the head.')
    legs_joints: list[str] = _sorted('joints', 'legs', 'Joints of the legs.')
    other_joints: list[str] = _sorted(
        'joints', 'other', "Joints of the robot's file that belong to no other subsystem.")
    arm_actuators: list[str] = _sorted(
        'actuators', 'arm', 'Actuators of the arms, in the order of the file.')
    base_actuators: list[str] = _sorted(
        'actuators', 'base', 'Actuators that move the whole robot.')
    torso_actuators: list[str] = _sorted('actuators', 'torso', 'Actuators of the torso.')
    head_actuators: list[str] = _sorted('actuators', 'head', 'Actuators of the head.')
    legs_actuators: list[str] = _sorted('actuators', 'legs', 'Actuators of the legs.')
    other_actuators: list[str] = _sorted(
        'actuators', 'other', 'Actuators of the joints of no other subsystem.')

    def __init__(self, fname: str | PathLike[str], idn: int | str = 0) -> None:
        super().__init__(fname, idn=idn)
        self._root()
        self._base: RobotBaseModel | None = None
        #: Pose from :meth:`set_base_xpos` and :meth:`set_base_ori`.
        self._floor_xpos: FloatArray | None = None
        #: True if nobody has chosen the height of that place.
        self._may_be_raised = True
        self._root_quat: FloatArray | None = None
        self._laws: dict[tuple[MujocoXMLModel, str], FrictionLaw] = {}
        self._check_subsystems()
        self.update_joints()
        self.update_actuators()

    def set_naming_prefix(self, prefix: str) -> None:
        """
        Set the prefix of all names of the robot, and of present and future mounted parts.

        :param prefix: a letter, then at most 63 letters, digits and underscores, such as
            ``left_``; empty: each part has the prefix that its idn gives
        :raises ModelError: if it is none of these, or the class of a part overrides
            :attr:`naming_prefix`
        """
        super().set_naming_prefix(prefix)
        for part, words in self._mounted():
            part.set_naming_prefix(prefix and prefix + words)
        self.update_joints()
        self.update_actuators()

    def _mounted(self) -> list[tuple[MujocoXMLModel, str]]:
        """Return the parts on the robot and what follows the robot's prefix in their names."""
        return [] if self._base is None else [(self._base, 'base_')]

    def _was_mounted(self) -> None:
        if self._given_prefix:
            self.set_naming_prefix(self._given_prefix)
        self._refresh_if_edited()

    # ------------------------------------------------------------------ base and place

    @property
    def is_placed(self) -> bool:
        """True if :meth:`set_base_xpos` was called; else an arena places the robot."""
        return self._floor_xpos is not None

    @property
    def base(self) -> RobotBaseModel | None:
        """The base that the robot stands on, or None for the floor."""
        return self._base

    @property
    def models(self) -> list[MujocoXMLModel]:
        """All parts that are mounted on the robot: the base, then the grippers."""
        return [part for part, _ in self._mounted()]

    def add_base(self, base: RobotBaseModel) -> None:
        """
        Put the robot on a base.

        :param base: a mount or a mobile base that nothing else stands on
        :raises TypeError: if it is not a base
        :raises ModelError: if the robot has a base already
        """
        if not isinstance(base, (MountModel, MobileBaseModel)):
            raise KindError('a base must be a MountModel or a MobileBaseModel, '
                            f'not {type(base).__name__}')
        if self._base is not None:
            raise ModelError(f'{self.name} stands on {self._base.name} already, '
                             f'cannot add {base.name}')
        if isinstance(base, MobileBaseModel) and base._spec.body(base.support_body) is None:
            raise UnknownNameError(f'body of {base.name} to mount a robot on', base.support_body,
                                   [body.name for body in base._spec.bodies[1:]])
        self._base = base
        self.update_joints()
        self.update_actuators()
        self._was_mounted()

    @property
    def foot_offset(self) -> FloatArray:
        """From the root to the point that stands on a base or floor [m], shape (3,), a copy."""
        if self._foot_offset is None:
            return -self.base_offset
        return np.array(self._foot_offset)

    @property
    def bottom_offset(self) -> FloatArray:
        """From the root body to the floor that the robot stands on [m], shape (3,), a copy."""
        if self._base is None:
            return self.foot_offset
        return self.foot_offset + self._base.bottom_offset - self._base.top_offset

    @property
    def horizontal_radius(self) -> float:
        """Nominal radius about the root, as in robosuite [m]; arms reach farther."""
        return max(self._horizontal_radius, self._base.horizontal_radius if self._base else 0.0)

    def set_base_xpos(self, pos: ArrayLike, may_be_raised: bool = False) -> None:
        """
        Place the robot.

        :param pos: of the floor below the root, in the world [m], shape (3,)
        :param may_be_raised: raise a robot from a file whose shapes reach into the floor, as where
            an arena places it
        :raises ModelError: if a number is not finite
        """
        self._floor_xpos = finite_numbers(pos, 3, f'position of {self.name}')
        self._may_be_raised = may_be_raised

    def set_base_ori(self, rpy: ArrayLike) -> None:
        """
        Set the orientation of the robot.

        :param rpy: roll, pitch, yaw of the root in the world [rad], shape (3,)
        :raises ModelError: if a number is not finite
        """
        self._root_quat = quat_wxyz_from_rpy(
            finite_numbers(rpy, 3, f'orientation of {self.name}'))

    def set_base_quat(self, quat_xyzw: ArrayLike) -> None:
        """
        Set the orientation of the robot.

        :param quat_xyzw: of the root in the world, of length 1, shape (4,)
        :raises ModelError: if a number is not finite
        """
        self._root_quat = xyzw_to_wxyz(
            finite_numbers(quat_xyzw, 4, f'orientation of {self.name}'))

    # ------------------------------------------------------------------ recorded lists

    def refresh(self) -> None:
        """
        Update the recorded lists, ranges and offsets after edits of :attr:`spec`.

        The mounted parts are updated too.
        """
        super().refresh()
        for part in self.models:
            part.refresh()
        self.update_joints()
        self.update_actuators()

    def _refresh_if_edited(self) -> None:
        if any(part._spec_is_shared for part in (self, *self.models)):
            self.refresh()

    def _own_parts(self) -> list[MujocoXMLModel]:
        """Return the robot, and its base if it has one."""
        return [self] if self._base is None else [self, self._base]

    # ------------------------------------------------------------------ subsystems

    def joints_of(self, subsystem: str) -> list[str]:
        """
        Return the joints of a subsystem.

        :param subsystem: such as ``arm`` or ``torso``
        :raises UnknownNameError: if the subsystem is unknown
        """
        return list(self._lookup(self._joints_of, subsystem))

    def actuators_of(self, subsystem: str) -> list[str]:
        """
        Return the actuators of a subsystem.

        :param subsystem: such as ``arm`` or ``torso``
        :raises UnknownNameError: if the subsystem is unknown
        """
        return list(self._lookup(self._actuators_of, subsystem))

    def _lookup(self, table: dict[str, list[str]], subsystem: str) -> list[str]:
        if subsystem not in SUBSYSTEMS:
            raise UnknownNameError('subsystem', subsystem, SUBSYSTEMS)
        return table[subsystem]

    @property
    def joint_actuators(self) -> list[str]:
        """The actuators of all subsystems, but not of tendons, sites and ball joints."""
        return [name for names in self._actuators_of.values() for name in names]

    @property
    def all_joints(self) -> list[str]:
        """Joints of the robot, then of its base."""
        return [joint for part in self._own_parts() for joint in part.joints]

    @property
    def all_actuators(self) -> list[str]:
        """Actuators of the robot, then of its base."""
        return [actuator for part in self._own_parts() for actuator in part.actuators]

    def _check_subsystems(self) -> None:
        """Check that what the class declares of joints has the names of joints and subsystems."""
        for joint, subsystem in self._subsystem_of_joint.items():
            if joint not in self._joints:
                raise UnknownNameError(f'joint in _subsystem_of_joint of {self.name}', joint,
                                       self._joints)
            if subsystem not in SUBSYSTEMS:
                raise UnknownNameError(f"subsystem of joint '{joint}' of {self.name}", subsystem,
                                       SUBSYSTEMS)

    def update_joints(self) -> None:
        """Sort all joints into subsystems again, as ``add_base`` does."""
        self._joints_of = {part: [] for part in SUBSYSTEMS}
        for part in self._own_parts():
            for raw, name in zip(part._joints, part.correct_naming(part._joints)):
                self._joints_of[self._subsystem(part, raw)].append(name)

    def update_actuators(self) -> None:
        """Sort all actuators that drive a joint into subsystems again, as ``add_base`` does."""
        self._actuators_of = {part: [] for part in SUBSYSTEMS}
        for part in self._own_parts():
            for raw, name in zip(part._actuators, part.correct_naming(part._actuators)):
                driven = driven_joint(part._own_model, part._own_model.actuator(raw).id)
                if driven is not None:
                    self._actuators_of[self._subsystem(part, driven)].append(name)

    def _subsystem(self, part: MujocoXMLModel, raw: str) -> str:
        if part is self and raw in self._subsystem_of_joint:
            return self._subsystem_of_joint[raw]
        subsystem = classify(raw)
        if subsystem == 'arm' and isinstance(part, RobotBaseModel):
            return part.subsystem_of_others
        return subsystem

    def format_action(self, subsystem: str, action: ArrayLike,
                      ctrlrange: ArrayLike | None = None) -> FloatArray:
        """
        Map an abstract action to commands of a subsystem's actuators, clamping it to [-1, 1].

        :param subsystem: ``arm``, ``base``, ``torso``, ``head``, ``legs`` or ``other``
        :param action: -1 is the low, +1 the high end of a control range, shape (n,)
        :param ctrlrange: ranges in place of the files', shape (n, 2)
        :returns: commands in the actuators' units, shape (n,), a copy
        :raises UnknownNameError: if the subsystem is unknown
        :raises CommandError: if the length is wrong or a number is not finite
        """
        names = self.actuators_of(subsystem)
        checked = finite_numbers(action, len(names), f'an action of the {subsystem} of '
                                 f'{self.name}', CommandError)
        if ctrlrange is None:
            ranges = {name: range_ for part in self._own_parts()
                      for name, range_ in part.control_ranges.items()}
            ctrlrange = [ranges[name] for name in names]
        low, high = np.asarray(ctrlrange, dtype=float).reshape(-1, 2).T
        commands = low + (np.clip(checked, -1.0, 1.0) + 1.0) / 2.0 * (high - low)
        # Rounding may exceed an end of the range.
        return np.asarray(np.clip(commands, low, high))

    # ------------------------------------------------------------------ composing

    def attach_to(self, spec: mujoco.MjSpec, frame: mujoco.MjsFrame,
                  floor_xpos: ArrayLike | None = None) -> None:
        """
        Add a copy of the robot and of everything mounted on it to another spec.

        On a mobile base the root body stays fixed, or is free if that of the base is, and carries
        the base; the contents of the root move to a body ``manipulator_mount`` on the base's
        support.

        :param spec: the spec to add to
        :param frame: the frame of that spec to attach the robot to
        :param floor_xpos: position of the floor below the copy's root, in the frame [m], shape
            (3,); None: where :meth:`set_base_xpos` or else the file puts it
        :raises ModelError: if the spec, the robot's base or a gripper has one of the names already
        """
        self._refresh_if_edited()
        placed, base = self._placed_copy(floor_xpos), self._base
        if isinstance(base, MobileBaseModel):
            self._attach_on_mobile_base(spec, frame, base, placed)
            return
        self._attach_copy(spec, frame, placed)
        if isinstance(base, MountModel):
            self._attach_base(spec, spec.body(self.root_body), base)

    def _attach_base(self, spec: mujoco.MjSpec, root: mujoco.MjsBody,
                     base: RobotBaseModel) -> None:
        frame = root.add_frame(pos=self.foot_offset - base.top_offset - base.base_offset)
        base_spec = base._spec.copy()
        for joint in base_spec.body(base._root().name).joints:
            if int(joint.type) == int(mujoco.mjtJoint.mjJNT_FREE):
                # Only a body of the world can be free, and the root carries the base.
                root.add_freejoint().name = base.correct_naming(joint.name)
                base_spec.delete(joint)
        base._attach_copy(spec, frame, base_spec)

    def _attach_on_mobile_base(self, spec: mujoco.MjSpec, frame: mujoco.MjsFrame,
                               base: MobileBaseModel, part_spec: mujoco.MjSpec) -> None:
        TakenNames(spec).add(part_spec, self.naming_prefix, self.name)
        mount = part_spec.body(self._root().name)
        if part_spec.body(_MANIPULATOR_MOUNT) is not None:
            raise ModelError(f"{self.name} cannot stand on a mobile base: it has a body "
                             f"'{_MANIPULATOR_MOUNT}' of its own")
        root = frame.parent.add_body(name=self.root_body, pos=mount.pos, quat=mount.quat)
        root.set_frame(frame)
        rename_body(part_spec, mount, _MANIPULATOR_MOUNT)
        mount.pos, mount.quat = -self.foot_offset, [1.0, 0.0, 0.0, 0.0]
        for joint in mount.joints:
            if int(joint.type) == int(mujoco.mjtJoint.mjJNT_FREE):  # The base moves the robot.
                part_spec.delete(joint)
        present = len(spec.actuators)
        self._attach_base(spec, root, base)
        support = spec.body(base.correct_naming(base.support_body))
        self._attach_copy(spec, support.add_frame(), part_spec)
        rotate_actuators(spec.actuators[present:], len(base.actuators))

    def _placed_copy(self, floor_xpos: ArrayLike | None) -> mujoco.MjSpec:
        """Return a copy of the spec with the root at the pose that the robot gets."""
        placed = self._spec.copy()
        root = placed.body(self._root().name)
        compiled = self._own_model.body(root.name)
        floor = self._floor_xpos if floor_xpos is None else np.asarray(floor_xpos, dtype=float)
        root.pos = compiled.pos if floor is None else floor - self.bottom_offset
        root.quat = compiled.quat if self._root_quat is None else self._root_quat
        # Nothing else may turn or move the root.
        root.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        root.set_frame(placed.worldbody.add_frame())
        return placed

    # ------------------------------------------------------------------ what a robot declares

    @property
    def name_in_world(self) -> str:
        """Its prefix without the underscores at the end, by which a world's robots go."""
        return self.naming_prefix.rstrip('_')

    @property
    @abstractmethod
    def default_base(self) -> str | None:
        """Name of the base that the robot stands on unless another is requested."""

    @property
    @abstractmethod
    def default_controller_config(self) -> dict[str, str]:
        """Names of robosuite's controller settings, by arm or subsystem."""

    @property
    @abstractmethod
    def init_qpos(self) -> FloatArray:
        """Start positions in the order of :attr:`joints` [rad or m], shape (dof,)."""

    @property
    @abstractmethod
    def base_xpos_offset(self) -> dict[str, Placement]:
        """Place of the robot by arena [m], or a function of the table's length [m]."""

    def placement_in(self, arena: str) -> Placement | None:
        """
        Return what :attr:`base_xpos_offset` says of an arena, or None.

        :param arena: its name
        :raises ModelError: if :attr:`base_xpos_offset` is not a mapping
        """
        declared = mapping(self.base_xpos_offset, f'base_xpos_offset of {self.name}',
                           "{'empty': (-0.6, 0.0, 0.0)}")
        placement: Placement | None = declared.get(arena)
        return placement

    @property
    def init_base_qpos(self) -> FloatArray | None:
        """Start positions of the joints of the base, in its order [rad or m], or None for zero."""
        return None

    def set_joint_attribute(self, attrib: str, values: ArrayLike, force: bool = True) -> None:
        """
        Set an attribute of all joints of the robot, but not of its base and grippers.

        :param attrib: ``damping``, ``frictionloss``, ``armature`` or ``stiffness``
        :param values: one for each of :attr:`joints`, shape (dof,)
        :param force: also where the file gives a value other than zero
        :raises CommandError: if the number of values is wrong, or one is not finite or negative
        :raises UnknownNameError: if the attribute is unknown
        """
        settable = ('damping', 'frictionloss', 'armature', 'stiffness')
        if attrib not in settable:
            raise UnknownNameError('joint attribute', attrib, settable)
        numbers = finite_numbers(values, len(self._joints), f'{attrib} of {self.name}',
                                 CommandError)
        if (numbers < 0.0).any():
            place = int(np.argmax(numbers < 0.0))
            raise CommandError(f'{attrib} of {self.name} must not be negative, '
                               f'got {numbers[place]:g} at index {place}')
        for name, value in zip(self._joints, numbers):
            joint = self._spec.joint(name)
            if force or not np.any(getattr(joint, attrib)):
                _set(joint, attrib, value)

    def set_actuation(self, subsystem: str, friction: str | Mapping[str, Any] | None = None,
                      torque_speed: str | Mapping[str, Any] | None = None,
                      armature: float | Sequence[float] | None = None) -> None:
        """
        Choose what motors and gears add to the joints of a subsystem; None keeps what there is.

        :param subsystem: such as ``arm``; two arms are one subsystem
        :param friction: ``catalogue``, or the keys of
            :class:`~manip_sim.models.descriptions.Friction`
        :param torque_speed: ``catalogue``, or the keys of
            :class:`~manip_sim.models.descriptions.TorqueSpeed`
        :param armature: inertia of the rotors, reflected to the joints [kg m^2 or kg], a number or
            one for each joint
        :raises ModelError: if the subsystem has no scalar joints, the catalogue has no values or
            values cannot be used
        :raises UnknownNameError: if the subsystem is unknown
        """
        from manip_sim.models.descriptions import JointActuation, read_catalogue, single
        names = self.joints_of(subsystem)
        joints = [(part, raw) for part in self._own_parts() for raw in part._joints
                  if part.correct_naming(raw) in names
                  and int(part._spec.joint(raw).type) in SCALAR]
        owner = f'{subsystem} of {self.name}'
        if not joints:
            raise ModelError(f'{owner}: it has no such joints')
        specs = [part._spec.joint(raw) for part, raw in joints]
        actuation = JointActuation([part.correct_naming(raw) for part, raw in joints], owner,
                                   read_catalogue(self.file.parent, subsystem), friction,
                                   torque_speed)
        for attrib, values in (*actuation.attributes(), *(
                () if armature is None else
                [('armature', actuation.of_each(single(armature, owner), 'armature'))])):
            for joint, value in zip(specs, values):
                _set(joint, attrib, value)
        self._laws.update(zip(joints, actuation.laws()))
        for part in dict.fromkeys(part for part, _ in joints):
            part.refresh()

    @property
    def friction_laws(self) -> dict[str, FrictionLaw]:
        """Friction and torque limits over the velocity, by joint; a copy."""
        return {part.correct_naming(raw): law for (part, raw), law in self._laws.items()
                if law.acts}


def _set(joint: mujoco.MjsJoint, attrib: str, value: float) -> None:
    is_array = np.ndim(getattr(joint, attrib)) > 0
    setattr(joint, attrib, [value, 0.0, 0.0] if is_array else value)


@lru_cache(maxsize=1024)
def classify(name: str) -> str:
    """
    Return the subsystem of an unprefixed name of a joint or actuator.

    robosuite's keywords torso, mobile, head and leg, or legs, decide in this order, but only as
    whole words, in lower or upper case: ``head_pan`` is head, ``overhead_joint`` is arm.
    """
    words = {word.lower() for word in _WORD.findall(name)}
    for keyword, subsystem in KEYWORDS.items():
        if keyword in words or subsystem in words - {'base'}:
            return subsystem
    return 'arm'


def driven_joint(model: mujoco.MjModel, actuator: int) -> str | None:
    """Return the name of the hinge or slide that an actuator drives, or None."""
    kind = int(model.actuator_trntype[actuator])
    if kind not in JOINT_TRANSMISSIONS:
        return None
    joint = int(model.actuator_trnid[actuator, 0])
    if int(model.jnt_type[joint]) not in SCALAR:
        return None
    name: str = model.joint(joint).name
    return name


ROBOTS: Registry[RobotModel] = Registry('robot', RobotModel)  # type: ignore[type-abstract]
RobotModel.registry = ROBOTS
