# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Log the robots of a node at its start, and those that come later."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from manip_sim.control.modes import MODES, POSITION
from manip_sim.interface.topics import Scope
from manip_sim.interface.world_topics import STALLS
from manip_sim.models import World
from manip_sim.models.asset_files import LostShape
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.models.urdf_writer import TOPIC_PLUGIN
from manip_sim.models.world import inferred_by_model, skipped_geoms
from manip_sim.rclpy_internals import missing_for_publishing
from manip_sim.ros.feature import Feature, NodeContext
from manip_sim.ros.messages import missing_note
from manip_sim.simulation import SimulatedRobot, Simulation

Value = Callable[[str], Any]


class StartupLog(Feature):
    """Logs the robots of a simulation after its start, and what the user has to know of them."""

    def __init__(self, context: NodeContext) -> None:
        self._context, self._log = context, context.node.get_logger()

    def started(self) -> None:
        context, log, value = self._context, self._log, self._context.parameters.value
        simulation, world = context.simulation, context.simulation.world
        log.info(_introduction(context.robots, simulation, value, context.thread.paused))
        for note in (*_inferred(world), *simulation.lowered_gains, *context.notes,
                     *([missing_note(context.missing)] if context.missing else ())):
            log.info(note)
        for name in missing_for_publishing():
            log.warning(f'no {name}: Python does nothing else while a message is published')
        for sentence in skipped_geoms(world):
            log.warning(sentence)
        for defect in simulation.start_defects:
            log.warning(f'start: {defect}')
        if (value('ros2_control_tag') and value('stepping') == 'lockstep'
                and value('ros2_control_plugin') == TOPIC_PLUGIN):
            log.warning(STALLS)
        if context.node.get_parameter('use_sim_time').value:
            log.warning('use_sim_time has no effect here: this node is the source of the time')

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        world = self._context.simulation.world
        for note in (*_inferred(world, robot.robot_model), *robot.joints.lowered):
            self._log.info(note)
        for sentence in skipped_geoms(world, robot.robot_model):
            self._log.warning(sentence)


def _introduction(robots: Mapping[Scope, SimulatedRobot], simulation: Simulation, value: Value,
                  paused: bool) -> str:
    """
    Return a description of the robots: their parts, modes, limits and topics.

    :param robots: by the scope of their topics and parameters
    :param simulation: of the robots
    :param value: returns the value of a parameter
    :param paused: whether the simulation is paused
    """
    lines = []
    for scope, robot in robots.items():
        name = f'{scope.name}: ' if scope.name else ''
        task = value('task')
        composition = (f'{value("robot")}, task {task}' if task else
                       f'{value(scope.parameter("robot"))} in arena {value("arena")}')
        lines.append(f'{name}{composition}, '
                     f'{value("stepping")}, {value("publish_rate"):g} Hz, timestep '
                     f'{simulation.timestep_s:g} s'
                     + (', paused until ~/pause is called' if paused else ''))
        lines += _parts(scope, robot, value)
    space = '<robot>/' if any(scope.name for scope in robots) else ''
    lines.append(f'  states on {space}joint_states and {space}<part>/joint_states, commands '
                 f'on {space}<part>/command, {space}<part>/joint_command and '
                 f'{space}joint_command')
    return '\n'.join(lines)


def _parts(scope: Scope, robot: SimulatedRobot, value: Value) -> Iterator[str]:
    for name, part in robot.parts.items():
        if not part.joints or part.atomic != (name,):
            continue
        mode = POSITION.name
        if part.gripper is None and part.actuators:
            mode = value(scope.parameter(f'control_mode.{name}'))
        yield f'  {name}: {mode} mode, joints {", ".join(part.joints)}'
        if part.gripper is None:
            limits = ' '.join(f'[{low:g}, {high:g}]' for low, high in robot.limits(name))
            yield f'    limits {limits} {" or ".join(MODES[mode].units)}'


def _inferred(world: World, robot: RobotModel | None = None) -> Iterator[str]:
    """
    Yield the inferences about each model that comes from a file, but for lost shapes.

    Arms without a gripper, which have no topics of an end effector, are named with the remedy.

    :param world: the world of the models
    :param robot: that all is about; None: the whole world
    """
    for name, sentences in inferred_by_model(world, robot):
        kept = [sentence for sentence in sentences if not isinstance(sentence, LostShape)]
        if kept:
            yield f'{name}: inferred: {"; ".join(kept)}'
    for model in world.robots if robot is None else [robot]:
        if isinstance(model, ManipulatorModel):
            for arm in model.arms:
                if arm not in model.grippers:
                    yield (f"{model.name}: arm '{arm}' has no gripper, so no {arm}/eef_pose, "
                           f'{arm}/target_pose or {arm}/wrench; gripper:=NullGripper puts a bare '
                           f"flange with these on '{model.eef_name[arm]}'")
