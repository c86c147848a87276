# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Functions of the present state that MuJoCo takes as constants of a step.

They are dry friction and torque limits of joints, velocities of belts, weight that robots with a
free root carry, and springs that pull bodies to a place, as a person does with the mouse. Nothing
of them is part of a saved state.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.models.actuators import FrictionLaw
from manip_sim.physics.clock import Clock
from manip_sim.physics.physics import Physics
from manip_sim.physics.poses_and_twists import MAX_DISTANCE_M
from manip_sim.quoting import quoted
from manip_sim.validation import finite_command_numbers

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class Belts:
    """
    The geoms with a surface velocity that have the name of an actuator, whose control scales it.

    In the file, ``surfacevel`` is that for a control of 1. It is a function of the present
    controls, so nothing here is part of a saved state. The first number in ``user`` of such an
    actuator is its control at the start.

    :param physics: of the world
    """

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        self._per_control: dict[str, FloatArray] = {}
        physics.on_change(self._find)

    def _find(self) -> None:
        model = self._physics.model
        known, self._per_control = self._per_control, {}
        actuators = {model.actuator(actuator).name: actuator for actuator in range(model.nu)}
        moving = np.flatnonzero(model.geom_surfacevel.any(axis=1)).tolist()
        moving += [model.geom(name).id for name in known
                   if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name) >= 0]
        self._geoms: list[int] = []
        self._actuators: list[int] = []
        for geom in sorted(set(moving)):
            name = str(model.geom(geom).name)
            if name in actuators:
                # A model that has replaced another one holds the velocity written last.
                velocity = known.get(name, model.geom_surfacevel[geom].copy())
                self._per_control[name] = velocity
                self._geoms.append(geom)
                self._actuators.append(actuators[name])
        self._velocities = np.array(list(self._per_control.values())).reshape(-1, 6)

    def begin(self, data: mujoco.MjData) -> None:
        """Set the controls of the start."""
        model = self._physics.model
        if model.nuser_actuator:
            data.ctrl[self._actuators] = model.actuator_user[self._actuators, 0]

    @property
    def acts(self) -> bool:
        """True if there is a surface that may move."""
        return bool(self._geoms)

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Let surfaces move as the present controls say; return whether any has changed."""
        if not self._geoms:
            return False
        velocities = data.ctrl[self._actuators][:, None] * self._velocities
        if (velocities == model.geom_surfacevel[self._geoms]).all():
            return False
        model.geom_surfacevel[self._geoms] = velocities
        return True


class FrictionLaws:
    """
    The laws of the joints of a world.

    Dry friction and torque limits in the model are functions of the velocities of the present
    state alone, so nothing of them is part of a saved state. Hess and Soom's form of the Stribeck
    curve has the same bits on every processor, which an exponential function has not.

    :param physics: of the world at the start, with the torque limits of its servos
    :param laws: by joint
    :raises ModelError: if a joint with a torque-speed curve has no torque limit
    """

    def __init__(self, physics: Physics, laws: Mapping[str, FrictionLaw]) -> None:
        self._physics, self._laws = physics, dict(laws)
        model = physics.model
        joints = np.array([model.joint(name).id for name in laws], dtype=np.int64)
        self._limits = model.jnt_actfrcrange[joints].copy()
        self._friction = model.dof_frictionloss[model.jnt_dofadr[joints]].copy()
        for name, joint, law in zip(laws, joints, laws.values()):
            if np.isfinite(law.no_load) and not model.jnt_actfrclimited[joint]:
                raise ModelError(f"joint '{name}' has no torque limit, so it can have no "
                                 'torque-speed curve')
        coulomb, static, stribeck, knee, no_load = np.array(
            [[law.coulomb, law.static, law.stribeck_velocity, law.knee, law.no_load]
             for law in laws.values()]).reshape(-1, 5).T
        self._stribeck = np.isfinite(stribeck)
        self._coulomb, self._excess, self._scale = coulomb, static - coulomb, stribeck
        self._curved = np.isfinite(no_load)
        self._knee = np.where(self._curved, knee, 0.0)
        self._no_load = np.where(self._curved, no_load, 1.0)
        physics.on_change(self._rebind)

    def _rebind(self) -> None:
        model = self._physics.model
        self._joints = np.array([model.joint(name).id for name in self._laws], dtype=np.int64)
        self._dofs = model.jnt_dofadr[self._joints]

    def refresh_joint_parameters(self) -> None:
        """Take over the dry friction of joints without a law of it, changed in the model."""
        self._friction = np.where(
            self._stribeck, self._friction, self._physics.model.dof_frictionloss[self._dofs])

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Change the model to what the present velocities give; the next step starts with it."""
        velocity = data.qvel[self._dofs]
        speed = np.abs(velocity)
        model.dof_frictionloss[self._dofs] = np.where(
            self._stribeck, self._coulomb + self._excess / (1.0 + (speed / self._scale)**2),
            self._friction)
        left = np.where(self._curved, np.clip(
            (self._no_load - speed) / (self._no_load - self._knee), 0.0, 1.0), 1.0)
        moves = np.stack([velocity < 0.0, velocity > 0.0], axis=1)
        model.jnt_actfrcrange[self._joints] = self._limits * np.where(moves, left[:, None], 1.0)


