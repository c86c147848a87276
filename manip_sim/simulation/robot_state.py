# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The state of a robot at one instant, as plain copies that are safe to keep, and its reader.

The joints and the grippers of a robot are read exactly, and as they are measured. The dynamics of
a joint complete its state: a URDF has no place for most of them. With the links of
``robot_description`` they are everything that a controller needs to compute the torques of the
simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
import math

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.controlled_joints import ControlledJoints
from manip_sim.errors import UnknownNameError
from manip_sim.models.actuators import declared_velocity, FrictionLaw
from manip_sim.physics.clock import Clock
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.parts import (
    atomic_parts, end_effector, EndEffector, EndEffectorReader, find_places, Part, READINGS)
from manip_sim.physics.physics import Physics
from manip_sim.physics.robot_frames import OdometryReader
from manip_sim.sensing.robot_sensing import ExternalWrenchChannel, JOINTS, ODOM, RobotSensing
from manip_sim.sensing.sensor_noise import JointChannel, OdometryChannel, WrenchChannel


@dataclass(frozen=True)
class State:
    """
    A snapshot of one instant.

    :ivar time_ns: simulation time [ns], a whole number of steps
    :ivar position: of all scalar joints, in the order of the robot's ``joint_names``
        [rad or m], shape (n,)
    :ivar velocity: [rad/s or m/s], shape (n,)
    :ivar effort: of the actuators at the joint in the last physics step, gravity compensation
        included [N m or N], shape (n,)
    :ivar end_effectors: by arm, of the arms with a gripper
    """

    time_ns: int
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    end_effectors: dict[str, EndEffector] = field(default_factory=dict)


@cache
def _channels_of(arm: str) -> tuple[str, ...]:
    """Return the names of the channels of a gripper."""
    return tuple(f'{arm}/{reading}' for reading in READINGS)


def _read(read: Callable[[mujoco.MjData], FloatArray], physics: Physics) -> FloatArray:
    return read(physics.data)


class RobotReader:
    """
    A reader of one robot.

    :param physics: of the world at the start
    :param name: of the robot
    :param parts: of the robot, by name
    :param efforts: of the actuators of the model
    :param clock: of the simulation
    :ivar joint_names: all scalar joints, in the order of the states
    :ivar indices_of: indices of each part's joints in :attr:`joint_names`, by part
    :ivar end_effectors: readers of the grippers, by arm, of the arms with a gripper
    :ivar sensing: the measurements: noise, resolution and latency
    """

    def __init__(self, physics: Physics, name: str, parts: Mapping[str, Part],
                 efforts: ActuatorEfforts, clock: Clock) -> None:
        self._physics, self._efforts, self._clock, self._parts = physics, efforts, clock, parts
        self.joint_names = tuple(j for part in atomic_parts(parts) for j in part.joints)
        place = {joint: index for index, joint in enumerate(self.joint_names)}
        self.indices_of = {part_name: np.array([place[j] for j in part.joints], dtype=np.int64)
                           for part_name, part in parts.items()}
        physics.on_change(self._find_places)
        self.end_effectors = {
            part_name.split('/')[0]: EndEffectorReader(physics, part.gripper)
            for part_name, part in parts.items() if part.gripper is not None}
        self.sensing = RobotSensing(
            name, clock, float(physics.model.opt.timestep), physics.interrupt)
        self._add_channels(name)

    def _find_places(self) -> None:
        """Find the addresses of the joints, which change when a robot before is deleted."""
        find_places(self._physics.model, self._parts.values())
        qpos, dofs = (np.concatenate([getattr(part, kind) for part in atomic_parts(self._parts)])
                      for kind in ('qpos_addresses', 'dof_addresses'))
        #: Addresses in ``qpos`` and ``qvel`` of the joints of each part, and of all joints.
        self._addresses: dict[str | None, tuple[IntArray, IntArray]] = {None: (qpos, dofs), **{
            name: (qpos[indices], dofs[indices]) for name, indices in self.indices_of.items()}}

    def _add_channels(self, name: str) -> None:
        model = self._physics.model
        types = model.jnt_type[model.dof_jntid[self._addresses[None][1]]]
        self.sensing.add(JOINTS, self.exact, JointChannel(
            f'{name} joints', types == int(mujoco.mjtJoint.mjJNT_SLIDE)))
        for arm, reader in self.end_effectors.items():
            wrench = WrenchChannel(reader.ft_frame, 6)
            noise = {'wrench': wrench, 'external_wrench': ExternalWrenchChannel(wrench)}
            for reading, channel in zip(READINGS, _channels_of(arm)):
                read = partial(_read, getattr(reader, reading), self._physics)
                self.sensing.add(channel, read, noise.get(reading))

    def measured(self, part: str | None = None) -> FloatArray:
        """Return the measurements of a part's joints, as :meth:`SimulatedRobot.measured`."""
        if part not in self._addresses or not (
                self.sensing.settings.measures or self.sensing.faulty() is not None):
            return self.exact(part)
        rows = self.sensing.measured(JOINTS)
        return rows if part is None else rows.reshape(3, -1)[:, self.indices_of[part]].ravel()

    def exact(self, part: str | None = None) -> FloatArray:
        """Return the same as :meth:`measured`, without noise and latency."""
        if part not in self._addresses:
            raise UnknownNameError('part', part, self.indices_of)
        qpos, dofs = self._addresses[part]
        physics = self._physics
        return np.concatenate([
            physics.qpos[qpos], physics.qvel[dofs], self._efforts.values[dofs]])

    def state(self, read: Callable[[str], FloatArray]) -> State:
        """
        Return the state of all joints and grippers.

        :param read: returns a channel by its name, measured or exactly
        """
        position, velocity, effort = read(JOINTS).reshape(3, -1)
        return State(
            time_ns=self._clock.time_ns, position=position, velocity=velocity, effort=effort,
            end_effectors={arm: end_effector(*map(read, _channels_of(arm)))
                           for arm in self.end_effectors})

    def add_odometry(self, name: str, joints: Sequence[str]) -> None:
        """
        Measure the odometry of a base.

        :param name: of the robot
        :param joints: x, y and yaw
        """
        self._odometry = OdometryReader(self._physics.model, joints)
        self.sensing.add(ODOM, self._read_odometry, OdometryChannel(f'{name} odom'))

    def _read_odometry(self) -> FloatArray:
        """Return pose and twist of the base in the frame of its odometry, exactly, (13,)."""
        state = self._odometry.read(self._physics.model, self._physics.data)
        return np.concatenate([state.position, state.quat_xyzw, state.linear, state.angular])

    def end_period(self, steps: int, period_s: float) -> None:
        """
        Record measurements at the end of a control period.

        :param steps: physics steps of the period
        :param period_s: its length [s]
        """
        self.sensing.end_period({f'{arm}/external_wrench': reader.external.weight(period_s)
                                 for arm, reader in self.end_effectors.items()}, steps)


