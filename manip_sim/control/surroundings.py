# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Mocap bodies, joints of the arena and actuators that are of no part of a robot."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import math

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import wxyz_to_xyzw, xyzw_to_wxyz
from manip_sim.arrays import FloatArray
from manip_sim.control.modes import EFFORT, POSITION
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.arenas import Arena
from manip_sim.models.robots.robot_model import driven_joint
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.physics import Physics
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quoting import quoted_names

_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
#: The part that the joints of the arena are, in topics and parameters.
ARENA = 'arena'
#: The part that actuators of tendons, sites and bodies are, which are of no other part.
ACTUATORS = 'actuators'
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class DirectControls:
    """
    Controls of actuators by the names that commands use, without setpoints or modes.

    :param physics: of the world
    :param part: their collective name in topics and messages
    :param kind: noun for a name, for messages
    :param names: all known names
    :param actuator_of: the actuator by name, where a name has one
    """

    def __init__(self, physics: Physics, part: str, kind: str, names: Sequence[str],
                 actuator_of: Mapping[str, str]) -> None:
        self._physics = physics
        self._part, self._kind, self._names = part, kind, names
        self._actuator_of = dict(actuator_of)

    def __contains__(self, name: str) -> bool:
        """Return whether a name has an actuator."""
        return name in self._actuator_of

    def control(self, name: str) -> tuple[str, int]:
        """
        Return what a joint or actuator is commanded by, and the id of the actuator.

        :returns: ``position``, ``velocity`` or ``effort``, and the id
        :raises UnknownNameError: if the name is unknown
        :raises CommandError: if no actuator drives it
        """
        if name not in self._names:
            raise UnknownNameError(self._kind, name, self._names)
        if name not in self._actuator_of:
            driven = quoted_names(list(self._actuator_of)) or 'none'
            raise CommandError(f"no actuator of the {self._part} drives '{name}'; driven are: "
                               f'{driven}')
        model = self._physics.model
        actuator = int(model.actuator(self._actuator_of[name]).id)
        affine = int(model.actuator_biastype[actuator]) == _AFFINE
        _, of_position, of_velocity = model.actuator_biasprm[actuator, :3].tolist()
        if affine and of_position:
            # MuJoCo integrates the control of such a servo.
            integrates = int(model.actuator_dyntype[actuator]) == _INTEGRATOR
            return 'velocity' if integrates else 'position', actuator
        return 'velocity' if affine and of_velocity else 'effort', actuator

    def checked(self, names: Sequence[str], position: Sequence[float], velocity: Sequence[float],
                effort: Sequence[float]) -> dict[str, float]:
        """
        Return the controls of a joint command, clamped to their ranges, by name.

        :param names: of joints or actuators, each once
        :param position: [rad or m], as many as names, or empty; NaN leaves one out
        :param velocity: likewise
        :param effort: likewise
        :raises CommandError: if the numbers do not fit the names
        :raises UnknownNameError: if a name is unknown
        """
        columns = {'position': position, 'velocity': velocity, 'effort': effort}
        if not names or len(set(names)) != len(names):
            raise CommandError(f'{self._part}: a joint command needs names, each of them once')
        for quantity, values in columns.items():
            if len(values) not in (0, len(names)):
                raise CommandError(f'{self._part}: expected {len(names)} numbers in {quantity}, '
                                   f'one for each name, or none, got {len(values)}')
        model, controls = self._physics.model, {}
        for index, name in enumerate(names):
            accepted, actuator = self.control(name)
            for quantity, values in columns.items():
                value = float(values[index]) if len(values) else math.nan
                if math.isinf(value):
                    raise CommandError(f"{self._part}: {quantity} of '{name}' must be finite")
                if math.isnan(value):
                    continue
                if quantity != accepted:
                    raise CommandError(f"{self._part}: '{name}' takes a {accepted}, got a "
                                       f'{quantity}')
                if model.actuator_ctrllimited[actuator]:
                    value = min(max(value, float(model.actuator_ctrlrange[actuator, 0])),
                                float(model.actuator_ctrlrange[actuator, 1]))
                if abs(value) > mujoco.mjMAXVAL:
                    raise CommandError(f"{self._part}: {quantity} of '{name}' must be within "
                                       f'{mujoco.mjMAXVAL:g}, got {value:g}')
                controls[name] = value
        return controls

    def command(self, controls: Mapping[str, float]) -> None:
        """
        Let actuators act from the next control period on.

        :param controls: from :meth:`checked`
        """
        for name, value in controls.items():
            self._physics.ctrl[self.control(name)[1]] = value


