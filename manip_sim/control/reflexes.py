# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Stop a part that is too fast, exerts too much or is pushed too hard, as arms of today do.

Collisions are noticed by a momentum observer, from the torques of joints.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.commands import Command, JointSetpoint, NoCommand
from manip_sim.control.controlled_joints import ControlledJoints
from manip_sim.control.joint_controller import JointController
from manip_sim.control.modes import MODES, POSITION, VELOCITY
from manip_sim.control.streamed_trajectories import STREAM_INTERVAL_S
from manip_sim.derived import Derived
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.external_wrench import RobotForces, subtree_size
from manip_sim.physics.parts import atomic_parts, EndEffectorReader, Part
from manip_sim.physics.physics import Physics
from manip_sim.quoting import format_value
from manip_sim.validation import (
    command_numbers, finite_command_numbers, numbers_of, positive_number)

#: States of a robot, from good to bad: it takes commands; a reflex has stopped some part; it comes
#: to rest before it takes commands; all of it was stopped.
SAFETY_STATES = RUNNING, PROTECTIVE_STOP, RECOVERING, EMERGENCY_STOP = (
    'running', 'protective_stop', 'recovering', 'emergency_stop')
#: Reason of a stop of all parts.
_EMERGENCY = 'emergency stop'
#: Why a robot that recovers takes no commands yet.
_RECOVERS = 'the robot recovers: its joints have yet to come to rest'
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
#: Words for thresholds: there are none, or those that every robot has.
OFF, DEFAULT = 'none', 'default'
#: The default thresholds, as a share of the effort limits of the joints.
_DEFAULT_SHARE = 0.25
#: Gain of the observer [1/s].
_GAIN_PER_S = 100.0


class Discontinuities:
    """
    The goals that were commanded last, and what the next ones demand beyond them.

    The velocity of a joint is what is commanded, or the difference of two commanded positions over
    the time between them, and its acceleration the difference of two velocities over that time. A
    command that no other one preceded within the longest interval of a stream continues from the
    setpoint.

    :param joints: of the robot
    """

    remembered = ('_last',)

    def __init__(self, joints: ControlledJoints) -> None:
        self._joints = joints
        #: Time [s], position (NaN in a command for a velocity) and velocity of the last command,
        #: by joint.
        self._last: dict[int, tuple[float, float, float]] = {}

    def clear(self) -> None:
        """Forget all commands."""
        self._last.clear()

    def forget(self, indices: IntArray) -> None:
        """Forget the commands of joints, which something else moves."""
        for index in indices.tolist():
            self._last.pop(index, None)

    def demands(self, indices: IntArray, goals: FloatArray, are_positions: BoolArray,
                now_s: float, period_s: float) -> FloatArray:
        """
        Return the shares of velocity and acceleration limits that goals demand, and keep them.

        :param indices: of the joints, shape (n,)
        :param goals: that are commanded [rad, m, or per s], shape (n,)
        :param are_positions: which of them are positions, the others are velocities, shape (n,)
        :param now_s: simulation time since the last reset [s]
        :param period_s: length of a control period [s]
        :returns: shape (n, 2)
        """
        setpoints, shares = self._joints.setpoints, np.zeros((len(indices), 2))
        limits = np.stack([self._joints.velocity_limits(indices),
                           self._joints.acceleration_limits(indices)], axis=1)
        for row, (index, goal, is_position) in enumerate(zip(
                indices.tolist(), goals.tolist(), are_positions.tolist())):
            last_s, before, velocity = self._last.get(index, (now_s, 0.0, 0.0))
            interval_s = now_s - last_s
            if not 0.0 < interval_s <= STREAM_INTERVAL_S or is_position == math.isnan(before):
                interval_s, before, velocity = period_s, setpoints.position.item(
                    index), setpoints.velocity.item(index)
            demanded = (goal - before) / interval_s if is_position else goal
            shares[row] = abs(demanded), abs(demanded - velocity) / interval_s
            self._last[index] = now_s, goal if is_position else math.nan, demanded
        return shares / limits


