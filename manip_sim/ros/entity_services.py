# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The services of ``simulation_interfaces`` that list, describe, measure and move entities."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import Vector3
import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

from manip_sim.errors import CommandError
from manip_sim.physics.entities import Box, EntityState, Sphere
from manip_sim.physics.poses_and_twists import Pose, Twist
from manip_sim.quoting import one_line, quoted
from manip_sim.ros.feature import NodeContext
from manip_sim.ros.messages import filled, import_optional, numbers_of, stamp_of, WORLD
from manip_sim.ros.simulation_interfaces_messages import (
    answering, BoundsType, Category, change_unless_diverged, Rejection, ResultCode, SetEntityCode,
    StandardTypes, TagsMode)

re2 = import_optional('re2')
#: Of a regular expression, as a program and as a text; RE2 takes long for thousands of brackets.
_MAX_FILTER_BYTES, _MAX_FILTER_LENGTH = 2**20, 1000
#: Longest description of an entity, most tags and longest tag, so that requests cannot fill the
#: memory.
_MAX_DESCRIPTION, _MAX_TAGS, _MAX_TAG = 10_000, 100, 200


@dataclass(frozen=True)
class _Info:
    """Information about an entity that a client has set, or by default its kind."""

    category: int
    description: str = ''
    tags: tuple[str, ...] = ()


class EntityServices:
    """
    The services that list robots and objects, describe and measure them, and move free ones.

    :param types: the message types of the package
    """

    def __init__(self, context: NodeContext, types: StandardTypes) -> None:
        self._simulation, self._thread = context.simulation, context.thread
        self._messages = types.messages
        #: Information that clients have set, by the name of the entity.
        self._infos: dict[str, _Info] = {}
        # A group of their own: a request for many steps, in another group, does not hold them up.
        types.offer(context.node, {name: answering(fill) for name, fill in {
            'GetEntities': self._get_entities, 'GetEntitiesStates': self._get_states,
            'GetEntityInfo': self._get_info, 'SetEntityInfo': self._set_info,
            'GetEntityBounds': self._get_bounds, 'GetEntityState': self._get_entity_state,
            'SetEntityState': self._set_entity_state}.items()},
            MutuallyExclusiveCallbackGroup())

    def forget_gone(self) -> None:
        """Forget the set information of entities that are gone."""
        there = self._simulation.entities.names
        self._infos = {name: info for name, info in self._infos.items() if name in there}

    def _info(self, name: str) -> _Info:
        is_free = self._simulation.entities.is_free(name)
        return self._infos.get(name) or _Info(int(
            Category.CATEGORY_OBJECT if is_free else Category.CATEGORY_ROBOT))

    def _get_entities(self, request: Any, response: Any) -> None:
        response.entities = self._thread.call(partial(
            self._overlapping, _region(request.filters.bounds), self._candidates(request.filters)))

    def _get_states(self, request: Any, response: Any) -> None:
        """Answer with the states of one instant."""
        region, names = _region(request.filters.bounds), self._candidates(request.filters)
        simulation = self._simulation

        def read() -> tuple[int, dict[str, EntityState]]:
            return simulation.time_ns, {
                name: simulation.entities.read(simulation.data, name)
                for name in self._overlapping(region, names)}
        time_ns, states = self._thread.call(read)
        response.entities = list(states)
        response.states = [_fill_state(self._messages.EntityState(), time_ns, state)
                           for state in states.values()]

    def _candidates(self, filters: Any) -> list[str]:
        """Return the entities that filters but for bounds let pass."""
        categories = {category.category for category in filters.categories}
        return matching(filters.filter, [
            name for name in self._simulation.entities.names
            if (not categories or self._info(name).category in categories)
            and has_tags(self._info(name).tags, filters.tags)])

    def _overlapping(self, region: Box | Sphere | None, names: list[str]) -> list[str]:
        """Return the entities whose bounds overlap a region; in the simulation's thread."""
        if region is None:
            return names
        entities, data = self._simulation.entities, self._simulation.data
        return [name for name in names
                if (box := entities.bounds(data, name, in_world=True)) and region.overlaps(box)]

    def _get_info(self, request: Any, response: Any) -> None:
        info = self._info(request.entity)
        response.info.category.category = info.category
        response.info.description, response.info.tags = info.description, list(info.tags)

    def _set_info(self, request: Any, _: Any) -> None:
        self._info(request.entity)  # There is such an entity.
        info = request.info
        category, tags = int(info.category.category), tuple(info.tags)
        if category not in list(Category):
            raise Rejection(ResultCode.RESULT_OPERATION_FAILED, f'there is no category {category}'
                            f', only {", ".join(f"{c.name} ({c.value})" for c in Category)}')
        if (len(info.description) > _MAX_DESCRIPTION or len(tags) > _MAX_TAGS
                or any(len(tag) > _MAX_TAG for tag in tags)):
            raise Rejection(ResultCode.RESULT_OPERATION_FAILED, 'a description may have '
                            f'{_MAX_DESCRIPTION} characters, and an entity {_MAX_TAGS} tags of '
                            f'{_MAX_TAG} characters')
        self._infos[request.entity] = _Info(category, info.description, tags)

    def _get_bounds(self, request: Any, response: Any) -> None:
        simulation = self._simulation
        box = self._thread.call(
            lambda: simulation.entities.bounds(simulation.data, request.entity))
        if box is not None:
            response.bounds.type = int(BoundsType.TYPE_BOX)
            response.bounds.points = [filled(Vector3(), box.high), filled(Vector3(), box.low)]

    def _get_entity_state(self, request: Any, response: Any) -> None:
        name, simulation = request.entity, self._simulation
        _fill_state(response.state, *self._thread.call(
            lambda: (simulation.time_ns, simulation.entities.read(simulation.data, name))))

    def _set_entity_state(self, request: Any, response: Any) -> None:
        name = request.entity
        if not self._simulation.entities.is_free(name):
            raise Rejection(ResultCode.RESULT_OPERATION_FAILED,
                            f"'{request.entity}' cannot be moved, only free bodies can")
        if request.state.header.frame_id not in ('', WORLD):
            raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED,
                            f"frame_id '{request.state.header.frame_id}' is not supported: leave "
                            f"it empty or write '{WORLD}'")
        pose, twist = _parts(request)

        change_unless_diverged(self._simulation, self._thread, partial(
            self._thread.change, 'place', name, pose and _listed(pose.position, pose.quat_xyzw),
            twist and _listed(twist.linear, twist.angular)))


