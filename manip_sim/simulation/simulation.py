# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Own the physics of one world: take commands, advance, tell the state, go back to the start."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.loading import compile_spec
from manip_sim.models.robots import RobotModel
from manip_sim.models.world import World
from manip_sim.simulation.activation import (
    add_setpoint_activation, position_servos_without_dynamics)
from manip_sim.simulation.commands import Command, Goal
from manip_sim.simulation.drives import (
    Drive, GripperController, split_joint_command, SubsystemDrive)
from manip_sim.simulation.parts import find_parts, Part
from manip_sim.simulation.state import State
from manip_sim.simulation.wrench import EndEffectorReader

#: A generalised velocity that no robot has: the physics has diverged [rad/s or m/s].
_ABSURD_VELOCITY = 1e4
#: How long the coupled joints of grippers may take to find their start [s].
_SETTLE_S = 0.5
#: How often controllers that move something are called [s].
_TICK_S = 0.01


class Simulation:
    """
    The physics of a world, and the parts of its first robot.

    Time is a count of steps. Nothing here waits or looks at a clock; one thread at a time may use
    it. Commands are validated by the parts' drives, which only read, and take effect with
    :meth:`apply`.

    :param world: an arena with robots; the first robot is commanded and observed, the others hold
        where they start
    :param visual: keep the shapes that cannot collide, to look at; they make a step dearer
    :ivar model: the ``mujoco.MjModel``
    :ivar data: the ``mujoco.MjData``
    :ivar drives: what moves each part, by the part's name
    :ivar step_count: physics steps since construction; a reset does not change it
    :ivar diverged: why the physics is held, or None
    """

    def __init__(self, world: World, visual: bool = False) -> None:
        self.robot = world.robots[0]
        spec = world.compose(visual)
        servos = position_servos_without_dynamics(spec, world.gripper_actuators)
        add_setpoint_activation(spec, servos)
        self.model: Any = compile_spec(spec, world.name)
        # A physics that went wrong shall be seen, not be set back by MuJoCo behind our back.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.data: Any = mujoco.MjData(self.model)
        self.step_count = 0
        self.diverged: str | None = None
        self._start = world.init_qpos()
        self._timestep_ns: int = round(self.model.opt.timestep * 1e9)
        self.parts: dict[str, Part] = {p.name: p for p in find_parts(self.model, self.robot)}
        self.drives: dict[str, Drive] = {
            name: self._drive(part, self.robot) for name, part in self.parts.items()}
        # The other robots are not commanded: they hold where they start.
        self._bystanders = [self._drive(part, robot) for robot in world.robots[1:]
                            for part in find_parts(self.model, robot)]
        self._subsystems = [d for d in self.drives.values() if isinstance(d, SubsystemDrive)]
        self._grippers = [d for d in self.drives.values() if isinstance(d, GripperController)]
        self.end_effectors = {
            name.split('/')[0]: EndEffectorReader(self.model, part.gripper)
            for name, part in self.parts.items() if part.gripper is not None}
        self._index_joints()
        self._settle_linkages()
        self._good = np.empty(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION))
        self.reset()

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
        for drive in [*self._grippers, *self._bystanders]:
            part = drive.part
            if part.gripper is not None:
                self._start.update(zip(part.joints, self.data.qpos[part.qpos_addresses].tolist()))

    def _drive(self, part: Part, robot: RobotModel) -> Drive:
        if part.gripper is not None:
            return GripperController(self.model, part, self.timestep_s)
        return SubsystemDrive(self.model, part, robot)

    def _index_joints(self) -> None:
        parts = self.parts.values()
        self.joint_names: tuple[str, ...] = tuple(j for part in parts for j in part.joints)
        self._qpos_addresses = np.concatenate([part.qpos_addresses for part in parts])
        self._dof_addresses = np.concatenate([part.dof_addresses for part in parts])
        self.slice_of: dict[str, slice] = {}
        begin = 0
        for part in parts:
            self.slice_of[part.name] = slice(begin, begin + len(part.joints))
            begin += len(part.joints)

    @property
    def timestep_s(self) -> float:
        """Length of a physics step [s]."""
        return float(self.model.opt.timestep)

    @property
    def time_ns(self) -> int:
        """Simulation time: steps times the timestep [ns]."""
        return self.step_count * self._timestep_ns

    def drive(self, part: str) -> Drive:
        """
        Return what moves a part.

        :raises UnknownNameError: if the robot has no such part
        """
        if part not in self.drives:
            raise UnknownNameError('part', part, self.drives)
        return self.drives[part]

    def joint_command(self, position: Mapping[str, float]) -> list[Goal]:
        """
        Validate position goals for joints of any parts, all or none.

        :param position: goal by joint [rad or m]
        :raises CommandError: if a joint is not there, or a number is not finite
        """
        names = list(position)
        return self.split_joint_command(names, [position[n] for n in names], [], [])

    def split_joint_command(self, names: list[str], position: Any, velocity: Any, effort: Any
                            ) -> list[Goal]:
        """
        Validate goals for joints of any parts, all or none.

        :param names: joints
        :param position: goals of the joints whose part is in position mode; with one entry for
            each name, or empty; so are ``velocity`` and ``effort``
        :raises CommandError: if a joint is not there, or the numbers do not fit
        """
        return split_joint_command(self.drives, names, position, velocity, effort)

    def apply(self, command: Command) -> None:
        """Let a validated command take effect with the next control period."""
        self.drives[command.part].apply(command, self.data, self.step_count,
                                        self.step_count * self.timestep_s)

    def set_control_mode(self, part: str, mode: str) -> None:
        """
        Change how a subsystem is controlled; it stays where it is.

        :param mode: ``position``, ``velocity`` or ``effort``
        :raises UnknownNameError: if there is no such part or mode
        """
        self._subsystem(part).set_mode(mode, self.data)

    def set_command_timeout(self, part: str, timeout_s: float) -> None:
        """
        Change after how long without a fresh command a subsystem rests.

        :param timeout_s: simulation time [s]; 0 is never
        :raises UnknownNameError: if there is no such subsystem
        """
        self._subsystem(part).command_timeout_s = timeout_s

    def _subsystem(self, part: str) -> SubsystemDrive:
        drive = self.drive(part)
        if not isinstance(drive, SubsystemDrive):
            raise CommandError(f'{part} is a gripper, which is always in position mode')
        return drive

    def advance(self, steps: int) -> None:
        """
        Run one control period; afterwards all of the data belongs to the new instant.

        Does nothing while :attr:`diverged` is set.

        :param steps: number of physics steps
        """
        if self.diverged is not None:
            return
        for subsystem in self._subsystems:
            subsystem.update(self.data, self.step_count, self.timestep_s, steps)
        mujoco.mj_getState(self.model, self.data, self._good,
                           mujoco.mjtState.mjSTATE_INTEGRATION)
        warnings = self._bad_numbers()
        self._step(steps)
        # After mj_step the sensors are one step older than the positions.
        mujoco.mj_forward(self.model, self.data)
        self._check_divergence(warnings)

    def _step(self, steps: int) -> None:
        end = self.step_count + steps
        while self.step_count < end:
            chunk = end - self.step_count
            moving = [gripper for gripper in self._grippers if gripper.moving]
            if moving:
                chunk = min(chunk, max(1, round(_TICK_S / self.timestep_s)))
            for gripper in moving:
                gripper.tick(self.data, chunk * self.timestep_s)
            mujoco.mj_step(self.model, self.data, chunk)
            self.step_count += chunk

    def _bad_numbers(self) -> int:
        warning, kinds = self.data.warning, mujoco.mjtWarning
        return sum(int(warning[int(kind)].number) for kind in (
            kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC))

    def _check_divergence(self, warnings_before: int) -> None:
        velocity = self.data.qvel
        if not (np.isfinite(self.data.qpos).all() and np.isfinite(velocity).all()
                and np.isfinite(self.data.qacc).all()):
            reason = 'a position, velocity or acceleration is not finite'
        elif np.abs(velocity).max(initial=0.0) > _ABSURD_VELOCITY:
            reason = f'a velocity is above {_ABSURD_VELOCITY:g}'
        elif self._bad_numbers() > warnings_before:
            reason = 'MuJoCo warns of a bad position, velocity or acceleration'
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
        mujoco.mj_resetData(self.model, self.data)
        for joint, position in self._start.items():
            self.data.joint(joint).qpos[0] = position
        for drive in [*self.drives.values(), *self._bystanders]:
            drive.reset(self.data)
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
