# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Defects of the start of robots, found before anything moves, and their remedies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray
from manip_sim.models.actuators import effort_range, position_servos, SCALAR
from manip_sim.models.couplings import (
    actuated_joints, JointCouplings, joints_between, moved_joints)
from manip_sim.models.robots.robot_model import driven_joint
from manip_sim.quoting import quoted_names

#: Geoms that overlap by less only touch [m].
_TOUCHING_M = 0.0005
#: A joint that is outside its range by less, as a fraction of the range, is at its end.
_AT_END = 1e-3
#: A joint is blocked if contacts leave less than this share of its acceleration; one that can move
#: away from its neighbour keeps half of it.
_BLOCKED = 0.25
#: Armature that holds other joints still while one is tried, as a multiple of the larger of their
#: inertia and that of the one, so that a hand is held alone as on an arm.
_HELD = 1e3
#: Acceleration by the trial force of a joint without a force limit [rad/s^2 or m/s^2].
_TRIAL_ACCELERATION = 100.0
#: A moment of inertia so many times that of the same mass at the edge of a link is absurd; guesses
#: of people who measure none are some ten times too large.
_ABSURD_INERTIA = 50.0
#: Smaller moments stand for rotors, too [kg m^2], and smaller links for larger ones [m].
_SMALL_INERTIA, _SMALL_M = 0.01, 0.02
#: A force nearer to its limit than this fraction of it is at the limit.
_AT_LIMIT = 1e-6
#: Number of names that one sentence lists.
_LISTED = 8
_FREE, _BALL, _SLIDE, _HINGE = (int(getattr(mujoco.mjtJoint, f'mjJNT_{name}')) for name in (
    'FREE', 'BALL', 'SLIDE', 'HINGE'))
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)


@dataclass(frozen=True)
class StartDefect:
    """
    A defect in one sentence, and what to write instead.

    :ivar kind: ``overlap``, ``blocked``, ``range``, ``actuators``, ``undriven``,
        ``effort``, ``inertia``, ``control``, ``meshes`` or ``states``
    :ivar text: the defect, with the names of the compiled model
    :ivar remedy: what to write, with the names of the compiled model
    """

    kind: str
    text: str
    remedy: str


@dataclass(frozen=True)
class _Remedies:
    """
    Words and remedies for one kind of file, most of them templates of ``str.format``.

    :ivar pose: place of the pose at the start
    :ivar body: a body
    :ivar shape: a ``geom`` of a ``body``
    :ivar exclusion: a ``first`` and an ``other`` body that may not collide
    :ivar drive: an actuator for the ``joint``, and for ``others``
    :ivar limit: an effort limit from ``low`` to ``high`` [N m or N]
    :ivar wider_range: a wider range of a joint
    :ivar inertia: the same ``moment`` of inertia about all axes [kg m^2]
    """

    pose: str
    body: str
    shape: str
    exclusion: str
    drive: str
    limit: str
    wider_range: str
    inertia: str


_MJCF = _Remedies(
    pose='init_qpos, or the keyframe', body='body', shape="geom '{geom}' of body '{body}'",
    exclusion='write <exclude body1="{first}" body2="{other}"/> into <contact>',
    drive='write <motor joint="{joint}" ctrlrange="-LIMIT LIMIT"/> into <actuator>, with the '
          'torque limit [N m or N]{others}; a body that must not move needs no <joint>',
    limit='write a higher limit, such as actuatorfrcrange="{low:g} {high:g}" on the joint, and so '
          'forcerange or ctrlrange of the actuator where they are lower',
    wider_range='give the joint a wider range',
    inertia='diaginertia="{moment:g} {moment:g} {moment:g}" of its <inertial>')
#: For a URDF file, or the SRDF and the YAML file beside it; its shapes have no names.
_URDF = _Remedies(
    pose="init_qpos, or 'start' in the YAML file", body='link',
    shape="a collision shape of link '{body}'",
    exclusion='write <disable_collisions link1="{first}" link2="{other}" reason="Never"/> into '
              'the SRDF of the same name beside the URDF',
    drive='write type="fixed" if the joint must not move, or <mimic joint="..."/> if another one '
          'drives it',
    limit='write a higher limit, such as <limit effort="{high:g}" .../>, for the joint; efforts: '
          'guess in the YAML file replaces limits that are placeholders',
    wider_range='give the joint a wider range, by lower and upper of its <limit>',
    inertia='<inertia ixx="{moment:g}" iyy="{moment:g}" izz="{moment:g}" ixy="0" ixz="0" iyz="0"/>'
)


