# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A task by a description, such as a YAML file, in place of a class."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import math
from typing import Any, NoReturn

import mujoco
import numpy as np

from manip_sim.algebra import length
from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.arenas import Arena, create_arena
from manip_sim.models.composing import DEFAULT, Gripper, Grippers, Robot
from manip_sim.models.object_creation import Description
from manip_sim.quoting import quoted
from manip_sim.simulation import Simulation
from manip_sim.tasks.grasping import bodies_of_gripper, held_only_by, speed, touching
from manip_sim.tasks.placing import add_goal, draw, draw_yaw, move_mocap, nearness, place
from manip_sim.tasks.task import Task
from manip_sim.tasks.task_description import (
    Condition, Contact, Described, Distance, END_EFFECTOR, GRIPPER, Held, InBox, JointInRange,
    Speed, Start)

#: Number of draws of a start until all things are apart.
_TRIES = 1000
_ONE_AXIS = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
#: Width of a turn that is drawn at once [rad].
_PIECE_RAD = math.pi / 2.0


class DescribedTask(Task, registered=False):
    """
    A task by a description.

    :raises ModelError: if the robot cannot do it, or a name is not in the world
    """

    def __init__(self, description: Described, robot: Robot = 'Panda',
                 gripper: Gripper | Grippers = DEFAULT, **composition: Any) -> None:
        self._described, about = description, description.about
        # What classes of tasks have, this task has of its own.
        own: dict[str, Any] = {
            'name': about.name, 'instruction': about.instruction, 'horizon_s': about.horizon,
            'needs_fingers': about.grasps, 'own_gripper': about.gripper}
        vars(self).update(own)
        super().__init__(robot, gripper, **composition)
        self.arguments['description'] = description.values
        self._terms = [*description.success, *description.terms]
        self._check_names()

    def arena(self) -> Arena:
        """Return the arena with the goals."""
        about = self._described.about
        given: dict[str, Any] = (
            {'name': about.arena} if isinstance(about.arena, str) else {**about.arena})
        if not isinstance(given.get('name'), str):
            self._reject("'arena' needs 'name', that of an arena")
        name = given.pop('name')
        if name == 'table':
            given.setdefault('cube', False)
        try:
            arena = create_arena(name, **given)
        except TypeError as error:
            raise ModelError(f'{self._described.where}: arena: {error}') from None
        for goal in self._described.goals:
            if arena.spec.body(goal.name) is not None:
                self._reject(f'goal {quoted(goal.name)}: there is a body of this name already')
            add_goal(arena, goal.name, goal.radius, goal.flat)
        return arena

    def objects(self) -> Iterable[Description]:
        """Return the objects."""
        return self._described.objects

    # ------------------------------------------------------------------ names

    def _reject(self, reason: str) -> NoReturn:
        raise ModelError(f'{self._described.where}: {reason}')

    def _check_names(self) -> None:
        """Reject names that are not in the world, with the nearest ones."""
        model = self.world.compile(visual=True)
        bodies = _names(model, mujoco.mjtObj.mjOBJ_BODY)
        things = [END_EFFECTOR, *bodies, *_names(model, mujoco.mjtObj.mjOBJ_SITE)]
        joints = [name for name in _names(model, mujoco.mjtObj.mjOBJ_JOINT)
                  if int(model.joint(name).type[0]) in _ONE_AXIS]
        for term in self._terms:
            if isinstance(term, Distance):
                self._known('body or site', term.distance, things)
            elif isinstance(term, InBox):
                self._known('body or site', [term.position], things)
            elif isinstance(term, Contact):
                self._known('body', term.contact, [GRIPPER, *bodies])
            elif isinstance(term, Held):
                self._known('body', [term.held], bodies)
            elif isinstance(term, JointInRange):
                self._known('joint of one axis', [term.joint], joints)
            elif isinstance(term, Speed):
                self._known('body', [term.speed], bodies)
        movable = [name for name in bodies if model.body(name).mocapid[0] >= 0
                   or _is_free(model, model.body(name).id)]
        self._known('object, goal or joint', self._described.starts, [*movable, *joints])
        for key, start in self._described.starts.items():
            if (key in joints) == isinstance(start.position.low, list):
                self._reject(f'start of {quoted(key)}: position must be '
                             + ('one number [m or rad]' if key in joints else 'x, y, z [m]'))
            if key in joints:
                self._check_range(model.joint(key), key, start)
            if isinstance(start.yaw.low, list):
                self._reject(f'start of {quoted(key)}: yaw must be one number [rad]')
        self._joints = {key for key in self._described.starts if key in joints}

    def _check_range(self, joint: Any, key: str, start: Start) -> None:
        low, high = joint.range
        if bool(joint.limited) and not low <= start.position.low <= start.position.high <= high:
            self._reject(f'start of {quoted(key)}: position must be from {low:g} to {high:g}, the '
                         f'range of the joint, got {start.position.low:g} to '
                         f'{start.position.high:g}')

    def _known(self, kind: str, names: Iterable[str], available: list[str]) -> None:
        for name in names:
            if name not in available:
                self._reject(str(UnknownNameError(kind, name, available)))

    # ------------------------------------------------------------------ an episode

    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """Draw and place what the description has under ``start``."""
        starts = self._described.starts
        for _ in range(_TRIES):
            drawn = {key: draw(random, np.atleast_1d(start.position.low),
                               np.atleast_1d(start.position.high))
                     for key, start in starts.items()}
            if self._apart([drawn[key] for key in starts if key not in self._joints]):
                break
        else:
            self._reject(f'none of {_TRIES} starts has all things apart by '
                         f'{self._described.about.apart:g} m')
        for key, start in starts.items():
            if key in self._joints:
                simulation.data.joint(key).qpos[0] = drawn[key][0]
                continue
            quat = _turned(random, start)
            if simulation.model.body(key).mocapid[0] >= 0:
                move_mocap(simulation, key, drawn[key], quat)
            else:
                place(simulation, key, drawn[key], quat)

    def _apart(self, points: list[FloatArray]) -> bool:
        least = self._described.about.apart
        return all(length(points[i][:2] - points[j][:2]) >= least
                   for i in range(len(points)) for j in range(i))

    def success(self, simulation: Simulation) -> bool:
        """Return whether all conditions hold."""
        return all(self._lack(simulation, term) == 0.0 for term in self._described.success)

    def progress(self, simulation: Simulation) -> float:
        """Return how nearly the conditions hold, their weighted mean; 0 if rewards are sparse."""
        if self._described.about.reward == 'sparse':
            return 0.0
        total = sum(term.weight * nearness(self._lack(simulation, term)) for term in self._terms)
        return total / sum(term.weight for term in self._terms)

    def goal(self, simulation: Simulation) -> FloatArray:
        """Return where the goals are, in ``world`` [m], shape (3 n,)."""
        return np.array([simulation.data.body(goal.name).xpos
                         for goal in self._described.goals]).ravel()

    def expert(self, simulation: Simulation) -> NoReturn:
        """Raise: a description has no expert."""
        self._reject('a task by a description has no expert: give a policy')

    def _lack(self, simulation: Simulation, term: Condition) -> float:
        """Return by how much a condition does not hold [m, rad or m/s]; 0.0 if it does."""
        return float(_LACKS[type(term)](self, simulation, term))

    def _where(self, simulation: Simulation, name: str) -> FloatArray:
        """Return the position of a body, site or the end effector in ``world`` [m], a copy."""
        if name == END_EFFECTOR:
            return self._end_effector(simulation)
        model, data = simulation.model, simulation.data
        is_body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) >= 0
        return np.array((data.body if is_body else data.site)(name).xpos)

    def _distance(self, simulation: Simulation, term: Distance) -> float:
        one, other = (self._where(simulation, name) for name in term.distance)
        far = length((one - other)[['xyz'.index(axis) for axis in term.axes]])
        return 0.0 if far < term.below else max(far - term.below, 1e-9)

    def _position(self, simulation: Simulation, term: InBox) -> float:
        here = self._where(simulation, term.position)
        return length(np.maximum(np.maximum(np.array(term.low) - here,
                                            here - np.array(term.high)), 0.0))

    def _contact(self, simulation: Simulation, term: Contact) -> float:
        robot, names = simulation.robot, sorted(term.contact, key=lambda name: name == GRIPPER)
        others = (bodies_of_gripper(simulation, robot, self.arm) if names[1] == GRIPPER
                  else {simulation.model.body(names[1]).id})
        touches = bool(touching(simulation, names[0]) & others)
        return 0.0 if touches == term.touch else 1.0

    def _held(self, simulation: Simulation, term: Held) -> float:
        return 0.0 if held_only_by(simulation, term.held, simulation.robot, self.arm) else 1.0

    def _joint(self, simulation: Simulation, term: JointInRange) -> float:
        here = float(simulation.data.joint(term.joint).qpos[0])
        return max(term.low - here, here - term.high, 0.0)

    def _speed(self, simulation: Simulation, term: Speed) -> float:
        fast = speed(simulation, term.speed)
        return 0.0 if fast < term.below else max(fast - term.below, 1e-9)