def has_tags(tags: Collection[str], wanted: Any) -> bool:
    """
    Return whether tags pass a filter.

    :param wanted: a ``TagsFilter``, which without tags lets everything pass
    :raises Rejection: if its mode is not known
    """
    if wanted.filter_mode not in list(TagsMode):
        raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED, f'tags: filter_mode '
                        f'{wanted.filter_mode} is not supported, only ANY (0) and ALL (1)')
    every = all if wanted.filter_mode == TagsMode.FILTER_MODE_ALL else any
    return not wanted.tags or every(tag in tags for tag in wanted.tags)


def _region(bounds: Any) -> Box | Sphere | None:
    """
    Return the region in ``world`` that bounds describe; None for empty bounds.

    :raises Rejection: if they are of a type that is not supported, or no region
    """
    kind = bounds.type
    if kind == BoundsType.TYPE_EMPTY:
        return None
    if kind not in (BoundsType.TYPE_BOX, BoundsType.TYPE_SPHERE):
        raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED, f'bounds of type {kind} are not '
                        'supported in filters, only EMPTY (0), BOX (1) and SPHERE (3)')
    points = np.array([numbers_of(point) for point in bounds.points]).reshape(-1, 3)
    name = 'a box' if kind == BoundsType.TYPE_BOX else 'a sphere'
    if len(points) != 2:
        raise Rejection(ResultCode.RESULT_OPERATION_FAILED,
                        f'bounds: {name} has 2 points, got {len(points)}')
    if not np.isfinite(points if kind == BoundsType.TYPE_BOX else points.ravel()[:4]).all():
        raise Rejection(ResultCode.RESULT_OPERATION_FAILED,
                        f'bounds: the numbers of {name} must be finite, got {points.tolist()}')
    if kind == BoundsType.TYPE_BOX:
        return Box(points.min(axis=0), points.max(axis=0))
    if points[1, 0] < 0.0:
        raise Rejection(ResultCode.RESULT_OPERATION_FAILED, 'bounds: the radius of a sphere must '
                        f'not be negative, got {points[1, 0]:g}')
    return Sphere(points[0], float(points[1, 0]))


def _fill_state(message: Any, time_ns: int, state: EntityState) -> Any:
    message.header.stamp, message.header.frame_id = stamp_of(time_ns), WORLD
    for part, numbers in (
            (message.pose, (state.pose.position, state.pose.quat_xyzw)),
            (message.twist, (state.twist.linear, state.twist.angular)),
            (message.acceleration, (state.linear_acceleration, state.angular_acceleration))):
        filled(part, np.concatenate(numbers))
    return message


def _listed(*vectors: Any) -> list[list[float]]:
    return [vector.tolist() for vector in vectors]


def _parts(request: Any) -> tuple[Pose | None, Twist | None]:
    """Return pose and twist to set, or None; version 1 of the standard has no flags, sets both."""
    state = request.state
    set_pose, set_twist = (getattr(request, flag, True) for flag in ('set_pose', 'set_twist'))
    pose = twist = None
    if not (set_pose or set_twist):
        raise Rejection(ResultCode.RESULT_OPERATION_FAILED, 'nothing to set: set_pose and '
                        'set_twist are false, and an acceleration cannot be set')
    if set_pose:
        try:
            pose = Pose.checked(*map(numbers_of, (state.pose.position, state.pose.orientation)))
        except CommandError as error:
            raise Rejection(SetEntityCode.INVALID_POSE, str(error)) from error
    if set_twist:
        twist = Twist.checked(numbers_of(state.twist.linear), numbers_of(state.twist.angular))
    return pose, twist


def matching(pattern: str, names: list[str]) -> list[str]:
    """
    Return the names in which a POSIX Extended regular expression matches.

    RE2 searches in a time that grows with the length of the names, unlike Python's ``re``.

    :raises Rejection: if it is none or too large, or RE2 is not installed
    """
    if not pattern:
        return names
    if re2 is None:
        raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED,
                        f'filter {quoted(pattern)}: regular expressions need the package '
                        "google-re2: pip install 'manip_sim[filters]'")
    options = re2.Options()
    options.posix_syntax, options.log_errors, options.max_mem = True, False, _MAX_FILTER_BYTES
    try:
        if len(pattern) > _MAX_FILTER_LENGTH:
            raise ValueError(f'longer than {_MAX_FILTER_LENGTH} characters')
        expression = re2.compile(pattern, options)
    except (re2.error, ValueError) as error:  # A text that is not UTF-8 raises ValueError.
        reason = error.args[0].decode() if type(error) is re2.error else error
        raise Rejection(ResultCode.RESULT_OPERATION_FAILED,
                        f'filter {quoted(pattern)}: {one_line(str(reason))}') from error
    return [name for name in names if expression.search(name) is not None]
