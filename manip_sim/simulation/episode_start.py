# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The start of episodes: positions of joints, and values drawn from a seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
import threading
from typing import Any

import mujoco
import numpy as np

from manip_sim.algebra import wxyz_to_xyzw, xyzw_to_wxyz
from manip_sim.arrays import FloatArray
from manip_sim.control.surroundings import Surroundings
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.loading import compile_spec
from manip_sim.models.randomization import (
    draw_places, extents, GROUPS, OF_NODE, Randomization, RandomizationLike, Rule)
from manip_sim.models.world import World
from manip_sim.physics.parts import Part
from manip_sim.physics.physics import Physics
from manip_sim.physics.state_dependent_terms import Belts, FloatingBases
from manip_sim.quoting import format_value
from manip_sim.sensing.robot_sensing import RobotSensing
from manip_sim.sensing.sensor_noise import QUANTITIES
from manip_sim.simulation.robot_spawning import RobotsPlan
from manip_sim.validation import check_kind, mapping

#: Drawn values, by ``group/name/quantity``: a number or several, in SI units.
Sample = Mapping[str, Any]
#: By group: name of the kind of element in messages, its number for MuJoCo, and its count.
_KINDS = {
    'bodies': ('body', mujoco.mjtObj.mjOBJ_BODY, 'nbody'),
    'geoms': ('geom', mujoco.mjtObj.mjOBJ_GEOM, 'ngeom'),
    'joints': ('joint', mujoco.mjtObj.mjOBJ_JOINT, 'njnt'),
    'lights': ('light', mujoco.mjtObj.mjOBJ_LIGHT, 'nlight'),
    'cameras': ('cam', mujoco.mjtObj.mjOBJ_CAMERA, 'ncam')}
#: The field of a model that a quantity is, and its place in a row; None for the whole row.
_FIELDS: Mapping[tuple[str, str], tuple[str, int | None]] = {
    ('bodies', 'mass'): ('body_mass', None), ('bodies', 'position'): ('body_pos', None),
    ('bodies', 'orientation'): ('body_quat', None), ('geoms', 'friction'): ('geom_friction', 0),
    ('geoms', 'torsional_friction'): ('geom_friction', 1),
    ('geoms', 'rolling_friction'): ('geom_friction', 2), ('geoms', 'size'): ('geom_size', None),
    ('geoms', 'color'): ('geom_rgba', None), ('joints', 'damping'): ('dof_damping', None),
    ('joints', 'friction'): ('dof_frictionloss', None),
    ('joints', 'armature'): ('dof_armature', None), ('lights', 'position'): ('light_pos', None),
    ('lights', 'direction'): ('light_dir', None), ('lights', 'diffuse'): ('light_diffuse', None),
    ('lights', 'ambient'): ('light_ambient', None),
    ('lights', 'specular'): ('light_specular', None), ('cameras', 'position'): ('cam_pos', None),
    ('cameras', 'orientation'): ('cam_quat', None)}
#: Fields of a compiled model that depend on sizes of geoms.
_OF_SIZES = ('geom_aabb', 'geom_rbound', 'bvh_aabb', 'bvh_child', 'bvh_depth', 'bvh_nodeid',
             'body_mass', 'body_inertia', 'body_ipos', 'body_iquat')
#: Count of numbers of ``geom_size`` of a type of geom.
_NUMBERS = {'SPHERE': 1, 'CAPSULE': 2, 'CYLINDER': 2, 'ELLIPSOID': 3, 'BOX': 3}
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
#: Specs are not for several threads at once, and worlds that are reset together share one.
_ONE_SPEC = threading.Lock()
#: Duration of the simulation in which coupled joints settle at their start [s].
_SETTLE_S = 0.5


