# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Live parameters: their values act, and they show the values that act."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import contextlib
from functools import partial
from typing import Any

from rclpy.parameter import Parameter

from manip_sim.control.cartesian.cartesian_settings import IMPEDANCE
from manip_sim.errors import SimulationEnded
from manip_sim.interface.parameters import law_parameters
from manip_sim.interface.topics import Scope
from manip_sim.ros.feature import Feature, NodeContext
from manip_sim.sensing.sensor_noise import QUANTITIES
from manip_sim.simulation import SimulatedRobot


class LiveParameters(Feature):
    """The parameters that may change while the node runs."""

    def __init__(self, context: NodeContext) -> None:
        self._context = context
        thread = context.thread
        self._robots: dict[Scope, SimulatedRobot] = {}
        #: Names of the laws that move parts, by part.
        self._laws: dict[Scope, Mapping[str, str]] = {}
        #: Functions that use a value, by the name of the parameter.
        self._uses: dict[str, Callable[[Any], object]] = {
            'real_time_factor': thread.set_real_time_factor, 'pause_at': thread.pause_at,
            'seed': partial(setattr, thread, 'next_seed'),
            'keyframe': partial(thread.change, 'keyframe')}
        for scope, robot in context.robots.items():
            self.robot_added(scope, robot)

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        self._robots[scope] = robot
        parameters = self._context.parameters
        for setting, acting in robot.settings.items():
            name = scope.parameter(setting)
            self._uses[name] = self._use_of(scope, robot, setting)
            # Values that randomization has drawn stay, unless the user sets others.
            if name in parameters.names and parameters.value(name) != acting and (
                    parameters.value(name) or setting not in QUANTITIES):
                self._uses[name](parameters.value(name))
        self._begin_laws()

    def _begin_laws(self) -> None:
        """Let parameters of laws that have begun to move parts act, with what the user gave."""
        for name in self._follow_laws():
            self._uses[name](self._context.parameters.value(name))

    def _follow_laws(self) -> list[str]:
        """Declare the parameters of the laws that move parts, and no others; return new names."""
        laws = self._context.thread.call(
            lambda: {scope: robot.laws for scope, robot in self._robots.items()})
        new = []
        for scope, robot in self._robots.items():
            before, self._laws[scope] = self._laws.get(scope, {}), laws[scope]
            for part in {**before, **laws[scope]}:
                if before.get(part) != laws[scope].get(part):
                    if part in before:
                        self._forget_law(scope.parameter(f'law.{part}.'))
                    new += self._declare_law(scope, robot, part)
        return new

    def _forget_law(self, begin: str) -> None:
        """Forget the parameters of the law that moved a part."""
        self._context.parameters.forget(begin)
        for name in [name for name in self._uses if name.startswith(begin)]:
            del self._uses[name]

    def _declare_law(self, scope: Scope, robot: SimulatedRobot, part: str) -> list[str]:
        """Declare the parameters of the law that moves a part, if there is one; return names."""
        parameters, law = self._context.parameters, self._laws[scope].get(part)
        specs = [] if law is None else law_parameters(scope, part, law)
        with parameters.without_acting():
            parameters.declare([spec for spec in specs if spec.name not in parameters.names])
        for spec in specs:
            self._uses[spec.name] = self._use_of(
                scope, robot, spec.name.removeprefix(scope.parameter('')))
        return [spec.name for spec in specs]

    def robot_removed(self, scope: Scope) -> None:
        self._laws.pop(scope, None)
        for setting in self._robots.pop(scope).settings:
            self._uses.pop(scope.parameter(setting), None)

    def _use_of(self, scope: Scope, robot: SimulatedRobot, setting: str
                ) -> Callable[[Any], object]:
        """Return the function that changes a setting of a robot."""
        change = partial(self._context.thread.change, *_operation(robot.name, setting))
        group, _, part = setting.partition('.')
        if group not in ('command_timeout', 'timeout_follows_mode'):
            return change
        timeout, follows = (scope.parameter(f'{group}.{part}') for group in (
            'command_timeout', 'timeout_follows_mode'))
        value_of = self._context.parameters.value
        # A Cartesian target comes to rest by itself: only a timeout that was set ends it.
        return lambda _: change(value_of(timeout), not value_of(follows))

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        for name in [parameter.name for parameter in parameters if parameter.name in self._uses]:
            self._context.thread.call(
                partial(self._uses[name], self._context.parameters.value(name)))
        if not self._context.parameters.showing:
            self._begin_laws()

    def show(self) -> None:
        """Let parameters have the values that act, as a reset or a restored state changes them."""
        with contextlib.suppress(SimulationEnded):
            self._follow_laws()
            self._context.parameters.show(self._context.thread.call(self._acting))

    def _acting(self) -> dict[str, Any]:
        """Return acting values by name."""
        simulation, seed = self._context.simulation, self._context.thread.next_seed
        values: dict[str, Any] = {
            'seed': simulation.seed if seed is None else seed,
            'keyframe': simulation.episode_start.keyframe}
        for scope, robot in self._robots.items():
            values.update({
                scope.parameter(name): value for name, value in robot.settings.items()})
        return values


def _operation(robot: str, setting: str) -> tuple[str, ...]:
    """Return the operation that changes a setting of a robot, and its arguments but the value."""
    group, *which = setting.split('.')
    if setting in QUANTITIES:
        return 'sensing', robot, setting
    if group in IMPEDANCE:
        return 'cartesian', robot, *which, group
    return {'control_mode': 'mode', 'command_timeout': 'timeout',
            'timeout_follows_mode': 'timeout'}.get(group, group), robot, *which
