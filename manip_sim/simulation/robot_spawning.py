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
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.actuators import add_setpoint_activation, position_servos_without_dynamics
from manip_sim.models.arenas import Arena
from manip_sim.models.bases import base_names
from manip_sim.models.grippers import gripper_names
from manip_sim.models.registry import is_path
from manip_sim.models.robots import robot_names, RobotModel
from manip_sim.models.user_files import AllowedRoots, InMemoryFile, split_arguments, stem_of
from manip_sim.models.world import compensate_free_robots, compose_robot, DEFAULT, NONE, World
from manip_sim.physics.object_spawning import ElementMap, plan_world, WorldPlan
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quoting import format_value
from manip_sim.validation import check_kind

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
            f"a simulation needs a World, such as compose('Panda'), got {format_value(world)}")
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


class RunningWorld(Protocol):
    """A simulation, which the plans of its next worlds are made from."""

    @property
    def robots(self) -> Mapping[str, object]:
        """The robots that there are now, by name."""

    @property
    def world(self) -> World:
        """The robots, the arena and the objects that there are now; a copy."""

    @property
    def plan(self) -> WorldPlan:
        """The plan of the present world."""

    @property
    def spawned_robots(self) -> list[str]:
        """Names of the robots that came while the simulation ran."""

    def start_of(self, robot: RobotModel) -> dict[str, float]:
        """Return where the joints of another robot start, by name [rad or m]."""


def plan_with_robot(simulation: RunningWorld, robot: RobotModel) -> RobotsPlan:
    """
    Return the plan of a running world with one more robot, which comes after the others.

    :param simulation: only read
    :param robot: placed by ``set_base_xpos``, else where the arena places a robot
    :raises ModelError: if a name is taken already, there are too many robots, or MuJoCo cannot
        compile the world
    """
    check_kind(robot, RobotModel, 'robot', 'a RobotModel')
    world = simulation.world
    if len(world.robots) >= MAX_ROBOTS:
        raise ModelError(f'there are {len(world.robots)} robots already, a world takes no more')
    if robot.root_body in simulation.plan.object_names or any(
            name.startswith(robot.naming_prefix) for name in simulation.plan.object_names):
        raise ModelError(f"an object has a name that begins with '{robot.naming_prefix}': give "
                         'the robot another name')
    return _follow(simulation, world.with_robots([*world.robots, robot]),
                   simulation.start_of(robot))


def plan_without_robot(simulation: RunningWorld, name: str) -> RobotsPlan:
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


def plan_in_arena(simulation: RunningWorld, arena: Arena, cameras: Iterable[str] = ()
                  ) -> RobotsPlan:
    """
    Return the plan of a running world in another arena, without objects but for the arena's own.

    Robots stay where they are placed; one that nothing placed stands where the arena says.

    :param simulation: only read
    :param arena: the new one
    :param cameras: that the world must have
    :raises ModelError: if the world draws where objects are placed, a camera is missing, or MuJoCo
        cannot compile the world
    """
    world = simulation.world
    if world.randomization is not None:
        raise ModelError('the world draws its objects and properties at random, which belong to '
                         'its arena')
    world.arena, world.objects = arena, list(arena.objects)
    plan = _follow(simulation, world)
    there = {camera.name for camera in plan.plan.spec.cameras}
    for camera in cameras:
        if camera not in there:
            raise ModelError(f"the arena {arena.arena_name} has no camera '{camera}', whose "
                             'images are published')
    return plan


def _follow(simulation: RunningWorld, world: World, start: Mapping[str, float] | None = None
            ) -> RobotsPlan:
    before = simulation.plan
    base = compose_base(world)
    base.compiler.discardvisual = before.base.compiler.discardvisual
    plan = plan_world(base, tuple(world.objects), world.name)
    return RobotsPlan(
        world, replace(plan, since=ElementMap(before.compiled, plan.compiled)),
        start or {})


#: Name of a robot that is sent as text.
UNNAMED_ROBOT = 'robot'


class RequestedRobot:
    """
    A robot, as a request describes it.

    :param values: ``robot``, a name of the catalogue, which includes the folders of
        ``model_path``, or a file; where they are not the robot's own ``gripper`` and ``base``,
        names of the catalogue; and ``name``
    :param source: where they come from, for messages
    :param files: those that a request may name
    :param folder: where relative paths begin; None: in the folders of ``spawn_roots``
    :raises ModelError: on one line, naming the key
    """

    #: The key that only robots have.
    KEY = 'robot'

    def __init__(self, values: Mapping[str, Any], source: str, files: AllowedRoots,
                 folder: Path | None = None) -> None:
        self._given: Path | InMemoryFile | None = None
        self._files = files
        known = {'name': None, self.KEY: robot_names(),
                 'gripper': [DEFAULT, NONE, *gripper_names()],
                 'base': [DEFAULT, NONE, *base_names()]}
        for key, value in values.items():
            if key not in known:
                raise ModelError(f'{source}: {UnknownNameError("key", key, known)}')
            names = known[key]
            if not isinstance(value, str):
                raise ModelError(f'{source}: {key}: expected a name, got {format_value(value)}')
            if names is None or value in names:
                continue
            if key != self.KEY or not is_path(value):
                raise ModelError(f'{source}: {UnknownNameError(key, value, names)}')
            self._given = files.first(
                files.places(value) if folder is None else [folder / value])
            files.check(self._given, 'robot file')
        self._values = values

    @classmethod
    def from_text(cls, text: InMemoryFile, files: AllowedRoots) -> RequestedRobot:
        """
        Return the robot that a URDF is, which a request sends as text.

        :param text: names no files
        """
        robot = cls({}, str(text.file), files)
        robot._given, robot._values = text, {cls.KEY: UNNAMED_ROBOT}
        return robot

    @property
    def name(self) -> str:
        """The name that it gives itself, or what kind of robot it is."""
        named: str = self._values[self.KEY]
        default_name = named if self._given is None else stem_of(Path(split_arguments(named)[0]))
        name: str = self._values.get('name', default_name)
        return name

    def create(self, name: str, pose: Pose) -> RobotModel:
        """
        Create the robot.

        :param name: begin of all of its names
        :param pose: of its base
        :raises ModelError: if the parts do not fit together
        """
        from manip_sim.models.files.requested_robot import load_requested
        robot = compose_robot(
            self._values[self.KEY] if self._given is None else load_requested(
                self._given, self._files, name), self._values.get('gripper', DEFAULT),
            self._values.get('base', DEFAULT), prefix=f'{name}_', idn=name)
        # A message cannot leave out the height, so zero does not count as a choice.
        robot.set_base_xpos(pose.position, may_be_raised=not pose.position[2])
        robot.set_base_quat(pose.quat_xyzw)
        return robot