class Element:
    """
    The place of a quantity in a model.

    :param model: a ``mujoco.MjModel``
    :param key: ``group/name/quantity``
    :raises UnknownNameError: if the model has no such element
    """

    def __init__(self, model: mujoco.MjModel, key: str) -> None:
        self.group, self.name, self.quantity = split(key)
        noun, kind, _ = _KINDS[self.group]
        self.id = mujoco.mj_name2id(model, kind, self.name)
        if self.id < 0:
            raise UnknownNameError(noun, self.name, element_names(model)[self.group])
        self.field, self._place = _FIELDS[self.group, self.quantity]
        rows: Any = self.id
        if self.group == 'joints':
            first = int(model.jnt_dofadr[self.id])
            width = {_FREE: 6, int(mujoco.mjtJoint.mjJNT_BALL): 3}
            rows = slice(first, first + width.get(int(model.jnt_type[self.id]), 1))
        self._rows = rows
        self._count = (3 if self.quantity == 'color' else _sizes(model, self.id, self.name)
                       if self.quantity == 'size' else None)

    def read(self, model: mujoco.MjModel) -> FloatArray:
        """Return the value in a model, shape (n,); quaternions as w, x, y, z."""
        row = np.atleast_1d(np.asarray(getattr(model, self.field)[self._rows], dtype=float))
        if self.group == 'joints':  # A row for each degree of freedom; damping has more columns.
            return row.reshape(len(row), -1)[:1, 0].copy()
        if self._place is not None:
            return row[self._place:self._place + 1].copy()
        return row[:self._count].copy()

    def write(self, model: mujoco.MjModel, value: FloatArray) -> None:
        """Change the value in a model."""
        field = getattr(model, self.field)
        if self.group == 'joints':
            field[self._rows].reshape(field[self._rows].shape[0], -1)[:, 0] = value[0]
        elif self._place is not None:
            field[self._rows, self._place] = value[0]
        elif field.ndim == 1:
            field[self._rows] = value[0]
        else:
            field[self._rows, :len(value)] = value


def split(key: str) -> tuple[str, str, str]:
    """Return group, name and quantity of a drawn value; a setting has its name and no quantity."""
    check_kind(key, str, 'the name of a drawn value', 'text')
    group, _, rest = key.partition('/')
    if group == OF_NODE:
        return group, rest, ''
    name, _, quantity = rest.rpartition('/')
    if quantity not in GROUPS.get(group, {}):
        raise ModelError(f'nothing that is drawn is called {format_value(key)}')
    return group, name, quantity


def _sizes(model: mujoco.MjModel, geom: int, name: str) -> int:
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name[7:]
    if kind not in _NUMBERS:
        raise ModelError(f"geom '{name}' is a {kind.lower()}, whose size cannot be drawn; it can "
                         f'of {", ".join(known.lower() for known in _NUMBERS)}')
    return _NUMBERS[kind]


def element_names(model: mujoco.MjModel) -> dict[str, list[str]]:
    """Return the names of all elements of which something can be drawn, by group."""
    return {group: [mujoco.mj_id2name(model, kind, index) or ''
                    for index in range(getattr(model, count))]
            for group, (_, kind, count) in _KINDS.items()}


def apply_to_model(model: mujoco.MjModel, nominal: mujoco.MjModel, drawn: Sample,
                   before: Iterable[str] = ()) -> None:
    """
    Write drawn values to a model, and compute what MuJoCo derives from them.

    Sizes are written, but not what the compiler derives from them.

    :param model: a ``mujoco.MjModel``; elements that it does not have are left out
    :param nominal: the same model as it was compiled, with these sizes
    :param drawn: by ``group/name/quantity``
    :param before: what had been drawn, whose values become nominal first
    """
    keys = [key for key in dict.fromkeys([*before, *drawn]) if split(key)[0] != OF_NODE]
    if not keys:
        return
    for key in keys:
        try:
            element = Element(model, key)
        except UnknownNameError:  # An object that came or went since.
            continue
        value = np.atleast_1d(np.array(drawn[key], dtype=float)) if key in drawn else (
            element.read(nominal))
        if element.quantity == 'orientation' and key in drawn:
            value = xyzw_to_wxyz(value)
        if element.quantity == 'mass':
            mass = float(nominal.body_mass[element.id])
            if mass <= 0.0:
                continue
            model.body_inertia[element.id] = nominal.body_inertia[element.id] * (value[0] / mass)
        element.write(model, value)
    mujoco.mj_setConst(model, mujoco.MjData(model))