class CollisionObserver:
    """
    The residual ``r = K (p - integral of (tau + C^T v - g + r))`` of the momentum of a robot.

    With the torques behind the gears, so that friction is known, it is the torque that the world
    exerts at joints after a low-pass of first order with the rate ``K``. MuJoCo has the forces on
    bodies in each step; what they exert at joints is computed from their means over a control
    period, and equals the integrand. Payloads that are declared are part of the robot.

    :param physics: of the world
    :param joints: controller of all joints
    :param readers: of the grippers, by arm
    :ivar forces: on the bodies of the robot
    :ivar residual: of all joints [N m or N], shape (n,)
    """

    remembered = ('residual',)

    def __init__(self, physics: Physics, joints: JointController,
                 readers: Mapping[str, EndEffectorReader]) -> None:
        self._physics, self._joints, self._readers = physics, joints, readers
        self.forces = RobotForces(physics, joints.names)
        self.residual: FloatArray = np.zeros(len(joints.names))
        self._derived = Derived()
        physics.on_change(self._derived.clear)

    def restart(self) -> None:
        """Forget all forces."""
        self.residual = np.zeros(len(self.residual))

    def unit_of(self, joint: str) -> str:
        """Return the unit of the torque at a joint."""
        return 'N' if int(self._physics.model.joint(joint).type[0]) == _SLIDE else 'N m'

    def observe(self, data: mujoco.MjData, period_s: float) -> None:
        """
        Take over the forces of a control period, when it has ended.

        :param data: the ``mujoco.MjData``
        :param period_s: length of the period [s]
        """
        weight = -math.expm1(-_GAIN_PER_S * period_s)
        self.residual = self.residual + weight * (self._exerted(data) - self.residual)

    def _exerted(self, data: mujoco.MjData) -> FloatArray:
        """Return the mean torques that the world exerts at joints, shape (n,)."""
        forces, tools = self.forces.mean, [
            reader.external for reader in self._readers.values()]
        if not (forces.any() or any([tool.mean.any() for tool in tools])):
            return np.zeros(len(self.residual))
        dofs, moved = self._derived.made_of(self._make_moved, self._physics.arrays)
        wrenches, first = forces.copy(), self.forces.bodies.start
        for tool in tools:
            bodies = slice(tool.bodies.start - first, tool.bodies.stop - first)
            wrenches[bodies] = 0.0
            wrenches[bodies.start] = tool.mean
        force, torque = np.einsum('nm,mk->nk', moved, wrenches).reshape(-1, 2, 3).transpose(
            1, 0, 2)
        x, y, z = data.subtree_com[self._physics.model.body_rootid[first]].tolist()
        torque = torque - np.stack([y * force[:, 2] - z * force[:, 1],
                                    z * force[:, 0] - x * force[:, 2],
                                    x * force[:, 1] - y * force[:, 0]], axis=1)
        motions = data.cdof[dofs]
        exerted: FloatArray = np.einsum('nk,nk->n', motions, np.hstack([torque, force]))
        return exerted

    def _make_moved(self, _: Any) -> tuple[IntArray, FloatArray]:
        """Return the degrees of freedom, and 1 for each body that they move, shape (n, m)."""
        model, bodies = self._physics.model, self.forces.bodies
        dofs = self._joints.dofs(np.arange(len(self.residual)))
        moved = np.zeros((len(dofs), bodies.stop - bodies.start))
        for row, body in zip(moved, model.dof_bodyid[dofs].tolist()):
            row[body - bodies.start:body - bodies.start + subtree_size(model, body)] = 1.0
        return dofs, moved


def read_thresholds(value: ArrayLike, limits: FloatArray) -> tuple[float, ...]:
    """
    Return thresholds of joints [N m or N], 0 where there is none.

    :param value: :data:`OFF`, :data:`DEFAULT`, a number, one for each joint, or the text of such
    :param limits: effort limits of the joints, shape (n,)
    :raises CommandError: if it is something else, or a number is negative or not finite
    """
    if isinstance(value, str):
        value = value.strip()
        if value == OFF:
            return ()
        if value == DEFAULT:
            return tuple((_DEFAULT_SHARE * limits).tolist())
        try:
            value = numbers_of(value)
        except ValueError:
            raise CommandError(
                f"thresholds of collisions must be '{OFF}', '{DEFAULT}', a number or one for each "
                f'joint such as [20, 20, 10], got {format_value(value)}') from None
    if isinstance(value, (bool, int, float)):
        value = [positive_number(value, 'a limit', CommandError, or_zero=True)]
    numbers = command_numbers(value, 'thresholds of collisions')
    if numbers.size == 1 and numbers.ndim < 2:
        numbers = np.broadcast_to(numbers, len(limits))
    thresholds = finite_command_numbers(numbers, len(limits), 'thresholds of collisions')
    if (thresholds < 0.0).any():
        raise CommandError(f'thresholds of collisions must be positive, or 0 for none, '
                           f'got {format_value(value)}')
    return tuple(thresholds.tolist()) if thresholds.any() else ()


