# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A robot with one arm or two, and the grippers on them."""

from __future__ import annotations

from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Callable
from os import PathLike
from typing import Any, TypeVar

import mujoco
from numpy.typing import ArrayLike

from manip_sim.algebra import wxyz_to_xyzw
from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.grippers.gripper_model import GripperModel
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.robots.robot_model import RobotModel
from manip_sim.validation import mapping

ARMS_OF_TYPE = {'single': ('right',), 'bimanual': ('right', 'left')}
T = TypeVar('T')


class ArmDict(OrderedDict[str, T]):
    """
    An ordered dictionary by arm that can also be read by end effector body.

    :param arm_of_body: returns the arm of a prefixed end effector body, or None
    """

    def __init__(self, arm_of_body: Callable[[str], str | None]) -> None:
        super().__init__()
        self._arm_of_body = arm_of_body

    def __missing__(self, key: str) -> T:
        arm = self._arm_of_body(key)
        if arm is None or arm not in self:
            raise KeyError(key)
        return self[arm]

    def __contains__(self, key: object) -> bool:
        return super().__contains__(key) or super().__contains__(self._arm_of_body(str(key)))

    def get(self, key: str, default: Any = None) -> Any:
        """Return the entry of an arm or end effector body, or the default."""
        return self[key] if key in self else default  # noqa: SIM401


