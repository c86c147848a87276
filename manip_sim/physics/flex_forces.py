# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Forces of flexes on the bodies of a tool: edges that tie it to other bodies, and contacts.

MuJoCo collects neither in ``cfrc_ext``. Elasticity of surfaces and solids does not occur: MuJoCo
does not compile it with the integrator that worlds have.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray

_OF_EDGES = int(mujoco.mjtEq.mjEQ_FLEX)
_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
#: True if contacts act on the vertices of a flex as in versions of MuJoCo before 4.0.
_BY_DISTANCE = int(mujoco.__version__.partition('.')[0]) < 4


@dataclass(frozen=True, eq=False)
class FlexForces:
    """
    Where flexes act on the bodies of a tool.

    :ivar bodies: whether each body is of the tool, shape (nbody,)
    :ivar vertices: whether each vertex of a flex is on such a body, shape (nflexvert,)
    :ivar ends: vertices of the edges of all flexes, shape (nflexedge, 2)
    :ivar flexes: of the edges, shape (nflexedge,)
    :ivar ties: edges that connect the tool with something else, shape (k,)
    """

    bodies: BoolArray
    vertices: BoolArray
    ends: IntArray
    flexes: IntArray
    ties: IntArray

    @classmethod
    def of(cls, model: mujoco.MjModel, bodies: slice) -> FlexForces | None:
        """
        Find the flexes of a model; None if it has none.

        :param model: the compiled ``mujoco.MjModel``
        :param bodies: of the tool
        """
        if model.nflex == 0:
            return None
        on_tool = np.zeros(model.nbody + 1, dtype=bool)  # The last one stands for no body.
        on_tool[bodies] = True
        vertices = on_tool[model.flex_vertbodyid]
        flexes = np.repeat(np.arange(model.nflex), model.flex_edgenum)
        ends = model.flex_edge.reshape(-1, 2) + model.flex_vertadr[flexes, None]
        has_one = vertices[ends]
        ties = np.flatnonzero((has_one[:, 0] != has_one[:, 1]) & (model.flexedge_rigid == 0))
        return cls(on_tool[:-1], vertices, ends, flexes, ties)

    @property
    def has_vertices(self) -> bool:
        """True if the tool has vertices of a flex, which pulls at it or touches something."""
        return bool(self.vertices.any())

    def add(self, wrench: FloatArray, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """
        Add the forces in the last step to a wrench about the origin of ``world``.

        :param wrench: force [N] and torque [N m], shape (6,), is changed
        """
        if self.ties.size:
            self._add_edges(wrench, model, data)
        contact = data.contact
        of_flex = (contact.geom < 0).any(axis=1) & (contact.efc_address >= 0)
        for index in np.flatnonzero(of_flex).tolist():
            self._add_contact(wrench, model, data, index)

    def _add_edges(self, wrench: FloatArray, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        forces = self._edge_forces(model, data)[self.ties]
        first, second = data.flexvert_xpos[self.ends[self.ties]].transpose(1, 0, 2)
        way = second - first
        # A force that makes an edge longer pushes its second vertex on, and the first one back.
        away = forces[:, None] * way / np.maximum(np.linalg.norm(way, axis=1), 1e-12)[:, None]
        is_second = self.vertices[self.ends[self.ties, 1]][:, None]
        pushes = np.where(is_second, away, -away)
        wrench[:3] += pushes.sum(axis=0)
        wrench[3:] += np.cross(np.where(is_second, second, first), pushes).sum(axis=0)

    def _edge_forces(self, model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
        """Return the forces that make edges longer, of springs, dampers and constraints [N]."""
        disabled = model.opt.disableflags
        forces = np.zeros(model.nflexedge)
        if not disabled & int(mujoco.mjtDisableBit.mjDSBL_SPRING):
            forces += model.flex_edgestiffness[self.flexes] * (
                model.flexedge_length0 - data.flexedge_length)
        if not disabled & int(mujoco.mjtDisableBit.mjDSBL_DAMPER):
            forces -= model.flex_edgedamping[self.flexes] * data.flexedge_velocity
        rows = np.flatnonzero(data.efc_type == _EQUALITY)
        for equality in np.flatnonzero(model.eq_type == _OF_EDGES).tolist():
            own = rows[data.efc_id[rows] == equality]
            if own.size:
                flex = int(model.eq_obj1id[equality])
                edges = np.flatnonzero((self.flexes == flex) & (model.flexedge_rigid == 0))
                forces[edges] += data.efc_force[own]
        return forces

    def _add_contact(self, wrench: FloatArray, model: mujoco.MjModel, data: mujoco.MjData,
                     index: int) -> None:
        shares = [self._share(model, data, index, side) for side in (0, 1)]
        share, local = shares[1] - shares[0], np.empty(6)
        if share == 0.0:
            return
        contact = data.contact[index]
        mujoco.mj_contactForce(model, data, index, local)
        force, torque = share * local.reshape(2, 3) @ contact.frame.reshape(3, 3)
        wrench[:3] += force
        wrench[3:] += torque + np.cross(contact.pos, force)

    def _share(self, model: mujoco.MjModel, data: mujoco.MjData, index: int, side: int) -> float:
        """Return the share of the force on one side of a contact that acts on the tool."""
        contact = data.contact[index]
        if contact.geom[side] >= 0:
            return float(self.bodies[model.geom_bodyid[contact.geom[side]]])
        flex = int(contact.flex[side])
        first = int(model.flex_vertadr[flex])
        if contact.vert[side] >= 0:
            return float(self.vertices[first + contact.vert[side]])
        size = int(model.flex_dim[flex]) + 1
        begin = int(model.flex_elemdataadr[flex]) + int(contact.elem[side]) * size
        vertices = first + model.flex_elem[begin:begin + size]
        if contact.flex[1 - side] == flex:
            vertices = vertices[vertices != first + contact.vert[1 - side]]
        return float(_weights(data.flexvert_xpos[vertices], contact.pos)
                     @ self.vertices[vertices])


def _weights(corners: FloatArray, point: FloatArray) -> FloatArray:
    """
    Return the shares of a contact's force that act on the corners of an element.

    From MuJoCo 4.0 on they are the weights of the corners in the point of the element that is
    nearest to that of the contact; before, they were the inverse distances from it.
    """
    if _BY_DISTANCE:
        near = 1.0 / np.maximum(np.linalg.norm(corners - point, axis=1), 1e-15)
        return np.asarray(near / near.sum())
    weights, inside = np.zeros(len(corners)), np.arange(len(corners))
    while True:
        edges = (corners[inside[1:]] - corners[inside[0]]).T
        shares = np.linalg.lstsq(edges, point - corners[inside[0]], rcond=None)[0]
        weights[:] = 0.0
        weights[inside] = [1.0 - shares.sum(), *shares]
        if weights.min() >= 0.0:
            return weights
        inside = np.flatnonzero(weights > 0.0)