def find_start_defects(model: mujoco.MjModel, data: mujoco.MjData, roots: Iterable[str | int],
                       urdf: tuple[str, ...] = ()) -> list[StartDefect]:
    """
    Find overlaps, blocked joints, joints outside their range, drive defects, absurd inertias.

    :param model: the compiled ``mujoco.MjModel``
    :param data: the ``mujoco.MjData`` at the start, after ``mj_forward``; only read
    :param roots: the root bodies of the robots, by their names or ids
    :param urdf: what the names of elements from URDF files begin with; their remedies are for URDF
    :returns: overlaps first, the deepest before others; empty if nothing is wrong
    """
    start = _Start(model, data, roots, urdf)
    return [*start.overlaps(), *start.blocked(), *start.held(), *start.out_of_range(),
            *start.shared(), *start.undriven(), *start.efforts(), *start.inertias()]


class _Start:
    """
    The start of robots, whose methods yield its defects.

    The parameters are as for :func:`find_start_defects`.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, roots: Iterable[str | int],
                 urdf: tuple[str, ...]) -> None:
        self.model, self.data, self._urdf = model, data, urdf
        #: True for each body of a robot, shape (nbody,).
        self.of_robots = _bodies_below(model, [model.body(root).id for root in roots])
        #: Contacts of a geom of a robot with any other one.
        self.contacts = [contact for contact in data.contact if min(contact.geom) >= 0
                         and self.of_robots[model.geom_bodyid[contact.geom]].any()]
        self.joints = [joint for joint in np.flatnonzero(
            self.of_robots[model.jnt_bodyid]).tolist() if int(model.jnt_type[joint]) != _FREE]
        #: Scalar joints that actuators act on, also through tendons.
        self.actuated = [joint for joint in dict.fromkeys(
            joint for actuator in range(model.nu) for joint in actuated_joints(model, actuator))
            if joint in self.joints and int(model.jnt_type[joint]) in SCALAR]
        #: The actuators that act on each joint alone, not through a tendon or a site.
        self.drivers: dict[int, list[int]] = {}
        for actuator in range(model.nu):
            driven = actuated_joints(model, actuator)
            if driven_joint(model, actuator) is not None and driven[0] in self.joints:
                self.drivers.setdefault(driven[0], []).append(actuator)

    def _remedies(self, name: str) -> _Remedies:
        """Return the remedies for an element."""
        return _URDF if self._urdf and name.startswith(self._urdf) else _MJCF

    def _shape(self, geom: int) -> str:
        body = self.model.body(self.model.geom_bodyid[geom]).name
        return self._remedies(body).shape.format(geom=self.model.geom(geom).name, body=body)

    def _unit(self, joint: int) -> str:
        return 'N m' if int(self.model.jnt_type[joint]) in (_HINGE, _BALL) else 'N'

    # ------------------------------------------------------------------ contacts

    def overlaps(self) -> Iterator[StartDefect]:
        """Yield the geoms that overlap, once for two bodies, the deepest first."""
        bodies, reported = self.model.geom_bodyid, set()
        for contact in sorted(self.contacts, key=lambda contact: float(contact.dist)):
            pair = tuple(sorted(bodies[contact.geom].tolist()))
            if contact.dist >= -_TOUCHING_M or pair in reported:
                continue
            reported.add(pair)
            # The geom farther from the robot's root is reported as inside the one nearer to it.
            outer, inner = sorted(contact.geom, key=lambda geom: (
                bool(self.of_robots[bodies[geom]]), int(bodies[geom])))
            yield StartDefect(
                'overlap', f'{self._shape(inner)} starts {-1e3 * contact.dist:.1f} mm inside '
                f'{self._shape(outer)}', self._apart(inner, outer))

    def _apart(self, inner: int, outer: int) -> str:
        """Return the remedy for a geom of a robot that overlaps another geom."""
        bodies = [int(self.model.geom_bodyid[geom]) for geom in (outer, inner)]
        other, body = (self.model.body(index).name for index in bodies)
        if not self.of_robots[bodies[0]]:
            return (f'place the robot elsewhere (its position, or base_xpos_offset), or move '
                    f"'{other}', or start in another pose")
        remedies = self._remedies(body)
        if len(joints_between(self.model, *bodies)) < 2:
            # Geoms of neighbours often overlap at their common joint.
            return remedies.exclusion.format(first=other, other=body)
        return (f'start in another pose ({remedies.pose}), or mount the part farther out, or make '
                'the shapes smaller')

    def blocked(self) -> Iterator[StartDefect]:
        """Yield the joints that contacts hardly let move."""
        model = self.model
        trial = copy.copy(model) if self.contacts else model
        for joint in self.actuated:
            moved = _bodies_below(model, [int(model.jnt_bodyid[joint])])
            against = [contact for contact in self.contacts
                       if moved[model.geom_bodyid[contact.geom]].sum() == 1]
            if not against or not self._is_blocked(trial, joint):
                continue
            contact = min(against, key=lambda contact: float(contact.dist))
            # The message names the geom that does not move with the joint.
            mover, neighbour = sorted(
                contact.geom, key=lambda geom: not moved[model.geom_bodyid[geom]])
            yield StartDefect(
                'blocked', f"joint '{model.joint(joint).name}' starts blocked by "
                f'{self._shape(neighbour)}', self._apart(mover, neighbour))

    def _is_blocked(self, trial: mujoco.MjModel, joint: int) -> bool:
        """
        Return whether contacts hardly let the full force move a joint, forwards or backwards.

        :param trial: a copy of the model to try it with, changed in place
        """
        model = self.model
        trial.dof_armature[:], trial.opt.disableflags = model.dof_armature, model.opt.disableflags
        scalar = np.flatnonzero(np.isin(model.jnt_type, SCALAR)).tolist()
        together = JointCouplings(model, scalar).group(joint)
        held = np.ones(model.nv, dtype=bool)
        held[[model.jnt_dofadr[j] for j in together]] = False
        inertia = model.dof_M0[model.jnt_dofadr[joint]]
        trial.dof_armature[held] += _HELD * np.maximum(model.dof_M0[held], inertia)
        # Contacts are as soft as the bodies are free, and an arm beyond a hand is not here.
        mujoco.mj_setConst(trial, copy.copy(self.data))
        trial.opt.noslip_iterations = 0  # They do not converge beside what is held.
        with_contacts = _span(trial, self.data, joint)
        trial.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        return with_contacts < _BLOCKED * _span(trial, self.data, joint)

    # ------------------------------------------------------------------ joints and their drives

    def held(self) -> Iterator[StartDefect]:
        """Yield a defect if equality constraints hold joints in place that actuators drive."""
        model = self.model
        held = model.eq_obj1id[(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT))
                               & (model.eq_active0 != 0) & (model.eq_obj2id < 0)]
        names = [str(model.joint(joint).name) for joint in self.actuated if joint in held]
        if names:
            yield StartDefect(
                'blocked', f'equality constraints hold in place what actuators drive: joints '
                f'{quoted_names(names)}', 'write active="false" in these <joint> of <equality>, '
                'or leave the actuators out')

    def out_of_range(self) -> Iterator[StartDefect]:
        """Yield the joints that start outside their range."""
        model = self.model
        for joint in self.joints:
            if int(model.jnt_type[joint]) not in SCALAR or not model.jnt_limited[joint]:
                continue
            low, high = model.jnt_range[joint]
            name = model.joint(joint).name
            position = float(self.data.qpos[model.jnt_qposadr[joint]])
            beyond = max(low - position, position - high)
            if beyond > _AT_END * (high - low):
                unit = 'm' if int(model.jnt_type[joint]) == _SLIDE else 'rad'
                remedies = self._remedies(name)
                yield StartDefect(
                    'range', f"joint '{name}' starts at {position:.4g} {unit}, {beyond:.4g} "
                    f'outside its range of {low:.4g} to {high:.4g}',
                    f'write a value from {low:.4g} to {high:.4g} for it into {remedies.pose}, or '
                    f'{remedies.wider_range}')

    def shared(self) -> Iterator[StartDefect]:
        """Yield the joints that several actuators drive."""
        for joint, actuators in self.drivers.items():
            if len(actuators) > 1:
                names = [self.model.actuator(actuator).name for actuator in actuators]
                yield StartDefect(
                    'actuators', f"joint '{self.model.joint(joint).name}' is driven by "
                    f'{len(names)} actuators, {quoted_names(names)}',
                    f'leave one of them in <actuator>: delete {quoted_names(names[1:])}')

    def undriven(self) -> Iterator[StartDefect]:
        """Yield a defect if nothing moves or holds some joints."""
        moved = moved_joints(self.model)
        names = [self.model.joint(joint).name for joint in self.joints if joint not in moved]
        if names:
            noun, verb, them, others = ('joint', 'has', 'it', '') if len(names) == 1 else (
                'joints', 'have', 'them', ', and so for each of them')
            yield StartDefect(
                'undriven', f'{noun} {quoted_names(names, _LISTED)} {verb} no actuator, and no '
                f'spring or coupling to a joint that has one: nothing holds {them}',
                self._remedies(names[0]).drive.format(joint=names[0], others=others))

    def efforts(self) -> Iterator[StartDefect]:
        """Yield the actuators that cannot hold the start pose, or need their full force for it."""
        weak = dict(self._too_weak())
        yield from weak.values()
        yield from self._at_full_force(weak.keys())

    def _too_weak(self) -> Iterator[tuple[int, StartDefect]]:
        """Yield the joints whose actuator cannot hold the start pose, and their defects."""
        model = self.model
        alone = {joint: actuators[0] for joint, actuators in self.drivers.items()
                 if len(actuators) == 1 and int(model.jnt_type[joint]) != _BALL}
        if not alone:
            return
        joints, actuators = np.array(list(alone)), np.array(list(alone.values()))
        dofs = model.jnt_dofadr[joints]
        at_rest = copy.copy(self.data)
        at_rest.qvel[:] = 0.0
        mujoco.mj_forward(model, at_rest)
        needed = at_rest.qfrc_bias[dofs] - at_rest.qfrc_passive[dofs]
        # Gravity compensation by the actuators counts against the force limit of the joint alone.
        beside = (model.jnt_actgravcomp[joints] != 0) & (model.jnt_actfrclimited[joints] == 0)
        needed -= np.where(beside, at_rest.qfrc_gravcomp[dofs], 0.0)
        limits = effort_range(model, joints, actuators)
        excess = np.maximum(limits[:, 0] - needed, needed - limits[:, 1])
        for index in np.flatnonzero(excess > _AT_LIMIT * np.abs(needed)).tolist():
            joint, effort = int(joints[index]), float(needed[index])
            name, unit = model.joint(joint).name, self._unit(joint)
            there = limits[index, 1 if effort > 0.0 else 0]
            enough, remedies = float(f'{1.1 * abs(effort):.2g}'), self._remedies(name)
            yield joint, StartDefect(
                'effort', f"joint '{name}' needs {effort:.4g} {unit} to keep its start pose, its "
                f"actuator '{model.actuator(int(actuators[index])).name}' has {there:.4g} {unit}",
                f'start where the joint carries less ({remedies.pose}), or '
                f'{remedies.limit.format(low=-enough, high=enough)}')

    def _at_full_force(self, reported: Iterable[int]) -> Iterator[StartDefect]:
        """Yield the servos whose control is so far off the start that they exert full force."""
        model, data, joints, reported = self.model, self.data, set(self.joints), set(reported)
        is_servo = (model.actuator_forcelimited != 0) & position_servos(model, np.arange(model.nu))
        for actuator in np.flatnonzero(is_servo).tolist():
            driven = actuated_joints(model, actuator)
            if not joints.intersection(driven) or reported.intersection(driven):
                continue
            force = float(data.actuator_force[actuator])
            limit = model.actuator_forcerange[actuator]
            if not (np.abs(limit - force) <= _AT_LIMIT * np.abs(limit)).any() or force == 0.0:
                continue
            name, unit = model.actuator(actuator).name, self._unit(driven[0])
            there = _control_without_force(model, actuator, float(data.actuator_length[actuator]))
            yield StartDefect(
                'effort', f"actuator '{name}' starts with its full force of {force:.4g} {unit}: "
                f'its control is {float(data.ctrl[actuator]):.4g}'
                + ('' if there is None else f', at {there:.4g} it would exert none'),
                ('' if there is None else
                 f'write {there:.4g} for it into ctrl of the keyframe, or ')
                + 'start the joint where the control holds it')

    # ------------------------------------------------------------------ links

    def inertias(self) -> Iterator[StartDefect]:
        """Yield a defect if no body of their mass and size has the inertias of moving links."""
        model = self.model
        absurd: dict[int, float] = {}
        for body in np.flatnonzero(self.of_robots & (model.body_weldid != 0)).tolist():
            moment = float(model.body_inertia[body].max())
            most = float(model.body_mass[body]) * _radius(model, body)**2
            if model.body_geomnum[body] and moment > max(_ABSURD_INERTIA * most, _SMALL_INERTIA):
                absurd[body] = moment / most
        if absurd:
            body, *others = sorted(absurd, key=lambda body: -absurd[body])
            mass, radius = float(model.body_mass[body]), _radius(model, body)
            likely = float(f'{0.4 * mass * radius**2:.2g}')
            names = [model.body(other).name for other in others]
            so_have = f'; so have {quoted_names(names, _LISTED)}' if names else ''
            name = str(model.body(body).name)
            remedies = self._remedies(name)
            yield StartDefect(
                'inertia', f"{remedies.body} '{name}' has a moment of inertia of "
                f'{model.body_inertia[body].max():.3g} kg m^2, but its mass of {mass:.3g} kg '
                f'within {1e3 * radius:.0f} mm of its centre of mass has '
                f'{mass * radius**2:.2g} kg m^2 at most{so_have}',
                f'write moments of some {likely:g} kg m^2, as '
                f'{remedies.inertia.format(moment=likely)}, or the true mass')


def _bodies_below(model: mujoco.MjModel, roots: list[int]) -> BoolArray:
    """Return which bodies are in the subtrees of some bodies, shape (nbody,)."""
    below = np.zeros(model.nbody, dtype=bool)
    below[roots] = True
    for body in range(1, model.nbody):
        below[body] |= below[model.body_parentid[body]]
    return below


def _span(model: mujoco.MjModel, data: mujoco.MjData, joint: int) -> float:
    """Return the difference between the accelerations by the full force in either direction."""
    dof, trial = int(model.jnt_dofadr[joint]), copy.copy(data)
    trial.qvel[:] = 0.0
    accelerations = []
    for sign in (1.0, -1.0):
        trial.qfrc_applied[dof] = data.qfrc_applied[dof] + sign * _full_force(model, joint)
        mujoco.mj_forward(model, trial)
        accelerations.append(trial.qacc[dof])
    return float(accelerations[0] - accelerations[1])


def _full_force(model: mujoco.MjModel, joint: int) -> float:
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    forces = [float(np.abs(model.actuator_forcerange[a] * model.actuator_gear[a, 0]).max())
              for a in range(model.nu) if model.actuator_forcelimited[a]
              and driven_joint(model, a) == model.joint(joint).name]
    inertia = model.dof_M0[model.jnt_dofadr[joint]]
    return max(forces, default=float(_TRIAL_ACCELERATION * inertia))


def _control_without_force(model: mujoco.MjModel, actuator: int, length: float) -> float | None:
    """Return the control in range at which a servo exerts no force at rest, or None."""
    if int(model.actuator_dyntype[actuator]) == _INTEGRATOR:
        return None
    constant, slope = model.actuator_biasprm[actuator, :2]
    control = float(-(constant + slope * length) / model.actuator_gainprm[actuator, 0])
    low, high = model.actuator_ctrlrange[actuator]
    limited = bool(model.actuator_ctrllimited[actuator])
    return control if not limited or low <= control <= high else None


def _radius(model: mujoco.MjModel, body: int) -> float:
    """Return how far the shapes, the origin and the children of a body are from its centre [m]."""
    centre = model.body_ipos[body]
    geoms = np.flatnonzero(model.geom_bodyid == body)
    distances = [float(np.linalg.norm(model.geom_pos[geom] - centre)) + float(
        model.geom_rbound[geom]) for geom in geoms]
    children = np.flatnonzero(model.body_parentid == body)
    distances += [float(np.linalg.norm(model.body_pos[child] - centre)) for child in children]
    return max([*distances, float(np.linalg.norm(centre)), _SMALL_M])
