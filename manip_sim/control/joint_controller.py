# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Control the joints of a robot: which command owns each joint, and where its setpoint goes.

Parts that have had no fresh command for too long time out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
import math
from typing import Any, TypeVar

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_commands import (
    CartesianCommand, CartesianWrench, GuardedTwist)
from manip_sim.control.cartesian.controller import CartesianController
from manip_sim.control.cartesian.kinematic_chains import Arms, KinematicChain, Payloads
from manip_sim.control.commands import (
    BaseTwist, Command, CommandHandle, JointImpedance, JointSetpoint, JointTrajectory, Status,
    TrajectoryReference, TrajectoryStop)
from manip_sim.control.controlled_joints import ControlledJoints
from manip_sim.control.modes import Arrival, ControlMode, Law, LAWS, MODES, PREFIX
from manip_sim.control.seats import Seats, SeatState
from manip_sim.control.setpoints import TrajectoryFollowing
from manip_sim.control.velocity_stream import BaseTwists
from manip_sim.derived import Derived
from manip_sim.errors import ModelError
from manip_sim.physics.parts import EndEffectorReader, Part
from manip_sim.physics.payload import Payload
from manip_sim.physics.physics import Physics
from manip_sim.validation import clamp

C = TypeVar('C', bound=Command)
#: Share of the acceleration limits that a change of the speed of trajectories may use.
_SLEW_SHARE = 0.5


class CommandTimeouts:
    """
    The time of each part's last command, and how long it lasts without a fresh one.

    Times ``now_s`` are simulation time [s].

    :param parts: names of parts that do not overlap; none has a timeout at first
    :ivar counts: number of timeouts of each part
    """

    remembered = ('_timeout_s', '_last_s', 'counts')
    #: Only counted.
    undigested = ('counts',)

    def __init__(self, parts: Iterable[str]) -> None:
        self._timeout_s = dict.fromkeys(parts, 0.0)
        self._last_s: dict[str, float] = {}
        self.counts = dict.fromkeys(self._timeout_s, 0)

    def __getitem__(self, part: str) -> float:
        """Return the timeout of a part, simulation time [s]; 0 for none."""
        return self._timeout_s[part]

    def set(self, part: str, timeout_s: float) -> None:
        """
        Change the timeout of a part.

        :param timeout_s: simulation time [s]; 0 for none
        """
        self._timeout_s[part] = timeout_s

    def renew(self, parts: Iterable[str], now_s: float) -> None:
        """
        Restart the timeouts of parts.

        :param parts: those that have a fresh command
        """
        for part in parts:
            self._last_s[part] = now_s

    def forget(self, parts: Iterable[str]) -> None:
        """Stop watching parts whose commands are done."""
        for part in parts:
            self._last_s.pop(part, None)

    def clear(self) -> None:
        """Stop watching all parts."""
        self._last_s.clear()

    @property
    def pending(self) -> bool:
        """True if any part that is watched has a timeout."""
        return any([self._timeout_s[part] for part in self._last_s])

    @property
    def first_s(self) -> float:
        """Time at which the first part is overdue, or a little before [s]; infinite for none."""
        return min([last_s + self._timeout_s[part] - 2e-9
                    for part, last_s in self._last_s.items() if self._timeout_s[part] > 0.0],
                   default=math.inf)

    def overdue(self, now_s: float) -> list[str]:
        """Return the parts whose last command is older than their timeout."""
        return [part for part, last_s in self._last_s.items()
                if 0.0 < self._timeout_s[part] <= now_s - last_s + 1e-9]

    def count(self, part: str) -> None:
        """Count a timeout of a part, and stop watching it."""
        del self._last_s[part]
        self.counts[part] += 1


