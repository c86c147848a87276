# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the node has for one robot: its settings as parameters, its states, its commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any, TYPE_CHECKING

from rclpy.parameter import Parameter

from manip_sim.interface.scope import Scope
from manip_sim.ros.cartesian_topics import CartesianSubscribers
from manip_sim.ros.command_subscribers import CommandSubscribers
from manip_sim.ros.state_publishers import StatePublishers
from manip_sim.sensing.settings import QUANTITIES
from manip_sim.simulation import SimulatedRobot

if TYPE_CHECKING:
    from manip_sim.ros.sim_node import SimNode


class ServedRobot:
    """
    Publishers of the states of a robot, subscriptions to its commands, and its live parameters.

    :param scope: namespace of its topics and parameters
    :param robot: the robot, whose parameters are declared
    :ivar states: the publishers
    :ivar commands: the subscriptions
    """

    def __init__(self, node: SimNode, scope: Scope, robot: SimulatedRobot) -> None:
        self._node, self._declared, self._thread = node, node.declared, node.thread
        self.scope, self.robot = scope, robot
        #: What uses the value of a live parameter, by its name.
        self._uses: dict[str, Callable[[Any], None]] = {}
        self._control()
        self.states = StatePublishers(node, robot, scope)
        node.thread.observe(self.states.publish, look=self.states.look)
        self.commands = CommandSubscribers(node, robot, scope)
        self._cartesian = CartesianSubscribers(node, self.commands)

    def close(self) -> None:
        """Take no commands and publish no states any more, before the robot is deleted."""
        self.commands.close()
        self._thread.unobserve(self.states.publish)
        self.states.close(self._node)

    def _control(self) -> None:
        scope, robot, change = self.scope, self.robot, self._thread.change
        value = self._declared.value
        for quantity in QUANTITIES:
            name = scope.parameter(quantity)
            self._uses[name] = partial(change, 'sensing', robot.name, quantity)
        for arm in robot.end_effectors:
            self._uses[scope.parameter(f'wrench_cutoff.{arm}')] = partial(
                change, 'wrench_cutoff', robot.name, arm)
        for arm, settings in robot.joints.cartesian.settings.items():
            for setting in asdict(settings):
                self._uses[scope.parameter(f'cartesian.{arm}.{setting}')] = partial(
                    change, 'cartesian', robot.name, arm, setting)
        for name, acting in self.robot.settings.items():
            given = scope.parameter(name)
            # Values that randomization has drawn stay, unless the user sets others.
            if given in self._declared.names and value(given) != acting and (
                    value(given) or name not in QUANTITIES):
                self._use(given, value(given))

    @property
    def acting(self) -> dict[str, Any]:
        """Acting values of the robot's live parameters, without those that follow from them."""
        return {self.scope.parameter(name): value for name, value in self.robot.settings.items()}

    @property
    def timeouts(self) -> dict[str, bool]:
        """True if a part's timeout ends Cartesian targets too, by the name of its parameter."""
        begin, joints = self.scope.parameter('command_timeout.'), self.robot.joints
        return {name: joints.ends_targets(name.removeprefix(begin))
                for name, value in self.acting.items() if name.startswith(begin) and value}

    def parameter_changed(self, parameter: Parameter) -> None:
        """
        Use the new value of a parameter, if it is one of the robot.

        :raises SimulationEnded: if the simulation has ended
        """
        self._use(parameter.name, parameter.value)

    def _use(self, name: str, value: Any) -> None:
        if name in self._uses:
            self._uses[name](value)
        found = self._declared.of_parts.get(name)
        if found is None or found.scope != self.scope or not found.is_atomic:
            return
        robot, part, change = self.robot.name, found.part, self._thread.change
        group, _, quantity = found.group.partition('.')
        if group == 'control_mode':
            change('mode', robot, part, value)
        elif group == 'command_timeout':
            # A Cartesian target comes to rest by itself: only a timeout that was set ends it.
            change('timeout', robot, part, self._declared.value(name), self._declared.is_set(name))
        elif group == 'reflex':
            change('reflex', robot, part, quantity, value)
        else:
            change(group, robot, part, value)