class ManipulatorModel(RobotModel):
    """
    A robot with arms that end in bodies for grippers.

    :param fname: path of an MJCF file with one root body
    :param idn: number or word in names, as in ``robot0_joint1``
    :raises ModelError: if :attr:`arm_type` is not known, or does not fit the end effector bodies
    :raises UnknownNameError: if the file lacks an end effector body
    """

    def __init__(self, fname: str | PathLike[str], idn: int | str = 0) -> None:
        super().__init__(fname, idn=idn)
        if self.arm_type not in ARMS_OF_TYPE:
            raise UnknownNameError('arm type', self.arm_type, ARMS_OF_TYPE)
        if set(self.arms) != set(self._eef_name):
            raise ModelError(f'{self.name} is {self.arm_type}, so it needs an end effector body '
                             f'for {", ".join(self.arms)}; it has {self._eef_name}')
        self._check_important('body', self._eef_name.values(), self._bodies)
        self._grippers: ArmDict[GripperModel] = ArmDict(self._arm_of_body)

    def refresh(self) -> None:
        """
        Update the recorded lists, ranges and offsets after edits of :attr:`spec`.

        The mounted parts are updated too.

        :raises UnknownNameError: if an end effector body no longer exists
        """
        super().refresh()
        self._check_important('body', self._eef_name.values(), self._bodies)

    @property
    @abstractmethod
    def arm_type(self) -> str:
        """``single`` or ``bimanual``."""

    @property
    @abstractmethod
    def default_gripper(self) -> dict[str, str]:
        """Name by arm of the gripper that is mounted unless another is requested."""

    @property
    def declared_grippers(self) -> dict[str, str]:
        """
        A copy of :attr:`default_gripper`.

        :raises ModelError: if that is not a mapping
        """
        return dict(mapping(self.default_gripper, f'default_gripper of {self.name}',
                            "{'right': 'PandaGripper'}"))

    @property
    def _eef_name(self) -> dict[str, str]:
        """Raw name of the end effector body by arm."""
        return {'right': 'right_hand'}

    @property
    def gripper_mount_pos_offset(self) -> dict[str, list[float]]:
        """Position of a gripper's root body in the end effector body, by arm [m]."""
        return {}

    @property
    def gripper_mount_quat_offset(self) -> dict[str, list[float]]:
        """Orientation of a gripper's root body in the end effector body, by arm (w, x, y, z)."""
        return {}

    @property
    def arms(self) -> tuple[str, ...]:
        """``right``, and ``left`` if there are two."""
        return ARMS_OF_TYPE[self.arm_type]

    @property
    def eef_name(self) -> dict[str, str]:
        """Prefixed name of the end effector body by arm."""
        return {arm: self.correct_naming(self._eef_name[arm]) for arm in self.arms}

    @property
    def hand_rotation_offset(self) -> dict[str, FloatArray]:
        """
        The rotation of the end effector body in its parent link, by arm.

        x, y, z, w with unit norm, shape (4,), of the compiled model.
        """
        return {arm: wxyz_to_xyzw(self._own_model.body(body).quat)
                for arm, body in self._eef_name.items()}

    @property
    def grippers(self) -> ArmDict[GripperModel]:
        """The mounted grippers by arm, in the order of mounting."""
        return self._grippers

    @property
    def cameras(self) -> list[str]:
        """All cameras of the robot, its base and its grippers."""
        cameras = super().cameras
        return cameras + [camera for part in self.models for camera in part.cameras]

    def _arm_of_body(self, name: str) -> str | None:
        return next((arm for arm, body in self.eef_name.items() if body == name), None)

    def _mounted(self) -> list[tuple[MujocoXMLModel, str]]:
        return [*super()._mounted(), *(
            (gripper, 'gripper_' if len(self.arms) == 1 else f'gripper_{arm}_')
            for arm, gripper in self._grippers.items())]

    @property
    def own_hands(self) -> tuple[str, ...]:
        """The arms that carry a hand which is part of the robot's own file."""
        return ()

    def take_off_hand(self, arm: str) -> None:
        """
        Remove the hand of the robot's own file from an arm, if there is one.

        :param arm: ``right`` or ``left``
        """

    def add_gripper(self, gripper: GripperModel, arm_name: str | None = None) -> None:
        """
        Mount a gripper.

        :param gripper: the gripper; each of several arms gets a copy with the arm added to its idn
        :param arm_name: an arm or its end effector body; None mounts on every arm
        :raises TypeError: if it is not a gripper
        :raises UnknownNameError: if the arm is unknown
        :raises ModelError: if the arm has a gripper already, or the gripper is mounted already
        """
        if not isinstance(gripper, GripperModel):
            raise TypeError(f'a gripper must be a GripperModel, not {type(gripper).__name__}')
        arms = self.arms if arm_name is None else (self.arm_of(arm_name),)
        for arm in arms:
            if arm in self._grippers:
                raise ModelError(f"{self.name}'s {arm} arm holds {self._grippers[arm].name} "
                                 f'already, cannot add {gripper.name}')
        if any(gripper is mounted or gripper.naming_prefix == mounted.naming_prefix
               for mounted in self._grippers.values()):
            raise ModelError(f"a gripper with the prefix '{gripper.naming_prefix}' is mounted on "
                             f'{self.name} already: give {gripper.name} another idn')
        for arm in arms:
            part = gripper if len(arms) == 1 else gripper.clone(f'{gripper.idn}_{arm}')
            part.set_mount_pose(self.gripper_mount_pos_offset.get(arm),
                                self.gripper_mount_quat_offset.get(arm))
            self._grippers[arm] = part
        self._was_mounted()

    def arm_of(self, arm_name: str) -> str:
        """
        Return an arm by its name or by that of its end effector body.

        :param arm_name: an arm or its end effector body
        :raises UnknownNameError: if the arm is unknown
        """
        for arm, body in self.eef_name.items():
            if arm_name in (arm, body):
                return arm
        raise UnknownNameError(f'arm of {self.name}', arm_name,
                               [*self.arms, *self.eef_name.values()])

    def attach_to(self, spec: mujoco.MjSpec, frame: mujoco.MjsFrame,
                  floor_xpos: ArrayLike | None = None) -> None:
        """
        Add a copy of the robot and of everything mounted on it to another spec.

        :param spec: the spec to add to
        :param frame: the frame of that spec to attach the robot to
        :param floor_xpos: as for :meth:`RobotModel.attach_to`
        """
        super().attach_to(spec, frame, floor_xpos)
        for arm, gripper in self._grippers.items():
            gripper._attach_recorded(spec, spec.body(self.eef_name[arm]).add_frame())