class FloatingBases:
    """
    The weight of compensated links, given back to the joints of free robots that carry it.

    :param physics: of the world
    :param roots: names of the root bodies of the robots
    :ivar roots: the same; robots that come or go have to change it before the model is replaced
    :ivar dofs: degrees of freedom with weight to give back, shape (k,)
    """

    dofs: IntArray

    def __init__(self, physics: Physics, roots: Iterable[str]) -> None:
        self._physics, self.roots = physics, tuple(roots)
        physics.on_change(self._rebind)

    def _rebind(self) -> None:
        model, roots = self._physics.model, self.roots
        free_trees = {int(model.body_rootid[body]) for body in model.jnt_bodyid[
            model.jnt_type == _FREE]} & {int(model.body(root).id) for root in roots}
        joint = model.dof_jntid
        self.dofs = np.flatnonzero(
            np.isin(model.body_rootid[model.dof_bodyid], list(free_trees))
            & (model.jnt_actgravcomp[joint] == 0))

    def apply(self) -> None:
        """Apply the weight as of the last ``mj_forward`` or step."""
        data = self._physics.data
        data.qfrc_applied[self.dofs] = -data.qfrc_gravcomp[self.dofs]


#: Duration of a pull after it was last asked for, in simulation time [s].
PULL_S = 0.2
#: Stiffness for each kilogram [N/m/kg], as in MuJoCo's viewer.
_STIFFNESS = 100.0
#: A corner feels like less than the body, which would hang far below; the spring is made for the
#: body, but at most for so many times the mass felt there.
_MOST_FELT = 4.0
#: The spring is softer in long periods, in which its force is constant: its angular frequency
#: times the period is at most this, or twice as much at a corner.
_MOST_PER_PERIOD = 0.25
#: The force is at most so many times the weight of the body and everything that it carries.
MOST_WEIGHTS = 5.0
_GRAVITY = 9.81


@dataclass(frozen=True)
class _Pull:
    """
    A spring.

    :ivar number: tells it from the next one at the same body
    :ivar point: where it holds the body, in the body's frame [m], shape (3,)
    :ivar target: where it pulls the point to, in ``world`` [m], shape (3,)
    :ivar until_ns: simulation time at which it ends [ns]
    :ivar felt: mass that was felt at the point when it began [kg]
    :ivar mass: that the stiffness is made for [kg]
    :ivar most: its force at most [N]
    """

    number: int
    point: FloatArray
    target: FloatArray
    until_ns: int
    felt: float
    mass: float
    most: float


