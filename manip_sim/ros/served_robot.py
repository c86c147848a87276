# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters and topics of one robot: its settings, its states, its commands."""

from __future__ import annotations

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
        settings = robot.settings
        #: What uses the value of a live parameter, by its name.
        self._uses = {scope.parameter(name): partial(
            node.thread.change, *_operation(robot.name, name)) for name in settings}
        for name, acting in settings.items():
            given = scope.parameter(name)
            # Values that randomization has drawn stay, unless the user sets others.
            if given in self._declared.names and self._declared.value(given) != acting and (
                    self._declared.value(given) or name not in QUANTITIES):
                self._use(given, self._declared.value(given))
        self.states = StatePublishers(node, robot, scope)
        node.thread.observe(self.states.publish, look=self.states.look)
        self.commands = CommandSubscribers(node, robot, scope)
        CartesianSubscribers(node, self.commands)

    def close(self) -> None:
        """Take no commands and publish no states any more, before the robot is deleted."""
        self.commands.close()
        self._thread.unobserve(self.states.publish)
        self.states.close(self._node)

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
            # A Cartesian target comes to rest by itself: only a timeout that was set ends it.
            self._uses[name](value, *(
                [self._declared.is_set(name)]
                if name.startswith(self.scope.parameter('command_timeout.')) else []))


def _operation(robot: str, setting: str) -> tuple[str, ...]:
    """Return the operation that changes a setting of a robot, and its arguments but the value."""
    group, *which = setting.split('.')
    if setting in QUANTITIES:
        return 'sensing', robot, setting
    return {'control_mode': 'mode', 'command_timeout': 'timeout'}.get(group, group), robot, *which
