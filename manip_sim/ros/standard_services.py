# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The services of the package ``simulation_interfaces``, where that is installed."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
import inspect
from typing import Any

from geometry_msgs.msg import Vector3
import mujoco
import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

from manip_sim.algebra import wxyz_to_xyzw
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.interface.composition import spawn_files
from manip_sim.models import arena_names, create_arena
from manip_sim.models.arenas import ARENAS
from manip_sim.models.cameras import chosen_cameras
from manip_sim.models.robots import robot_names
from manip_sim.physics.entities import Box, EntityState, Sphere
from manip_sim.physics.poses_and_twists import Pose, Twist
from manip_sim.quoting import one_line, quoted
from manip_sim.ros.executor import in_background, Rounds
from manip_sim.ros.feature import Feature, NodeContext
from manip_sim.ros.messages import filled, import_optional, numbers_of, stamp_of, WORLD
from manip_sim.ros.spawning_services import (
    answering, answering_later, BoundsType, Category, change_unless_diverged, check_frame,
    FeatureCode, FORMATS, LoadCode, reject_if_diverged, Rejection, resource_of,
    result_filled, ResultCode, ScopeCode, SetEntityCode, SetStateCode, SpawningServices,
    StandardTypes, StateCode, SUFFIXES, TagsMode, WorldCode)
from manip_sim.simulation.robot_spawning import plan_in_arena, RequestedRobot, RobotsPlan

re2 = import_optional('re2')
#: Of a regular expression, as a program and as a text; RE2 takes long for thousands of brackets.
_MAX_FILTER_BYTES, _MAX_FILTER_LENGTH = 2**20, 1000
#: Longest description of an entity, most tags and longest tag, so that requests cannot fill the
#: memory.
_MAX_DESCRIPTION, _MAX_TAGS, _MAX_TAG = 10_000, 100, 200
_ABOUT = ('manip_sim: a step is one control period, 1/publish_rate of simulation time; scope ALL '
          'of a reset restarts simulation time, scope STATE lets it go on.')
#: Scopes that can be together.
_SCOPES = ScopeCode.SCOPE_TIME | ScopeCode.SCOPE_STATE | ScopeCode.SCOPE_SPAWNED


@dataclass(frozen=True)
class _Info:
    """Information about an entity that a client has set, or by default its kind."""

    category: int
    description: str = ''
    tags: tuple[str, ...] = ()


