# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Add objects to a running world, and delete them, with everything else as it was.

Nothing here changes its arguments. Making a plan compiles the new world, which may take a while
and may be done in another thread; :func:`carry_over` then copies the state, which is quick. The
arrays to copy between two models, and the kind of element that each row is for, are taken from
``mujoco.introspect``, so that arrays of later versions of MuJoCo are copied too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
import copy
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any
import weakref

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, IntArray
from manip_sim.errors import UnknownNameError
from manip_sim.models.loading import compile_spec
from manip_sim.models.object_creation import check_object_names, ObjectModel
from manip_sim.models.spec_edits import TakenNames
from manip_sim.quoting import quoted_names

#: Sizes of a model whose elements have names, and what stands for them in ``name_*adr``.
_NAMED = {
    'nbody': 'body', 'njnt': 'jnt', 'ngeom': 'geom', 'nsite': 'site', 'ncam': 'cam',
    'nlight': 'light', 'nflex': 'flex', 'nmesh': 'mesh', 'nskin': 'skin', 'nhfield': 'hfield',
    'ntex': 'tex', 'nmat': 'mat', 'npair': 'pair', 'nexclude': 'exclude', 'neq': 'eq',
    'ntendon': 'tendon', 'nsensor': 'sensor', 'nnumeric': 'numeric', 'ntext': 'text',
    'ntuple': 'tuple', 'nplugin': 'plugin'}
#: Numbers of positions and velocities of a joint that is not scalar.
_QPOS_OF_JOINT = {int(mujoco.mjtJoint.mjJNT_FREE): 7, int(mujoco.mjtJoint.mjJNT_BALL): 4}
_DOFS_OF_JOINT = {int(mujoco.mjtJoint.mjJNT_FREE): 6, int(mujoco.mjtJoint.mjJNT_BALL): 3}
#: Kinds of elements that equalities connect whose ``eq_objtype`` does not say it.
_ENDS = {int(mujoco.mjtEq.mjEQ_JOINT): int(mujoco.mjtObj.mjOBJ_JOINT),
         int(mujoco.mjtEq.mjEQ_TENDON): int(mujoco.mjtObj.mjOBJ_TENDON)}
#: Return where the rows of each element of a model begin, and how many there are.
Spans = Callable[[Any], tuple[IntArray, IntArray]]
#: Compiled from the element's own tree, but rounded differently if there is another tree.
_DERIVED = frozenset((
    'body_invweight0', 'dof_invweight0', 'tendon_invweight0', 'dof_M0', 'actuator_acc0'))
#: Of ``mujoco.MjData``, what ``mj_forward`` does not compute; objects have no plugins, delays or
#: plastic joints, so their arrays are the same before and after.
_STATE = ('qpos', 'qvel', 'act', 'history', 'plastic', 'qacc_warmstart', 'plugin_state', 'ctrl',
          'qfrc_applied', 'xfrc_applied', 'eq_active', 'mocap_pos', 'mocap_quat', 'userdata')


@dataclass(frozen=True)
class WorldPlan:
    """
    A world with its objects, compiled.

    :ivar base: ``mujoco.MjSpec`` of arena and robots, without objects
    :ivar objects: in the order of the world
    :ivar spec: ``mujoco.MjSpec`` of the whole world
    :ivar taken: the names in it
    :ivar compiled: its ``mujoco.MjModel``, which is never changed
    :ivar since: what it has in common with the plan that it was made from, or None
    """

    base: Any
    objects: tuple[ObjectModel, ...]
    spec: mujoco.MjSpec
    taken: TakenNames
    compiled: mujoco.MjModel
    since: ElementMap | None = None

    @property
    def object_names(self) -> list[str]:
        """The names of the objects."""
        return [item.name for item in self.objects]


@dataclass(frozen=True)
class LiveWorld:
    """
    A running world.

    :ivar plan: what it was compiled from
    :ivar model: the ``mujoco.MjModel``, a copy of the plan's that may have been changed since
    :ivar data: the ``mujoco.MjData``
    """

    plan: WorldPlan
    model: mujoco.MjModel
    data: mujoco.MjData


