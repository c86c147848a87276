# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Forces on the bodies of a tool that MuJoCo does not collect in ``cfrc_ext``.

``cfrc_ext`` has applied forces, contacts, connect and weld constraints, and spatial tendons.
MuJoCo attributes the others to the joints: actuators on sites, slider-cranks, adhesion, and the
fluid; and forces of flexes to nothing. Forces between two bodies of the tool cancel.
"""

from __future__ import annotations

from dataclasses import dataclass
import threading
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray

_SITE, _BODY, _CRANK = (int(getattr(mujoco.mjtTrn, f'mjTRN_{name}')) for name in (
    'SITE', 'BODY', 'SLIDERCRANK'))
_OF_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)
_BODY_OF_WRAP = {int(mujoco.mjtWrap.mjWRAP_SITE): 'site_bodyid',
                 int(mujoco.mjtWrap.mjWRAP_SPHERE): 'geom_bodyid',
                 int(mujoco.mjtWrap.mjWRAP_CYLINDER): 'geom_bodyid'}
_MESH, _ELLIPSOID = int(mujoco.mjtGeom.mjGEOM_MESH), mujoco.mjtGeom.mjGEOM_ELLIPSOID
#: Models of bodies in a fluid by tool, and their data, which a thread changes.
_THREADS = threading.local()
_OF_MASS = ('body_mass', 'body_inertia', 'body_ipos', 'body_iquat')
_OF_EDGES = int(mujoco.mjtEq.mjEQ_FLEX)
_EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
#: True if contacts act on the vertices of a flex as in versions of MuJoCo before 4.0.
_BY_DISTANCE = int(mujoco.__version__.partition('.')[0]) < 4


@dataclass(frozen=True, eq=False)
class FlexForces:
    """
    Vertices and edges at which flexes act on the bodies of a tool.

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
            constraints = rows[data.efc_id[rows] == equality]
            if constraints.size:
                flex = int(model.eq_obj1id[equality])
                edges = np.flatnonzero((self.flexes == flex) & (model.flexedge_rigid == 0))
                forces[edges] += data.efc_force[constraints]
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