@dataclass(frozen=True)
class JointDynamics:
    """
    One joint, which obeys ``M(q) a + armature a + h(q, v) = effort - damping v - friction``.

    ``friction`` is up to :attr:`friction_loss` against the motion, and a spring pulls with
    ``stiffness (spring_position - q)``. Units are SI, with m and N for sliding joints. What
    depends on the velocity is described by ``manip_sim.models.descriptions.FrictionLaw``.

    :ivar armature: inertia of the rotor reflected to the joint [kg m^2 or kg]
    :ivar damping: [N m s/rad or N s/m]
    :ivar friction_loss: dry friction [N m or N]
    :ivar static_friction: dry friction at rest [N m or N]; None if it is :attr:`friction_loss`
    :ivar stribeck_velocity: at which it is between both [rad/s or m/s]; None if there is none
    :ivar stiffness: of a spring [N m/rad or N/m]
    :ivar spring_position: where the spring is at rest [rad or m]
    :ivar position_range: lowest and highest [rad or m]; None if it is not limited
    :ivar velocity_limit: [rad/s or m/s]; None if there is none
    :ivar effort_range: lowest and highest, gravity compensation included [N m or N]; None if it is
        not limited at the joint
    :ivar acceleration_limit: of setpoints [rad/s^2 or m/s^2]; None for joints without a controller
    :ivar knee_velocity: up to which all of the effort range is there [rad/s or m/s]; None: always
    :ivar no_load_velocity: at which no effort is left [rad/s or m/s]; None: there always is
    """

    armature: float
    damping: float
    friction_loss: float
    static_friction: float | None
    stribeck_velocity: float | None
    stiffness: float
    spring_position: float
    position_range: tuple[float, float] | None
    velocity_limit: float | None
    effort_range: tuple[float, float] | None
    acceleration_limit: float | None
    knee_velocity: float | None
    no_load_velocity: float | None


def joint_dynamics(model: mujoco.MjModel, joints: ControlledJoints, names: Iterable[str],
                   laws: Mapping[str, FrictionLaw]) -> dict[str, JointDynamics]:
    """
    Return the dynamics of joints by name.

    :param model: the compiled ``mujoco.MjModel``
    :param joints: those that have a controller
    :param names: of hinge and slide joints
    :param laws: of joints whose friction or torque limit depends on the velocity
    """
    return {name: _of_joint(model, joints, name, laws.get(name)) for name in names}


def _of_joint(model: mujoco.MjModel, joints: ControlledJoints, name: str, law: FrictionLaw | None
              ) -> JointDynamics:
    joint = int(model.joint(name).id)
    dof = int(model.jnt_dofadr[joint])
    velocity = float(declared_velocity(model, joint))
    acceleration = None
    law = law or FrictionLaw()
    stribeck = _finite(law.stribeck_velocity)
    if name in joints.names:
        index = joints.find([name])
        velocity = float(joints.velocity_limits(index)[0])
        acceleration = float(joints.acceleration_limits(index)[0])
    return JointDynamics(
        armature=float(model.dof_armature[dof]),
        # Some releases of MuJoCo have polynomials here, whose first coefficient is linear.
        damping=float(np.reshape(model.dof_damping, (model.nv, -1))[dof, 0]),
        friction_loss=float(model.dof_frictionloss[dof]) if stribeck is None else law.coulomb,
        static_friction=None if stribeck is None else law.static, stribeck_velocity=stribeck,
        stiffness=float(np.reshape(model.jnt_stiffness, (model.njnt, -1))[joint, 0]),
        spring_position=float(model.qpos_spring[model.jnt_qposadr[joint]]),
        position_range=_range(model.jnt_limited[joint], model.jnt_range[joint]),
        velocity_limit=_finite(velocity),
        effort_range=_range(model.jnt_actfrclimited[joint], model.jnt_actfrcrange[joint]),
        acceleration_limit=acceleration, knee_velocity=_finite(law.knee),
        no_load_velocity=_finite(law.no_load))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _range(limited: int, ends: Iterable[float]) -> tuple[float, float] | None:
    low, high = ends
    return (float(low), float(high)) if limited else None
