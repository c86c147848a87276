# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The state of a robot at one instant, as plain copies that are safe to keep, and its reader.

The joints and the grippers of a robot are read exactly, and as they are measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import UnknownNameError
from manip_sim.physics.clock import Clock
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.end_effectors import end_effector, EndEffector, EndEffectorReader, READINGS
from manip_sim.physics.parts import atomic_parts, find_places, Part
from manip_sim.physics.physics import Physics
from manip_sim.physics.robot_frames import OdometryReader
from manip_sim.sensing.odometry_drift import OdometryChannel
from manip_sim.sensing.robot_sensing import ExternalWrenchChannel, JOINTS, ODOM, RobotSensing
from manip_sim.sensing.sensor_noise import JointChannel, WrenchChannel


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
                self.sensing.add(channel, partial(self._read, arm, reading), noise.get(reading))

    def _read(self, arm: str, name: str) -> FloatArray:
        """Return one of the readings of a gripper, exactly."""
        reading: FloatArray = getattr(self.end_effectors[arm], name)(self._physics.data)
        return reading

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