def plan_world(base: Any, objects: tuple[ObjectModel, ...], name: str = 'world') -> WorldPlan:
    """
    Compile a world with objects.

    :param base: ``mujoco.MjSpec`` of arena and robots, such as ``World.compose(objects=False)``;
        not changed
    :param objects: all objects, in order
    :param name: of the world, for messages
    :raises ModelError: if names collide or MuJoCo cannot compile it
    """
    check_object_names(objects)
    spec, taken = _composed(base, objects)
    return WorldPlan(base, tuple(objects), spec, taken, compile_spec(spec, name))


def _composed(base: Any, objects: Iterable[ObjectModel]) -> tuple[Any, TakenNames]:
    spec = base.copy()
    taken = TakenNames(spec)
    for item in objects:
        item.attach(spec, taken)
    return spec, taken


def compile_visual(plan: WorldPlan) -> Any:
    """
    Return the ``mujoco.MjModel`` of a plan with the geoms that cannot collide.

    It has the same bodies, joints and cameras, and so the same positions.

    :raises ModelError: with MuJoCo's message, if MuJoCo cannot compile it
    """
    base = plan.base.copy()
    base.compiler.discardvisual = False
    return compile_spec(_composed(base, plan.objects)[0], 'the world with its visual shapes')


def plan_with(plan: WorldPlan, *items: ObjectModel) -> WorldPlan:
    """
    Return the plan of a world with more objects, which come last in their order.

    Compiling takes as long for many as for one.

    :raises ModelError: if a name is taken already or MuJoCo cannot compile it
    """
    objects = (*plan.objects, *items)
    check_object_names(objects)
    spec = plan.spec.copy()
    taken = plan.taken.copy(spec)
    for item in items:
        item.attach(spec, taken)
    return _follow(plan, objects, spec, taken,
                   f'the world with {quoted_names([item.name for item in items], 3)}')


def _follow(plan: WorldPlan, objects: tuple[ObjectModel, ...], spec: Any, taken: TakenNames,
            name: str) -> WorldPlan:
    compiled = compile_spec(spec, name)
    return WorldPlan(plan.base, objects, spec, taken, compiled,
                     ElementMap(plan.compiled, compiled))


def plan_without(plan: WorldPlan, *names: str) -> WorldPlan:
    """
    Return the plan of a world without some of its objects.

    :raises UnknownNameError: if one is not the name of an object
    """
    for name in names:
        if name not in plan.object_names:
            raise UnknownNameError('object', name, plan.object_names)
    left = tuple(item for item in plan.objects if item.name not in names)
    spec = plan.spec.copy()
    taken = plan.taken.copy(spec)
    if not all(item.detach(spec, taken) for item in plan.objects if item.name in names):
        spec, taken = _composed(plan.base, left)
    return _follow(plan, left, spec, taken, f'the world without {quoted_names(names, 3)}')


def start_live(plan: WorldPlan) -> LiveWorld:
    """Return a world at its start."""
    model = copy.copy(plan.compiled)
    return LiveWorld(plan, model, mujoco.MjData(model))


def in_common(live: LiveWorld, plan: WorldPlan) -> ElementMap:
    """Return the elements that a running world has in common with the world of a plan."""
    both = plan.since
    if both is None or both.old() is not live.plan.compiled:
        both = ElementMap(live.plan.compiled, plan.compiled)
    return both


def carry_over(live: LiveWorld, plan: WorldPlan, both: ElementMap | None = None) -> LiveWorld:
    """
    Return the world of another plan in the state of a running one.

    The state of common elements stays bit for bit: positions, velocities, activations, controls,
    applied forces, warm start, time, and all numbers of the model and its options that were
    changed after compiling. New objects are at their start. All of the data belongs to the same
    instant, as after ``mj_forward``.

    Later steps, too, give the same bits as without the change, unless constraints connect all
    moving trees of one of the two worlds, as for a robot alone: MuJoCo then solves them at once
    instead of island by island, and the results differ by rounding.

    :param live: not changed
    :param plan: of the same arena
    :param both: as :func:`in_common` returns it; None: found here
    """
    model = copy.copy(plan.compiled)
    both = both or in_common(live, plan)
    carry_edits(live.plan.compiled, live.model, model, both)
    data = mujoco.MjData(model)
    carry_data(live.data, data, both)
    mujoco.mj_forward(model, data)
    return LiveWorld(plan, model, data)


