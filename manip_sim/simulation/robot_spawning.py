# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Plan a running world with one more robot, or without one, with everything else as it was.

Nothing here changes its arguments. Making a plan compiles the new world, which takes a while and
may be done in another thread; ``Simulation.change_robots`` then takes it over between two control
periods, which is quick.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import copy
from dataclasses import dataclass, field, replace
from typing import Any, TYPE_CHECKING

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.arenas import Arena, EmptyArena
from manip_sim.models.gravity_compensation import compensate_free_robots
from manip_sim.models.object_model import ObjectModel
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.models.setpoint_activation import (
    add_setpoint_activation, position_servos_without_dynamics)
from manip_sim.models.world import World
from manip_sim.physics.object_spawning import plan_world, WorldPlan
from manip_sim.physics.state_transfer import ElementMap
from manip_sim.quoting import shown

if TYPE_CHECKING:
    from manip_sim.simulation.simulation import Simulation

#: Robots that a world may have, so that requests cannot fill the memory.
MAX_ROBOTS = 16


@dataclass(frozen=True)
class RobotsPlan:
    """
    A world with other robots, compiled.

    :ivar world: its robots and its arena
    :ivar plan: the same with the objects, compiled
    :ivar start: of the joints of a new robot, by name [rad or m]
    """

    world: World
    plan: WorldPlan
    start: Mapping[str, float] = field(default_factory=dict)

    @property
    def joints(self) -> set[str]:
        """Names of all joints in it."""
        return {joint.name for joint in self.plan.spec.joints}


def compose_base(world: World, visual: bool = False) -> Any:
    """
    Return the ``mujoco.MjSpec`` of arena and robots as a simulation needs it, without objects.

    :param visual: with the geoms that cannot collide
    :raises ModelError: if it is not a world, or two parts have a name in common
    """
    if not isinstance(world, World):
        raise ModelError(
            f"a simulation needs a World, such as compose('Panda'), got {shown(world)}")
    spec = world.compose(visual, objects=False)
    add_setpoint_activation(spec, [
        *(name for robot in world.robots for name in robot.joint_actuators),
        *position_servos_without_dynamics(spec, world.gripper_actuators)])
    if world.gravity_compensation:
        compensate_free_robots(spec, world.robots)
    return spec


def actuators_of(world: World) -> list[str]:
    """Return the names of the actuators of all robots and their grippers."""
    return [*(name for robot in world.robots for name in robot.joint_actuators),
            *world.gripper_actuators]


def plan_with_robot(simulation: Simulation, robot: RobotModel) -> RobotsPlan:
    """
    Return the plan of a running world with one more robot, which comes after the others.

    :param simulation: only read
    :param robot: placed by ``set_base_xpos``, else where the arena places a robot
    :raises ModelError: if a name is taken already, there are too many robots, or MuJoCo cannot
        compile the world
    """
    world = simulation.world
    if len(world.robots) >= MAX_ROBOTS:
        raise ModelError(f'there are {len(world.robots)} robots already, a world takes no more')
    if robot.root_body in simulation.plan.object_names or any(
            name.startswith(robot.naming_prefix) for name in simulation.plan.object_names):
        raise ModelError(f"an object has a name that begins with '{robot.naming_prefix}': give "
                         'the robot another name')
    return _follow(simulation, world.with_robots([*world.robots, robot]),
                   _start_of(simulation, robot))


def plan_without_robot(simulation: Simulation, name: str) -> RobotsPlan:
    """
    Return the plan of a running world without one of the robots that came while it ran.

    :param simulation: only read
    :raises ModelError: if the robot was there at the start
    :raises UnknownNameError: if the robot is unknown
    """
    world = simulation.world
    if name not in simulation.robots:
        raise UnknownNameError('robot', name, simulation.spawned_robots)
    if name not in simulation.spawned_robots:
        raise ModelError(f"robot '{name}' was there at the start and cannot be deleted")
    return _follow(simulation, world.with_robots(
        [robot for robot in world.robots if robot.name_in_world != name]))


def plan_in_arena(simulation: Simulation, arena: Arena, cameras: Iterable[str] = ()) -> RobotsPlan:
    """
    Return the plan of a running world in another arena, without objects but for the arena's own.

    Robots stay where they are placed; one that nothing placed stands where the arena says.

    :param simulation: only read
    :param arena: the new one
    :param cameras: that the world must have
    :raises ModelError: if the world draws where objects are placed, a camera is missing, or MuJoCo
        cannot compile the world
    """
    world: World = copy.copy(simulation.world)
    if world.randomization is not None:
        raise ModelError('the world draws its objects and properties at random, which belong to '
                         'its arena')
    world.arena, world.objects = arena, list(arena.objects)
    plan = _follow(simulation, world, objects=tuple(world.objects))
    there = {camera.name for camera in plan.plan.spec.cameras}
    for camera in cameras:
        if camera not in there:
            raise ModelError(f"the arena {arena.arena_name} has no camera '{camera}', whose "
                             'images are published')
    return plan


def _follow(simulation: Simulation, world: World, start: Mapping[str, float] | None = None,
            objects: tuple[ObjectModel, ...] | None = None) -> RobotsPlan:
    before = simulation.plan
    base = compose_base(world)
    base.compiler.discardvisual = before.base.compiler.discardvisual
    plan = plan_world(base, before.objects if objects is None else objects, world.name)
    return RobotsPlan(world, replace(plan, since=ElementMap(before.compiled, plan.compiled)),
                      start or {})


def _start_of(simulation: Simulation, robot: RobotModel) -> dict[str, float]:
    """Return the start of a robot's joints; joints of grippers satisfy their couplings."""
    world = simulation.world
    alone: World = copy.copy(world.with_robots([robot]))
    alone.arena, alone.objects, alone.cameras, alone.lidars = EmptyArena(), [], [], []
    alone.randomization = alone.noise = None
    keyframe = simulation.episode_start.keyframe
    alone.keyframe = keyframe if keyframe in alone.keyframes else ''
    settled = type(simulation)(alone).start
    with_others = world.with_robots([*world.robots, robot]).init_qpos(
        simulation.seed, keyframe)
    of_grippers = {joint for gripper in (
        robot.grippers.values() if isinstance(robot, ManipulatorModel) else ())
        for joint in gripper.joints}
    return {joint: position if joint in of_grippers else with_others[joint]
            for joint, position in settled.items()}
