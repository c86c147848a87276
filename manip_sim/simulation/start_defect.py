# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Defects of the start of robots, found before anything moves, and their remedies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import copy
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray
from manip_sim.models.actuators import (
    actuated_joints, effort_range, JointCouplings, joints_between, moved_joints, position_servos)
from manip_sim.models.robots.robot_model import driven_joint
from manip_sim.quoting import quoted_names


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
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


def check_start(model: mujoco.MjModel, data: mujoco.MjData, roots: Iterable[str]) -> list[str]:
    """
    Return the defects of the start of robots, a sentence for each.

    The parameters are as for :func:`find_start_defects`.
    """
    return [defect.text for defect in find_start_defects(model, data, roots)]


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
    of_robots = _bodies_below(model, [model.body(root).id for root in roots])
    contacts = [contact for contact in data.contact if min(contact.geom) >= 0
                and of_robots[model.geom_bodyid[contact.geom]].any()]
    joints = [joint for joint in _actuated_joints(model) if of_robots[model.jnt_bodyid[joint]]]
    return [*_overlaps(model, contacts, of_robots, urdf),
            *_blocked(model, data, contacts, joints, of_robots, urdf), *_held(model, joints),
            *_out_of_range(model, data, of_robots, urdf),
            *find_drive_defects(model, data, of_robots, urdf),
            *_inertias(model, of_robots, urdf)]


def _bodies_below(model: mujoco.MjModel, roots: list[int]) -> BoolArray:
    """Return which bodies are in the subtrees of some bodies, shape (nbody,)."""
    below = np.zeros(model.nbody, dtype=bool)
    below[roots] = True
    for body in range(1, model.nbody):
        below[body] |= below[model.body_parentid[body]]
    return below


def _actuated_joints(model: mujoco.MjModel) -> list[int]:
    """Return the scalar joints that actuators act on."""
    joints = [joint for a in range(model.nu) for joint in actuated_joints(model, a)]
    return [joint for joint in dict.fromkeys(joints) if int(model.jnt_type[joint]) in _SCALAR]


def _overlaps(model: mujoco.MjModel, contacts: list[Any], of_robots: BoolArray,
              urdf: tuple[str, ...]) -> Iterator[StartDefect]:
    deepest: dict[tuple[int, ...], Any] = {}
    for contact in sorted(contacts, key=lambda contact: float(contact.dist)):
        if contact.dist < -_TOUCHING_M:
            deepest.setdefault(tuple(sorted(model.geom_bodyid[contact.geom].tolist())), contact)
    for contact in deepest.values():
        # The geom farther from the robot's root is reported as inside the one nearer to it.
        outer, inner = sorted(contact.geom, key=lambda geom: (
            bool(of_robots[model.geom_bodyid[geom]]), int(model.geom_bodyid[geom])))
        yield StartDefect(
            'overlap', f'{_geom(model, inner, urdf)} starts {-1e3 * contact.dist:.1f} mm inside '
            f'{_geom(model, outer, urdf)}', _apart(model, inner, outer, of_robots, urdf))


def _apart(model: mujoco.MjModel, inner: int, outer: int, of_robots: BoolArray,
           urdf: tuple[str, ...]) -> str:
    """Return the remedy for a geom of a robot that overlaps another geom."""
    bodies = [int(model.geom_bodyid[geom]) for geom in (outer, inner)]
    other, body = (model.body(index).name for index in bodies)
    if not of_robots[bodies[0]]:
        return (f"place the robot elsewhere (its position, or base_xpos_offset), or move '{other}'"
                ', or start in another pose')
    remedies = remedies_for(body, urdf)
    if len(joints_between(model, *bodies)) < 2:
        # Geoms of neighbours often overlap at their common joint.
        return remedies.exclusion(other, body)
    return (f'start in another pose ({remedies.pose}), or mount the part farther out, or make the '
            'shapes smaller')


