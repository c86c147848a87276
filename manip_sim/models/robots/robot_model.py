# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What all robots share: how they are found by name, and what each has to declare."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.registry import Registry
from manip_sim.models.robots.standing_model import StandingModel
from manip_sim.models.validation import finite_numbers

#: A position [m], or a function that takes the length of the table [m] and returns one.
Position = tuple[float, float, float]
Placement = Union[Position, Callable[[float], Position]]


class RobotModel(StandingModel, ABC):
    """
    A robot without grippers, and the base that it stands on. Prefix ``robot{idn}_``.

    Another prefix, set by :meth:`StandingModel.set_naming_prefix`, also applies to all that is
    mounted on the robot: with ``left_`` the base has ``left_base_``, a gripper ``left_gripper_``,
    or on two arms ``left_gripper_right_`` and ``left_gripper_left_``.

    :param fname: path of an MJCF file with one root body
    :param idn: number or word in names, as in ``robot0_joint1``
    :raises ModelError: if the file has no root body or several
    """

    def __init_subclass__(cls, registered: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if registered:
            ROBOTS.register(cls)

    @property
    def _prefix_of_idn(self) -> str:
        """The prefix unless another is given."""
        return f'robot{self.idn}_'

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
        """Where to place the robot by arena [m], or a function of the table's length [m]."""

    @property
    def init_base_qpos(self) -> FloatArray | None:
        """Start positions of the joints of the base, in its order [rad or m], or None for zero."""
        return None

    def set_joint_attribute(self, attrib: str, values: ArrayLike, force: bool = True) -> None:
        """
        Set an attribute of all joints of the robot, without those of its base and grippers.

        :param attrib: ``damping``, ``frictionloss``, ``armature`` or ``stiffness``
        :param values: one for each of :attr:`joints`, shape (dof,)
        :param force: also where the file gives a value other than zero
        :raises CommandError: if the number of values is wrong or one is not finite
        :raises UnknownNameError: if there is no such attribute
        """
        settable = ('damping', 'frictionloss', 'armature', 'stiffness')
        if attrib not in settable:
            raise UnknownNameError('joint attribute', attrib, settable)
        numbers = finite_numbers(values, len(self._joints), f'{attrib} of {self.name}',
                                 CommandError)
        for name, value in zip(self._joints, numbers):
            joint = self._spec.joint(name)
            if force or not np.any(getattr(joint, attrib)):
                is_array = np.ndim(getattr(joint, attrib)) > 0
                setattr(joint, attrib, [value, 0.0, 0.0] if is_array else value)


ROBOTS: Registry[RobotModel] = Registry('robot', RobotModel)  # type: ignore[type-abstract]
