# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the arena has besides free bodies: mocap bodies, and joints with or without actuators."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.arenas import Arena
from manip_sim.models.quaternion import wxyz_to_xyzw, xyzw_to_wxyz
from manip_sim.models.robots.subsystems import driven_joint
from manip_sim.quoting import quoted_names
from manip_sim.simulation.modes import POSITION
from manip_sim.simulation.physics import Physics
from manip_sim.simulation.poses import Pose

#: The part that the joints of the arena are, in topics and parameters.
ARENA = 'arena'
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class Surroundings:
    """
    Mocap bodies, and joints of the arena, such as those of doors, drawers and knobs.

    :param physics: of the world
    :param arena: the arena of the world
    :ivar mocap_names: names of the mocap bodies
    :ivar joints: scalar joints of the arena
    :ivar actuators: of the arena, those that drive one of these joints each
    """

    def __init__(self, physics: Physics, arena: Arena) -> None:
        self._physics, model = physics, physics.model
        self.joints = tuple(name for name in arena.joints
                            if int(model.joint(name).type[0]) in _SCALAR)
        joint_of = {name: driven_joint(model, model.actuator(name).id)
                    for name in arena.actuators}
        self.actuators = tuple(name for name in arena.actuators if joint_of[name] in self.joints)
        self._actuator_of = {joint_of[name] or '': name for name in self.actuators}
        physics.on_change(self._look_at_model)

    def _look_at_model(self) -> None:
        model = self._physics.model
        self._mocap = {str(model.body(body).name): int(model.body_mocapid[body])
                       for body in np.flatnonzero(model.body_mocapid >= 0).tolist()}
        self.mocap_names = tuple(self._mocap)
        ids = [model.joint(name).id for name in self.joints]
        self._qpos, self._dofs = model.jnt_qposadr[ids], model.jnt_dofadr[ids]

    def state(self) -> FloatArray:
        """
        Return the state of :attr:`joints` at the present instant.

        :returns: positions [rad or m], velocities and efforts of actuators, shape (3 n,), a copy
        """
        data = self._physics.data
        return np.concatenate([data.qpos[self._qpos], data.qvel[self._dofs],
                               data.qfrc_actuator[self._dofs]])

    def control(self, joint: str) -> tuple[str, int]:
        """
        Return what a joint of the arena is commanded by, and the id of its actuator.

        :returns: ``position``, ``velocity`` or ``effort``, and the id
        :raises UnknownNameError: if there is no such joint
        :raises CommandError: if no actuator drives it
        """
        if joint not in self.joints:
            raise UnknownNameError('joint of the arena', joint, self.joints)
        if joint not in self._actuator_of:
            driven = quoted_names(list(self._actuator_of)) or 'none'
            raise CommandError(f"no actuator of the arena drives '{joint}'; driven are: {driven}")
        model = self._physics.model
        actuator = int(model.actuator(self._actuator_of[joint]).id)
        affine = int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
        _, of_position, of_velocity = model.actuator_biasprm[actuator, :3].tolist()
        if affine and of_position:
            return 'position', actuator
        return 'velocity' if affine and of_velocity else 'effort', actuator

    def checked(self, names: Sequence[str], position: Sequence[float], velocity: Sequence[float],
                effort: Sequence[float]) -> dict[str, float]:
        """
        Return the controls of a joint command, clamped to their ranges, by joint.

        :param names: joints of the arena, each once
        :param position: [rad or m], as many as names, or empty; NaN is no command
        :param velocity: likewise
        :param effort: likewise
        :raises CommandError: if the numbers do not fit the joints
        :raises UnknownNameError: if there is no such joint
        """
        given = {'position': position, 'velocity': velocity, 'effort': effort}
        if not names or len(set(names)) != len(names):
            raise CommandError('arena: a joint command needs names, each of them once')
        for quantity, values in given.items():
            if len(values) not in (0, len(names)):
                raise CommandError(f'arena: expected {len(names)} numbers in {quantity}, one for '
                                   f'each name, or none, got {len(values)}')
        return dict(self._controls(names, given))

    def _controls(self, names: Sequence[str], given: dict[str, Sequence[float]]
                  ) -> Iterator[tuple[str, float]]:
        model = self._physics.model
        for index, name in enumerate(names):
            wanted, actuator = self.control(name)
            for quantity, values in given.items():
                value = float(values[index]) if len(values) else math.nan
                if math.isinf(value):
                    raise CommandError(f"arena: {quantity} of '{name}' must be finite")
                if math.isnan(value):
                    continue
                if quantity != wanted:
                    raise CommandError(f"arena: '{name}' takes a {wanted}, got a {quantity}")
                if model.actuator_ctrllimited[actuator]:
                    value = min(max(value, float(model.actuator_ctrlrange[actuator, 0])),
                                float(model.actuator_ctrlrange[actuator, 1]))
                yield name, value

    def command(self, controls: dict[str, float]) -> None:
        """
        Let actuators of the arena act from the next control period on.

        :param controls: from :meth:`checked`
        """
        for joint, value in controls.items():
            self._physics.ctrl[self.control(joint)[1]] = value

    def hold(self, joint: str, position: float) -> None:
        """Let the actuator of a joint hold a position, if it is a servo of the arena."""
        if joint in self._actuator_of and self.control(joint)[0] == POSITION.name:
            self.command({joint: position})

    def pose(self, name: str) -> FloatArray:
        """
        Return the pose of a mocap body.

        :returns: position [m] and quaternion x, y, z, w in ``world``, shape (7,)
        :raises UnknownNameError: if there is no such mocap body
        """
        mocap, data = self._find(name), self._physics.data
        return np.concatenate([data.mocap_pos[mocap], wxyz_to_xyzw(data.mocap_quat[mocap])])

    def set_target(self, name: str, position: ArrayLike, quat_xyzw: ArrayLike) -> None:
        """
        Move a mocap body; it is there from the next control period on.

        :param position: in ``world`` [m], shape (3,)
        :param quat_xyzw: of length 1, shape (4,)
        :raises UnknownNameError: if there is no such mocap body
        :raises CommandError: if the numbers are not those of a pose
        """
        mocap, pose = self._find(name), Pose.checked(position, quat_xyzw)
        self._physics.data.mocap_pos[mocap] = pose.position
        self._physics.data.mocap_quat[mocap] = xyzw_to_wxyz(pose.quat_xyzw)

    def _find(self, name: str) -> int:
        if name not in self._mocap:
            raise UnknownNameError('mocap body', name, self._mocap)
        return self._mocap[name]
