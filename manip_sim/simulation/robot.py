# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""One robot of a simulated world: its parts, their controllers, its end effectors."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import CommandError
from manip_sim.models.robots import RobotModel
from manip_sim.simulation.cartesian.frames import Frame, Frames
from manip_sim.simulation.cartesian.parser import CartesianParser
from manip_sim.simulation.cartesian.targets import Hand
from manip_sim.simulation.command_parser import CommandParser
from manip_sim.simulation.commands import Command, GripperCommand
from manip_sim.simulation.gripper_controller import GripperController
from manip_sim.simulation.joint_controller import JointController
from manip_sim.simulation.parts import find_parts, Part
from manip_sim.simulation.state import ControllerState, State
from manip_sim.simulation.wrench import EndEffectorReader


class SimulatedRobot:
    """
    What is commanded and seen of one robot.

    Commands are validated by :attr:`parse`, which only reads, and take effect with :meth:`apply`.
    Made and driven by a ``Simulation``, which owns the physics.

    :param model: the compiled ``mujoco.MjModel``
    :param data: the ``mujoco.MjData`` at the start, after ``mj_forward``
    :param robot: is in the model
    :param now_ns: tells the simulation time [ns]
    :ivar robot_model: the robot, with its base and its grippers
    :ivar parts: by name
    :ivar joints: controls the joints
    :ivar grippers: by part
    :ivar end_effectors: by arm, of the arms with a gripper
    :ivar parse: makes commands
    :ivar parse_cartesian: makes Cartesian commands
    :ivar joint_names: all scalar joints, in the order of the states
    :ivar indices_of: where the joints of each part are among these, by part
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: RobotModel,
                 now_ns: Callable[[], int]) -> None:
        self._data = data
        self._now_ns = now_ns
        self._timestep_s = self._period_s = float(model.opt.timestep)
        self.robot_model = robot
        self.parts: dict[str, Part] = find_parts(model, robot)
        atomic = [part for name, part in self.parts.items() if part.atomic == (name,)]
        self.end_effectors = {
            name.split('/')[0]: EndEffectorReader(model, part.gripper)
            for name, part in self.parts.items() if part.gripper is not None}
        self.joints = JointController(
            model, data, {name: p for name, p in self.parts.items() if p.gripper is None},
            [part.name for part in atomic if part.gripper is None], self._hands(model))
        self.grippers = {part.name: GripperController(model, part, self._timestep_s)
                         for part in atomic if part.gripper is not None}
        self.parse = CommandParser(robot, self.joints, self.grippers)
        self.parse_cartesian = CartesianParser(self.joints, self._frames(model))
        self._index_joints(atomic)

    def _frames(self, model: mujoco.MjModel) -> Frames:
        bodies = [*self.robot_model.bodies,
                  *(body for part in self.robot_model.models for body in part.bodies)]
        return Frames(model, bodies, [site for reader in self.end_effectors.values()
                                      for site in (reader.grip_site, reader.ft_frame)])

    def _hands(self, model: mujoco.MjModel) -> dict[str, Hand]:
        hands = {}
        for arm, reader in self.end_effectors.items():
            joints = [j for j in self.parts[arm].driven_joints if j] if arm in self.parts else []
            if not joints:
                continue
            tip = model.site(reader.grip_site)
            body = int(model.body_parentid[int(model.joint(joints[0]).bodyid[0])])
            center = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE,
                                       f'{self.robot_model.naming_prefix}{arm}_center')
            origin = Frame(model.body(body).name, body)
            if center >= 0:
                origin = Frame(model.site(center).name, int(model.site_bodyid[center]), center)
            hands[arm] = Hand(Frame(tip.name, int(tip.bodyid[0]), int(tip.id)), origin,
                              self.parts[arm].qpos_addresses)
        return hands

    def _index_joints(self, atomic: list[Part]) -> None:
        self.joint_names: tuple[str, ...] = tuple(j for part in atomic for j in part.joints)
        qpos, dofs = (np.concatenate([getattr(part, kind) for part in atomic])
                      for kind in ('qpos_addresses', 'dof_addresses'))
        place = {name: index for index, name in enumerate(self.joint_names)}
        self.indices_of = {name: np.array([place[j] for j in part.joints], dtype=np.int64)
                           for name, part in self.parts.items()}
        #: Of the joints of each part, and of all joints, in ``qpos`` and ``qvel``.
        self._addresses: dict[str | None, tuple[IntArray, IntArray]] = {None: (qpos, dofs), **{
            name: (qpos[indices], dofs[indices]) for name, indices in self.indices_of.items()}}

    def rebind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """
        Go on with a model in which the robot is what and where it was.

        :param model: the ``mujoco.MjModel``
        :param data: its ``mujoco.MjData``, in the present state
        """
        self._data = data
        self.joints.rebind(model)
        for gripper in self.grippers.values():
            gripper.rebind(model)
        for reader in self.end_effectors.values():
            reader.rebind(model)

    @property
    def name(self) -> str:
        """What its names begin with, without the underscore that follows."""
        return self.robot_model.naming_prefix.rstrip('_')

    @property
    def frame_body(self) -> str:
        """The body that says where the robot is, such as its mobile base."""
        base = self.robot_model.base
        return base.root_body if base is not None and base.joints else self.robot_model.root_body

    @property
    def twist_joints(self) -> tuple[str, ...]:
        """The joints x, y and yaw of a base that takes a twist, or none."""
        indices = self.joints.twist_indices
        return () if indices is None else tuple(self.joints.names[i] for i in indices)

    @property
    def moving(self) -> bool:
        """Whether setpoints change, or may, in the next interval."""
        return self.joints.moving or any(gripper.moving for gripper in self.grippers.values())

    @property
    def resting(self) -> bool:
        """Whether nothing is to be done for it in the physics loop until the next command."""
        return self.joints.resting and not any(g.moving for g in self.grippers.values())

    # ------------------------------------------------------------------ what is commanded

    def apply(self, *commands: Command, period_s: float | None = None) -> None:
        """
        Let validated commands take effect with the next control period.

        :param commands: made by :attr:`parse`
        :param period_s: length of a control period [s]; None is that of the last one
        """
        if period_s is not None:
            self._period_s = period_s
        now_s = self._now_ns() * 1e-9
        for command in commands:
            if isinstance(command, GripperCommand):
                (part,) = command.parts
                self.grippers[part].apply(command, self._data)
            else:
                self.joints.apply(command, self._data, now_s, self._period_s)

    def withdraw(self, command: Command, reason: str) -> None:
        """
        Abort a command; what no newer command has taken comes to rest.

        :param command: that has been applied
        :param reason: why, for the command's handle
        """
        if isinstance(command, GripperCommand):
            (part,) = command.parts
            self.grippers[part].withdraw(command.handle, self._data, reason)
        else:
            self.joints.withdraw(command.handle, self._data, reason)

    def limits(self, part: str) -> FloatArray:
        """
        Return the range of each driven joint's goal in its present mode, shape (n, 2), a copy.

        :param part: such as ``arm``
        :raises UnknownNameError: if there are no such joints
        """
        return self.joints.ranges(self.joints.indices_of(part))

    def set_control_mode(self, part: str, mode: str) -> None:
        """
        Change how a part is controlled; it comes to rest.

        :param part: such as ``arm``
        :param mode: ``position``, ``velocity`` or ``effort``
        :raises CommandError: if the part is a gripper
        :raises UnknownNameError: if there is no such part or mode
        """
        self._check_no_gripper(part)
        self.joints.set_mode(part, mode, self._data)

    def command_interfaces(self) -> dict[str, str]:
        """Return by driven joint what its commands are: ``position``, ``velocity``, ``effort``."""
        fingers = [joint for gripper in self.grippers.values()
                   for joint in gripper.commanded_joints]
        return {**{name: self.joints.mode_of(name) for name in self.joints.names},
                **dict.fromkeys(fingers, 'position')}

    def set_command_timeout(self, part: str, timeout_s: float) -> None:
        """
        Change after how long without a fresh command a part rests.

        :param part: such as ``arm``
        :param timeout_s: simulation time [s]; 0 is never
        :raises CommandError: if the part is a gripper
        :raises UnknownNameError: if there is no such part
        """
        self._check_no_gripper(part)
        self.joints.set_timeout(part, timeout_s)

    def _check_no_gripper(self, part: str) -> None:
        if part in self.grippers:
            raise CommandError(f'{part} is a gripper, which is always in position mode')

    def tare_wrench(self) -> None:
        """Let the present external wrench of every arm read zero."""
        for reader in self.end_effectors.values():
            reader.tare(self._data)

    # ------------------------------------------------------------------ what is seen

    def state(self) -> State:
        """Return a snapshot of the present instant."""
        position, velocity, effort = self.measured().reshape(3, -1)
        return State(
            time_ns=self._now_ns(), position=position, velocity=velocity, effort=effort,
            end_effectors={arm: reader.read(self._data)
                           for arm, reader in self.end_effectors.items()})

    def measured(self, part: str | None = None) -> FloatArray:
        """
        Return positions, velocities and efforts of the joints of a part, one after the other.

        :param part: its name; None is all joints
        :returns: in the order of their names, shape (3 n,), a copy
        """
        qpos, dofs = self._addresses[part]
        data = self._data
        return np.concatenate([data.qpos[qpos], data.qvel[dofs], data.qfrc_actuator[dofs]])

    def controller_state(self, part: str) -> ControllerState:
        """
        Return what the controllers of a part's driven joints want and get, copies.

        :param part: such as ``arm``
        :raises UnknownNameError: if there are no such joints
        """
        return self.joints.controller_state(part, self._data)

    # ------------------------------------------------------------------ in the physics loop

    def begin_period(self, period_s: float) -> None:
        """
        See which commands are done or too old.

        :param period_s: length of the control period [s]
        """
        self._period_s = period_s
        self.joints.begin_period(self._data, self._now_ns() * 1e-9, period_s)

    def tick(self, duration_s: float) -> None:
        """
        Write the controls of the next interval.

        :param duration_s: [s]
        """
        self.joints.tick(self._data, self._now_ns() * 1e-9, duration_s)
        for gripper in self.grippers.values():
            if gripper.moving:
                gripper.tick(self._data, duration_s)

    def reset(self) -> None:
        """Drop all commands, hold the joints where they are, forget the tare; modes stay."""
        self.joints.reset(self._data)
        for gripper in self.grippers.values():
            gripper.reset(self._data)
        for reader in self.end_effectors.values():
            reader.reset()
