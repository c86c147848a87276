# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots with arms, and those of the catalogue. Every module here is imported for its robots."""

from __future__ import annotations

from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Callable
from os import PathLike
from typing import Any, TYPE_CHECKING, TypeVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import wxyz_to_xyzw
from manip_sim.arrays import FloatArray
from manip_sim.errors import KindError, ModelError, UnknownNameError
from manip_sim.models.grippers import GripperModel
from manip_sim.models.mjcf import CatalogueModel, FromYaml, MujocoXMLModel
from manip_sim.models.registry import import_submodules
from manip_sim.models.robots.robot_model import Placement, RobotModel, ROBOTS
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
            raise KindError(f'a gripper must be a GripperModel, not {type(gripper).__name__}')
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


class CatalogueRobot(CatalogueModel, ManipulatorModel, registered=False):
    """A robot with arms from ``assets/robots``."""

    _kind = 'robots'
    gains_are_highest = True
    _arms = FromYaml('arms', {})
    _base_name = FromYaml('base', None)
    _controllers = FromYaml('controllers', {})
    _start = FromYaml('start', {})
    _placement = FromYaml('placement', {})
    #: From the middle of the near edge of a table, on the floor [m].
    _table_placement = FromYaml('table_placement', (0.0, 0.0, 0.0))
    _foot_offset = FromYaml('foot', None)
    _top_offset = FromYaml('top', (0.0, 0.0, 0.0))
    _horizontal_radius = FromYaml('radius', 0.0)

    def _of_arms(self, key: str) -> dict[str, str]:
        return {arm: described[key] for arm, described in self._arms.items() if key in described}

    @property
    def arm_type(self) -> str:
        """``single`` or ``bimanual``."""
        return 'single' if len(self._arms) == 1 else 'bimanual'

    @property
    def _eef_name(self) -> dict[str, str]:
        return self._of_arms('mount')

    @property
    def default_base(self) -> str | None:
        """Name of the base that the robot stands on unless another is requested."""
        name: str | None = self._base_name
        return name

    @property
    def default_gripper(self) -> dict[str, str]:
        """Name by arm of the gripper that is mounted unless another is requested."""
        return self._of_arms('gripper')

    @property
    def default_controller_config(self) -> dict[str, str]:
        """Names of robosuite's controller settings, by arm or subsystem."""
        return {**self._of_arms('controller'), **self._controllers}

    @property
    def init_qpos(self) -> FloatArray:
        """Start positions in the order of :attr:`joints` [rad or m], shape (dof,), a copy."""
        return np.array([self._start.get(joint, 0.0) for joint in self._joints])

    @property
    def base_xpos_offset(self) -> dict[str, Placement]:
        """Place of the robot by arena [m], or a function of the table's length [m]."""
        x, y, z = self._table_placement
        return {'table': lambda table_length: (x - table_length / 2.0, y, z),
                **{arena: tuple(position) for arena, position in self._placement.items()}}


class Baxter(CatalogueRobot, folder='baxter'):
    """Two seven-joint arms and a screen, 2.2 kg payload each, 1.2 m reach."""


class FR3(CatalogueRobot, folder='fr3'):
    """Seven-joint arm, 3 kg payload, 0.855 m reach, with faster joints than the Panda."""


class GR1(CatalogueRobot, folder='gr1'):
    """Humanoid of 1.65 m: torso, head, two seven-joint arms and two six-joint legs."""


class IIWA(CatalogueRobot, folder='iiwa'):
    """Seven-joint arm, 7 kg payload, 0.8 m reach."""


class Jaco(CatalogueRobot, folder='jaco'):
    """Seven-joint arm of carbon fibre with a spherical wrist."""


class Kinova3(CatalogueRobot, folder='kinova3'):
    """Seven-joint arm, four of them without end stops, 4 kg payload, 0.902 m reach."""


class Panda(CatalogueRobot, folder='panda'):
    """Seven-joint arm, 3 kg payload, 0.855 m reach."""


class PandaOmron(Panda, folder='panda_omron'):
    """The Panda, by default on the Omron base."""

    _torso_start = FromYaml('torso_start', ())

    @property
    def init_torso_qpos(self) -> FloatArray:
        """Start position of the column [m], shape (1,)."""
        return np.array(self._torso_start)

    @property
    def init_base_qpos(self) -> FloatArray | None:
        """Start positions of the base: the torso lifted, if it has one, else zero [m or rad]."""
        if self.base is None:
            return None
        lifted = dict(zip(self.torso_joints, self._torso_start))
        return np.array([lifted.get(joint, 0.0) for joint in self.base.joints])


class SO101(CatalogueRobot, folder='so101'):
    """Five-joint arm of printed parts and hobby servos, 0.34 m reach with the gripper down."""


class Sawyer(CatalogueRobot, folder='sawyer'):
    """Seven-joint arm with a screen, 4 kg payload, 1.26 m reach."""


class Tiago(CatalogueRobot, folder='tiago'):
    """Mobile robot with a lifting torso, a head and a seven-joint arm, 3 kg payload."""


class UR5e(CatalogueRobot, folder='ur5e'):
    """Six-joint arm, 5 kg payload, 0.85 m reach."""


class XArm7(CatalogueRobot, folder='xarm7'):
    """Seven-joint arm, 3.5 kg payload, 0.7 m reach; four of its joints turn twice around."""


import_submodules(__name__, __path__)


def robot_names() -> list[str]:
    """Return the names that :func:`create_robot` takes, also those in the user's folders."""
    return ROBOTS.all_names()


def create_robot(name: str | PathLike[str], idn: int | str = 0, prefix: str = '') -> RobotModel:
    """
    Create a robot by its name, that of its class or of an entry point, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.registry.find_source`` takes
    :param idn: number or word in the prefix ``robot{idn}_``
    :param prefix: that the names of the robot and of everything mounted on it get instead, such
        as ``left_`` (see :meth:`RobotModel.set_naming_prefix`)
    :raises UnknownNameError: if the robot is unknown, naming the nearest ones
    :raises ModelError: if names cannot begin with the prefix, a file cannot be used, or the robot
        of another package cannot be imported
    """
    robot = ROBOTS.create_or_load(name, idn=idn)
    if not isinstance(prefix, str) or prefix:
        robot.set_naming_prefix(prefix)
    return robot


if not TYPE_CHECKING:
    def __getattr__(name: str) -> type[RobotModel]:
        return ROBOTS.attribute(__name__, name)


__all__ = [
    'Baxter', 'FR3', 'GR1', 'IIWA', 'Jaco', 'Kinova3', 'ManipulatorModel', 'Panda', 'PandaOmron',
    'Placement', 'RobotModel', 'SO101', 'Sawyer', 'Tiago', 'UR5e', 'XArm7', 'create_robot',
    'robot_names']
