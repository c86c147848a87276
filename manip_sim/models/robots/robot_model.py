# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What all robots share: how they are found by name, and what each has to declare."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, Union

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.registry import Registry
from manip_sim.models.robots.standing_model import StandingModel
from manip_sim.models.validation import finite_numbers
from manip_sim.models.velocity_law import VelocityLaw

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
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

    def __init__(self, fname: str | PathLike[str], idn: int | str = 0) -> None:
        super().__init__(fname, idn=idn)
        self._laws: dict[tuple[MujocoXMLModel, str], VelocityLaw] = {}

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
                _set(joint, attrib, value)

    def set_actuation(self, subsystem: str, friction: str | Mapping[str, Any] | None = None,
                      torque_speed: str | Mapping[str, Any] | None = None,
                      armature: float | Sequence[float] | None = None) -> None:
        """
        Choose what motors and gears add to the joints of a subsystem; None keeps what there is.

        :param subsystem: such as ``arm``; two arms are one subsystem
        :param friction: ``catalogue``, or the keys of
            :class:`~manip_sim.models.joint_actuation.Friction`
        :param torque_speed: ``catalogue``, or the keys of
            :class:`~manip_sim.models.joint_actuation.TorqueSpeed`
        :param armature: inertia of the rotors, reflected to the joints [kg m^2 or kg], a number or
            one for each joint
        :raises ModelError: if there are no such joints, the catalogue has no values or values
            cannot be used
        :raises UnknownNameError: if there is no such subsystem
        """
        from manip_sim.models.joint_actuation import JointActuation, read_catalogue, single
        joints = self._scalar_joints(subsystem)
        where = f'{subsystem} of {self.name}'
        if not joints:
            raise ModelError(f'{where}: it has no such joints')
        specs = [part._spec.joint(raw) for part, raw in joints]
        actuation = JointActuation([part.correct_naming(raw) for part, raw in joints], where,
                                   read_catalogue(self.file.parent, subsystem))
        if friction is not None:
            actuation.set_friction(friction)
        if torque_speed is not None:
            actuation.set_torque_speed(torque_speed)
        for attrib, values in (*actuation.attributes(), *(
                () if armature is None else
                [('armature', actuation.of_each(single(armature, where), 'armature'))])):
            for joint, value in zip(specs, values):
                _set(joint, attrib, value)
        self._laws.update(zip(joints, actuation.laws()))
        for part, _ in joints:
            part.refresh()

    @property
    def velocity_laws(self) -> dict[str, VelocityLaw]:
        """How friction and torque limits follow the velocity, by joint; a copy."""
        return {part.correct_naming(raw): law for (part, raw), law in self._laws.items()
                if law.acts}

    def _scalar_joints(self, subsystem: str) -> list[tuple[MujocoXMLModel, str]]:
        """Return the hinge and slide joints of a subsystem, by the part that they are in."""
        wanted = self.joints_of(subsystem)
        return [(part, raw) for part in self._own_parts() for raw in part._joints
                if part.correct_naming(raw) in wanted
                and int(part._spec.joint(raw).type) in _SCALAR]


def _set(joint: mujoco.MjsJoint, attrib: str, value: float) -> None:
    is_array = np.ndim(getattr(joint, attrib)) > 0
    setattr(joint, attrib, [value, 0.0, 0.0] if is_array else value)


ROBOTS: Registry[RobotModel] = Registry('robot', RobotModel)  # type: ignore[type-abstract]
