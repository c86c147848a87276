# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the node has for one robot: its settings as parameters, its states, its commands."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TYPE_CHECKING

from rclpy.parameter import Parameter

from manip_sim.interface.parameters import commanded_parts, reflex_parameters
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
        for name, part in robot.parts.items():
            if part.gripper is None and part.actuators and part.atomic == (name,):
                for group in ('control_mode', 'command_timeout', 'stream_interval', 'stream_hold'):
                    self._change_part(group, name, value(scope.parameter(f'{group}.{name}')))
        for arm in robot.end_effectors:
            name = scope.parameter(f'wrench_cutoff.{arm}')
            self._uses[name] = partial(change, 'wrench_cutoff', robot.name, arm)
            self._uses[name](value(name))
        for quantity in QUANTITIES:
            name = scope.parameter(quantity)
            self._uses[name] = partial(change, 'sensing', robot.name, quantity)
            if value(name):
                self._uses[name](value(name))
        for spec in reflex_parameters(scope, commanded_parts(robot.parts), [*robot.end_effectors]):
            name, quantity = spec.name.split('.')[-2:]
            self._uses[spec.name] = partial(change, 'reflex', robot.name, name, quantity)
            if value(spec.name):
                self._uses[spec.name](value(spec.name))

    def parameter_changed(self, parameter: Parameter) -> None:
        """
        Use the new value of a parameter, if it is one of the robot.

        :raises SimulationEnded: if the simulation has ended
        """
        if parameter.name in self._uses:
            self._uses[parameter.name](parameter.value)
        self._cartesian.parameter_changed(parameter)
        scope, group, part = self._declared.of_part(parameter.name) or (None, '', '')
        if scope == self.scope:
            self._change_part(group, part, parameter.value)

    def _change_part(self, group: str, part: str, value: Any) -> None:
        robot, change = self.robot.name, self._thread.change
        if group == 'control_mode':
            change('mode', robot, part, value)
        elif group == 'command_timeout':
            # A Cartesian target comes to rest by itself: only a timeout that was set ends it.
            name = self.scope.parameter(f'command_timeout.{part}')
            change('timeout', robot, part, self._declared.value(name), self._declared.is_set(name))
        else:
            change(group, robot, part, value)