class Surroundings:
    """
    Mocap bodies, joints of the arena, such as hinges of doors, and actuators of no part.

    :param physics: of the world
    :param efforts: of its actuators in the last step
    :param arena: the arena of the world
    :param of_parts: actuators of the robots' parts and grippers
    :ivar of_parts: the same; robots that come or go have to change it before the model is replaced
    :ivar mocap_names: names of the mocap bodies
    :ivar joints: scalar joints of the arena
    :ivar actuators: of the arena, which drive one of these joints each
    :ivar other_actuators: of the arena, such as on tendons, and of objects
    :ivar commands: of :attr:`joints` and of :attr:`other_actuators`, by ``arena`` and
        ``actuators``
    """

    def __init__(self, physics: Physics, efforts: ActuatorEfforts, arena: Arena,
                 of_parts: Collection[str]) -> None:
        self._physics, self._efforts, model = physics, efforts, physics.model
        self.joints = tuple(name for name in arena.joints
                            if int(model.joint(name).type[0]) in _SCALAR)
        joint_of = {name: driven_joint(model, model.actuator(name).id)
                    for name in arena.actuators}
        self.actuators = tuple(name for name in arena.actuators if joint_of[name] in self.joints)
        self.of_parts = set(of_parts)
        self.commands = {
            ARENA: DirectControls(physics, ARENA, 'joint of the arena', self.joints,
                                  {joint_of[name] or '': name for name in self.actuators})}
        physics.on_change(self._rebind)

    def _rebind(self) -> None:
        model = self._physics.model
        self._mocap = {str(model.body(body).name): int(model.body_mocapid[body])
                       for body in np.flatnonzero(model.body_mocapid >= 0).tolist()}
        self.mocap_names = tuple(self._mocap)
        ids = [model.joint(name).id for name in self.joints]
        self._qpos, self._dofs = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
        names = [str(model.actuator(actuator).name) for actuator in range(model.nu)]
        of_others = {*self.of_parts, *self.actuators}
        self.other_actuators = tuple(name for name in names if name not in of_others)
        self._others = np.array(
            [model.actuator(name).id for name in self.other_actuators], dtype=np.int64)
        self.commands[ACTUATORS] = DirectControls(
            self._physics, ACTUATORS, 'actuator that is of no part', self.other_actuators,
            {name: name for name in self.other_actuators})

    def state(self) -> FloatArray:
        """
        Return the state of :attr:`joints` at the present instant.

        :returns: positions [rad or m], velocities and efforts of actuators, shape (3 n,), a copy
        """
        data = self._physics.data
        return np.concatenate([data.qpos[self._qpos], data.qvel[self._dofs],
                               self._efforts.values[self._dofs]])

    def state_of_actuators(self) -> FloatArray:
        """
        Return the state of :attr:`other_actuators` at the present instant.

        :returns: lengths of their transmissions [rad or m], rates of these and forces, shape
            (3 n,), a copy
        """
        data = self._physics.data
        return np.concatenate([data.actuator_length[self._others],
                               data.actuator_velocity[self._others],
                               data.actuator_force[self._others]])

    def hold(self, joint: str, position: float) -> None:
        """Let the actuator of a joint hold a position, if it is a servo of the arena."""
        arena = self.commands[ARENA]
        if joint in arena and arena.control(joint)[0] == POSITION.name:
            arena.command({joint: position})

    def hold_actuators(self, known: Collection[str] = ()) -> bool:
        """
        Let position servos among :attr:`other_actuators` hold the lengths that they have.

        :param known: names of those that go on as before
        :returns: whether there are others
        """
        model, data = self._physics.model, self._physics.data
        others = self.commands[ACTUATORS]
        new = [name for name in self.other_actuators if name not in known]
        for name in new:
            kind, actuator = others.control(name)
            gain, activation = model.actuator_gainprm[actuator, 0], model.actuator_actadr[actuator]
            bias = model.actuator_biasprm[actuator]
            if not gain or not bias[1] or kind == EFFORT.name:
                continue
            setpoint = -(bias[0] + bias[1] * data.actuator_length[actuator]) / gain
            if activation >= 0:
                data.act[activation] = setpoint
            if kind == POSITION.name:
                others.command(others.checked([name], [setpoint], [], []))
        return bool(new)

    def pose(self, name: str) -> FloatArray:
        """
        Return the pose of a mocap body.

        :returns: position [m] and quaternion x, y, z, w in ``world``, shape (7,)
        :raises UnknownNameError: if the mocap body is unknown
        """
        mocap, data = self._find(name), self._physics.data
        return np.concatenate([data.mocap_pos[mocap], wxyz_to_xyzw(data.mocap_quat[mocap])])

    def set_target(self, name: str, position: ArrayLike, quat_xyzw: ArrayLike) -> None:
        """
        Move a mocap body; it is there from the next control period on.

        :param position: in ``world`` [m], shape (3,)
        :param quat_xyzw: of length 1, shape (4,)
        :raises UnknownNameError: if the mocap body is unknown
        :raises CommandError: if the numbers are not a pose
        """
        mocap, pose = self._find(name), Pose.checked(position, quat_xyzw)
        self._physics.data.mocap_pos[mocap] = pose.position
        self._physics.data.mocap_quat[mocap] = xyzw_to_wxyz(pose.quat_xyzw)

    def _find(self, name: str) -> int:
        if name not in self._mocap:
            raise UnknownNameError('mocap body', name, self._mocap)
        return self._mocap[name]