def _blocked(model: mujoco.MjModel, data: mujoco.MjData, contacts: list[Any], joints: list[int],
             of_robots: BoolArray, urdf: tuple[str, ...]) -> Iterator[StartDefect]:
    trial = copy.copy(model) if contacts else model
    for joint in joints:
        moved = _bodies_below(model, [int(model.jnt_bodyid[joint])])
        against = [contact for contact in contacts
                   if moved[model.geom_bodyid[contact.geom]].sum() == 1]
        if not against or not _is_blocked(model, trial, data, joint):
            continue
        contact = min(against, key=lambda contact: float(contact.dist))
        # The message names the geom that does not move with the joint.
        mover, neighbour = sorted(
            contact.geom, key=lambda geom: not moved[model.geom_bodyid[geom]])
        yield StartDefect(
            'blocked', f"joint '{model.joint(joint).name}' starts blocked by "
            f'{_geom(model, neighbour, urdf)}', _apart(model, mover, neighbour, of_robots, urdf))


def _held(model: mujoco.MjModel, joints: list[int]) -> Iterator[StartDefect]:
    """Yield a defect if equality constraints hold joints in place that actuators drive."""
    held = model.eq_obj1id[(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT))
                           & (model.eq_active0 != 0) & (model.eq_obj2id < 0)]
    names = [str(model.joint(joint).name) for joint in joints if joint in held]
    if names:
        yield StartDefect(
            'blocked', f'equality constraints hold in place what actuators drive: joints '
            f'{quoted_names(names)}', 'write active="false" in these <joint> of <equality>, or '
            'leave the actuators out')


def _is_blocked(model: mujoco.MjModel, trial: Any, data: mujoco.MjData, joint: int) -> bool:
    """
    Return whether contacts hardly let the full force move a joint, forwards or backwards.

    :param trial: a copy of the model to try it with, changed in place
    """
    trial.dof_armature[:], trial.opt.disableflags = model.dof_armature, model.opt.disableflags
    scalar = np.flatnonzero(np.isin(model.jnt_type, _SCALAR)).tolist()
    together = JointCouplings(model, scalar).group(joint)
    held = np.ones(model.nv, dtype=bool)
    held[[model.jnt_dofadr[j] for j in together]] = False
    inertia = model.dof_M0[model.jnt_dofadr[joint]]
    trial.dof_armature[held] += _HELD * np.maximum(model.dof_M0[held], inertia)
    # Contacts are as soft as the bodies are free, and an arm beyond a hand is not here.
    mujoco.mj_setConst(trial, copy.copy(data))
    trial.opt.noslip_iterations = 0  # They do not converge beside what is held.
    with_contacts = _span(trial, data, joint)
    trial.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return with_contacts < _BLOCKED * _span(trial, data, joint)


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


def _out_of_range(model: mujoco.MjModel, data: mujoco.MjData, of_robots: BoolArray,
                  urdf: tuple[str, ...]) -> Iterator[StartDefect]:
    for joint in range(model.njnt):
        if (not of_robots[model.jnt_bodyid[joint]] or int(model.jnt_type[joint]) not in _SCALAR
                or not model.jnt_limited[joint]):
            continue
        low, high = model.jnt_range[joint]
        name = model.joint(joint).name
        position = float(data.qpos[model.jnt_qposadr[joint]])
        beyond = max(low - position, position - high)
        if beyond > _AT_END * (high - low):
            hinge = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
            yield StartDefect(
                'range', f"joint '{name}' starts at {position:.4g} "
                f'{"rad" if hinge else "m"}, {beyond:.4g} outside its range of {low:.4g} to '
                f'{high:.4g}',
                f'write a value from {low:.4g} to {high:.4g} for it into '
                f'{remedies_for(name, urdf).pose}, or {remedies_for(name, urdf).wider_range()}')