def spawn(live: LiveWorld, *items: ObjectModel) -> LiveWorld:
    """
    Return the world with more objects and everything else as it is.

    :param live: not changed
    :raises ModelError: if a name is taken already or MuJoCo cannot compile it
    """
    return carry_over(live, plan_with(live.plan, *items))


def delete(live: LiveWorld, name: str) -> LiveWorld:
    """
    Return the world without one of its objects and everything else as it is.

    :param live: not changed
    :raises UnknownNameError: if it is not the name of an object
    """
    return carry_over(live, plan_without(live.plan, name))


class ElementMap:
    """
    The elements that two models have in common.

    Elements of one kind are the same if they have the same name. Those without a name are matched
    in order, by what they belong to: a body, or what a constraint connects.

    :param old: a ``mujoco.MjModel``
    :param new: another one
    """

    def __init__(self, old: Any, new: Any) -> None:
        for struct in ('mjModel', 'mjData'):
            _arrays(struct)  # Slow the first time, and not while the physics waits.
        #: The first model, weakly.
        self.old = weakref.ref(old)
        self._places: dict[str, tuple[IntArray, IntArray]] = {}
        for size, kind in _NAMED.items():
            self._add(size, _keys(old, kind), _keys(new, kind))
        self._add_parts(old, new, 'njnt', 'nq', _spans_of_joints('qpos', _QPOS_OF_JOINT))
        self._add_parts(old, new, 'njnt', 'nv', _spans_of_joints('dof', _DOFS_OF_JOINT))
        # Several controls of one actuator came with MuJoCo 4.
        actuators = 'nactuator' if hasattr(old, 'nactuator') else 'nu'
        self._add(actuators, _keys(old, 'actuator'), _keys(new, 'actuator'))
        self._add_parts(old, new, actuators, 'na', _spans_of_actuators('act'))
        if actuators != 'nu':
            self._add_parts(old, new, actuators, 'nu', _spans_of_actuators('ctrl'))
            self._add_parts(old, new, actuators, 'nout', _spans_of_actuators('out'))
        self._add_parts(old, new, 'nbody', 'nmocap', _mocap_of_body)

    def _add(self, size: str, old: list[Any], new: list[Any]) -> None:
        place = {key: index for index, key in enumerate(new)}
        both = [(index, place[key]) for index, key in enumerate(old) if key in place]
        pairs = np.array(both, dtype=np.int64).reshape(-1, 2)
        self._places[size] = pairs[:, 0], pairs[:, 1]

    def _add_parts(self, old: Any, new: Any, whole: str, size: str, spans: Spans) -> None:
        rows, new_rows = self._places[whole]
        (first, count), (new_first, new_count) = spans(old), spans(new)
        counts = np.minimum(count[rows], new_count[new_rows])
        within = np.arange(counts.sum()) - np.repeat(counts.cumsum() - counts, counts)
        self._places[size] = (np.repeat(first[rows], counts) + within,
                              np.repeat(new_first[new_rows], counts) + within)

    def rows(self, size: str, old: Any, new: Any) -> tuple[IntArray, IntArray]:
        """
        Return the rows of two arrays that belong to the same elements.

        :param size: name of the size that counts the rows, such as ``nbody``; rows of sizes that
            are not known here, such as ``nmeshvert``, are matched in order
        """
        if size in self._places:
            return self._places[size]
        same = np.arange(min(len(old), len(new)))
        return same, same


def carry_edits(compiled: mujoco.MjModel, edited: Any, target: Any, both: ElementMap) -> None:
    """
    Apply the edits of one model to another one.

    :param compiled: the ``mujoco.MjModel`` before the edits
    :param edited: the same model after them
    :param target: the model to change; it gets the options and statistics of the edited one
    :param both: the elements that are in the edited model and in the target
    """
    for name, size in _arrays('mjModel').items():
        before, after = getattr(compiled, name), getattr(edited, name)
        if not isinstance(after, np.ndarray) or not after.size or (
                name not in _DERIVED and before.tobytes() == after.tobytes()):
            continue
        other = getattr(target, name)
        old, new = both.rows(size, after, other)
        if name not in _DERIVED:
            differs: BoolArray = (before != after).reshape(len(after), -1).any(axis=1)
            old, new = old[differs[old]], new[differs[old]]
        # An array of user data is as wide as that of the element with most of them.
        width: tuple[Any, ...] = tuple(
            slice(min(n, m)) for n, m in zip(other.shape[1:], after.shape[1:]))
        other[(new, *width)] = after[(old, *width)]
    for group in ('opt', 'vis', 'stat'):
        _copy_fields(getattr(edited, group), getattr(target, group))


