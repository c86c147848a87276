# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots that a file and a description declare, with arms or without."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.bases import MobileBaseModel, RobotBaseModel
from manip_sim.models.files.hand_model import BuiltInGripper
from manip_sim.models.files.robot_plan import RobotPlan
from manip_sim.models.files.xacro_expansion import stem_of
from manip_sim.models.grippers.gripper_model import GripperModel
from manip_sim.models.loading import compile_without_meshes
from manip_sim.models.robots.manipulator_model import ManipulatorModel
from manip_sim.models.robots.robot_model import Placement, RobotModel


class FileRobot(RobotModel, registered=False):
    """
    A robot from a file.

    :param plan: the file, completed by its description
    :param idn: number or word in names
    :ivar inferred: the inferences and omissions, in sentences
    """

    _refers_to_all = True  # As it was read with ``read_model``.

    def __init__(self, plan: RobotPlan, idn: int | str) -> None:
        self._plan = plan
        self._own_hands: dict[str, BuiltInGripper] = dict(plan.hands)
        self._subsystem_of_joint = plan.subsystems
        if plan.description.foot is not None:
            x, y, z = plan.description.foot
            self._foot_offset = (x, y, z)
        self._keyframes = plan.keyframes
        super().__init__(plan.file, idn=idn)
        self.inferred = [*plan.inferred, *(
            f'{arm} hand: {sentence}' for arm, hand in plan.hands.items()
            for sentence in hand.inferred)]

    def _read(self) -> Any:
        return self._plan.spec

    def _compile_alone(self) -> mujoco.MjModel:
        if self._spec_is_shared:
            return super()._compile_alone()
        return compile_without_meshes(self._spec, self.name, ())

    def _record(self) -> None:
        super()._record()
        hands = self._own_hands.values()
        not_ours = set().union(*(hand.names_in_file for hand in hands))
        self._joints = [name for name in self._joints if name not in not_ours]
        self._actuators = [name for name in self._actuators
                           if name not in not_ours | self._plan.loose_actuators]
        for hand in hands:
            hand.bind(self, self._own_model)

    def add_base(self, base: RobotBaseModel) -> None:
        """
        Put the robot on a base; a mobile one leaves the mocap bodies of the file out.

        :param base: as for :meth:`RobotModel.add_base`
        """
        super().add_base(base)
        mocap = self._plan.mocap
        if mocap is not None and isinstance(base, MobileBaseModel):
            kept = [said for said in self.inferred if said not in mocap.notes()]
            self.inferred = [*kept, *(f'{said}, as the robot stands on a mobile base'
                                      for said in mocap.left_out())]

    @property
    def bottom_offset(self) -> FloatArray:
        """
        From the root body to the floor that the robot stands on [m], shape (3,), a copy.

        Without a base it is below the lowest shape if the file puts that into the floor, unless
        :meth:`set_base_xpos` placed the robot.
        """
        offset = super().bottom_offset
        if self._base is None and self._may_be_raised:
            offset[2] -= self._plan.depth_in_floor
        return offset

    def _placed_copy(self, floor_xpos: ArrayLike | None) -> mujoco.MjSpec:
        spec = super()._placed_copy(floor_xpos)
        if floor_xpos is None and self._floor_xpos is None and self._base is None:
            spec.body(self._root().name).pos[2] += self._plan.depth_in_floor
        return spec

    def attach_to(self, spec: mujoco.MjSpec, frame: mujoco.MjsFrame,
                  floor_xpos: ArrayLike | None = None) -> None:
        """
        Add a copy of the robot, of everything mounted on it and of the file's mocap bodies.

        :param spec: the spec to add to
        :param frame: the frame of that spec to attach the robot to
        :param floor_xpos: as for :meth:`RobotModel.attach_to`
        """
        super().attach_to(spec, frame, floor_xpos)
        if self._plan.mocap is None or isinstance(self.base, MobileBaseModel):
            return
        in_file, root = self._own_model.body(self._root().name), spec.body(self.root_body)
        self._plan.mocap.add_to(spec, self.naming_prefix, self.name, *(
            np.concatenate([place.pos, place.quat]) for place in (in_file, root)))

    @property
    def type_name(self) -> str:
        """Name of the file, such as ``iiwa14``."""
        return stem_of(self.file)

    @property
    def described(self) -> dict[str, Any]:
        """The file's description, completed by inference, as the keys of a YAML file."""
        model = self._own_model
        return _described_plan(self._plan, {
            str(model.joint(joint).name): model.jnt_range[joint] for joint in range(model.njnt)
            if model.jnt_limited[joint]})

    @property
    def default_base(self) -> str | None:
        """The base that the description names; None is the floor."""
        return self._plan.description.base

    @property
    def default_controller_config(self) -> dict[str, str]:
        """Names of controller settings in the description, by arm or subsystem."""
        arms = self._plan.description.by_arm.items()
        return {**self._plan.description.controllers,
                **{side: arm.controller for side, arm in arms if arm.controller is not None}}

    @property
    def init_qpos(self) -> FloatArray:
        """Start positions of the joints [rad or m], shape (dof,), a copy."""
        # A ball joint has no start: it stays at the unit quaternion, whose w is 1.
        return np.array([self._plan.start.get(joint, 1.0) for joint in self._joints])

    @property
    def base_xpos_offset(self) -> dict[str, Placement]:
        """Where to place the robot by arena [m]: as described, else in front of table or bins."""
        declared = {arena: (float(x), float(y), float(z))
                    for arena, (x, y, z) in self._plan.description.placement.items()}
        return {'bins': (-0.5, -0.1, 0.0),
                'table': lambda table_length: (-0.16 - table_length / 2.0, 0.0, 0.0), **declared}