class EntityServices:
    """
    The services that list robots and objects, describe and measure them, and move free ones.

    :param types: the message types of the package
    """

    def __init__(self, context: NodeContext, types: StandardTypes) -> None:
        self._context, self._simulation, self._thread = context, context.simulation, context.thread
        self._messages = types.messages
        #: Information that clients have set, by the name of the entity.
        self._infos: dict[str, _Info] = {}
        # A group of their own: a request for many steps, in another group, does not hold them up.
        types.offer(context.node, {name: answering(fill) for name, fill in {
            'GetEntities': self._get_entities, 'GetEntitiesStates': self._get_states,
            'GetEntityInfo': self._get_info, 'SetEntityInfo': self._set_info,
            'GetEntityBounds': self._get_bounds, 'GetEntityState': self._get_entity_state,
            'SetEntityState': self._set_entity_state}.items()},
            MutuallyExclusiveCallbackGroup())

    def forget_gone(self) -> None:
        """Forget the set information of entities that are gone."""
        there = self._simulation.entities.names
        self._infos = {name: info for name, info in self._infos.items() if name in there}

    def _info(self, name: str) -> _Info:
        is_free = self._simulation.entities.is_free(name)
        return self._infos.get(name) or _Info(int(
            Category.CATEGORY_OBJECT if is_free else Category.CATEGORY_ROBOT))

    def _get_entities(self, request: Any, response: Any) -> None:
        response.entities = self._thread.call(partial(
            self._overlapping, _region(request.filters.bounds), self._candidates(request.filters)))

    def _get_states(self, request: Any, response: Any) -> None:
        """Answer with the states of one instant."""
        region, names = _region(request.filters.bounds), self._candidates(request.filters)
        simulation = self._simulation

        def read() -> tuple[int, dict[str, EntityState]]:
            return simulation.time_ns, {
                name: simulation.entities.read(simulation.data, name)
                for name in self._overlapping(region, names)}
        time_ns, states = self._thread.call(read)
        response.entities = list(states)
        response.states = [_fill_state(self._messages.EntityState(), time_ns, state)
                           for state in states.values()]

    def _candidates(self, filters: Any) -> list[str]:
        """Return the entities that filters but for bounds let pass."""
        categories = {category.category for category in filters.categories}
        return matching(filters.filter, [
            name for name in self._simulation.entities.names
            if (not categories or self._info(name).category in categories)
            and has_tags(self._info(name).tags, filters.tags)])

    def _overlapping(self, region: Box | Sphere | None, names: list[str]) -> list[str]:
        """Return the entities whose bounds overlap a region; in the simulation's thread."""
        if region is None:
            return names
        entities, data = self._simulation.entities, self._simulation.data
        return [name for name in names
                if (box := entities.bounds(data, name, in_world=True)) and region.overlaps(box)]

    def _get_info(self, request: Any, response: Any) -> None:
        info = self._info(request.entity)
        response.info.category.category = info.category
        response.info.description, response.info.tags = info.description, list(info.tags)

    def _set_info(self, request: Any, _: Any) -> None:
        self._info(request.entity)  # There is such an entity.
        info = request.info
        category, tags = int(info.category.category), tuple(info.tags)
        if category not in list(Category):
            raise CommandError(f'there is no category {category}, only '
                               + ', '.join(f'{c.name} ({c.value})' for c in Category))
        if (len(info.description) > _MAX_DESCRIPTION or len(tags) > _MAX_TAGS
                or any(len(tag) > _MAX_TAG for tag in tags)):
            raise CommandError(f'a description may have {_MAX_DESCRIPTION} characters, and an '
                               f'entity {_MAX_TAGS} tags of {_MAX_TAG} characters')
        self._infos[request.entity] = _Info(category, info.description, tags)

    def _get_bounds(self, request: Any, response: Any) -> None:
        simulation = self._simulation
        box = self._thread.call(
            lambda: simulation.entities.bounds(simulation.data, request.entity))
        if box is not None:
            response.bounds.type = int(BoundsType.TYPE_BOX)
            response.bounds.points = [filled(Vector3(), box.high), filled(Vector3(), box.low)]

    def _get_entity_state(self, request: Any, response: Any) -> None:
        name, simulation = request.entity, self._simulation
        _fill_state(response.state, *self._thread.call(
            lambda: (simulation.time_ns, simulation.entities.read(simulation.data, name))))

    def _set_entity_state(self, request: Any, response: Any) -> None:
        name = request.entity
        if not self._simulation.entities.is_free(name):
            raise CommandError(f"'{name}' cannot be moved, only free bodies can")
        check_frame(request.state.header.frame_id)
        pose, twist = _parts(request)

        change_unless_diverged(self._context, partial(
            self._thread.change, 'place', name, pose and _listed(pose.position, pose.quat_xyzw),
            twist and _listed(twist.linear, twist.angular)))


def has_tags(tags: Collection[str], wanted: Any) -> bool:
    """
    Return whether tags pass a filter.

    :param wanted: a ``TagsFilter``, which without tags lets everything pass
    :raises Rejection: if its mode is not known
    """
    if wanted.filter_mode not in list(TagsMode):
        raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED, f'tags: filter_mode '
                        f'{wanted.filter_mode} is not supported, only ANY (0) and ALL (1)')
    every = all if wanted.filter_mode == TagsMode.FILTER_MODE_ALL else any
    return not wanted.tags or every(tag in tags for tag in wanted.tags)


def _region(bounds: Any) -> Box | Sphere | None:
    """
    Return the region in ``world`` that bounds describe; None for empty bounds.

    :raises Rejection: if they are of a type that is not supported, or no region
    """
    kind = bounds.type
    if kind == BoundsType.TYPE_EMPTY:
        return None
    if kind not in (BoundsType.TYPE_BOX, BoundsType.TYPE_SPHERE):
        raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED, f'bounds of type {kind} are not '
                        'supported in filters, only EMPTY (0), BOX (1) and SPHERE (3)')
    points = np.array([numbers_of(point) for point in bounds.points]).reshape(-1, 3)
    name = 'a box' if kind == BoundsType.TYPE_BOX else 'a sphere'
    if len(points) != 2:
        raise CommandError(f'bounds: {name} has 2 points, got {len(points)}')
    if not np.isfinite(points if kind == BoundsType.TYPE_BOX else points.ravel()[:4]).all():
        raise CommandError(
            f'bounds: the numbers of {name} must be finite, got {points.tolist()}')
    if kind == BoundsType.TYPE_BOX:
        return Box(points.min(axis=0), points.max(axis=0))
    if points[1, 0] < 0.0:
        raise CommandError('bounds: the radius of a sphere must not be negative, got '
                           f'{points[1, 0]:g}')
    return Sphere(points[0], float(points[1, 0]))