_LACKS: dict[type[Condition], Callable[[Any, Simulation, Any], float]] = {
    Distance: DescribedTask._distance, InBox: DescribedTask._position,
    Contact: DescribedTask._contact, Held: DescribedTask._held, JointInRange: DescribedTask._joint,
    Speed: DescribedTask._speed}


def _turned(random: np.random.Generator, start: Start) -> FloatArray:
    """Return the turn about z of a start, as a quaternion w, x, y, z."""
    low, high = start.yaw.low, start.yaw.high
    pieces = max(1, math.ceil((high - low) / _PIECE_RAD))
    half = (high - low) / pieces / 2.0
    # One of equal pieces, and the turn within, which is evenly distributed only if it is small.
    piece = min(int(random.random() * pieces), pieces - 1)
    middle = low + (2 * piece + 1) * half
    first = np.array([math.cos(middle / 2.0), 0.0, 0.0, math.sin(middle / 2.0)])
    found: FloatArray = np.empty(4)
    mujoco.mju_mulQuat(found, first, draw_yaw(random, half))
    return found


def _names(model: mujoco.MjModel, kind: Any) -> list[str]:
    count = {mujoco.mjtObj.mjOBJ_BODY: model.nbody, mujoco.mjtObj.mjOBJ_SITE: model.nsite,
             mujoco.mjtObj.mjOBJ_JOINT: model.njnt}[kind]
    names = (mujoco.mj_id2name(model, kind, index) for index in range(count))
    return [name for name in names if name]


def _is_free(model: mujoco.MjModel, body: int) -> bool:
    first = int(model.body_jntadr[body])
    return first >= 0 and int(model.jnt_type[first]) == int(mujoco.mjtJoint.mjJNT_FREE)