@lru_cache(maxsize=2)
def _arrays(struct: str) -> dict[str, str]:
    """Return the name of the size that counts the rows of each array, such as ``nbody``."""
    from mujoco.introspect import structs  # It is large, and only needed to change objects.
    bound = getattr(mujoco, struct[:1].upper() + struct[1:])
    sizes: dict[str, str] = {}
    for field in structs.STRUCTS[struct].fields:
        extent: Any = getattr(field, 'array_extent', None)
        if extent and isinstance(extent[0], str) and hasattr(bound, field.name):
            sizes[field.name] = extent[0]
    return sizes


def _copy_fields(source: Any, target: Any) -> None:
    struct: Any = type(source)
    for name in _fields(struct):
        value = getattr(source, name)
        if isinstance(value, np.ndarray):
            getattr(target, name)[...] = value
        elif isinstance(value, (bool, int, float)):
            setattr(target, name, value)
        else:
            _copy_fields(value, getattr(target, name))


@cache
def _fields(struct: type) -> tuple[str, ...]:
    return tuple(name for name in dir(struct) if not (
        name.startswith('_') or callable(getattr(struct, name))))


def carry_data(source: Any, target: Any, both: ElementMap) -> None:
    """
    Copy the state of a simulation and its counts of warnings.

    :param source: the ``mujoco.MjData`` to copy from
    :param target: the ``mujoco.MjData`` of another model, at its start
    :param both: the elements that are in both models
    """
    target.time = source.time
    sizes = _arrays('mjData')
    for name in _STATE:
        if name in sizes:
            old, new = both.rows(sizes[name], getattr(source, name), getattr(target, name))
            getattr(target, name)[new] = getattr(source, name)[old]
    for before, after in zip(source.warning, target.warning):
        after.number, after.lastinfo = before.number, before.lastinfo


def _keys(model: mujoco.MjModel, kind: str) -> list[Any]:
    """Return the name of each element of a kind, or its owner and its number there."""
    addresses, names = getattr(model, f'name_{kind}adr').tolist(), model.names
    unnamed: Counter[Any] = Counter()
    keys = []
    for index, address in enumerate(addresses):
        key: Any = names[address:names.index(b'\0', address)]
        if not key:
            owner = _owner(model, kind, index)
            key = owner, unnamed[owner]
            unnamed[owner] += 1
        keys.append(key)
    return keys


def _owner(model: mujoco.MjModel, kind: str, index: int) -> Any:
    """Return what an element without a name belongs to, by name."""
    if kind == 'eq':
        kind_of_ends = _ENDS.get(int(model.eq_type[index]), int(model.eq_objtype[index]))
        return int(model.eq_type[index]), *(
            mujoco.mj_id2name(model, kind_of_ends, int(ids[index]))
            for ids in (model.eq_obj1id, model.eq_obj2id))
    bodies = getattr(model, f'{kind}_bodyid', None)
    return None if bodies is None else model.body(int(bodies[index])).name


def _spans_of_joints(array: str, widths: dict[int, int]) -> Spans:
    def spans(model: mujoco.MjModel) -> tuple[IntArray, IntArray]:
        return getattr(model, f'jnt_{array}adr'), np.array(
            [widths.get(kind, 1) for kind in model.jnt_type.tolist()], dtype=np.int64)
    return spans


def _spans_of_actuators(array: str) -> Spans:
    def spans(model: mujoco.MjModel) -> tuple[IntArray, IntArray]:
        return (getattr(model, f'actuator_{array}adr'),
                np.maximum(getattr(model, f'actuator_{array}num'), 0))
    return spans


def _mocap_of_body(model: mujoco.MjModel) -> tuple[IntArray, IntArray]:
    return model.body_mocapid, (model.body_mocapid >= 0).astype(np.int64)
