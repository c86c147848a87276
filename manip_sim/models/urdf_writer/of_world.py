# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The URDF of each robot of a world."""

from __future__ import annotations

from collections.abc import Mapping

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.loading import compile_spec
from manip_sim.models.robots import RobotModel
from manip_sim.models.urdf_writer.hardware import Hardware
from manip_sim.models.urdf_writer.meshes import files_of_meshes
from manip_sim.models.urdf_writer.writer import Urdf, write_urdf
from manip_sim.models.world import World


def urdfs_of(world: World, hardware: Mapping[str, Hardware] | None = None) -> dict[str, Urdf]:
    """
    Return the URDF of each robot by its name in the world.

    :param world: with one robot or more
    :param hardware: by name of the robot, for those with a ``<ros2_control>`` tag
    :raises ModelError: if the world does not compile
    """
    spec = world.compose(objects=False)
    model = compile_spec(spec, world.name)
    meshes, wanted = files_of_meshes(spec, model), hardware or {}
    return {robot.name_in_world:
            write_urdf(model, robot, meshes, wanted.get(robot.name_in_world))
            for robot in world.robots}


def urdf_of(world: World, robot: str | None = None, hardware: Hardware | None = None) -> Urdf:
    """
    Return the URDF of one robot.

    :param world: with the robot
    :param robot: its name, as for :func:`urdfs_of`; None for the only one
    :param hardware: of the ``<ros2_control>`` tag; None for none
    :raises ModelError: if there are several robots and none is named, or the world does not
        compile
    :raises UnknownNameError: if there is no such robot
    """
    name = choose_robot(world, robot).name_in_world
    return urdfs_of(world, {} if hardware is None else {name: hardware})[name]


def choose_robot(world: World, name: str | None = None) -> RobotModel:
    """
    Return the robot of a name, or the only one; raises as :func:`urdf_of` does.

    :param world: with one robot or more
    :param name: of the robot, as for :func:`urdfs_of`; None for the only one
    """
    robots = {robot.name_in_world: robot for robot in world.robots}
    if name is None:
        if len(robots) != 1:
            raise ModelError('a URDF is of one robot: name one of '
                             + (', '.join(robots) or 'none'))
        return next(iter(robots.values()))
    if name not in robots:
        raise UnknownNameError('robot', name, robots)
    return robots[name]
