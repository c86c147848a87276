# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The chains of a robot's arms, their payloads, and the frames that Cartesian commands may refer to.

The compiled law reads the joints of the arms and the payloads as records.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from manip_sim.algebra import matrix_of
from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.records import Arm, CHAIN, readable
from manip_sim.control.servos import Servos
from manip_sim.derived import Derived
from manip_sim.errors import UnknownNameError
from manip_sim.models.robots import RobotModel
from manip_sim.physics.parts import EndEffectorReader, Part
from manip_sim.physics.payload import Payload
from manip_sim.physics.physics import Physics, places_of_inertia, WorldArrays
from manip_sim.physics.robot_frames import Frame, RobotFrames


@dataclass(frozen=True, eq=False)
class KinematicChain:
    """
    The joints of an arm between two frames, from the mount to the end effector.

    :ivar tip: the end effector, ``grip_site``
    :ivar origin: site ``<arm>_center``, or else the body that the arm is mounted on
    :ivar qpos: addresses of the arm's joints in ``qpos``, shape (n,)
    """

    tip: Frame
    origin: Frame
    qpos: IntArray


def find_chains(model: mujoco.MjModel, robot: RobotModel, parts: Mapping[str, Part],
                end_effectors: Mapping[str, EndEffectorReader]) -> dict[str, KinematicChain]:
    """
    Return the chains of a robot's arms that have a gripper and driven joints, by arm.

    :param model: the compiled ``mujoco.MjModel``
    :param parts: of the robot, by name
    :param end_effectors: readers of the grippers, by arm
    """
    chains = {}
    for arm, reader in end_effectors.items():
        joints = [j for j in parts[arm].driven_joints if j] if arm in parts else []
        if not joints:
            continue
        tip = model.site(reader.grip_site)
        body = int(model.body_parentid[int(model.joint(joints[0]).bodyid[0])])
        center = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE,
                                   f'{robot.naming_prefix}{arm}_center')
        origin = Frame(model.body(body).name, body)
        if center >= 0:
            origin = Frame(model.site(center).name, int(model.site_bodyid[center]), center)
        chains[arm] = KinematicChain(Frame(tip.name, int(tip.bodyid[0]), int(tip.id)), origin,
                                     parts[arm].qpos_addresses)
    return chains


def find_frames(model: mujoco.MjModel, robot: RobotModel,
                end_effectors: Mapping[str, EndEffectorReader]) -> RobotFrames:
    """
    Return the links of a robot and of its mounted parts, and the sites of its grippers.

    :param model: the compiled ``mujoco.MjModel``
    :param end_effectors: readers of the grippers, by arm
    """
    bodies = [*robot.bodies, *(body for part in robot.models for body in part.bodies)]
    return RobotFrames(model, bodies, [site for reader in end_effectors.values()
                                       for site in (reader.grip_site, reader.ft_frame)])


class Arms:
    """
    The joints of the arms of a robot, which are looked up once.

    :param physics: of the world
    :param servos: of all driven joints
    """

    def __init__(self, physics: Physics, servos: Servos) -> None:
        self._physics, self._servos, self._derived = physics, servos, Derived()
        self._low, self._high = servos.position_clamp().T
        physics.on_change(self.refresh_joint_parameters)  # They may have other addresses.

    def refresh_joint_parameters(self) -> None:
        """Take over addresses and damping of the joints, which were changed."""
        self._derived.of.clear()

    def arm(self, tip: Frame | None, indices: IntArray) -> Arm:
        """
        Return the joints of an arm as the compiled law reads them.

        :param tip: frame of the end effector; None if there is none, which no joint moves then
        :param indices: of the joints, shape (n,)
        """
        key = tip and tip.name, indices.tobytes()
        cached: tuple[FloatArray, Arm] | None = self._derived.of.get(key)
        if cached is None or cached[0] is not self._servos.passive_damping:
            # That of a restored state is another one.
            cached = self._derived.of[key] = (
                self._servos.passive_damping, self._make_arm(tip, indices))
        return cached[1]

    def _make_arm(self, tip: Frame | None, indices: IntArray) -> Arm:
        servos, model, dofs = self._servos, self._physics.model, self._servos.dofs[indices]
        efforts, joints = servos.ranges['effort'][indices], np.zeros(len(indices), CHAIN)
        moves = np.isin(dofs, [] if tip is None else _chain(model, tip.body))
        for field, values in (
                ('joint', indices), ('qpos', servos.qpos[indices]), ('dof', dofs),
                ('moves', moves), ('low', self._low[indices]),
                ('high', self._high[indices]), ('velocity_limit', servos.velocity_limit[indices]),
                ('cruising_velocity', servos.cruising_velocity[indices]),
                ('acceleration_limit', servos.acceleration_limit[indices]),
                ('weakest', efforts[:, 0]), ('strongest', efforts[:, 1]),
                ('damping', servos.passive_damping[indices]), ('turn', servos.turn[indices])):
            joints[field] = values
        return Arm(readable(joints), places_of_inertia(model, dofs),
                   0 if tip is None else int(model.body_rootid[tip.body]))