class DomainRandomizer:
    """
    The draws for the episodes of one simulation.

    :param given: the distributions; None for none
    :param physics: of the simulation
    :param sensing: of each robot, by its name
    :param lawful: joints whose dry friction follows a law of its own
    :raises ModelError: if a pattern matches nothing, or something cannot be drawn
    :ivar drawn: of the present episode, as it is replaced by each draw
    """

    def __init__(self, given: RandomizationLike | None, physics: Physics,
                 sensing: Mapping[str, RobotSensing], lawful: Iterable[str] = ()) -> None:
        self._physics = physics
        #: Begin of the names of the settings of each robot.
        self._begins = {robot: '' if len(sensing) == 1 else f'{robot}.' for robot in sensing}
        self._settings = {f'{self._begins[robot]}{name}': (of_robot, name)
                          for robot, of_robot in sensing.items() for name in QUANTITIES}
        self.drawn: Sample = {}
        self._seed = 0
        self._given = None if given is None else Randomization(given)
        if self._given is None:
            return
        lawful = set(lawful)
        for key, rule in self._given.resolve(self._names()).items():
            group, name, quantity = split(key)
            try:
                self._drawn_value(key, rule, 0, physics.plan.compiled)
            except (ModelError, KeyError) as error:
                raise ModelError(f'{rule.where}: {error}' if rule.where not in str(error)
                                 else str(error)) from None
            if (group, quantity) == ('joints', 'friction') and name in lawful:
                raise ModelError(f"{rule.where}: joint '{name}' has Stribeck friction, which "
                                 'cannot be drawn')

    def _names(self) -> dict[str, list[str]]:
        return {**element_names(self._physics.plan.compiled), OF_NODE: [*self._settings]}

    def _rules(self) -> dict[str, Rule]:
        return {} if self._given is None else self._given.resolve(self._names(), strict=False)

    @property
    def draws(self) -> bool:
        """True if anything is drawn at resets."""
        return self._given is not None

    def draw(self, seed: int) -> None:
        """
        Draw all for the episode of a seed, and change model and settings.

        :param seed: a whole number from 0
        """
        nominal = self._physics.plan.compiled
        drawn = {key: self._drawn_value(key, rule, seed, nominal)
                 for key, rule in self._rules().items()}
        self.set({**self._placed(nominal, seed), **drawn})
        self._seed = seed

    def _placed(self, nominal: mujoco.MjModel, seed: int) -> dict[str, Any]:
        """Return the poses of objects that are placed in areas; of those that still exist."""
        declared = () if self._given is None else self._given.placements
        there = set(self._physics.plan.object_names)
        areas = [replace(area, objects=tuple(name for name in area.objects if name in there))
                 for area in declared]
        names = [name for area in areas for name in area.objects]
        return {f'bodies/{name}/{quantity}': value.tolist() for name, (position, quat) in
                draw_places(areas, extents(nominal, names) if names else {}, seed).items()
                for quantity, value in (('position', position),
                                        ('orientation', wxyz_to_xyzw(quat)))}

    def _drawn_value(self, key: str, rule: Rule, seed: int, nominal: mujoco.MjModel,
                     pose: FloatArray | None = None) -> Any:
        """Return a drawn value as JSON can hold it; orientations as x, y, z, w."""
        draw = rule.draw(seed, key)
        if rule.group == OF_NODE:
            return float(rule.applied(np.zeros(1), draw)[0])
        element = Element(nominal, key)
        value = element.read(nominal) if pose is None else pose
        if element.quantity == 'orientation':
            value = wxyz_to_xyzw(_turned(value, rule.applied(np.zeros(3), draw)))
        else:
            value = rule.applied(value, draw)
        return value.tolist() if len(value) > 1 else float(value[0])

    def set(self, drawn: Sample) -> None:
        """
        Change model and settings to drawn values.

        :param drawn: by ``group/name/quantity``
        :raises ModelError: if something in it cannot be drawn
        """
        for key in mapping(drawn, 'what is drawn', "{'bodies/cube/mass': 0.1}"):
            split(key)
        physics, before = self._physics, self.drawn
        nominal = physics.plan.compiled
        if _sizes_in(before) or _sizes_in(drawn):
            nominal = _copy_sizes(physics.plan, physics.model, _sizes_in(drawn))
        self.drawn = dict(drawn)
        apply_to_model(physics.model, nominal, drawn, before)
        for key, value in drawn.items():
            group, name, _ = split(key)
            if group == OF_NODE and name in self._settings:
                sensing, quantity = self._settings[name]
                sensing.set(quantity, value)

    def replace_parameter(self, robot: str, name: str, value: float) -> None:
        """Let a value that was set by hand replace the drawn one, until the next draw."""
        key = f'{OF_NODE}/{self._begins.get(robot, "")}{name}'
        if key in self.drawn:
            self.drawn = {**self.drawn, key: float(value)}

    def _posed(self) -> Iterator[tuple[str, slice]]:
        """Yield the keys of drawn poses of free bodies, and where they are in ``qpos``."""
        model = self._physics.model
        for key in self.drawn:
            group, name, quantity = split(key)
            if group != 'bodies' or quantity == 'mass':
                continue
            body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            if body < 0 or not model.body_jntnum[body]:
                continue
            joint = int(model.body_jntadr[body])
            if int(model.jnt_type[joint]) == _FREE:
                begin, count = int(model.jnt_qposadr[joint]), 3
                if quantity == 'orientation':
                    begin, count = begin + 3, 4
                yield key, slice(begin, begin + count)

    def place(self, data: mujoco.MjData) -> None:
        """
        Put free bodies where they were drawn to be.

        :param data: changed; ``mj_forward`` is left to the caller
        """
        for key, places in self._posed():
            value = self.drawn[key]
            data.qpos[places] = value if key.endswith('/position') else xyzw_to_wxyz(value)

    def free_poses(self, data: mujoco.MjData) -> dict[str, FloatArray]:
        """Return present positions and orientations of free bodies that are drawn, by key."""
        return {key: data.qpos[places].copy() for key, places in self._posed()}

    def place_again(self, data: mujoco.MjData, before: Mapping[str, FloatArray], keeps: bool
                    ) -> None:
        """
        Draw the poses of free bodies that something else has placed since, from where they are.

        :param data: changed; ``mj_forward`` is left to the caller
        :param before: what :meth:`free_poses` has returned before that
        :param keeps: whether the poses that are known are to be taken instead of draws
        """
        if not keeps:
            rules = self._rules()
            self.drawn = {**self.drawn, **{
                key: self._drawn_value(key, rules[key], self._seed, self._physics.plan.compiled,
                                       here)
                for key, here in self.free_poses(data).items()
                if key in rules and not np.array_equal(here, before[key])}}
        self.place(data)


