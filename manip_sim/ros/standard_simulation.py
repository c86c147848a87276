# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The services and the action of ``simulation_interfaces`` for state, steps and resets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

from manip_sim.errors import CommandError
from manip_sim.ros.background import Rounds
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.spawning_services import FORMATS
from manip_sim.ros.standard_answers import (
    answering, answering_later, FeatureCode, NEEDED, reject_if_diverged, Rejection, result_filled,
    ResultCode, ScopeCode, SetStateCode, StandardTypes, StateCode)

_ABOUT = ('manip_sim: a step is one control period, 1/publish_rate of simulation time; scope ALL '
          'of a reset restarts simulation time, scope STATE lets it go on.')


class _Canceled(CommandError):
    """A client has cancelled a goal."""


class SimulationInterfaces:
    """
    The services of the standard for simulation state, steps and reset.

    A step is one control period. Scope ``ALL`` of a reset, and the state ``STOPPED``, restart
    simulation time; scope ``STATE`` lets it go on, as ``~/reset`` does.

    :param types: those of the package
    :ivar no_world: whether the world has been unloaded
    """

    def __init__(self, context: NodeContext, types: StandardTypes) -> None:
        self._context, self._simulation, self._thread = context, context.simulation, context.thread
        self._types = types
        self._stopped = False
        self.no_world = False
        # A request for many steps takes long, so it does not hold up the others.
        groups = MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()
        types.offer(context.node, {'StepSimulation': answering_later(self._step)}, groups[0])
        types.offer(context.node, {
            'GetSimulatorFeatures': self._features,
            'GetSimulationState': answering(self._get_state),
            'SetSimulationState': answering(self._set_state),
            'ResetSimulation': answering(self._reset)}, groups[1])
        self._has_goal = False
        self._server = None
        if types.has('SimulateSteps'):
            self._server = ActionServer(
                context.node, types.actions.SimulateSteps, '~/simulate_steps', self._simulate,
                goal_callback=self._accept, cancel_callback=lambda _: CancelResponse.ACCEPT,
                callback_group=groups[1])

    def close(self) -> None:
        """Destroy the server of the action, which rclpy does not with its node."""
        if self._server is not None:
            self._server.destroy()

    def _features(self, _: Any, response: Any) -> Any:
        response.features.features = [int(feature) for feature in FeatureCode if self._types.has(
            NEEDED.get(feature, 'GetSimulatorFeatures'))]
        response.features.spawn_formats = list(FORMATS)
        response.features.custom_info = _ABOUT
        return response

    def _state(self) -> int:
        if not self._thread.paused:
            return int(StateCode.STATE_PLAYING)
        if self.no_world:
            return int(StateCode.STATE_NO_WORLD)
        if self._stopped and self._thread.at_start:
            return int(StateCode.STATE_STOPPED)
        return int(StateCode.STATE_PAUSED)

    def stop(self) -> None:
        """Stop the simulation at the start of a world that has been loaded."""
        self._thread.pause(True)
        self._thread.reset(restart_time=True)
        self._stopped, self.no_world = True, False

    def _reject_without_world(self) -> None:
        if self.no_world and self._thread.paused:
            raise Rejection(ResultCode.RESULT_INCORRECT_STATE,
                            'no world is loaded: load one first')

    def _get_state(self, _: Any, response: Any) -> None:
        response.state.state = self._state()

    def _set_state(self, request: Any, response: Any) -> None:
        target = request.state.state
        self._reject_without_world()
        if target not in list(StateCode)[:3]:
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
        await self._make(request.steps, lambda done: None)

    async def _make(self, steps: int, after: Callable[[int], None]) -> None:
        """
        Make control periods while the simulation is paused.

        :param after: is called with the number of those that are made
        :raises CommandError: if one cannot be made
        """
        if steps == 0:
            raise Rejection(ResultCode.RESULT_OPERATION_FAILED, 'steps must be 1 or more, got 0')
        self._reject_without_world()
        if self._state() == StateCode.STATE_STOPPED:
            raise Rejection(ResultCode.RESULT_OPERATION_FAILED,
                            'the simulation is stopped: pause it first')
        for done in range(steps):
            try:
                self._thread.step()
            except CommandError as error:
                made = f' (after {done} of {steps} steps)' if done else ''
                raise CommandError(f'{error}{made}') from error
            after(done + 1)
            await Rounds(self._context.node)

    def _accept(self, _: Any) -> GoalResponse:
        if self._has_goal:
            self._context.log.warn('~/simulate_steps', 'second', 'rejected a goal of '
                                   '~/simulate_steps: another one is running')
            return GoalResponse.REJECT
        self._has_goal = True
        return GoalResponse.ACCEPT

    async def _simulate(self, goal_handle: Any) -> Any:
        """Make the steps of a goal, with feedback after each, until it is cancelled."""
        kind, steps = self._types.actions.SimulateSteps, goal_handle.request.steps
        result = kind.Result()

        def report(done: int) -> None:
            goal_handle.publish_feedback(kind.Feedback(
                completed_steps=done, remaining_steps=steps - done))
            if goal_handle.is_cancel_requested and done < steps:
                raise _Canceled(f'canceled after {done} of {steps} steps')
        try:
            with result_filled(result.result):
                await self._make(steps, report)
        finally:
            self._has_goal = False
        if result.result.result == ResultCode.RESULT_OK:
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return result

    def _reset(self, request: Any, response: Any) -> None:
        self._reject_without_world()
        scope = request.scope
        everything = scope in (ScopeCode.SCOPE_DEFAULT, ScopeCode.SCOPE_ALL)
        known = ScopeCode.SCOPE_TIME | ScopeCode.SCOPE_STATE
        if not everything and (scope & ~known or not scope & ScopeCode.SCOPE_STATE):
            raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED,
                            f'scope {scope} is not supported, only ALL (0 or 255), STATE (2) and '
                            'STATE with TIME (3)')
        self._thread.reset(
            restart_time=everything or bool(scope & ScopeCode.SCOPE_TIME))