class FileManipulator(FileRobot, ManipulatorModel, registered=False):
    """
    A robot with arms from a file.

    A hand in the file is one of :attr:`grippers` from the start; mounting another gripper replaces
    it.

    :param plan: the file, completed by its description
    :param idn: number or word in names
    """

    def __init__(self, plan: RobotPlan, idn: int | str) -> None:
        super().__init__(plan, idn=idn)
        self._grippers.update(self._own_hands)

    @property
    def arm_type(self) -> str:
        """``single`` or ``bimanual``."""
        return 'single' if len(self._plan.ends) == 1 else 'bimanual'

    @property
    def _eef_name(self) -> dict[str, str]:
        return self._plan.ends

    @property
    def default_gripper(self) -> dict[str, str]:
        """Names of grippers in the description, by arm."""
        return {side: arm.gripper for side, arm in self._plan.description.by_arm.items()
                if arm.gripper is not None}

    @property
    def own_hands(self) -> tuple[str, ...]:
        """The arms that carry a hand of the robot's own file."""
        return tuple(self._own_hands)

    def add_gripper(self, gripper: GripperModel, arm_name: str | None = None) -> None:
        """
        Mount a gripper, in place of a hand of the robot's own file.

        :param gripper: the gripper; if it goes on several arms, each gets a copy of its own
        :param arm_name: an arm or its end effector body; None mounts on every arm
        :raises TypeError: if it is not a gripper
        :raises UnknownNameError: if the arm is unknown
        :raises ModelError: if the arm has a gripper already, or the gripper is mounted already
        """
        if isinstance(gripper, GripperModel):
            for arm in self.arms if arm_name is None else (self.arm_of(arm_name),):
                self.take_off_hand(arm)
        super().add_gripper(gripper, arm_name)

    def take_off_hand(self, arm: str) -> None:
        """
        Remove the hand of the robot's own file from an arm, if there is one.

        :param arm: ``right`` or ``left``
        """
        hand = self._own_hands.pop(arm, None)
        if hand is None:
            return
        del self._grippers[arm]
        hand.remove_from(self._spec)
        self._record()
        self.update_joints()
        self.update_actuators()


def _described_plan(plan: RobotPlan, ranges: Mapping[str, FloatArray]) -> dict[str, Any]:
    """
    Return the description of a robot, completed by inference, so that nothing is left to infer.

    :param ranges: of the joints, by name in the file [rad or m], shape (2,)
    :returns: the keys of a robot's YAML file beside the model
    """
    declared = plan.description.model_dump(exclude_unset=True)
    arms = {side: _arm(plan, side) for side in plan.ends}
    return {**declared, 'model': plan.file.name, 'arms': arms or 'none',
            'subsystems': {**dict(plan.subsystems), **declared.get('subsystems', {})},
            'start': {
                joint: at if joint not in ranges else float(np.clip(at, *ranges[joint]))
                for joint, at in plan.start.items()}}


def _arm(plan: RobotPlan, side: str) -> dict[str, Any]:
    declared = plan.description.arm(side)
    values = {} if declared is None else declared.model_dump(exclude_unset=True)
    arm = {**values, 'mount': values.get('mount', plan.arms[side].name)}
    hand = plan.hands.get(side)
    if hand is None:
        return {**arm, 'hand': 'none'}
    hand_values = values.get('hand')
    return {**arm, 'hand': {
        **(hand_values if isinstance(hand_values, dict) else {}), 'body': hand.body,
        'grasp_point': hand.grasp_point.model_dump(), 'closing': hand.closing}}