def _turned(quat_wxyz: FloatArray, by: FloatArray) -> FloatArray:
    """Return an orientation that is turned by a rotation vector in its own axes [rad]."""
    product, turn = np.empty(4), np.array([1.0, 0.0, 0.0, 0.0])
    mujoco.mju_quatIntegrate(turn, by, 1.0)
    mujoco.mju_mulQuat(product, quat_wxyz, turn)
    return product


def _sizes_in(drawn: Sample) -> dict[str, Sequence[float]]:
    return {split(key)[1]: np.atleast_1d(value).tolist() for key, value in drawn.items()
            if split(key)[::2] == ('geoms', 'size')}


def _copy_sizes(plan: Any, model: mujoco.MjModel, sizes: Mapping[str, Sequence[float]]
                ) -> mujoco.MjModel:
    """Let the compiler derive from sizes what it does; copy it to a model, and return all."""
    sized = plan.compiled
    if sizes:
        with _ONE_SPEC:
            spec = plan.spec.copy()
            for name, size in sizes.items():
                geom = spec.geom(name)
                if geom is not None:
                    geom.size[:len(size)] = size
            sized = compile_spec(spec, 'the world with the sizes that were drawn')
    if any(getattr(model, field).shape != getattr(sized, field).shape for field in _OF_SIZES):
        raise ModelError('the sizes that were drawn change the structure of the world')
    for field in ('geom_size', *_OF_SIZES):
        getattr(model, field)[:] = getattr(sized, field)
    return sized


def _settle(model: mujoco.MjModel, data: mujoco.MjData, disabled: int = 0) -> None:
    """Let couplings move their joints, without gravity; ``disabled`` are further flags."""
    gravity, flags = model.opt.gravity.copy(), model.opt.disableflags
    model.opt.gravity[:] = 0.0
    # Only the couplings matter here, not what a gripper overlaps.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | disabled
    mujoco.mj_step(model, data, round(_SETTLE_S / model.opt.timestep))
    model.opt.gravity[:], model.opt.disableflags = gravity, flags


def start_without_control(model: mujoco.MjModel, positions: Mapping[str, float]
                          ) -> mujoco.MjData:
    """
    Return the state at a start, at rest, with coupled joints where their couplings put them.

    It needs no controllers, so it is for parts alone and for robots that cannot be controlled.

    :param model: the compiled ``mujoco.MjModel``
    :param positions: of joints, by name [rad or m]; others are where the model has them
    """
    data = mujoco.MjData(model)
    for joint, position in positions.items():
        data.joint(joint).qpos = position
    if model.neq:
        _settle(model, data, int(mujoco.mjtDisableBit.mjDSBL_ACTUATION))
        settled = data.qpos.copy()
        mujoco.mj_resetData(model, data)
        data.qpos[:] = settled
    mujoco.mj_forward(model, data)
    return data