@dataclass(frozen=True)
class ReflexLimits:
    """
    Limits beyond which a part is stopped; 0, and the word ``none``, for none.

    :ivar velocity: of any joint, as a multiple of its velocity limit
    :ivar effort: of any joint, as a multiple of its effort limit
    :ivar force: magnitude of the external force on the tool [N]
    :ivar torque: magnitude of the external torque on the tool [N m]
    :ivar discontinuity: velocity or acceleration that commands for positions or velocities demand
        of any joint, as a multiple of its limit
    :ivar collision: torques that the world exerts at joints [N m or N], as
        :func:`read_thresholds` reads them
    """

    velocity: float = 0.0
    effort: float = 0.0
    force: float = 0.0
    torque: float = 0.0
    discontinuity: float = 0.0
    collision: str = OFF

    @property
    def any(self) -> bool:
        """True if there is any limit."""
        return self != ReflexLimits()


class Reflexes:
    """
    The limits of each part, and which parts were stopped.

    A part that was stopped refuses commands until :meth:`reset`.

    Times ``now_s`` are simulation time since the last reset [s], ``period_s`` is the length of a
    control period [s].

    :param physics: of the world
    :param parts: of the robot, by name
    :param joints: controller of their joints
    :param end_effectors: readers of the grippers, by arm
    :param efforts: of the actuators of the model
    :ivar collisions: observes the torques that the world exerts, while any of them has a limit
    :ivar tripped: why each part was stopped that refuses commands
    :ivar is_emergency: whether the robot is in emergency stop
    :ivar is_recovering: whether it recovers, until all stopped joints rest
    :ivar counts: how often each part was stopped, resets included
    """

    remembered = ('_limits', 'tripped', 'counts', 'is_emergency', 'is_recovering', 'armed',
                  '_thresholds')
    #: Only counted.
    undigested = ('counts',)

    def __init__(self, physics: Physics, parts: Mapping[str, Part], joints: JointController,
                 end_effectors: Mapping[str, EndEffectorReader], efforts: ActuatorEfforts) -> None:
        self._joints, self._efforts = joints, efforts
        self._limits = {part.name: ReflexLimits() for part in atomic_parts(parts)
                        if part.gripper is None and part.actuators}
        # A gripper alone has no arm that a wrench could stop.
        self._readers = {parts[arm].atomic: reader for arm, reader in end_effectors.items()
                         if arm in parts}
        self.tripped: dict[str, str] = {}
        self.counts = dict.fromkeys(self._limits, 0)
        self.is_emergency = self.is_recovering = False
        self.armed: tuple[str, ...] = ()
        self._discontinuities = Discontinuities(joints)
        self.collisions = CollisionObserver(physics, joints, end_effectors)
        #: Of collisions [N m or N], by part that has any.
        self._thresholds: dict[str, tuple[float, ...]] = {}

    def set(self, part: str, quantity: str, limit: Any) -> None:
        """
        Change a limit of a part, of each of those that it consists of.

        :param quantity: a field of :class:`ReflexLimits`
        :param limit: 0 for none; of collisions see ``read_thresholds``
        :raises CommandError: if the limit is not a positive finite number, or no such thresholds,
            or no part has a tool whose wrench could exceed it
        :raises UnknownNameError: if the quantity is unknown
        """
        known = [field.name for field in fields(ReflexLimits)]
        if quantity not in known:
            raise UnknownNameError('quantity of a reflex', quantity, known)
        names = self._joints.parts_of(self._joints.indices_of(part))
        if quantity == 'collision':
            limit = self._set_thresholds(names, limit)
        else:
            limit = positive_number(limit, 'a limit', CommandError, or_zero=True)
        if limit and quantity in ('force', 'torque') and not any(
                (name,) in self._readers for name in names):
            raise CommandError(f'{part} has no tool on which the world could exert a {quantity}')
        for name in names:
            self._limits[name] = replace(self._limits[name], **{quantity: limit})
        self.armed = tuple(name for name, limits in self._limits.items() if limits.any)

    def _set_thresholds(self, names: Iterable[str], value: Any) -> str:
        """Change the thresholds of collisions of parts, and return them as a text."""
        joints = self._joints
        found = {name: read_thresholds(value, joints.efforts_allowed(joints.indices_of(name)))
                 for name in names}
        kept = {name: found.get(name, self._thresholds.get(name)) for name in self._limits}
        self._thresholds = {name: numbers for name, numbers in kept.items() if numbers}
        if not self._thresholds:
            self.collisions.restart()
        if not any(found.values()):
            return OFF
        return value.strip() if isinstance(value, str) else str(np.asarray(value, float).tolist())

    @property
    def observes(self) -> bool:
        """True if the torques that the world exerts at joints are observed."""
        return bool(self._thresholds)

    @property
    def limits(self) -> Mapping[str, ReflexLimits]:
        """The limits of each part."""
        return self._limits

    def check(self, data: mujoco.MjData) -> None:
        """Stop the parts that do too much, at the beginning of a control period."""
        if self.is_recovering:
            self._go_on_recovering()
        for part in self.armed:
            if part not in self.tripped:
                reason = self._excess(part, data)
                if reason is not None:
                    self._trip(part, reason, data)

    def check_command(self, command: Command, data: mujoco.MjData, now_s: float, period_s: float
                      ) -> None:
        """Stop the parts of which a command for positions or velocities demands too much."""
        joints, limits = self._joints, self._limits
        parts = [part for part in command.parts
                 if part in limits and limits[part].discontinuity]
        if not parts:
            return
        if not isinstance(command, JointSetpoint):
            self._discontinuities.forget(command.indices)
            return
        fields = np.array([MODES[mode].field for mode in command.modes])
        are_checked = np.isin(fields, (POSITION.field, VELOCITY.field))
        self._discontinuities.forget(command.indices[~are_checked])
        are_checked &= np.isfinite(command.values)  # An impedance may have gains alone.
        for part in sorted(parts):
            goes = are_checked & np.isin(command.indices, joints.indices_of(part))
            led = command.indices[goes]
            if led.size:
                demands = self._discontinuities.demands(
                    led, command.values[goes], fields[goes] == POSITION.field, now_s, period_s)
                worst, kind = np.unravel_index(demands.argmax(), demands.shape)
                share, allowed = demands[worst, kind], limits[part].discontinuity
                if share > allowed:
                    self._trip(part, f"a command demands {share:.3g} times the "
                               f"{('velocity', 'acceleration')[kind]} limit of joint "
                               f"'{joints.names[led[worst]]}', allowed is {allowed:g}", data)

    def check_laws(self, data: mujoco.MjData) -> None:
        """Stop the parts whose laws have failed."""
        for part, reason in self._joints.seats.failures().items():
            self._trip(part, reason, data)

    def hold_laws(self, data: mujoco.MjData) -> None:
        """Keep laws that have begun to move parts from it, as long as reflexes stop these."""
        for part in self.tripped.keys() & self._joints.seats.of.keys():
            if self._joints.seats.of[part].acts:
                self._joints.stop(part, f'stopped by a reflex: {self.tripped[part]}', data)

    def _trip(self, part: str, reason: str, data: mujoco.MjData) -> None:
        self.tripped = {**self.tripped, part: reason}
        self.counts[part] += 1
        self._discontinuities.forget(self._joints.indices_of(part))
        self._joints.stop(part, f'stopped by a reflex: {reason}', data)

    def refusal(self, command: Command) -> str | None:
        """
        Return why a command is rejected at present, or None.

        :param command: for this robot
        """
        if isinstance(command, NoCommand):
            return None
        if self.is_emergency:
            return 'the robot is in emergency stop; call recover'
        if self.is_recovering:
            return _RECOVERS
        for part, reason in self.tripped.items():
            if part in command.parts:
                return f'{part} was stopped by a reflex: {reason}; call reset_reflex'
        return None

    @property
    def safety_state(self) -> str:
        """One of :data:`SAFETY_STATES`."""
        if self.is_emergency:
            return EMERGENCY_STOP
        if self.is_recovering:
            return RECOVERING
        return PROTECTIVE_STOP if self.tripped else RUNNING

    def reset(self) -> None:
        """
        Let all parts take commands again, and laws of users begin anew.

        :raises CommandError: in emergency stop, and until a robot that recovers rests
        """
        self.check_reset()
        self.clear()

    def check_reset(self) -> None:
        """
        Check that :meth:`reset` is possible.

        :raises CommandError: in emergency stop, and until a robot that recovers rests
        """
        if self.is_emergency:
            raise CommandError('the robot is in emergency stop: call recover')
        if self.is_recovering:
            raise CommandError(_RECOVERS)

    def clear(self) -> None:
        """Run again, as after a reset of the simulation."""
        self.is_emergency = self.is_recovering = False
        self._discontinuities.clear()
        self._resume()

    def stop_all(self, data: mujoco.MjData) -> None:
        """Stop all parts, which refuse commands until :meth:`recover`."""
        self.is_emergency, self.is_recovering = True, False
        for part in self._limits:
            if self.tripped.get(part) != _EMERGENCY:
                self._trip(part, _EMERGENCY, data)

    def recover(self) -> None:
        """Let all parts take commands again as soon as all stopped parts rest."""
        self.is_emergency, self.is_recovering = False, bool(self.tripped)
        self._go_on_recovering()

    def _go_on_recovering(self) -> None:
        joints = self._joints
        if all([joints.setpoints.at_rest(joints.indices_of(part)) for part in self.tripped]):
            self.is_recovering = False
            self._resume()

    def _resume(self) -> None:
        tripped, self.tripped = self.tripped, {}
        self.collisions.restart()  # Earlier pushes are no collision of now.
        for part in tripped:
            self._joints.resume(part)

    def _excess(self, part: str, data: mujoco.MjData) -> str | None:
        """Return what a part does too much, in words, or None."""
        limits, joints = self._limits[part], self._joints
        indices = joints.indices_of(part)
        dofs = joints.dofs(indices)
        shares = {'velocity': np.abs(data.qvel[dofs]) / joints.velocity_limits(indices),
                  'effort': np.abs(self._efforts.values[dofs]) / joints.efforts_allowed(indices)}
        for quantity, share in shares.items():
            limit = getattr(limits, quantity)
            if limit and share.max(initial=0.0) > limit:
                worst = int(share.argmax())
                return (f"the {quantity} of joint '{joints.names[indices[worst]]}' is "
                        f'{share[worst]:.3g} times its limit, allowed is {limit:g}')
        return self._collision(part) or self._push(part, data)

    def _collision(self, part: str) -> str | None:
        """Return at which joint of a part the world exerts too much, in words, or None."""
        if part not in self._thresholds:
            return None
        joints, thresholds = self._joints, np.array(self._thresholds[part])
        indices = joints.indices_of(part)
        torques, known = np.abs(self.collisions.residual[indices]), thresholds > 0.0
        shares = np.divide(torques, thresholds, out=np.zeros(len(torques)), where=known)
        worst = int(shares.argmax())
        if shares[worst] <= 1.0:
            return None
        name = joints.names[indices[worst]]
        unit = self.collisions.unit_of(name)
        return (f"the world exerts {torques[worst]:.3g} {unit} at joint '{name}', "
                f'allowed is {thresholds[worst]:g} {unit}')

    def _push(self, part: str, data: mujoco.MjData) -> str | None:
        """Return by how much the tool of a part is pushed too hard, in words, or None."""
        reader = self._readers.get((part,))
        if reader is None:
            return None
        limits, wrench = self._limits[part], reader.external_wrench(data)
        for quantity, vector, unit in (('force', wrench[:3], 'N'), ('torque', wrench[3:], 'N m')):
            limit, size = getattr(limits, quantity), float(np.sqrt((vector**2).sum()))
            if limit and size > limit:
                return (f'the external {quantity} is {size:.3g} {unit}, allowed is {limit:g} '
                        f'{unit}')
        return None
