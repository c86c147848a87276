# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The services of the package ``simulation_interfaces``, where that is installed."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

from manip_sim.errors import CommandError
from manip_sim.models.regular_files import FilesBelow
from manip_sim.physics.poses_and_twists import Pose, Twist
from manip_sim.quoting import quoted
from manip_sim.ros.background import Rounds
from manip_sim.ros.feature import Feature
from manip_sim.ros.messages import filled, numbers_of, stamp_of, WORLD
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.optional_packages import import_optional
from manip_sim.ros.posix_ere import PosixExpression
from manip_sim.ros.spawning_services import FORMATS, SpawningServices
from manip_sim.ros.standard_answers import (
    answering, answering_later, BoundsType, Category, change_unless_diverged, FeatureCode,
    reject_if_diverged, Rejection, ResultCode, ScopeCode, SetEntityCode, SetStateCode, StateCode)

SERVICE_TYPES = import_optional('simulation_interfaces.srv')

#: Whether the package is installed.
AVAILABLE = SERVICE_TYPES is not None
_ABOUT = ('manip_sim: a step is one control period, 1/publish_rate of simulation time; scope ALL '
          'of a reset restarts simulation time, scope STATE lets it go on.')


class StandardServices(Feature):
    """
    The services of the standard under ``~/``; without their package a note.

    :param files: those that a request may name
    """

    def __init__(self, context: NodeContext, files: FilesBelow) -> None:
        if not AVAILABLE:
            context.missing['simulation_interfaces'] = 'standard simulation services'
            return
        SimulationInterfaces(context, SERVICE_TYPES)
        EntityServices(context, SERVICE_TYPES)
        SpawningServices(context, files, SERVICE_TYPES)


class SimulationInterfaces:
    """
    The services of the standard for simulation state, steps and reset.

    A step is one control period. Scope ``ALL`` of a reset, and the state ``STOPPED``, restart
    simulation time; scope ``STATE`` lets it go on, as ``~/reset`` does.

    :param types: of the services, as ``simulation_interfaces.srv`` has them
    """

    def __init__(self, context: NodeContext, types: Any) -> None:
        self._context, self._simulation, self._thread = context, context.simulation, context.thread
        self._stopped = False
        context.node.create_service(types.GetSimulatorFeatures, '~/get_simulator_features',
                                    self._features)
        # A request for many steps takes long, so it does not hold up the others.
        groups = MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()
        context.node.create_service(types.StepSimulation, '~/step_simulation',
                                    answering_later(self._step), callback_group=groups[0])
        for service_type, name, fill in (
                (types.GetSimulationState, 'get_simulation_state', self._get_state),
                (types.SetSimulationState, 'set_simulation_state', self._set_state),
                (types.ResetSimulation, 'reset_simulation', self._reset)):
            context.node.create_service(service_type, f'~/{name}', answering(fill),
                                        callback_group=groups[1])

    def _features(self, _: Any, response: Any) -> Any:
        response.features.features = [int(feature) for feature in FeatureCode]
        response.features.spawn_formats = list(FORMATS)
        response.features.custom_info = _ABOUT
        return response

    def _state(self) -> int:
        if not self._thread.paused:
            return int(StateCode.STATE_PLAYING)
        if self._stopped and self._thread.at_start:
            return int(StateCode.STATE_STOPPED)
        return int(StateCode.STATE_PAUSED)

    def _get_state(self, _: Any, response: Any) -> None:
        response.state.state = self._state()

    def _set_state(self, request: Any, response: Any) -> None:
        target = request.state.state
        if target not in list(StateCode):
            raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED,
                            f'state {target} cannot be set, only STOPPED (0), PLAYING (1) and '
                            'PAUSED (2); SIGTERM ends the simulator')
        if target == self._state():
            raise Rejection(SetStateCode.ALREADY_IN_TARGET_STATE,
                            'the simulation is in this state already')
        if target == StateCode.STATE_PLAYING:
            reject_if_diverged(self._simulation, SetStateCode.STATE_TRANSITION_ERROR)
        self._thread.pause(target != StateCode.STATE_PLAYING)
        if target == StateCode.STATE_STOPPED:
            self._thread.reset(restart_time=True)
        self._stopped = target == StateCode.STATE_STOPPED

    async def _step(self, request: Any, _: Any) -> None:
        steps: int = request.steps
        if steps == 0:
            raise Rejection(ResultCode.RESULT_OPERATION_FAILED, 'steps must be 1 or more, got 0')
        if self._state() == StateCode.STATE_STOPPED:
            raise Rejection(ResultCode.RESULT_OPERATION_FAILED,
                            'the simulation is stopped: pause it first')
        for done in range(steps):
            try:
                self._thread.step()
            except CommandError as error:
                after = f' (after {done} of {steps} steps)' if done else ''
                raise CommandError(f'{error}{after}') from error
            await Rounds(self._context.node)

    def _reset(self, request: Any, response: Any) -> None:
        scope = request.scope
        everything = scope in (ScopeCode.SCOPE_DEFAULT, ScopeCode.SCOPE_ALL)
        known = ScopeCode.SCOPE_TIME | ScopeCode.SCOPE_STATE
        if not everything and (scope & ~known or not scope & ScopeCode.SCOPE_STATE):
            raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED,
                            f'scope {scope} is not supported, only ALL (0 or 255), STATE (2) and '
                            'STATE with TIME (3)')
        self._thread.reset(
            restart_time=everything or bool(scope & ScopeCode.SCOPE_TIME))


class EntityServices:
    """
    The services that list robots and objects, return their poses and move free ones.

    :param types: of the services, as ``simulation_interfaces.srv`` has them
    """

    def __init__(self, context: NodeContext, types: Any) -> None:
        self._simulation, self._thread = context.simulation, context.thread
        # A group of their own: a request for many steps, in another group, does not hold them up.
        group = MutuallyExclusiveCallbackGroup()
        for service_type, name, fill in (
                (types.GetEntities, 'get_entities', self._get_entities),
                (types.GetEntityState, 'get_entity_state', self._get_entity_state),
                (types.SetEntityState, 'set_entity_state', self._set_entity_state)):
            context.node.create_service(service_type, f'~/{name}', answering(fill),
                                        callback_group=group)

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
        for part, numbers in (
                (message.pose, (state.pose.position, state.pose.quat_xyzw)),
                (message.twist, (state.twist.linear, state.twist.angular)),
                (message.acceleration, (state.linear_acceleration, state.angular_acceleration))):
            filled(part, np.concatenate(numbers))

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