class EpisodeStart:
    """
    The start to which resets return.

    :param world: that has it
    :param physics: of the world
    :param surroundings: which are held where they start
    :param floating_bases: of the robots
    :param belts: which run at their speed at the start
    :ivar positions: of joints, by name [rad or m]
    :ivar seed: that the present episode was drawn from
    :ivar randomized: the draws for the present episode
    """

    def __init__(self, world: World, physics: Physics, surroundings: Surroundings,
                 floating_bases: FloatingBases, belts: Belts) -> None:
        self.world, self._physics, self._belts = world, physics, belts
        self._surroundings, self._floating_bases = surroundings, floating_bases
        self.positions = world.init_qpos()
        self.seed = world.seed
        self.randomized = DomainRandomizer(None, physics, {})
        self._keyframe, self._changes = world.keyframe, False
        #: Keyframe and draws, and where couplings then put the joints of grippers.
        self._settled: tuple[str, Sample, dict[str, float]] | None = None

    def randomize(self, sensing: Mapping[str, RobotSensing]) -> None:
        """
        Let episodes draw what the ``randomization`` of the world says.

        :param sensing: of each robot, by name
        """
        self.randomized = DomainRandomizer(
            self.world.randomization, self._physics, sensing,
            [name for robot in self.world.robots for name, law in robot.friction_laws.items()
             if np.isfinite(law.stribeck_velocity)])

    @property
    def keyframe(self) -> str:
        """
        Keyframe of a file that joints start from, from the next reset on; empty: none.

        :raises UnknownNameError: if it is set to one that no part of the world has
        """
        return self._keyframe

    @keyframe.setter
    def keyframe(self, name: str) -> None:
        self._keyframe, self._changes = self.world.checked_keyframe(name), True

    @property
    def settings(self) -> tuple[str, bool]:
        """The keyframe, and whether the next reset uses another one than the last."""
        return self._keyframe, self._changes

    @settings.setter
    def settings(self, settings: tuple[str, bool]) -> None:
        self.keyframe, self._changes = settings

    def draw(self, seed: int | None) -> dict[str, float] | None:
        """
        Return where joints are at the next reset, by name [rad or m]; None: where they were.

        :param seed: of their noise; None keeps the present one
        :raises ModelError: if the seed is not a whole number from 0
        """
        if seed is None and not self._changes:
            return None
        return self.world.init_qpos(self.seed if seed is None else seed, self._keyframe)

    def begin(self, seed: int, positions: dict[str, float] | None) -> None:
        """
        Begin an episode at drawn positions.

        :param seed: of the episode
        :param positions: as :meth:`draw` has returned
        """
        self.seed, self._changes = seed, False
        if positions is not None:
            self.positions = positions

    def change_robots(self, plan: RobotsPlan) -> None:
        """Take over where the robots start that come, and forget those that go."""
        self.positions = {joint: position for joint, position in
                          {**self.positions, **plan.start}.items() if joint in plan.joints}
        self._settled = None

    def place(self) -> None:
        """Put all joints, objects and the surroundings to the start."""
        model, data = self._physics.model, self._physics.data
        mujoco.mj_resetData(model, data)
        for joint, position in self.positions.items():
            data.joint(joint).qpos[0] = position
            self._surroundings.hold(joint, position)
        self._belts.begin(data)
        self.randomized.place(data)
        mujoco.mj_forward(model, data)
        self._surroundings.hold_actuators()
        self._floating_bases.apply()

    def settle(self, grippers: Iterable[Part], reset: Callable[[], None]) -> None:
        """
        Make the start of grippers satisfy their couplings.

        A declared start may violate them; great forces would correct it in the first steps. The
        noise of the start does not move grippers, so the start without it is simulated, and again
        only when the keyframe, the draws or the robots have changed.

        :param reset: brings all to the start, at rest
        """
        model, data = self._physics.model, self._physics.data
        if not model.neq + model.ntendon:
            return
        keyframe, drawn = self._keyframe, self.randomized.drawn
        if self._settled is None or self._settled[0] != keyframe or self._settled[1] is not drawn:
            positions, self.positions = self.positions, self.world.exact_qpos(keyframe)
            reset()
            _settle(model, data)
            self.positions = positions
            self._settled = keyframe, drawn, {
                joint: position for part in grippers for joint, position in zip(
                    part.joints, data.qpos[part.qpos_addresses].tolist())}
        self.positions.update(self._settled[2])