class JointController(ControlledJoints):
    """
    Position, velocity and effort control of all driven joints of a robot.

    A command owns the joints it names until a newer one names them. A joint in effort mode holds
    its position until it gets its first effort.

    Times ``now_s`` are simulation time since the last reset [s], ``period_s`` is the length of a
    control period [s].

    Methods that take the name of a part raise an ``UnknownNameError`` if there is none.

    :param physics: of the world, prepared by ``add_setpoint_activation``, at the start
    :param parts: by name; the parts of one arm and of both arms may overlap
    :param atomic: the names of the parts that do not overlap
    :param chains: of the arms that take Cartesian commands, by arm
    :param gains_are_highest: whether gains of the model are upper bounds, see :class:`Servos`
    :param end_effectors: readers of the grippers, by arm
    :ivar cartesian: controller of the end effectors
    :ivar seats: the laws of users, by part
    :ivar command_timeouts: of the parts
    :ivar trajectories: that wait or lead setpoints
    :ivar base: twists of the mobile base
    """

    remembered = ('modes', '_effort', '_targets_end', '_efforts_due', '_written')

    def __init__(self, physics: Physics, parts: Mapping[str, Part],
                 atomic: Sequence[str], chains: Mapping[str, KinematicChain] | None = None,
                 gains_are_highest: bool = False,
                 end_effectors: Mapping[str, EndEffectorReader] | None = None) -> None:
        super().__init__(physics, parts, atomic, gains_are_highest)
        self._physics, self._arms = physics, Arms(physics, self.servos)
        self.seats = Seats(physics, self.servos, self._indices_of, {
            part: reader for arm, reader in (end_effectors or {}).items() if arm in parts
            for part in parts[arm].atomic if len(parts[arm].atomic) == 1}, self._arms)
        self.cartesian = CartesianController(
            physics, chains or {}, self.names, self.servos, self.setpoints,
            end_effectors or {}, self.seats, self._arms)
        self._everything = np.arange(len(self.names))
        self._derived = Derived()
        self.command_timeouts = CommandTimeouts(atomic)
        self.trajectories = TrajectoryFollowing(
            self.setpoints, self.commands, len(self.names), _SLEW_SHARE * float(np.min(
                self.servos.acceleration_limit / self.servos.velocity_limit, initial=1e3)))
        self.base = BaseTwists(self.servos, self.setpoints)
        #: The parts whose timeout was set, and so ends Cartesian targets too.
        self._targets_end: set[str] = set()
        #: True while new efforts have yet to be written.
        self._efforts_due = False
        self._written = False

    def refresh_joint_parameters(self) -> None:
        """Take over damping and dry friction of the joints, which were changed in the model."""
        self.servos.refresh_joint_parameters()
        self._arms.refresh_joint_parameters()

    @property
    def payloads(self) -> Payloads:
        """The payloads of the arms."""
        return self._derived.made_of(
            Payloads, self._physics, self.servos, self.cartesian.readers)

    @property
    def acts(self) -> bool:
        """True if controls change whether setpoints move or not."""
        return self.payloads.any or self.servos.any_integrates

    @property
    def flags(self) -> tuple[bool, bool, bool, bool]:
        """Values of MOVES, DUE, WRITTEN and ACTS of the compiled law; the last one is not set."""
        return self.setpoints.moving, self._efforts_due, self._written, self.acts

    @flags.setter
    def flags(self, flags: Sequence[bool]) -> None:
        self.setpoints.moving, self._efforts_due, self._written, _ = flags

    @property
    def moving(self) -> bool:
        """True if setpoints change, or may change, in the next interval, or a law acts."""
        self._physics.interrupt()
        if (self.seats.of or self.setpoints.moving or self._efforts_due or self.commands.waiting
                or self.acts):
            return True
        for command in self.commands.running:
            if isinstance(command, (JointTrajectory, BaseTwist)) or (
                    isinstance(command, CartesianCommand) and self.cartesian.moves(command)):
                return True
        return False

    @property
    def timeouts(self) -> dict[str, int]:
        """Number of command timeouts of each atomic part."""
        return self.command_timeouts.counts

    def settings(self, part: str) -> dict[str, Any]:
        """Return what acts for an atomic part, by the names of parameters."""
        index = int(self.indices_of(part)[0])
        longest_s, hold_s = self.setpoints.stream_settings(index)
        return {'control_mode': self.modes[index], 'command_timeout': self.command_timeouts[part],
                'timeout_follows_mode': part not in self._targets_end,
                'stream_interval': longest_s, 'stream_hold': hold_s,
                'integral_gain': self.servos.integral_gain(index)}

    @property
    def resting(self) -> bool:
        """True if control has nothing to do."""
        self._physics.interrupt()
        return not (self.setpoints.moving or self._written or self.commands.running
                    or self.commands.waiting or self.command_timeouts.pending or self.seats.of
                    or self.acts)

    @property
    def busy_parts(self) -> frozenset[str]:
        """The atomic parts with a motion that has an end: a trajectory, or one until contact."""
        # After a motion until contact has ended, the arm stays there.
        guarded = [c for c in self.commands.of(GuardedTwist) if c.handle.is_active]
        return frozenset().union(*(self.parts_of(command.indices) for command in (
            *self.commands.trajectories, *guarded)))

    # ------------------------------------------------------------------ commands

    def set_timeout(self, part: str, timeout_s: float, ends_targets: bool = True) -> None:
        """
        Change how long the last command of a part lasts if no fresh one comes.

        :param timeout_s: simulation time [s]; 0 for no timeout
        :param ends_targets: whether it ends Cartesian targets too, which come to rest anyway
        """
        for name in self.parts_of(self.indices_of(part)):
            self.command_timeouts.set(name, timeout_s)
            (self._targets_end.add if ends_targets else self._targets_end.discard)(name)

    def set_stream(self, part: str, longest_s: float | None = None, hold_s: float | None = None
                   ) -> None:
        """
        Change what counts as a stream, and what happens when one stops.

        :param longest_s: longest interval between messages of a stream [s]; None: no change
        :param hold_s: how long a part goes on at the velocity of a stream of goals after one was
            due [s]; 0 for two message intervals; None: no change
        """
        indices = self.indices_of(part)
        self.setpoints.set_stream(indices, longest_s, hold_s)
        for arm in self.cartesian.settings:
            if np.isin(self.indices_of(arm), indices).all():
                self.cartesian.set_stream(arm, longest_s, hold_s)

    def set_integral_gain(self, part: str, gain: float) -> None:
        """
        Change the rate at which servos of a part take away errors that remain.

        :param gain: [1/s]; 0 for not at all
        """
        if self.servos.set_integral_gain(self.indices_of(part), gain):
            self._write_again()

    def set_payload(self, arm: str, payload: Payload) -> None:
        """
        Change what an arm holds, which servos and laws carry from the next interval on.

        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        if payload != self.payloads[arm]:
            self.payloads[arm] = payload
            self._write_again()

    def _write_again(self) -> None:
        """Let the controls of joints at rest be written once more."""
        self.setpoints.resume()
        self._efforts_due = True

    def set_mode(self, part: str, mode: str, data: mujoco.MjData) -> None:
        """
        Change the control mode of a part; joints whose mode changes come to rest.

        :param mode: the name of one of :data:`MODES`
        :raises ModelError: if the gains or the law of the mode cannot be used; nothing has changed
            then
        :raises UnknownNameError: if the part or mode is unknown
        """
        wanted = MODES[mode]
        law = None if wanted.law is None else LAWS[wanted.law]
        if law is not None:
            self.seats.check(law, law.is_compiled)
        changed = self._enter(part, wanted, data)
        if law is not None and changed.size:
            self._sit(changed, law, law.values({}), law.is_compiled)

    def _enter(self, part: str, wanted: ControlMode, data: mujoco.MjData) -> IntArray:
        """Let joints of a part that are in another mode come to rest in one; return which do."""
        mode, servos = wanted.name, self.servos
        changed = np.array([i for i in self.indices_of(part) if self.modes[i] != mode],
                           dtype=np.int64)
        if changed.size:
            gains = wanted.gains([self.names[i] for i in changed])
            restart = servos.set_gains(changed, gains)
            self.commands.release(changed, Status.ABORTED, f'the control mode is {mode} now')
            self.modes = tuple(mode if i in changed else m for i, m in enumerate(self.modes))
            self.command_timeouts.forget(self.parts_of(changed))
            self.seats.rise(self.parts_of(changed))
            servos.integrate(changed, wanted.integrates)
            self._hold(changed, data, restart)
        return changed

    def set_law(self, part: str, law: Law, parameters: FloatArray, compiled: bool,
                data: mujoco.MjData) -> None:
        """
        Let a law of a user move a part from the next step on.

        :param parameters: of the law, shape (p,)
        :param compiled: whether it is compiled
        :raises ModelError: if it cannot be compiled, or act in this world
        """
        self.indices_of(part)
        self.seats.check(law, compiled)
        LAWS.add(law)
        self._enter(part, MODES[f'{PREFIX}{law.name}'], data)
        self._sit(self.indices_of(part), law, parameters, compiled)

    def _sit(self, indices: IntArray, law: Law, parameters: FloatArray, compiled: bool) -> None:
        for part in sorted(self.parts_of(indices)):
            self.seats.sit(part, law, parameters.copy(), compiled)
        self._give_seats()

    def _give_seats(self) -> None:
        """Let laws that act have the joints of their parts."""
        for part, seat in self.seats.of.items():
            if seat.acts:
                self.exert(self.indices_of(part), np.zeros(len(self.indices_of(part))))

    def resume(self, part: str) -> None:
        """Let the law of a part that was stopped begin anew, if there is one."""
        if part in self.seats.of:
            self.seats.of[part].restart()
            self._give_seats()

    def stop(self, part: str, reason: str, data: mujoco.MjData) -> None:
        """
        Abort the commands of a part; its joints come to rest as after a change of mode.

        :param part: an atomic one
        """
        indices = self.indices_of(part)
        self.commands.release(indices, Status.ABORTED, reason)
        self.command_timeouts.forget([part])
        if part in self.seats.of:
            self.seats.of[part].acts = False
        self._hold(indices, data)

    def _hold(self, indices: IntArray, data: mujoco.MjData, restart: bool = False) -> None:
        """
        Let joints come to rest as soon as their acceleration limits allow.

        :param restart: whether gains of servos have changed
        """
        servos, setpoints = self.servos, self.setpoints
        gives = servos.gives_effort(indices)
        free = indices[gives]
        behind = np.stack(servos.behind(setpoints.acceleration))
        if free.size:
            self._effort[free] = 0.0
            servos.give_effort(free, False)
            setpoints.set_state(free, data.qpos[servos.qpos[free]], data.qvel[servos.dofs[free]])
            behind[:, free] = 0.0
        setpoints.brake(indices)
        braking = indices[setpoints.acceleration[indices] != 0.0]
        if braking.size:
            # From the first step on, as far ahead of their joints as when they brake for long.
            position, velocity = (np.stack(servos.behind(setpoints.acceleration)) - behind)[
                :, braking]
            setpoints.shift(braking, position, velocity)
            setpoints.brake(braking)
        if self.servos.forget_commands(indices) or free.size or braking.size or restart:
            # Those that brake push the others, which have to withstand at once.
            servos.start(data, setpoints.joints, self.payloads.loads)

    def reset(self, data: mujoco.MjData) -> None:
        """Abort all commands and hold the joints where they are; modes stay."""
        everything = self._everything
        self.commands.release(everything, Status.ABORTED, 'the simulation was reset')
        self.command_timeouts.clear()
        self.trajectories.forget()
        self.base.forget()
        self.cartesian.reset(data)
        self._effort[:] = 0.0
        self.servos.give_effort(everything, False)
        self.servos.forget_commands(everything)
        position = data.qpos[self.servos.qpos]
        self.setpoints.reset(position)
        self.servos.hold(data, position)
        self._efforts_due = self._written = False
        for seat in self.seats.of.values():
            seat.restart()
        self._give_seats()

    def apply(self, command: Command, data: mujoco.MjData, now_s: float, period_s: float) -> None:
        """
        Apply a command, at the beginning of a control period.

        It loses joints whose control mode has changed since, and is aborted if none is left.
        """
        self.setpoints.now_s = now_s
        meant = self._of_present_mode(command)
        if meant is None:
            command.handle.end(Status.ABORTED, 'the control mode has changed')
            return
        meant.handle.status = Status.RUNNING
        self.command_timeouts.renew(meant.parts, now_s)
        if isinstance(meant, JointImpedance):
            meant = self._impede(meant, data)
        if meant is None:
            return
        if isinstance(meant, JointTrajectory):
            self.commands.enqueue(meant)
        elif isinstance(meant, TrajectoryStop):
            stopped = self.commands.stop(meant)
            self.setpoints.set_velocity(stopped, np.zeros(len(stopped)))
            meant.handle.end(Status.DONE)
        elif isinstance(meant, CartesianWrench):
            self._push(meant, data, now_s)
        else:
            drives = isinstance(meant, BaseTwist) and bool(self.commands.of(BaseTwist))
            goes_on = isinstance(meant, CartesianCommand) and self._has_target(meant.arm)
            self.commands.take(meant)
            self.commands.begin(meant)
            if isinstance(meant, BaseTwist):
                self.base.begin(meant, data, now_s, period_s, drives)
            elif isinstance(meant, JointSetpoint):
                self.apply_setpoint(meant, period_s)
            elif isinstance(meant, CartesianCommand):
                if MODES[self.modes[meant.indices[0]]].exerts_at_end_effector:
                    self.servos.give_effort(meant.indices, True)
                self.cartesian.begin(meant, data, now_s, goes_on)

    def impedes(self, arm: str) -> bool:
        """Return whether an arm with a gripper is an impedance in its present mode."""
        mode = MODES[self.modes[self.indices_of(arm)[0]]]
        return mode.exerts_at_end_effector and self.cartesian.settings[arm].impedes

    def _has_target(self, arm: str) -> bool:
        return any([command.arm == arm for command in self.cartesian_commands])

    def _push(self, command: CartesianWrench, data: mujoco.MjData, now_s: float) -> None:
        """Let an impedance push, which keeps its end effector where it is if it has no target."""
        if not self.impedes(command.arm):
            command.handle.end(Status.ABORTED, 'the arm is no impedance any more')
            return
        if not self._has_target(command.arm):
            stay = self.cartesian.stay(command, data)
            self.commands.take(stay)
            self.commands.begin(stay)
            self.servos.give_effort(stay.indices, True)
            self.cartesian.begin(stay, data, now_s, False)
        lasts_s = max(self.command_timeouts[part] for part in command.parts)
        self.cartesian.push(command, now_s + lasts_s if lasts_s else math.inf)
        command.handle.end(Status.DONE)

    def _impede(self, command: JointImpedance, data: mujoco.MjData) -> JointSetpoint | None:
        """Let servos pull as a command says, and return its goals, or None if it has none."""
        if self.servos.impede(command.indices, *command.pulls):
            self.servos.start(
                data, self.setpoints.joints, self.payloads.loads, command.indices)
        goals = command.setpoint()
        if goals is None:
            command.handle.end(Status.DONE)
        return goals

    def _of_present_mode(self, command: C) -> C | None:
        if isinstance(command, (TrajectoryStop, CartesianCommand)):
            return command
        if isinstance(command, JointSetpoint):
            changed = self._derived.made_of(
                _of_other_modes, command.indices, command.modes, self.modes)
        else:
            takes = 'takes_twists' if isinstance(command, BaseTwist) else 'follows_trajectories'
            changed = [i for i in command.indices if not getattr(MODES[self.modes[i]], takes)]
        return command.without(np.array(changed, dtype=np.int64)) if changed else command

    def apply_setpoint(self, command: JointSetpoint, period_s: float) -> None:
        """Let joints follow the goals of a command that has taken them."""
        arrival = Arrival(period_s, command.messages, command.sent_s)
        modes = dict.fromkeys(command.modes)
        for mode in modes:
            indices, values = command.indices, command.values
            if len(modes) > 1:
                chosen = np.array([own == mode for own in command.modes])
                indices, values = indices[chosen], values[chosen]
            MODES[mode].command(self, indices, values, arrival)

    def go_to(self, indices: IntArray, position: FloatArray, arrival: Arrival) -> None:
        """Let setpoints come to a position, or follow a stream of positions [rad or m]."""
        self.setpoints.go_to(indices, position, *arrival)

    def go_at(self, indices: IntArray, velocity: FloatArray, arrival: Arrival) -> None:
        """Let setpoints come to a velocity, or follow a stream of them [rad/s or m/s]."""
        self.setpoints.go_to(indices, velocity, *arrival, are_velocities=True)

    def exert(self, indices: IntArray, effort: FloatArray) -> None:
        """Exert an effort, and no longer follow setpoints [N m or N]."""
        self._effort[indices] = effort
        self.servos.give_effort(indices, True)
        self._write_again()

    @property
    def speed_scaling(self) -> float:
        """Share of their speed at which trajectories are followed."""
        return self.trajectories.clock.scaling

    def set_speed_scaling(self, scaling: float, now_s: float) -> None:
        """
        Let trajectories be followed slower, along the same paths.

        :param scaling: share of their speed, from 0 to 1
        """
        self.trajectories.clock.set(scaling, now_s)

    def late_s(self, now_s: float) -> float:
        """Return how late trajectories are because they were followed slower [s]."""
        return -self.trajectories.clock.ahead_s(now_s)

    def trajectory_reference(self, handle: CommandHandle, now_s: float
                             ) -> TrajectoryReference | None:
        """Return what the joints of a trajectory that runs follow, or None."""
        return self.trajectories.reference(handle, now_s)

    def withdraw(self, handle: CommandHandle, data: mujoco.MjData, reason: str) -> None:
        """
        Abort a command; joints that it was the last to take come to rest and stop pressing.

        They go where their acceleration limits let them stop from the measured motion.
        """
        own = self.commands.withdraw(handle, reason)
        if not own.size:
            return  # Nothing must change: a reset or a restored state has ended it before.
        velocity = data.qvel[self.servos.dofs[own]]
        stop = data.qpos[self.servos.qpos[own]] + velocity * np.abs(velocity) / (
            2.0 * self.servos.acceleration_limit[own])
        self.setpoints.come_back(own, clamp(stop, self.clamps(own))[0])

    # ------------------------------------------------------------------ in the control loop

    def begin_period(self, data: mujoco.MjData, now_s: float, period_s: float, interval_s: float
                     ) -> None:
        """
        Begin a control period; end position commands that are done and commands that timed out.

        :param interval_s: length of its first interval, if setpoints move [s]
        """
        self.cartesian.period_s, self.cartesian.interval_s = period_s, interval_s
        self.setpoints.now_s, self.setpoints.interval_s = now_s, interval_s
        for command in list(self.commands.running):
            if isinstance(command, CartesianCommand):
                self.cartesian.begin_period(command, data, now_s)
            if (isinstance(command, JointSetpoint) and self.setpoints.at_rest(command.indices)
                    and all([MODES[mode].ends for mode in dict.fromkeys(command.modes)])):
                self._finish(command, data, command.values)
            if (isinstance(command, BaseTwist) and not command.handle.is_active
                    and self.setpoints.at_rest(command.indices)):
                self.commands.running.remove(command)
        for part in self.command_timeouts.overdue(now_s):
            has_target = any([part in c.parts for c in self.cartesian_commands])
            if part in self.busy_parts or has_target and part not in self._targets_end:
                continue
            if any([part in self.parts_of(c.indices) for c in self.commands.of(GuardedTwist)]):
                self.command_timeouts.forget([part])  # Its motion came to its own end.
            else:
                self._time_out(part, data, now_s, period_s)

    def _finish(self, command: Command, data: mujoco.MjData, goal: FloatArray) -> None:
        self.commands.finish(command, goal - data.qpos[self.servos.qpos[command.indices]])

    def _time_out(self, part: str, data: mujoco.MjData, now_s: float, period_s: float) -> None:
        indices = self.indices_of(part)
        twists = [c for c in self.commands.of(BaseTwist) if part in c.parts]
        self.command_timeouts.count(part)
        self.commands.release(indices, Status.ABORTED, 'no fresh command came in time')
        # Joints of a law follow no setpoints, but the law gets them.
        gives = self.servos.gives_effort(indices) & (part not in self.seats.of)
        self._effort[indices[gives]] = 0.0
        self.setpoints.set_velocity(indices[~gives], np.zeros(np.count_nonzero(~gives)))
        for twist in twists:
            # It has ended, but brings the base to rest along its path.
            stop = replace(twist, twist=np.zeros(3))
            self.commands.begin(stop)
            self.base.begin(stop, data, now_s, period_s, True)

    def seats_of(self, part: str) -> list[SeatState]:
        """
        Return the seats of the law that moves a part, one for each part that it consists of.

        :raises ModelError: if no law moves all of it
        """
        indices = self.indices_of(part)
        modes = dict.fromkeys(self.modes_of(indices))
        seats = [seat for name in sorted(self.parts_of(indices))
                 if (seat := self.seats.of.get(name)) is not None]
        if not seats or len(modes) > 1:
            raise ModelError(f'no law moves {part}: its control mode is {" and ".join(modes)}')
        return seats

    @property
    def cartesian_commands(self) -> list[CartesianCommand]:
        """The commands for end effectors that run."""
        return self.commands.of(CartesianCommand)

    def start_trajectories(self, now_s: float, duration_s: float) -> None:
        """
        Start the trajectories that are due in an interval.

        :param now_s: when it begins, simulation time since the last reset [s]
        :param duration_s: its length [s]
        """
        if self.commands.waiting:
            self.setpoints.now_s = now_s
            self.trajectories.start_due(
                self.modes, now_s, duration_s, self.cartesian.period_s)

    def end_trajectories(self, data: mujoco.MjData, now_s: float) -> None:
        """End the trajectories that have come to an end."""
        for command in self.commands.of(JointTrajectory):
            position = self.trajectories.end(command, now_s)
            if position is not None:
                self._finish(command, data, position)
                # Setpoints may still have a velocity there, or have been held back on the way.
                self.setpoints.come_back(command.indices, position)
                self.command_timeouts.forget(command.parts.difference(
                    *(self.parts_of(c.indices) for c in self.commands.running)))


def _of_other_modes(indices: IntArray, modes: tuple[str, ...], present: tuple[str, ...]
                    ) -> list[int]:
    """Return the joints whose mode has changed since a command was made."""
    return [i for i, mode in zip(indices.tolist(), modes) if present[i] != mode]
