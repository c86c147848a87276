# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The services of ``simulation_interfaces`` for worlds, named poses, and what can be spawned."""

from __future__ import annotations

import inspect
from typing import Any

import mujoco
import numpy as np
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup

from manip_sim.errors import UnknownNameError
from manip_sim.models import arena_names, create_arena
from manip_sim.models.arenas.arena import ARENAS
from manip_sim.models.camera_choice import chosen_cameras
from manip_sim.models.regular_files import FilesBelow
from manip_sim.models.robots import robot_names
from manip_sim.quaternion import wxyz_to_xyzw
from manip_sim.quoting import quoted
from manip_sim.ros.background import in_background
from manip_sim.ros.entity_services import has_tags
from manip_sim.ros.messages import filled
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.spawned_robots import RequestedRobot, SpawnedRobots
from manip_sim.ros.spawning_services import SUFFIXES
from manip_sim.ros.standard_answers import (
    answering, answering_later, LoadCode, reject_if_diverged, Rejection, resource_of, ResultCode,
    StandardTypes, WorldCode)
from manip_sim.ros.standard_simulation import SimulationInterfaces
from manip_sim.simulation.robot_spawning import plan_in_arena, RobotsPlan

#: Scheme of the uris of arenas.
_SCHEME = 'arena:'
#: Most files that an answer names.
_MOST_FILES = 1000