def _fill_state(message: Any, time_ns: int, state: EntityState) -> Any:
    message.header.stamp, message.header.frame_id = stamp_of(time_ns), WORLD
    for part, numbers in (
            (message.pose, (state.pose.position, state.pose.quat_xyzw)),
            (message.twist, (state.twist.linear, state.twist.angular)),
            (message.acceleration, (state.linear_acceleration, state.angular_acceleration))):
        filled(part, np.concatenate(numbers))
    return message


def _listed(*vectors: Any) -> list[list[float]]:
    return [vector.tolist() for vector in vectors]


def _parts(request: Any) -> tuple[Pose | None, Twist | None]:
    """Return pose and twist to set, or None; version 1 of the standard has no flags, sets both."""
    state = request.state
    set_pose, set_twist = (getattr(request, flag, True) for flag in ('set_pose', 'set_twist'))
    pose = twist = None
    if not (set_pose or set_twist):
        raise CommandError('nothing to set: set_pose and set_twist are false, and an acceleration '
                           'cannot be set')
    if set_pose:
        try:
            pose = Pose.checked(*map(numbers_of, (state.pose.position, state.pose.orientation)))
        except CommandError as error:
            raise Rejection(SetEntityCode.INVALID_POSE, str(error)) from error
    if set_twist:
        twist = Twist.checked(numbers_of(state.twist.linear), numbers_of(state.twist.angular))
    return pose, twist


def matching(pattern: str, names: list[str]) -> list[str]:
    """
    Return the names in which a POSIX Extended regular expression matches.

    RE2 searches in a time that grows with the length of the names, unlike Python's ``re``.

    :raises Rejection: if it is none or too large, or RE2 is not installed
    """
    if not pattern:
        return names
    if re2 is None:
        raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED,
                        f'filter {quoted(pattern)}: regular expressions need the package '
                        "google-re2: pip install 'manip_sim[filters]'")
    options = re2.Options()
    options.posix_syntax, options.log_errors, options.max_mem = True, False, _MAX_FILTER_BYTES
    try:
        if len(pattern) > _MAX_FILTER_LENGTH:
            raise ValueError(f'longer than {_MAX_FILTER_LENGTH} characters')
        expression = re2.compile(pattern, options)
    except (re2.error, ValueError) as error:  # A text that is not UTF-8 raises ValueError.
        reason = error.args[0].decode() if type(error) is re2.error else error
        raise Rejection(ResultCode.RESULT_OPERATION_FAILED,
                        f'filter {quoted(pattern)}: {one_line(str(reason))}') from error
    return [name for name in names if expression.search(name) is not None]


class _Canceled(CommandError):
    """A client has cancelled a goal."""