class Payloads:
    """
    The payloads of the arms of a robot, each kept by the reader of its external wrench.

    :param physics: of the world
    :param servos: of all driven joints
    :param readers: of the grippers, by arm
    """

    def __init__(self, physics: Physics, servos: Servos,
                 readers: Mapping[str, EndEffectorReader]) -> None:
        self._physics, self._servos, self._readers = physics, servos, readers
        self._derived = Derived()

    def __getitem__(self, arm: str) -> Payload:
        """
        Return the payload of an arm.

        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        return self._reader(arm).external.payload

    def __setitem__(self, arm: str, payload: Payload) -> None:
        """
        Change the payload of an arm from now on.

        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        self._reader(arm).external.set_payload(payload)

    def _reader(self, arm: str) -> EndEffectorReader:
        if arm not in self._readers:
            raise UnknownNameError('arm with a gripper', arm, self._readers)
        return self._readers[arm]

    @property
    def any(self) -> bool:
        """True if any arm has a payload."""
        return any([reader.external.payload.mass for reader in self._readers.values()])

    @property
    def loads(self) -> Any:
        """The payloads as the compiled law reads them, all joints of the robot with them."""
        return self._derived.made_of(self._make_loads, self._physics.arrays, *[
            reader.external.payload for reader in self._readers.values()])

    def loads_of(self, indices: IntArray) -> Any:
        """Return the same for some joints, shape (n,)."""
        return self._derived.made_of(_loads_of, self.loads, indices)

    def _make_loads(self, _: WorldArrays, *payloads: Payload) -> Any:
        from manip_sim.control.law.loads import LOAD, Loads  # It imports numba.
        from manip_sim.control.law.records import readable
        model, data = self._physics.model, self._physics.data
        carried = [(payload, reader.external.site) for payload, reader in zip(
            payloads, self._readers.values()) if payload.mass]
        loads, places = np.zeros(len(carried), LOAD), np.zeros((len(carried), 3))
        inertias, chains = np.zeros((len(carried), 3, 3)), []
        for k, (payload, site) in enumerate(carried):
            body, turn = int(model.site_bodyid[site]), matrix_of(model.site_quat[site])
            loads[k] = body, model.body_rootid[body], payload.mass
            places[k] = model.site_pos[site] + _product(turn, np.array(payload.center_of_mass))
            inertias[k] = _product(_product(turn, payload.inertia_matrix), turn.T)
            chains.append(_chain(model, body))
        dofs = self._servos.dofs
        moved_by = np.array([np.isin(dofs, chain) for chain in chains], np.bool_)
        return Loads(model.opt.gravity, data.cdof_dot, data.qacc, readable(loads), places,
                     inertias, _padded(chains), moved_by.reshape(len(carried), len(dofs)))


def _product(one: Any, other: Any) -> Any:
    """Return a product of matrices with the same bits on every processor."""
    return np.einsum('ij,j...->i...', one, other)


def _chain(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the degrees of freedom that move a body."""
    chain: list[int] = []
    while body:
        first = int(model.body_dofadr[body])
        chain += range(first, first + int(model.body_dofnum[body]))
        body = int(model.body_parentid[body])
    return chain


def _padded(chains: Sequence[Sequence[int]]) -> IntArray:
    """Return lists as rows, with -1 after shorter ones."""
    rows = np.full((len(chains), max(map(len, chains), default=0)), -1, np.int64)
    for row, chain in zip(rows, chains):
        row[:len(chain)] = chain
    return rows


def _loads_of(loads: Any, indices: IntArray) -> Any:
    return loads._replace(moved_by=np.ascontiguousarray(loads.moved_by[:, indices]))