def _inertias(model: mujoco.MjModel, of_robots: BoolArray, urdf: tuple[str, ...]
              ) -> Iterator[StartDefect]:
    """Yield the moving links whose moments of inertia no body of their mass and size can have."""
    absurd: dict[int, float] = {}
    for body in np.flatnonzero(of_robots & (np.asarray(model.body_weldid) != 0)).tolist():
        moment = float(model.body_inertia[body].max())
        most = float(model.body_mass[body]) * _radius(model, body)**2
        if model.body_geomnum[body] and moment > max(_ABSURD_INERTIA * most, _SMALL_INERTIA):
            absurd[body] = moment / most
    if absurd:
        body, *others = sorted(absurd, key=lambda body: -absurd[body])
        mass, radius = float(model.body_mass[body]), _radius(model, body)
        likely = float(f'{0.4 * mass * radius**2:.2g}')
        so_have = f'; so have {quoted_names([model.body(other).name for other in others], 8)}'
        name = str(model.body(body).name)
        remedies = remedies_for(name, urdf)
        yield StartDefect(
            'inertia', f"{remedies.body} '{name}' has a moment of inertia of "
            f'{model.body_inertia[body].max():.3g} kg m^2, but its mass of {mass:.3g} kg within '
            f'{1e3 * radius:.0f} mm of its centre of mass has {mass * radius**2:.2g} kg m^2 at '
            f'most{so_have if others else ""}',
            f'write moments of some {likely:g} kg m^2, as {remedies.inertia(likely)}, or the '
            'true mass')


def _radius(model: mujoco.MjModel, body: int) -> float:
    """Return how far the shapes, the origin and the children of a body are from its centre [m]."""
    centre = model.body_ipos[body]
    geoms = np.flatnonzero(model.geom_bodyid == body)
    distances = [float(np.linalg.norm(model.geom_pos[geom] - centre)) + float(
        model.geom_rbound[geom]) for geom in geoms]
    children = np.flatnonzero(model.body_parentid == body)
    distances += [float(np.linalg.norm(model.body_pos[child] - centre)) for child in children]
    return max([*distances, float(np.linalg.norm(centre)), _SMALL_M])


def _geom(model: mujoco.MjModel, geom: int, urdf: tuple[str, ...]) -> str:
    body = model.body(model.geom_bodyid[geom]).name
    return remedies_for(body, urdf).shape(model.geom(geom).name, body)


class MjcfRemedies:
    """Remedies in an MJCF file."""

    #: Place of the pose at the start, and what a body is called.
    pose, body = 'init_qpos, or the keyframe', 'body'

    def shape(self, geom: str, body: str) -> str:
        """Return what a geom is called."""
        return f"geom '{geom}' of body '{body}'"

    def exclusion(self, first: str, other: str) -> str:
        """Return how two bodies are kept from colliding."""
        return f'write <exclude body1="{first}" body2="{other}"/> into <contact>'

    def drive(self, joints: list[str]) -> str:
        """Return how joints get what they lack, an actuator."""
        return (f'write <motor joint="{joints[0]}" ctrlrange="-LIMIT LIMIT"/> into <actuator>, '
                'with the torque limit [N m or N]'
                + ('' if len(joints) == 1 else ', and so for each of them')
                + '; a body that must not move needs no <joint>')

    def limit(self, effort: float) -> str:
        """
        Return how a joint gets a higher effort limit.

        :param effort: that is enough [N m or N]
        """
        return (f'write a higher limit, such as actuatorfrcrange="{-effort:g} {effort:g}" on the '
                'joint, and so forcerange or ctrlrange of the actuator where they are lower')

    def wider_range(self) -> str:
        """Return how a joint gets a wider range."""
        return 'give the joint a wider range'

    def inertia(self, moment: float) -> str:
        """
        Return how a body gets a moment of inertia.

        :param moment: the same about all axes [kg m^2]
        """
        return f'diaginertia="{moment:g} {moment:g} {moment:g}" of its <inertial>'