class SimulationInterfaces:
    """
    The services of the standard for simulation state, steps and reset.

    A step is one control period. Scope ``ALL`` of a reset, and the state ``STOPPED``, restart
    simulation time and remove what was spawned; scope ``STATE`` does neither, as ``~/reset``.

    :param types: the message types of the package
    :param spawning: whose group a reset shares, because it removes what was spawned
    :ivar no_world: whether the world has been unloaded
    """

    def __init__(self, context: NodeContext, types: StandardTypes, spawning: SpawningServices
                 ) -> None:
        self._context, self._simulation, self._thread = context, context.simulation, context.thread
        self._types, self._spawning = types, spawning
        self._stopped = False
        self.no_world = False
        # A request for many steps takes long, so it does not hold up the others.
        groups = MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()
        types.offer(context.node, {'StepSimulation': answering_later(self._step)}, groups[0])
        types.offer(context.node, {
            'GetSimulatorFeatures': self._features,
            'GetSimulationState': answering(self._get_state)}, groups[1])
        types.offer(context.node, {
            'SetSimulationState': answering_later(self._set_state),
            'ResetSimulation': answering_later(self._reset)}, spawning.group)
        self._has_goal = False
        self._server = None
        if types.has('SimulateSteps'):
            self._server = ActionServer(
                context.node, types.actions.SimulateSteps, '~/simulate_steps', self._simulate,
                goal_callback=self._accept, cancel_callback=lambda _: CancelResponse.ACCEPT,
                callback_group=groups[1])

    def close(self) -> None:
        """Destroy the server of the action, which rclpy does not with its node."""
        if self._server is not None:
            self._server.destroy()

    def _features(self, _: Any, response: Any) -> Any:
        response.features.features = [
            int(feature) for feature in FeatureCode if self._types.has(feature.needed)]
        response.features.spawn_formats = list(FORMATS)
        response.features.custom_info = _ABOUT
        return response

    def _state(self) -> int:
        if not self._thread.paused:
            return int(StateCode.STATE_PLAYING)
        if self.no_world:
            return int(StateCode.STATE_NO_WORLD)
        if self._stopped and self._thread.at_start:
            return int(StateCode.STATE_STOPPED)
        return int(StateCode.STATE_PAUSED)

    def stop(self) -> None:
        """Stop the simulation at the start of a world that has been loaded."""
        self._thread.pause(True)
        self._thread.reset(restart_time=True)
        self._stopped, self.no_world = True, False

    def _reject_without_world(self) -> None:
        if self.no_world and self._thread.paused:
            raise Rejection(ResultCode.RESULT_INCORRECT_STATE,
                            'no world is loaded: load one first')

    def _get_state(self, _: Any, response: Any) -> None:
        response.state.state = self._state()

    async def _set_state(self, request: Any, _: Any) -> None:
        target = request.state.state
        self._reject_without_world()
        if target not in list(StateCode)[:3]:
            raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED,
                            f'state {target} cannot be set, only STOPPED (0), PLAYING (1) and '
                            'PAUSED (2); SIGTERM ends the simulator')
        if target == self._state():
            raise Rejection(SetStateCode.ALREADY_IN_TARGET_STATE,
                            'the simulation is in this state already')
        if target == StateCode.STATE_PLAYING:
            reject_if_diverged(self._context, SetStateCode.STATE_TRANSITION_ERROR)
        self._thread.pause(target != StateCode.STATE_PLAYING)
        if target == StateCode.STATE_STOPPED:
            await self._put_back(restart_time=True, despawn=True)
        self._stopped = target == StateCode.STATE_STOPPED

    async def _step(self, request: Any, _: Any) -> None:
        await self._make(request.steps, lambda done: None)

    async def _make(self, steps: int, after: Callable[[int], None]) -> None:
        """
        Make control periods while the simulation is paused.

        :param after: is called with the number of those that are made
        :raises CommandError: if one cannot be made
        """
        if steps == 0:
            raise CommandError('steps must be 1 or more, got 0')
        self._reject_without_world()
        if self._state() == StateCode.STATE_STOPPED:
            raise CommandError('the simulation is stopped: pause it first')
        for done in range(steps):
            try:
                self._thread.step()
            except CommandError as error:
                made = f' (after {done} of {steps} steps)' if done else ''
                raise CommandError(f'{error}{made}') from error
            after(done + 1)
            await Rounds(self._context.node)

    def _accept(self, _: Any) -> GoalResponse:
        if self._has_goal:
            self._context.log.warn('~/simulate_steps', 'second', 'rejected a goal of '
                                   '~/simulate_steps: another one is running')
            return GoalResponse.REJECT
        self._has_goal = True
        return GoalResponse.ACCEPT

    async def _simulate(self, goal_handle: Any) -> Any:
        """Make the steps of a goal, with feedback after each, until it is cancelled."""
        kind, steps = self._types.actions.SimulateSteps, goal_handle.request.steps
        result = kind.Result()

        def report(done: int) -> None:
            goal_handle.publish_feedback(kind.Feedback(
                completed_steps=done, remaining_steps=steps - done))
            if goal_handle.is_cancel_requested and done < steps:
                raise _Canceled(f'canceled after {done} of {steps} steps')
        try:
            with result_filled(result.result):
                await self._make(steps, report)
        finally:
            self._has_goal = False
        if result.result.result == ResultCode.RESULT_OK:
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return result

    async def _reset(self, request: Any, _: Any) -> None:
        self._reject_without_world()
        scope = _SCOPES if request.scope in (
            ScopeCode.SCOPE_DEFAULT, ScopeCode.SCOPE_ALL) else request.scope
        time, state, spawned = (bool(scope & each) for each in (
            ScopeCode.SCOPE_TIME, ScopeCode.SCOPE_STATE, ScopeCode.SCOPE_SPAWNED))
        if scope & ~_SCOPES or time and not state:
            raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED,
                            f'scope {scope} is not supported, only ALL (0 or 255), STATE (2), '
                            'SPAWNED (4), both (6), and TIME (1) with STATE')
        if state:
            await self._put_back(restart_time=time, despawn=spawned)
        else:
            await self._spawning.despawn()

    async def _put_back(self, restart_time: bool, despawn: bool) -> None:
        """Put the simulation to its start, without what was spawned if that is to go too."""
        if despawn:
            if self._simulation.diverged is not None:  # Nothing can go before a reset.
                self._thread.reset()
            await self._spawning.despawn()
        self._thread.reset(restart_time)


