# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node: builds a robot from parameters and serves its simulation."""

from __future__ import annotations

import contextlib
from typing import Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.parameter import Parameter

from manip_sim.errors import ManipSimError, ParameterError, SimulationEnded
from manip_sim.models import compose, World
from manip_sim.ros.commands import CommandSubscribers
from manip_sim.ros.diagnostics import Diagnostics
from manip_sim.ros.log import RejectionLog
from manip_sim.ros.overrides import check_qos_names, check_qos_values, without_source
from manip_sim.ros.parameters import (
    node_parameters, Parameters, robot_parameters, steps_per_period)
from manip_sim.ros.publishers import publish_mjcf, StatePublishers
from manip_sim.ros.runner import Runner
from manip_sim.ros.services import SimulationServices
from manip_sim.ros.simulation_interfaces import offer_simulation_interfaces
from manip_sim.simulation import Simulation
from manip_sim.simulation.commands import Command


class SimNode(Node):
    """
    Serves one simulated robot; :meth:`start` lets it run, :meth:`stop` ends it.

    :param arguments: further arguments of ``rclpy.node.Node``, such as ``context`` and
        ``parameter_overrides``
    :raises ManipSimError: if a parameter cannot be used, or the models do not fit together
    """

    def __init__(self, **arguments: Any) -> None:
        try:
            super().__init__('manip_sim', **arguments)
        except InvalidParameterTypeException as error:
            raise ParameterError(str(error).rpartition(': ')[0]) from error
        except RCLError as error:
            raise ManipSimError(without_source(error)) from error
        self.rejections = RejectionLog(self.get_logger())
        try:
            self._build()
        except ManipSimError:
            self.destroy_node()
            raise

    def _build(self) -> None:
        check_qos_values(self)
        self._declared = Parameters(self)
        self._declared.declare(node_parameters())
        value = self._declared.value
        steps = steps_per_period(value('publish_rate'), value('timestep'))
        world = self._world()
        self.simulation = Simulation(world)
        controlled = [name for name, part in self.simulation.parts.items()
                      if part.gripper is None and part.actuators]
        self._declared.declare(robot_parameters(controlled))
        self._declared.check_names()
        self._declared.couple(self.simulation.parts)
        publishers = StatePublishers(self, self.simulation, value('publish_clock'),
                                     self.rejections)
        self.runner = Runner(
            self.simulation, publishers.publish, steps, value('stepping'),
            value('real_time_factor'), self._lockstep_parts(), value('start_paused'),
            self._tell_failure)
        for name in controlled:
            if self.simulation.parts[name].atomic == (name,):
                self.simulation.set_control_mode(name, value(f'control_mode.{name}'))
                self.simulation.set_command_timeout(name, value(f'command_timeout.{name}'))
        self.commands = CommandSubscribers(self, self.simulation, self.runner, self.rejections)
        SimulationServices(self, self.simulation, self.runner)
        offer_simulation_interfaces(self, self.simulation, self.runner)
        Diagnostics(self, self.simulation, self.runner, self.commands)
        publish_mjcf(self, world.to_xml())
        check_qos_names(self)
        self.add_post_set_parameters_callback(self._parameters_changed)
        self._introduce()
        for defect in self.simulation.start_defects:
            self.get_logger().warning(f'start: {defect}')
        if self.get_parameter('use_sim_time').value:
            self.get_logger().warning('use_sim_time has no effect here: this node makes the time')

    def _world(self) -> World:
        value = self._declared.value
        options = {'cube': value('cube')} if value('arena') == 'table' else {}
        return compose(
            value('robot'), value('gripper'), value('base'), value('arena'), idn=value('idn'),
            prefix=value('prefix'), timestep_s=value('timestep'),
            gravity_compensation=value('gravity_compensation'), **options)

    def _lockstep_parts(self) -> list[str]:
        # An empty list of strings is a list with an empty string in ROS.
        parts: list[str] = [part for part in self._declared.value('lockstep_parts') if part]
        for part in parts:
            if part not in self.simulation.parts:
                raise ParameterError(
                    f"parameter 'lockstep_parts': this robot has no part '{part}'; it has "
                    + ', '.join(self.simulation.parts))
        if not parts and self._declared.value('stepping') == 'lockstep':
            raise ParameterError("parameter 'lockstep_parts': lockstep needs at least one part")
        return parts

    def _parameters_changed(self, parameters: list[Parameter]) -> None:
        # After the end there is nothing to change.
        with contextlib.suppress(SimulationEnded):
            for parameter in parameters:
                name, _, part = parameter.name.partition('.')
                if parameter.name == 'real_time_factor':
                    self.runner.set_real_time_factor(parameter.value)
                elif name == 'control_mode':
                    self.runner.set_control_mode(part, parameter.value)
                elif name == 'command_timeout':
                    self.runner.set_command_timeout(part, parameter.value)

    def _tell_failure(self, command: Command, error: Exception) -> None:
        self.rejections.failure('commands', ', '.join(sorted(command.parts)), error)

    def _introduce(self) -> None:
        value = self._declared.value
        lines = [f'{value("robot")} in arena {value("arena")}, {value("stepping")}, '
                 f'{value("publish_rate"):g} Hz, timestep {self.simulation.timestep_s:g} s']
        unit = {'position': 'rad or m', 'velocity': 'rad/s or m/s', 'effort': 'N m or N'}
        for name, part in self.simulation.parts.items():
            if not part.joints or part.atomic != (name,):
                continue
            mode = value(f'control_mode.{name}') if part.gripper is None else 'position'
            lines.append(f'  {name}: {mode} mode, joints {", ".join(part.joints)}')
            if part.gripper is None:
                limits = ' '.join(f'[{low:g}, {high:g}]'
                                  for low, high in self.simulation.limits(name))
                lines.append(f'    limits {limits} {unit[mode]}')
        lines.append('  states on joint_states and <part>/joint_states, commands on '
                     '<part>/command, <part>/joint_command and joint_command')
        self.get_logger().info('\n'.join(lines))

    def start(self) -> None:
        """Let the simulation run."""
        self.runner.start()

    def stop(self) -> None:
        """End the simulation; the node can be destroyed then."""
        self.runner.stop()