class UrdfRemedies(MjcfRemedies):
    """Remedies in a URDF file, or in the SRDF and the YAML file beside it."""

    pose, body = "init_qpos, or 'start' in the YAML file", 'link'

    def shape(self, geom: str, body: str) -> str:
        """Return what a geom is called: shapes of a URDF have no names."""
        return f"a collision shape of link '{body}'"

    def exclusion(self, first: str, other: str) -> str:
        """Return how two links are kept from colliding."""
        return (f'write <disable_collisions link1="{first}" link2="{other}" reason="Never"/> into '
                'the SRDF of the same name beside the URDF')

    def drive(self, joints: list[str]) -> str:
        """Return what joints without an actuator are to be: a URDF has none."""
        return ('write type="fixed" if the joint must not move, or <mimic joint="..."/> if '
                'another one drives it')

    def limit(self, effort: float) -> str:
        """Return how a joint gets a higher effort limit."""
        return (f'write a higher limit, such as <limit effort="{effort:g}" .../>, for the joint; '
                'efforts: guess in the YAML file replaces limits that are placeholders')

    def wider_range(self) -> str:
        """Return how a joint gets a wider range."""
        return 'give the joint a wider range, by lower and upper of its <limit>'

    def inertia(self, moment: float) -> str:
        """
        Return how a link gets a moment of inertia.

        :param moment: the same about all axes [kg m^2]
        """
        return (f'<inertia ixx="{moment:g}" iyy="{moment:g}" izz="{moment:g}" ixy="0" ixz="0" '
                'iyz="0"/>')


def remedies_for(name: str, urdf: tuple[str, ...]) -> MjcfRemedies:
    """
    Return the remedies for an element.

    :param urdf: what the names of elements from URDF files begin with
    """
    return UrdfRemedies() if urdf and name.startswith(urdf) else MjcfRemedies()


#: A force nearer to its limit than this fraction of it is at the limit.
_AT_LIMIT = 1e-6
#: Number of names that one sentence lists.
_LISTED = 8
_FREE, _HINGE = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_HINGE)
_BALL = int(mujoco.mjtJoint.mjJNT_BALL)
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)


def find_drive_defects(model: mujoco.MjModel, data: mujoco.MjData, of_robots: BoolArray,
                       urdf: tuple[str, ...] = ()) -> Iterator[StartDefect]:
    """
    Yield the defects of the actuators of robots.

    :param model: the compiled ``mujoco.MjModel``
    :param data: the ``mujoco.MjData`` at the start, after ``mj_forward``; only read
    :param of_robots: whether each body is of a robot, shape (nbody,)
    :param urdf: what the names of elements from URDF files begin with
    """
    joints = [joint for joint in np.flatnonzero(of_robots[model.jnt_bodyid]).tolist()
              if int(model.jnt_type[joint]) != _FREE]
    drivers = _drivers(model, joints)
    yield from _shared(model, drivers)
    yield from _undriven(model, joints, urdf)
    alone = {joint: actuators[0] for joint, actuators in drivers.items() if len(actuators) == 1
             and int(model.jnt_type[joint]) != _BALL}
    weak = list(_too_weak(model, data, alone, urdf))
    yield from (defect for _, defect in weak)
    yield from _at_full_force(model, data, set(joints), {joint for joint, _ in weak})


def _drivers(model: mujoco.MjModel, joints: list[int]) -> dict[int, list[int]]:
    """Return the actuators that act on each joint alone, not through a tendon or a site."""
    drivers: dict[int, list[int]] = {}
    for actuator in range(model.nu):
        driven = actuated_joints(model, actuator)
        if driven_joint(model, actuator) is not None and driven[0] in joints:
            drivers.setdefault(driven[0], []).append(actuator)
    return drivers


def _shared(model: mujoco.MjModel, drivers: dict[int, list[int]]) -> Iterator[StartDefect]:
    for joint, actuators in drivers.items():
        if len(actuators) > 1:
            names = [model.actuator(actuator).name for actuator in actuators]
            yield StartDefect(
                'actuators', f"joint '{model.joint(joint).name}' is driven by {len(names)} "
                f'actuators, {quoted_names(names)}',
                f'leave one of them in <actuator>: delete {quoted_names(names[1:])}')


def _undriven(model: mujoco.MjModel, joints: list[int], urdf: tuple[str, ...]
              ) -> Iterator[StartDefect]:
    moved = moved_joints(model)
    names = [model.joint(joint).name for joint in joints if joint not in moved]
    if names:
        is_single = len(names) == 1
        yield StartDefect(
            'undriven', f'{"joint" if is_single else "joints"} {quoted_names(names, _LISTED)} '
            f'{"has" if is_single else "have"} no actuator, and no spring or coupling to a joint '
            f'that has one: nothing holds {"it" if is_single else "them"}',
            remedies_for(names[0], urdf).drive(names))


