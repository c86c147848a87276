# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The services of the package ``simulation_interfaces``, where that is installed."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from manip_sim.errors import CommandError
from manip_sim.models.regular_files import FilesBelow
from manip_sim.ros.entity_services import EntityServices
from manip_sim.ros.optional_packages import import_optional, missing_note
from manip_sim.ros.rejection import answering, Rejection, result_filled
from manip_sim.ros.spawned_robots import SpawnedRobots
from manip_sim.ros.spawning_services import FORMATS, SpawningServices
from manip_sim.ros.standard_codes import Feature, ResultCode, ScopeCode, SetStateCode, StateCode
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import Simulation

SERVICE_TYPES = import_optional('simulation_interfaces.srv')

#: Whether the package is installed.
AVAILABLE = SERVICE_TYPES is not None
_ABOUT = ('manip_sim: a step is one control period, 1/publish_rate of simulation time; scope ALL '
          'of a reset restarts simulation time, scope STATE lets it go on.')


class _YieldToExecutor:
    """An awaitable that lets the executor run what else is ready before a coroutine goes on."""

    def __init__(self, node: Node) -> None:
        self._node = node

    def __await__(self) -> Generator[None, None, None]:
        # An executor goes on with tasks that it has begun only when something wakes it.
        executor = self._node.executor
        if executor is not None:
            executor.wake()
        yield


def offer_simulation_interfaces(node: Any, simulation: Simulation, thread: SimulationThread,
                                objects_changed: Callable[[Simulation], None], files: FilesBelow,
                                robots: SpawnedRobots) -> None:
    """
    Offer the services of the standard under ``~/``; note if their package is missing.

    :param node: the node, with its ``notes``
    :param simulation: what is controlled
    :param objects_changed: is called after objects have come or gone
    :param files: those that a request may name
    :param robots: lets robots come and go
    """
    if not AVAILABLE:
        node.notes.append(missing_note('simulation_interfaces', 'standard simulation services'))
        return
    SimulationInterfaces(node, simulation, thread, SERVICE_TYPES)
    EntityServices(node, simulation, thread, SERVICE_TYPES)
    SpawningServices(node, simulation, thread, objects_changed, files, SERVICE_TYPES, robots)


class SimulationInterfaces:
    """
    The services of the standard for simulation state, steps and reset.

    A step is one control period. Scope ``ALL`` of a reset, and the state ``STOPPED``, restart
    simulation time; scope ``STATE`` lets it go on, as ``~/reset`` does.

    :param simulation: what is controlled
    :param types: of the services, as ``simulation_interfaces.srv`` has them
    """

    def __init__(self, node: Node, simulation: Simulation, thread: SimulationThread, types: Any
                 ) -> None:
        self._node = node
        self._simulation = simulation
        self._thread = thread
        self._stopped = False
        node.create_service(types.GetSimulatorFeatures, '~/get_simulator_features',
                            self._features)
        # A request for many steps takes long, so it does not hold up the others.
        groups = MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()
        node.create_service(types.StepSimulation, '~/step_simulation', self._step,
                            callback_group=groups[0])
        for service_type, name, fill in (
                (types.GetSimulationState, 'get_simulation_state', self._get_state),
                (types.SetSimulationState, 'set_simulation_state', self._set_state),
                (types.ResetSimulation, 'reset_simulation', self._reset)):
            node.create_service(service_type, f'~/{name}', answering(fill),
                                callback_group=groups[1])

    def _features(self, _: Any, response: Any) -> Any:
        response.features.features = [int(feature) for feature in Feature]
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
        if target == StateCode.STATE_PLAYING and self._simulation.diverged is not None:
            raise Rejection(SetStateCode.STATE_TRANSITION_ERROR,
                            f'{self._simulation.diverged}; reset it first')
        self._thread.pause(target != StateCode.STATE_PLAYING)
        if target == StateCode.STATE_STOPPED:
            self._thread.reset(restart_time=True)
        self._stopped = target == StateCode.STATE_STOPPED

    async def _step(self, request: Any, response: Any) -> Any:
        with result_filled(response.result):
            await self._advance(request.steps)
        return response

    async def _advance(self, steps: int) -> None:
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
            await _YieldToExecutor(self._node)

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