#: Scheme of the uris of arenas.
_SCHEME = 'arena:'
#: Most files that an answer names.
_MOST_FILES = 1000


class WorldServices:
    """
    The services that list, load and unload worlds, and list models and poses for spawning.

    A world is an arena. Loading one deletes all objects and the robots that were spawned; the
    robots of the start stay where their parameters put them.

    :param states: whose state is STOPPED after a world was loaded, and NO_WORLD after one was
        unloaded
    :param types: the message types of the package
    :param spawning: whose group these services share, because each plan is made from the one
        before, and whose files a request may name
    """

    def __init__(self, context: NodeContext, states: SimulationInterfaces, types: StandardTypes,
                 spawning: SpawningServices) -> None:
        self._context, self._simulation, self._thread = context, context.simulation, context.thread
        self._states, self._spawning, self._types = states, spawning, types
        types.offer(context.node, {
            'LoadWorld': answering_later(self._load),
            'UnloadWorld': answering_later(self._unload)}, spawning.group)
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
        reject_if_diverged(self._context)
        if self._context.parameters.value('task'):
            raise CommandError('the world belongs to a task, which needs it')
        # A world that cannot be used is rejected before anything goes.
        await in_background(self._context.node, lambda: self._plan(name))
        await self._spawning.despawn()
        plan = await in_background(self._context.node, lambda: self._plan(name))
        self._thread.change_robots(plan, 'the arena was replaced')
        self._states.stop()
        self._context.world_changed()

    def _plan(self, name: str) -> RobotsPlan:
        simulation = self._simulation
        return plan_in_arena(simulation, create_arena(name), chosen_cameras(
            self._context.parameters.value('cameras'), simulation.world.cameras,
            simulation.model))

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
                raise CommandError(unknown)
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
            rows = []
            for name, site in self._sites().items():
                quat = np.empty(4)
                mujoco.mju_mat2Quat(quat, simulation.data.site_xmat[site])
                rows.append((name, [*simulation.data.site_xpos[site], *wxyz_to_xyzw(quat)]))
            return rows
        for name, numbers in self._thread.call(read):
            if passes:
                message = self._types.messages.NamedPose(name=name)
                message.description = 'a site of the arena'
                filled(message.pose, np.array(numbers))
                poses.append(message)
        response.poses = poses

    def _get_pose_bounds(self, request: Any, _: Any) -> None:
        """Answer with empty bounds, by which the standard means a pose without bounds."""
        sites = self._thread.call(self._sites)
        if request.name not in sites:
            raise UnknownNameError('named pose', request.name, sites)

    def _get_spawnables(self, request: Any, response: Any) -> None:
        files = self._spawning.files
        unknown = [source for source in request.sources
                   if not any(map(files.is_folder, files.places(source)))]
        if unknown:
            response.result.error_message = (
                f'not below spawn_roots: {", ".join(map(quoted, unknown))}')
        spawnables = []
        for file in files.found(SUFFIXES, _MOST_FILES):
            spawnables.append(self._types.messages.Spawnable(description='a file'))
            resource_of(spawnables[-1], 'entity_resource').uri = file.as_uri()
        for name in robot_names():
            spawnable = self._types.messages.Spawnable(description=f'the robot {name}')
            resource = resource_of(spawnable, 'entity_resource')
            if hasattr(resource, 'resource_string'):  # In version 1 there are uris only.
                resource.resource_string = f'{{{RequestedRobot.KEY}: {name}}}'
                spawnables.append(spawnable)
        response.spawnables = spawnables


TYPES = StandardTypes(*(import_optional(f'simulation_interfaces.{kind}')
                        for kind in ('srv', 'msg', 'action')))
#: True if the package is installed.
AVAILABLE = TYPES.services is not None


class StandardServices(Feature):
    """
    The services of the standard under ``~/``; without their package a note.

    :raises ModelError: if the parameter ``spawn_roots`` names what is no folder
    """

    def __init__(self, context: NodeContext) -> None:
        files = spawn_files(context.parameters.value('spawn_roots'))
        if not AVAILABLE:
            context.missing['simulation_interfaces'] = 'standard simulation services'
            return
        spawning = SpawningServices(context, files, TYPES)
        self._simulation = SimulationInterfaces(context, TYPES, spawning)
        self._entities = EntityServices(context, TYPES)
        WorldServices(context, self._simulation, TYPES, spawning)

    def world_changed(self) -> None:
        if AVAILABLE:
            self._entities.forget_gone()

    def close(self) -> None:
        if AVAILABLE:
            self._simulation.close()