def _too_weak(model: mujoco.MjModel, data: mujoco.MjData, drivers: dict[int, int],
              urdf: tuple[str, ...]) -> Iterator[tuple[int, StartDefect]]:
    """Yield the joints whose actuator cannot hold the start pose, and their defects."""
    if not drivers:
        return
    joints, actuators = np.array(list(drivers)), np.array(list(drivers.values()))
    dofs = model.jnt_dofadr[joints]
    at_rest = copy.copy(data)
    at_rest.qvel[:] = 0.0
    mujoco.mj_forward(model, at_rest)
    needed = at_rest.qfrc_bias[dofs] - at_rest.qfrc_passive[dofs]
    # Gravity compensation by the actuators counts against the force limit of the joint alone.
    beside = (model.jnt_actgravcomp[joints] != 0) & (model.jnt_actfrclimited[joints] == 0)
    needed -= np.where(beside, at_rest.qfrc_gravcomp[dofs], 0.0)
    limits = effort_range(model, joints, actuators)
    excess = np.maximum(limits[:, 0] - needed, needed - limits[:, 1])
    for index in np.flatnonzero(excess > _AT_LIMIT * np.abs(needed)).tolist():
        joint, limit = int(joints[index]), limits[index]
        effort, name = float(needed[index]), model.joint(joint).name
        there = limit[1] if effort > 0.0 else limit[0]
        unit = _unit(model, joint)
        enough, remedies = float(f'{1.1 * abs(effort):.2g}'), remedies_for(name, urdf)
        yield joint, StartDefect(
            'effort', f"joint '{name}' needs {effort:.4g} {unit} to keep its start pose, its "
            f"actuator '{model.actuator(int(actuators[index])).name}' has {there:.4g} {unit}",
            f'start where the joint carries less ({remedies.pose}), or {remedies.limit(enough)}')


def _at_full_force(model: mujoco.MjModel, data: mujoco.MjData, joints: set[int], reported: set[int]
                   ) -> Iterator[StartDefect]:
    """Yield the servos whose control is so far from the start that they exert their full force."""
    is_servo = (model.actuator_forcelimited != 0) & position_servos(model, np.arange(model.nu))
    for actuator in np.flatnonzero(is_servo).tolist():
        driven = actuated_joints(model, actuator)
        if not joints.intersection(driven) or reported.intersection(driven):
            continue
        force = float(data.actuator_force[actuator])
        limit = model.actuator_forcerange[actuator]
        if not (np.abs(limit - force) <= _AT_LIMIT * np.abs(limit)).any() or force == 0.0:
            continue
        name, unit = model.actuator(actuator).name, _unit(model, driven[0])
        there = _control_without_force(model, actuator, float(data.actuator_length[actuator]))
        yield StartDefect(
            'effort', f"actuator '{name}' starts with its full force of {force:.4g} {unit}: its "
            f'control is {float(data.ctrl[actuator]):.4g}'
            + ('' if there is None else f', at {there:.4g} it would exert none'),
            ('' if there is None else f'write {there:.4g} for it into ctrl of the keyframe, or ')
            + 'start the joint where the control holds it')


def _control_without_force(model: mujoco.MjModel, actuator: int, length: float) -> float | None:
    """Return the control in range at which a servo exerts no force at rest, or None."""
    if int(model.actuator_dyntype[actuator]) == _INTEGRATOR:
        return None
    constant, slope = model.actuator_biasprm[actuator, :2]
    control = float(-(constant + slope * length) / model.actuator_gainprm[actuator, 0])
    low, high = model.actuator_ctrlrange[actuator]
    limited = bool(model.actuator_ctrllimited[actuator])
    return control if not limited or low <= control <= high else None


def _unit(model: mujoco.MjModel, joint: int) -> str:
    return 'N m' if int(model.jnt_type[joint]) in (_HINGE, _BALL) else 'N'
