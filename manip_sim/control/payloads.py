# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The payloads of the arms of a robot, and which joints move them, for the compiled law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import IntArray
from manip_sim.control.servos import Servos
from manip_sim.derived import Derived
from manip_sim.errors import UnknownNameError
from manip_sim.physics.parts import EndEffectorReader
from manip_sim.physics.payload import Payload
from manip_sim.physics.physics import Physics, WorldArrays


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
        from manip_sim.control.law.joint_records import readable
        from manip_sim.control.law.loads import LOAD, Loads  # It imports numba.
        model, data = self._physics.model, self._physics.data
        carried = [(payload, reader.external.site) for payload, reader in zip(
            payloads, self._readers.values()) if payload.mass]
        loads, places = np.zeros(len(carried), LOAD), np.zeros((len(carried), 3))
        inertias, chains = np.zeros((len(carried), 3, 3)), []
        for k, (payload, site) in enumerate(carried):
            body, axes = int(model.site_bodyid[site]), np.empty(9)
            mujoco.mju_quat2Mat(axes, model.site_quat[site])
            turn = axes.reshape(3, 3)
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