class WorldServices:
    """
    The services that list, load and unload worlds, and what is there to spawn and where.

    A world is an arena. Loading one deletes all objects and the robots that were spawned; those of
    the start stay where their parameters put them.

    :param states: whose state is STOPPED after a world was loaded, and NO_WORLD after one was
        unloaded
    :param files: those that a request may name
    :param types: those of the package
    :param group: of the services that spawn, because each plan is made from the one before
    """

    def __init__(self, context: NodeContext, states: SimulationInterfaces, files: FilesBelow,
                 types: StandardTypes, group: CallbackGroup) -> None:
        self._context, self._simulation, self._thread = context, context.simulation, context.thread
        self._states, self._files, self._types = states, files, types
        self._robots = SpawnedRobots(context)
        types.offer(context.node, {
            'LoadWorld': answering_later(self._load),
            'UnloadWorld': answering_later(self._unload)}, group)
        types.offer(context.node, {
            'GetCurrentWorld': answering(self._get_current),
            'GetAvailableWorlds': answering(self._get_available),
            'GetNamedPoses': answering(self._get_poses),
            'GetNamedPoseBounds': answering(self._get_pose_bounds),
            'GetSpawnables': answering(self._get_spawnables)}, MutuallyExclusiveCallbackGroup())

    async def _load(self, request: Any, response: Any) -> None:
        resource = resource_of(request, 'world_resource')
        if not resource.uri:
            if resource.resource_string:
                raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED,
                                'a world cannot be loaded from a text, give a uri')
            raise Rejection(LoadCode.NO_RESOURCE, 'give the uri of a world')
        if not resource.uri.startswith(_SCHEME):
            raise Rejection(LoadCode.UNSUPPORTED_FORMAT, f'uri {quoted(resource.uri)}: only '
                            f'arenas can be loaded, such as {_SCHEME}table; those of files are '
                            'found in the folders of the parameter model_path')
        name = resource.uri.removeprefix(_SCHEME)
        if name not in arena_names():
            raise UnknownNameError('arena', name, arena_names())
        await self._enter(name)
        self._fill(response.world, name)

    async def _unload(self, _: Any, __: Any) -> None:
        if self._states.no_world:
            raise Rejection(WorldCode.NO_WORLD_LOADED, 'no world is loaded')
        await self._enter('empty')
        self._states.no_world = True

    async def _enter(self, name: str) -> None:
        """Replace the arena, and stop the simulation at the start."""
        reject_if_diverged(self._simulation)
        if self._context.parameters.value('task'):
            raise Rejection(ResultCode.RESULT_OPERATION_FAILED,
                            'the world belongs to a task, which needs it')
        # A world that cannot be used is rejected before anything goes.
        await in_background(self._context.node, lambda: self._plan(name))
        for robot in self._robots.names:
            await self._robots.remove(robot)
        plan = await in_background(self._context.node, lambda: self._plan(name))
        self._thread.change_robots(plan, 'the arena was replaced')
        self._states.stop()
        self._context.world_changed()

    def _plan(self, name: str) -> RobotsPlan:
        simulation = self._simulation
        return plan_in_arena(simulation, create_arena(name), chosen_cameras(
            self._context.parameters.value('cameras'), simulation.world, simulation.model))

    def _get_current(self, _: Any, response: Any) -> None:
        if self._states.no_world:
            raise Rejection(WorldCode.NO_WORLD_LOADED, 'no world is loaded')
        self._fill(response.world, self._simulation.world.arena.arena_name)

    def _get_available(self, request: Any, response: Any) -> None:
        if request.filter.tags:
            raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED, 'worlds have no tags')
        if request.additional_sources:
            unknown = (f'cannot search {", ".join(map(quoted, request.additional_sources))}: name '
                       'the folders of files of arenas in the parameter model_path')
            if not request.continue_on_error:
                raise Rejection(ResultCode.RESULT_OPERATION_FAILED, unknown)
            response.result.error_message = unknown
        response.worlds = [self._fill(self._types.messages.WorldResource(), name)
                           for name in arena_names()]

    @staticmethod
    def _fill(world: Any, name: str) -> Any:
        world.name, world.world_resource.uri = name, f'{_SCHEME}{name}'
        if ARENAS.find_file(name) is None and name in ARENAS.names():
            world.description = (inspect.getdoc(ARENAS.get(name)) or '').partition('\n')[0]
        return world

    def _sites(self) -> dict[str, int]:
        """Return the sites of the arena, which are its named poses, by name."""
        model = self._simulation.model
        there = {site.name for site in self._simulation.world.arena.compose().sites if site.name}
        return {model.site(site).name: site for site in range(model.nsite)
                if model.site(site).name in there}

    def _get_poses(self, request: Any, response: Any) -> None:
        poses, simulation = [], self._simulation
        passes = has_tags((), request.tags)

        def read() -> list[tuple[str, list[float]]]:
            found = []
            for name, site in self._sites().items():
                quat = np.empty(4)
                mujoco.mju_mat2Quat(quat, simulation.data.site_xmat[site])
                found.append((name, [*simulation.data.site_xpos[site], *wxyz_to_xyzw(quat)]))
            return found
        for name, numbers in self._thread.call(read):
            if passes:
                message = self._types.messages.NamedPose(name=name)
                message.description = 'a site of the arena'
                filled(message.pose, np.array(numbers))
                poses.append(message)
        response.poses = poses

    def _get_pose_bounds(self, request: Any, _: Any) -> None:
        """Answer with empty bounds: the standard's word for what has none."""
        sites = self._thread.call(self._sites)
        if request.name not in sites:
            raise UnknownNameError('named pose', request.name, sites)

    def _get_spawnables(self, request: Any, response: Any) -> None:
        unknown = [source for source in request.sources
                   if not any(map(self._files.is_folder, self._files.places(source)))]
        if unknown:
            response.result.error_message = (
                f'not below spawn_roots: {", ".join(map(quoted, unknown))}')
        spawnables = []
        for file in self._files.found(SUFFIXES, _MOST_FILES):
            spawnables.append(self._types.messages.Spawnable(description='a file'))
            resource_of(spawnables[-1], 'entity_resource').uri = file.as_uri()
        for name in robot_names():
            spawnable = self._types.messages.Spawnable(description=f'the robot {name}')
            resource = resource_of(spawnable, 'entity_resource')
            if hasattr(resource, 'resource_string'):  # In version 1 there are uris only.
                resource.resource_string = f'{{{RequestedRobot.KEY}: {name}}}'
                spawnables.append(spawnable)
        response.spawnables = spawnables
