# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Own the physics of one world: take commands, advance, tell the state, go back to the start."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from manip_sim.errors import CommandError
from manip_sim.models.loading import compile_spec
from manip_sim.models.world import World
from manip_sim.simulation.activation import (
    add_setpoint_activation, position_servos_without_dynamics)
from manip_sim.simulation.command_parser import CommandParser
from manip_sim.simulation.commands import Command, GripperAction, GripperSetpoint
from manip_sim.simulation.gripper_controller import GripperController
from manip_sim.simulation.joint_controller import JointController
from manip_sim.simulation.parts import find_parts, Part
from manip_sim.simulation.start_check import check_start
from manip_sim.simulation.state import ControllerState, State
from manip_sim.simulation.wrench import EndEffectorReader
from manip_sim.typing import FloatArray

#: A generalised velocity that no robot has: the physics has diverged [rad/s or m/s].
_ABSURD_VELOCITY = 1e4
#: How long the coupled joints of grippers may take to find their start [s].
_SETTLE_S = 0.5
#: Setpoints that move are linear for at most so long [s].
_INTERVAL_S = 0.004


class Simulation:
    """
    The physics of a world, and the control of its first robot.

    Time is a count of steps. Nothing here waits or looks at a clock; one thread at a time may use
    it. Commands are validated by :attr:`parse`, which only reads, and take effect with
    :meth:`apply`.

    :param world: an arena with robots; the first robot is commanded and observed, the others hold
        where they start
    :param visual: keep the shapes that cannot collide, to look at; they slow down each step
    :ivar model: the ``mujoco.MjModel``
    :ivar data: the ``mujoco.MjData``
    :ivar parts: of the first robot, by name
    :ivar joints: controls its joints
    :ivar grippers: its grippers, by part
    :ivar parse: makes commands for it
    :ivar step_count: physics steps since construction; a reset does not change it
    :ivar start_defects: what starts inside something, blocked or outside its range
    :ivar diverged: why the physics is held, or None
    """

    def __init__(self, world: World, visual: bool = False) -> None:
        self.robot = world.robots[0]
        spec = world.compose(visual)
        add_setpoint_activation(spec, [
            *(name for robot in world.robots for name in robot.all_actuators),
            *position_servos_without_dynamics(spec, world.gripper_actuators)])
        self.model: Any = compile_spec(spec, world.name)
        # Report divergence instead of letting MuJoCo reset silently.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.data: Any = mujoco.MjData(self.model)
        self.step_count = 0
        self.diverged: str | None = None
        self._start = world.init_qpos()
        self._timestep_ns: int = round(self.model.opt.timestep * 1e9)
        self._period_s = self.timestep_s
        self._interval_steps = max(1, round(_INTERVAL_S / self.timestep_s))
        self._to_start()
        parts_of_robot = [find_parts(self.model, robot) for robot in world.robots]
        self.parts: dict[str, Part] = parts_of_robot[0]
        self._joint_controllers = [self._joint_controller(parts) for parts in parts_of_robot]
        self._gripper_controllers = [
            GripperController(self.model, part, self.timestep_s)
            for parts in parts_of_robot for part in parts.values() if part.gripper is not None]
        self.joints = self._joint_controllers[0]
        self.grippers = {g.part.name: g for g in self._gripper_controllers
                         if g.part is self.parts.get(g.part.name)}
        self.parse = CommandParser(self.robot, self.joints, self.grippers)
        self.end_effectors = {
            name.split('/')[0]: EndEffectorReader(self.model, part.gripper)
            for name, part in self.parts.items() if part.gripper is not None}
        self._index_joints()
        self._settle_linkages()
        self._good = np.empty(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION))
        self.reset()
        self.start_defects = check_start(
            self.model, self.data, [robot.root_body for robot in world.robots])

    def _joint_controller(self, parts: dict[str, Part]) -> JointController:
        joint_parts = {name: part for name, part in parts.items() if part.gripper is None}
        atomic = [name for name, part in joint_parts.items() if part.atomic == (name,)]
        return JointController(self.model, self.data, joint_parts, atomic)

    def _to_start(self) -> None:
        mujoco.mj_resetData(self.model, self.data)
        for joint, position in self._start.items():
            self.data.joint(joint).qpos[0] = position
        mujoco.mj_forward(self.model, self.data)

    def _settle_linkages(self) -> None:
        """
        Let the start of grippers with coupled joints obey the couplings.

        A declared start need not, and would be torn right with great force in the first steps.
        """
        self.reset()
        if not self.model.neq + self.model.ntendon:
            return
        gravity, flags = self.model.opt.gravity.copy(), self.model.opt.disableflags
        self.model.opt.gravity[:] = 0.0
        # Only the couplings count here, not what a hand is inside of.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        mujoco.mj_step(self.model, self.data, round(_SETTLE_S / self.timestep_s))
        self.model.opt.gravity[:], self.model.opt.disableflags = gravity, flags
        for gripper in self._gripper_controllers:
            part = gripper.part
            self._start.update(zip(part.joints, self.data.qpos[part.qpos_addresses].tolist()))

    def _index_joints(self) -> None:
        atomic = [part for name, part in self.parts.items() if part.atomic == (name,)]
        self.joint_names: tuple[str, ...] = tuple(j for part in atomic for j in part.joints)
        self._qpos_addresses = np.concatenate([part.qpos_addresses for part in atomic])
        self._dof_addresses = np.concatenate([part.dof_addresses for part in atomic])
        place = {name: index for index, name in enumerate(self.joint_names)}
        #: Where the joints of each part are among :attr:`joint_names`.
        self.indices_of = {name: np.array([place[j] for j in part.joints], dtype=np.int64)
                           for name, part in self.parts.items()}

    @property
    def timestep_s(self) -> float:
        """Length of a physics step [s]."""
        return float(self.model.opt.timestep)

    @property
    def time_s(self) -> float:
        """Simulation time [s]."""
        return self.time_ns * 1e-9

    @property
    def time_ns(self) -> int:
        """Simulation time: steps times the timestep [ns]."""
        return self.step_count * self._timestep_ns

    def apply(self, *commands: Command, period_s: float | None = None) -> None:
        """
        Let validated commands take effect with the next control period.

        :param period_s: length of a control period [s]; None is that of the last one
        """
        if period_s is not None:
            self._period_s = period_s
        for command in commands:
            if isinstance(command, (GripperAction, GripperSetpoint)):
                (part,) = command.parts
                self.grippers[part].apply(command, self.data)
            else:
                self.joints.apply(command, self.data, self.time_s, self._period_s)

    def limits(self, part: str) -> FloatArray:
        """
        Return the range of each driven joint's goal in its present mode, shape (n, 2), a copy.

        :raises UnknownNameError: if there are no such joints
        """
        return self.joints.ranges(self.joints.indices_of(part))

    def set_control_mode(self, part: str, mode: str) -> None:
        """
        Change how a part is controlled; it comes to rest.

        :param mode: ``position``, ``velocity`` or ``effort``
        :raises CommandError: if the part is a gripper
        :raises UnknownNameError: if there is no such part or mode
        """
        self._check_no_gripper(part)
        self.joints.set_mode(part, mode, self.data)

    def set_command_timeout(self, part: str, timeout_s: float) -> None:
        """
        Change after how long without a fresh command a part rests.

        :param timeout_s: simulation time [s]; 0 is never
        :raises CommandError: if the part is a gripper
        :raises UnknownNameError: if there is no such part
        """
        self._check_no_gripper(part)
        self.joints.set_timeout(part, timeout_s)

    def _check_no_gripper(self, part: str) -> None:
        if part in self.grippers:
            raise CommandError(f'{part} is a gripper, which is always in position mode')

    def advance(self, steps: int) -> None:
        """
        Run one control period; afterwards all of the data belongs to the new instant.

        Does nothing while :attr:`diverged` is set.

        :param steps: number of physics steps
        """
        if self.diverged is not None:
            return
        self._period_s = steps * self.timestep_s
        for joints in self._joint_controllers:
            joints.begin_period(self.data, self.time_s)
        mujoco.mj_getState(self.model, self.data, self._good,
                           mujoco.mjtState.mjSTATE_INTEGRATION)
        warnings = self._bad_numbers()
        self._step(steps)
        # After mj_step the sensors are one step older than the positions.
        mujoco.mj_forward(self.model, self.data)
        self._check_divergence(warnings)

    def _step(self, steps: int) -> None:
        left = steps
        while left:
            moving = any(controller.moving for controller in self._joint_controllers) or any(
                gripper.moving for gripper in self._gripper_controllers)
            # As even as they can be.
            chunk = -(-left // -(-left // self._interval_steps)) if moving else left
            for controller in self._joint_controllers:
                controller.tick(self.data, self.time_s, chunk * self.timestep_s)
            for gripper in self._gripper_controllers:
                if gripper.moving:
                    gripper.tick(self.data, chunk * self.timestep_s)
            mujoco.mj_step(self.model, self.data, chunk)
            self.step_count += chunk
            left -= chunk

    def _bad_numbers(self) -> int:
        warning, kinds = self.data.warning, mujoco.mjtWarning
        return sum(int(warning[int(kind)].number) for kind in (
            kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC,
            kinds.mjWARN_BADCTRL))

    def _check_divergence(self, warnings_before: int) -> None:
        velocity = self.data.qvel
        if not (np.isfinite(self.data.qpos).all() and np.isfinite(velocity).all()
                and np.isfinite(self.data.qacc).all()):
            reason = 'a position, velocity or acceleration is not finite'
        elif np.abs(velocity).max(initial=0.0) > _ABSURD_VELOCITY:
            reason = f'a velocity is above {_ABSURD_VELOCITY:g}'
        elif self._bad_numbers() > warnings_before:
            reason = 'MuJoCo warns of a bad position, velocity, acceleration or control'
        else:
            return
        self.diverged = f'the physics diverged at {self.time_ns / 1e9:.3f} s: {reason}'
        mujoco.mj_setState(self.model, self.data, self._good, mujoco.mjtState.mjSTATE_INTEGRATION)
        self.data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def reset(self) -> None:
        """
        Put everything back to the start and drop all commands; time goes on.

        Joints, grippers and their action state, free objects and tare are as after construction;
        control modes stay.
        """
        self._to_start()
        for controller in self._joint_controllers:
            controller.reset(self.data)
        for gripper in self._gripper_controllers:
            gripper.reset(self.data)
        for reader in self.end_effectors.values():
            reader.reset()
        self.diverged = None
        mujoco.mj_forward(self.model, self.data)

    def tare_wrench(self) -> None:
        """Let the present external wrench of every arm read zero."""
        for reader in self.end_effectors.values():
            reader.tare(self.data)

    def state(self) -> State:
        """Return a snapshot of the present instant."""
        data = self.data
        return State(
            time_ns=self.time_ns,
            position=data.qpos[self._qpos_addresses],
            velocity=data.qvel[self._dof_addresses],
            effort=data.qfrc_actuator[self._dof_addresses],
            end_effectors={arm: reader.read(data) for arm, reader in self.end_effectors.items()})

    def controller_state(self, part: str) -> ControllerState:
        """
        Return what the controllers of a part's driven joints want and get, copies.

        :raises UnknownNameError: if there are no such joints
        """
        return self.joints.controller_state(part, self.data)
