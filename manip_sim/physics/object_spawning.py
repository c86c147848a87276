# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Add objects to a running world, and delete them, with everything else as it was.

Nothing here changes its arguments. Making a plan compiles the new world, which may take a while
and may be done in another thread; :func:`carry_over` then copies the state, which is quick.
"""

from __future__ import annotations

from collections.abc import Iterable
import copy
from dataclasses import dataclass
from typing import Any

import mujoco

from manip_sim.errors import UnknownNameError
from manip_sim.models.loading import compile_spec
from manip_sim.models.object_creation import check_object_names, ObjectModel
from manip_sim.models.spec_edits import TakenNames
from manip_sim.physics.state_transfer import carry_data, carry_edits, ElementMap
from manip_sim.quoting import quoted_names


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


def plan_without(plan: WorldPlan, name: str) -> WorldPlan:
    """
    Return the plan of a world without one of its objects.

    :raises UnknownNameError: if it is not the name of an object
    """
    if name not in plan.object_names:
        raise UnknownNameError('object', name, plan.object_names)
    left = tuple(item for item in plan.objects if item.name != name)
    gone = plan.objects[plan.object_names.index(name)]
    spec = plan.spec.copy()
    taken = plan.taken.copy(spec)
    if not gone.detach(spec, taken):
        spec, taken = _composed(plan.base, left)
    return _follow(plan, left, spec, taken, f"the world without '{name}'")


def start_live(plan: WorldPlan) -> LiveWorld:
    """Return a world at its start."""
    model = copy.copy(plan.compiled)
    return LiveWorld(plan, model, mujoco.MjData(model))


def in_common(live: LiveWorld, plan: WorldPlan) -> ElementMap:
    """Return the elements that a running world has in common with the world of a plan."""
    both = plan.since
    if both is None or not both.begins_with(live.plan.compiled):
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
