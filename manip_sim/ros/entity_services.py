# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``GetEntities``, ``GetEntityState`` and ``SetEntityState`` of ``simulation_interfaces``."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Point, Quaternion, Vector3
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from manip_sim.errors import CommandError
from manip_sim.quoting import quoted
from manip_sim.ros.messages import stamp_of, WORLD
from manip_sim.ros.posix_ere import PosixExpression
from manip_sim.ros.rejection import answering, Rejection
from manip_sim.ros.standard_codes import BoundsType, Category, ResultCode, SetEntityCode
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import Simulation
from manip_sim.simulation.poses import Pose, Twist


class EntityServices:
    """
    The services that list robots and objects, return their poses and move free ones.

    :param simulation: what has the entities
    :param types: of the services, as ``simulation_interfaces.srv`` has them
    """

    def __init__(self, node: Node, simulation: Simulation, thread: SimulationThread, types: Any
                 ) -> None:
        self._simulation = simulation
        self._thread = thread
        # A group of their own: a request for many steps, in another group, does not hold them up.
        group = MutuallyExclusiveCallbackGroup()
        for service_type, name, fill in (
                (types.GetEntities, 'get_entities', self._get_entities),
                (types.GetEntityState, 'get_entity_state', self._get_entity_state),
                (types.SetEntityState, 'set_entity_state', self._set_entity_state)):
            node.create_service(service_type, f'~/{name}', answering(fill), callback_group=group)

    def _get_entities(self, request: Any, response: Any) -> None:
        filters = request.filters
        if filters.tags.tags:
            raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED, 'entities have no tags')
        if filters.bounds.type != BoundsType.TYPE_EMPTY:
            raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED, 'entities have no bounds')
        wanted = {category.category for category in filters.categories}
        response.entities = _matching(filters.filter, [
            name for name in self._simulation.entities.names
            if not wanted or self._category(name) in wanted])

    def _category(self, name: str) -> int:
        return int(Category.CATEGORY_OBJECT if self._simulation.entities.is_free(name)
                   else Category.CATEGORY_ROBOT)

    def _get_entity_state(self, request: Any, response: Any) -> None:
        name, simulation = request.entity, self._simulation
        time_ns, state = self._thread.call(
            lambda: (simulation.time_ns, self._simulation.entities.read(simulation.data, name)))
        message = response.state
        message.header.stamp, message.header.frame_id = stamp_of(time_ns), WORLD
        message.pose.position = _filled(Point(), state.pose.position)
        message.pose.orientation = _filled(Quaternion(), state.pose.quat_xyzw)
        message.twist.linear = _filled(Vector3(), state.twist.linear)
        message.twist.angular = _filled(Vector3(), state.twist.angular)
        message.acceleration.linear = _filled(Vector3(), state.linear_acceleration)
        message.acceleration.angular = _filled(Vector3(), state.angular_acceleration)

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

        def place() -> None:
            if self._simulation.diverged is not None:
                raise Rejection(ResultCode.RESULT_INCORRECT_STATE,
                                f'{self._simulation.diverged}; reset it first')
            self._thread.change('place', name, pose and _listed(pose.position, pose.quat_xyzw),
                                twist and _listed(twist.linear, twist.angular))
        self._thread.call(place)


def _filled(message: Any, values: Any) -> Any:
    for field, value in zip(message.get_fields_and_field_types(), values.tolist()):
        setattr(message, field, value)
    return message


def _numbers(message: Any) -> list[float]:
    return [getattr(message, field) for field in message.get_fields_and_field_types()]


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
            pose = Pose.checked(_numbers(state.pose.position), _numbers(state.pose.orientation))
        except CommandError as error:
            raise Rejection(SetEntityCode.INVALID_POSE, str(error)) from error
    if set_twist:
        twist = Twist.checked(_numbers(state.twist.linear), _numbers(state.twist.angular))
    return pose, twist


def _matching(pattern: str, names: list[str]) -> list[str]:
    """Return the names in which a POSIX Extended regular expression matches."""
    if not pattern:
        return names
    try:
        expression = PosixExpression(pattern)
    except ValueError as error:
        raise Rejection(ResultCode.RESULT_OPERATION_FAILED,
                        f'filter {quoted(pattern)}: {error}') from error
    return [name for name in names if expression.found_in(name)]
