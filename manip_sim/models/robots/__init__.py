# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots. Every module here is imported, which registers its robots."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.mjcf import CatalogueModel, FromYaml
from manip_sim.models.registry import import_submodules
from manip_sim.models.robots.manipulator_model import ManipulatorModel
from manip_sim.models.robots.robot_model import Placement, RobotModel, ROBOTS


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
    if prefix:
        robot.set_naming_prefix(prefix)
    return robot


if not TYPE_CHECKING:
    def __getattr__(name: str) -> type[RobotModel]:
        return ROBOTS.attribute(__name__, name)


__all__ = [
    'Baxter', 'FR3', 'GR1', 'IIWA', 'Jaco', 'Kinova3', 'ManipulatorModel', 'Panda', 'PandaOmron',
    'RobotModel', 'SO101', 'Sawyer', 'Tiago', 'UR5e', 'XArm7', 'create_robot', 'robot_names']
