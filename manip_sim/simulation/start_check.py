# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find defects of the start of robots, before anything moves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import copy
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray
from manip_sim.models.couplings import JointCouplings
from manip_sim.models.mechanism import actuated_joints, joints_between
from manip_sim.models.robots.subsystems import driven_joint
from manip_sim.quoting import quoted_names
from manip_sim.simulation.start_defect import StartDefect
from manip_sim.simulation.start_drives import find_drive_defects
from manip_sim.simulation.start_remedies import remedies_for

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
    Find overlaps, blocked joints, joints outside their range, drive defects and absurd inertias.

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
            *_blocked(model, data, contacts, joints, of_robots, urdf),
            *_out_of_range(model, data, of_robots, urdf),
            *find_drive_defects(model, data, of_robots, urdf), *_inertias(model, of_robots)]


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


def _inertias(model: mujoco.MjModel, of_robots: BoolArray) -> Iterator[StartDefect]:
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
        yield StartDefect(
            'inertia', f"body '{model.body(body).name}' has a moment of inertia of "
            f'{model.body_inertia[body].max():.3g} kg m^2, but its mass of {mass:.3g} kg within '
            f'{1e3 * radius:.0f} mm of its centre of mass has {mass * radius**2:.2g} kg m^2 at '
            f'most{so_have if others else ""}',
            f'write moments of some {likely:g} kg m^2, as <inertia ixx="{likely:g}" '
            f'iyy="{likely:g}" izz="{likely:g}" ixy="0" ixz="0" iyz="0"/> of a URDF or '
            f'diaginertia="{likely:g} {likely:g} {likely:g}" of MJCF, or the true mass')


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