class SpringForces:
    """
    Springs between points of bodies and places in ``world``, one for a body.

    A spring lasts :data:`PULL_S` and has to be asked for again; resets, restored states and
    objects that come or go end it. It is in ``xfrc_applied`` during control periods only, so it
    is not in saved states.

    :param physics: of the world
    :param clock: counts simulation time
    """

    def __init__(self, physics: Physics, clock: Clock) -> None:
        self._physics, self._clock = physics, clock
        self._pulls: dict[str, _Pull] = {}
        self._bodies: dict[str, int] = {}
        physics.on_change(self._rebind)

    def _rebind(self) -> None:
        model = self._physics.model
        self._pulls.clear()
        kind = mujoco.mjtObj.mjOBJ_BODY
        self._bodies = {mujoco.mj_id2name(model, kind, body) or '': body
                        for body in range(1, model.nbody)}
        self._moving = {name for name, body in self._bodies.items() if model.body_weldid[body]}

    def __bool__(self) -> bool:
        """Return whether something is pulled."""
        return bool(self._pulls)

    def state(self) -> dict[str, _Pull]:
        """Return the springs by body, for :meth:`set_state`."""
        return dict(self._pulls)

    def set_state(self, state: Mapping[str, _Pull]) -> None:
        """
        Let springs of another simulation of the same world pull.

        :raises ModelError: if they are none, or their bodies are not here
        """
        for body, pull in state.items():
            if body not in self._moving or not isinstance(pull, _Pull) or (
                    np.shape(pull.point) != (3,) or np.shape(pull.target) != (3,)):
                raise ModelError(f'{quoted(body)} cannot be pulled like that')
        self._physics.interrupt()
        self._pulls = dict(state)

    def check_body(self, body: str) -> None:
        """
        Check that a body can be pulled; in any thread.

        :raises UnknownNameError: if the body is unknown
        :raises CommandError: if it cannot move
        """
        if body not in self._bodies:
            raise UnknownNameError('body', body, self._bodies)
        if body not in self._moving:
            raise CommandError(f'pull: {quoted(body)} cannot move')

    def check(self, body: str, point: ArrayLike, target: ArrayLike) -> None:
        """
        Check what :meth:`pull` would get; in any thread.

        :raises UnknownNameError: if the body is unknown
        :raises CommandError: if it cannot move, or a number is not finite or too large
        """
        self.check_body(body)
        for name, values in (('the point', point), ('the target', target)):
            if np.abs(finite_command_numbers(values, 3, f'pull: {name}')).max() > MAX_DISTANCE_M:
                raise CommandError(f'pull: {name} must be within {MAX_DISTANCE_M:g} m of the '
                                   'origin')

    def pull(self, body: str, point: ArrayLike, target: ArrayLike, number: int = 0) -> None:
        """
        Pull a body from the next control period on, for :data:`PULL_S`.

        While the number stays the same, the spring holds the body where it did at first, and only
        its target moves.

        :param point: of the body, in ``world`` [m], shape (3,); one outside of the sphere around
            its shapes is moved into that
        :param target: where the point is pulled to, in ``world`` [m], shape (3,)
        :param number: of the pull
        :raises UnknownNameError: as :meth:`check`
        :raises CommandError: as :meth:`check`
        """
        self.check(body, point, target)
        self._physics.interrupt()
        pull = self._pulls.get(body)
        if pull is None or pull.number != number:
            pull = self._begin(self._bodies[body], np.asarray(point, float), number)
        self._pulls[body] = replace(pull, target=np.array(target, float),
                                    until_ns=self._clock.time_ns + round(PULL_S * 1e9))

    def _begin(self, body: int, point: FloatArray, number: int) -> _Pull:
        model, data = self._physics.model, self._physics.data
        held = np.empty(3)
        mujoco.mju_mulMatTVec(held, data.xmat[body].reshape(3, 3), point - data.xpos[body])
        geoms = range(int(model.body_geomadr[body]),
                      int(model.body_geomadr[body]) + int(model.body_geomnum[body]))
        reach = max([float(mujoco.mju_norm3(model.geom_pos[geom])) + float(model.geom_rbound[geom])
                     for geom in geoms], default=0.0)
        held *= min(1.0, reach / max(float(mujoco.mju_norm3(held)), 1e-9))
        jacobian, solved = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, self._place(body, held), body)
        mujoco.mj_solveM(model, data, solved, jacobian)
        # The mean over three directions, as the viewer of MuJoCo takes it.
        felt = 3.0 / max(float(np.einsum('ij,ij', jacobian, solved)), 1e-9)
        carried = float(model.body_subtreemass[int(model.body_weldid[body])])
        mass = max(felt, min(carried, _MOST_FELT * felt))
        return _Pull(number, held, point, 0, felt, mass, MOST_WEIGHTS * carried * _GRAVITY)

    def _place(self, body: int, point: FloatArray) -> FloatArray:
        """Return where a point of a body is in ``world``."""
        data, place = self._physics.data, np.empty(3)
        mujoco.mju_mulMatVec(place, data.xmat[body].reshape(3, 3), point)
        place += data.xpos[body]
        return place

    def end(self, body: str | None = None) -> None:
        """End the pull of a body, if there is one; None: all pulls."""
        for name in list(self._pulls) if body is None else [body]:
            self._pulls.pop(name, None)

    def apply(self, period_s: float) -> None:
        """
        Write the forces of the next control period, and end the pulls that nobody asks for.

        :param period_s: its length [s]
        """
        stiffness = min(_STIFFNESS, (_MOST_PER_PERIOD / period_s) ** 2)
        for name, pull in list(self._pulls.items()):
            if self._clock.time_ns >= pull.until_ns:
                del self._pulls[name]
            else:
                self._apply(self._bodies[name], pull, stiffness)

    def _apply(self, body: int, pull: _Pull, stiffness: float) -> None:
        model, data = self._physics.model, self._physics.data
        velocity, moment = np.empty(6), np.empty(3)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0)
        point = self._place(body, pull.point)
        mujoco.mju_cross(moment, velocity[:3], point - data.xpos[body])
        damping = 2.0 * np.sqrt(stiffness * pull.mass * pull.felt)
        force = stiffness * pull.mass * (pull.target - point) - damping * (velocity[3:] + moment)
        force *= min(1.0, pull.most / max(float(mujoco.mju_norm3(force)), 1e-9))
        mujoco.mju_cross(moment, point - data.xipos[body], force)
        data.xfrc_applied[body, :3], data.xfrc_applied[body, 3:] = force, moment

    def release(self) -> None:
        """Take the forces of the control period back that has ended."""
        for name in self._pulls:
            self._physics.data.xfrc_applied[self._bodies[name]] = 0.0