@dataclass(frozen=True, eq=False)
class UncollectedForces:
    """
    Places at which forces that are not in ``cfrc_ext`` act on the bodies of a tool.

    :ivar first: id of the first body of the tool; bodies are in depth-first order
    :ivar end: id after the last one
    :ivar sites: actuators on sites: actuator, site where the force acts, site of its axes, sign
    :ivar cranks: slider-cranks with an end on the tool: actuator, site of the crank, of the slider
    :ivar adhesions: adhesion actuators of any body: actuator, body
    :ivar tendons: whether a spatial tendon connects the tool with something else
    :ivar flexes: None for a model without a flex
    """

    first: int
    end: int
    sites: tuple[tuple[int, int, int, float], ...]
    cranks: tuple[tuple[int, int, int], ...]
    adhesions: tuple[tuple[int, int], ...]
    tendons: bool
    flexes: FlexForces | None

    @classmethod
    def of(cls, model: mujoco.MjModel, bodies: slice) -> UncollectedForces:
        """
        Find the actuators that act on a tool.

        :param model: the compiled ``mujoco.MjModel``
        :param bodies: of the tool
        """
        first, end = bodies.start, bodies.stop
        on_tool = np.zeros(model.nbody, dtype=bool)
        on_tool[first:end] = True
        sites, cranks, adhesions = [], [], []
        for actuator, kind in enumerate(model.actuator_trntype.tolist()):
            target, reference = model.actuator_trnid[actuator].tolist()
            if kind == _BODY:
                adhesions.append((actuator, target))
            elif kind in (_SITE, _CRANK):
                has_one = bool(on_tool[model.site_bodyid[target]])
                has_other = reference >= 0 and bool(on_tool[model.site_bodyid[reference]])
                if kind == _CRANK and has_one != has_other:
                    cranks.append((actuator, target, reference))
                elif has_one != has_other:
                    axes = reference if reference >= 0 else target
                    sites.append((actuator, target, axes, 1.0) if has_one else
                                 (actuator, reference, axes, -1.0))
        return cls(first, end, tuple(sites), tuple(cranks), tuple(adhesions),
                   _is_tied_by_tendons(model, on_tool), FlexForces.of(model, bodies))

    @property
    def pulls(self) -> bool:
        """True if forces other than contacts and the fluid may act on the tool."""
        return (self.tendons or bool(self.sites or self.cranks)
                or self.flexes is not None and self.flexes.has_vertices)

    @property
    def is_empty(self) -> bool:
        """True if the fluid is the only force that ``cfrc_ext`` lacks."""
        return not (self.sites or self.cranks or self.adhesions
                    or self.flexes is not None)

    def wrench(self, model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
        """
        Return the sum of the forces in the last step.

        :param model: the ``mujoco.MjModel``
        :param data: the ``mujoco.MjData``, after ``mj_step`` or ``mj_forward``
        :returns: force [N] and torque about the origin of ``world`` [N m], in its axes, shape (6,)
        """
        wrench = np.zeros(6)
        for actuator, site, axes, sign in self.sites:
            gear = sign * data.actuator_force[actuator] * model.actuator_gear[actuator]
            _add(wrench, _rotated(data.site_xmat[axes], gear[:3]), data.site_xpos[site],
                 _rotated(data.site_xmat[axes], gear[3:]))
        for crank in self.cranks:
            self._add_crank(wrench, model, data, *crank)
        for actuator, body in self.adhesions:
            if data.actuator_force[actuator] and data.ncon:
                self._add_adhesion(wrench, model, data, float(data.actuator_force[actuator]), body)
        if self.flexes is not None:
            self.flexes.add(wrench, model, data)
        if has_fluid(model.opt):
            self._add_fluid(wrench, model, data)
        return wrench

    def _add_crank(self, wrench: FloatArray, model: mujoco.MjModel, data: mujoco.MjData,
                   actuator: int, crank: int, slider: int) -> None:
        # The length of the transmission is a.v - sqrt(r^2 + (a.v)^2 - v.v), with the axis a of
        # the slider and v from there to the crank; its derivatives are the forces.
        axis = data.site_xmat[slider].reshape(3, 3)[:, 2]
        way = data.site_xpos[crank] - data.site_xpos[slider]
        along = mujoco.mju_dot3(axis, way)
        square = along**2 + model.actuator_cranklength[actuator]**2 - mujoco.mju_dot3(way, way)
        root = np.sqrt(square) if square > 0.0 else np.inf
        force = data.actuator_force[actuator] * model.actuator_gear[actuator, 0] * (
            axis * (1.0 - along / root) + way / root)
        # The opposite acts on the body of the slider, through the pin of the crank too.
        has_crank = self.first <= model.site_bodyid[crank] < self.end
        _add(wrench, force if has_crank else -force, data.site_xpos[crank])

    def _add_adhesion(self, wrench: FloatArray, model: mujoco.MjModel, data: mujoco.MjData,
                      force: float, body: int) -> None:
        contact = data.contact
        geoms = contact.geom
        bodies = np.where(geoms >= 0, model.geom_bodyid[geoms], -1)
        sticks = ((bodies == body).any(axis=1) & (geoms >= 0).all(axis=1)
                  & (contact.exclude <= 1))
        on_tool = (bodies >= self.first) & (bodies < self.end)
        share = force / max(int(np.count_nonzero(sticks)), 1)
        for index in np.flatnonzero(sticks & (on_tool[:, 0] != on_tool[:, 1])).tolist():
            towards_other = share if on_tool[index, 0] else -share
            _add(wrench, towards_other * contact.frame[index, :3], contact.pos[index])

    def _add_fluid(self, wrench: FloatArray, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        bodies, floating, alone = self._in_fluid(model)
        # Edits of the model count.
        for name in _OF_MASS:
            getattr(floating, name)[1:] = getattr(model, name)[bodies]
        floating.opt.density, floating.opt.viscosity = model.opt.density, model.opt.viscosity
        floating.opt.wind[:] = model.opt.wind
        position, velocity = alone.qpos.reshape(-1, 7), alone.qvel.reshape(-1, 6)
        position[:, :3], position[:, 3:] = data.xpos[bodies], data.xquat[bodies]
        for row, body in zip(velocity, bodies):
            moves = np.empty(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, moves, 0)
            row[:3] = moves[3:]
            mujoco.mju_mulMatTVec(row[3:], data.xmat[body].reshape(3, 3), moves[:3])
        for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel, mujoco.mj_passive):
            stage(floating, alone)
        for row, body in zip(alone.qfrc_fluid.reshape(-1, 6), bodies):
            _add(wrench, row[:3], data.xpos[body], _rotated(data.xmat[body], row[3:]))

    def _in_fluid(self, model: mujoco.MjModel
                  ) -> tuple[list[int], mujoco.MjModel, mujoco.MjData]:
        """Return the bodies with a mass, and their model and data in this thread."""
        known = vars(_THREADS).setdefault('known', WeakKeyDictionary())
        if self not in known:
            bodies = [body for body in range(self.first, self.end) if model.body_mass[body] > 0.0]
            floating = _floating(model, bodies)
            known[self] = bodies, floating, mujoco.MjData(floating)
        entry: tuple[list[int], mujoco.MjModel, mujoco.MjData] = known[self]
        return entry


def has_fluid(options: mujoco.MjOption) -> bool:
    """Return whether there is a fluid, as options can be changed."""
    return bool(options.density or options.viscosity)


def _add(wrench: FloatArray, force: FloatArray, point: FloatArray,
         torque: FloatArray | None = None) -> None:
    """Add a force at a point, and a torque, to a wrench about the origin."""
    moment = np.empty(3)
    mujoco.mju_cross(moment, point, force)
    wrench[:3] += force
    wrench[3:] += moment if torque is None else moment + torque


def _rotated(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    rotated = np.empty(3)
    mujoco.mju_mulMatVec(rotated, matrix.reshape(3, 3), vector)
    return rotated


def is_spatial(model: mujoco.MjModel, tendon: int) -> bool:
    """Return whether a tendon is a line through space, and no sum of joints."""
    return int(model.wrap_type[model.tendon_adr[tendon]]) != _OF_JOINT


def _is_tied_by_tendons(model: mujoco.MjModel, on_tool: np.ndarray) -> bool:
    for first, count in zip(model.tendon_adr.tolist(), model.tendon_num.tolist()):
        ends = {bool(on_tool[getattr(model, _BODY_OF_WRAP[kind])[model.wrap_objid[wrap]]])
                for wrap, kind in enumerate(model.wrap_type[first:first + count].tolist(), first)
                if kind in _BODY_OF_WRAP}
        if len(ends) == 2:
            return True
    return False


def _floating(model: mujoco.MjModel, bodies: list[int]) -> mujoco.MjModel:
    """Return a model of some bodies, each with a free joint and what the fluid acts on."""
    spec, shapes = mujoco.MjSpec(), []
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9
    spec.compiler.balanceinertia = True
    for body in bodies:
        added = spec.worldbody.add_body(mass=1.0, inertia=[1.0] * 3, explicitinertial=True)
        added.add_freejoint()
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            if model.geom_fluid[geom, 0] > 0.0:
                kind = int(model.geom_type[geom])
                added.add_geom(type=_ELLIPSOID if kind == _MESH else mujoco.mjtGeom(kind),
                               size=model.geom_size[geom], pos=model.geom_pos[geom],
                               quat=model.geom_quat[geom])
                shapes.append(geom)
    floating = spec.compile()
    floating.geom_fluid[:] = model.geom_fluid[shapes]
    return floating
