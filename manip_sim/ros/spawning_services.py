# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
``SpawnEntity`` and ``DeleteEntity`` of ``simulation_interfaces``, for objects and robots.

First come the numbers and responses of all its services, the same in its versions 1 and 2. The
numbers are copied because the package may be absent; where it is installed, a test compares them
with it. The services are offered that the installed version has: :class:`StandardTypes`.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from pathlib import Path
import re
from typing import Any
from urllib.parse import unquote, urlsplit

from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup

from manip_sim.algebra import xyzw_to_wxyz
from manip_sim.errors import CommandError, ManipSimError, ModelError, UnknownNameError
from manip_sim.interface.composition import check_robot_name
from manip_sim.models.asset_files import MissingAssetError, UnsupportedAssetError
from manip_sim.models.object_creation import (
    create_object, named_by_itself, object_from_model, object_from_text, ObjectModel, UNNAMED)
from manip_sim.models.object_model import check_object_name
from manip_sim.models.untrusted_models import load_self_contained
from manip_sim.models.user_files import AllowedRoots, InMemoryFile, parse_requested
from manip_sim.physics.object_spawning import plan_with, plan_without, WorldPlan
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quoting import quoted
from manip_sim.ros.executor import in_background, Rounds
from manip_sim.ros.feature import NodeContext
from manip_sim.ros.messages import numbers_of, WORLD
from manip_sim.simulation.robot_spawning import (
    plan_with_robot, plan_without_robot, RequestedRobot, RobotsPlan)

#: Before a word within a name such as ``GetEntities``.
_CAPITAL = re.compile('(?<!^)(?=[A-Z])')

#: Constants of the message ``Result``.
ResultCode = IntEnum('ResultCode', {
    'RESULT_FEATURE_UNSUPPORTED': 0, 'RESULT_OK': 1, 'RESULT_NOT_FOUND': 2,
    'RESULT_INCORRECT_STATE': 3, 'RESULT_OPERATION_FAILED': 4})
#: Constants of the response of ``SetSimulationState``.
SetStateCode = IntEnum('SetStateCode', {
    'ALREADY_IN_TARGET_STATE': 101, 'STATE_TRANSITION_ERROR': 102})
#: Constants of the response of ``SetEntityState``.
SetEntityCode = IntEnum('SetEntityCode', {'INVALID_POSE': 101})
#: Constants of the response of ``SpawnEntity``.
SpawnCode = IntEnum('SpawnCode', {
    'NAME_NOT_UNIQUE': 101, 'NAME_INVALID': 102, 'UNSUPPORTED_FORMAT': 103, 'NO_RESOURCE': 104,
    'NAMESPACE_INVALID': 105, 'RESOURCE_PARSE_ERROR': 106, 'MISSING_ASSETS': 107,
    'UNSUPPORTED_ASSETS': 108, 'INVALID_POSE': 109})
#: Constants of the response of ``SpawnEntities``.
SpawnAllCode = IntEnum('SpawnAllCode', {'ENTITIES_SPAWN_FAILED': 150})
#: Constants of the response of ``LoadWorld``.
LoadCode = IntEnum('LoadCode', {'UNSUPPORTED_FORMAT': 101, 'NO_RESOURCE': 102})
#: Constants of the responses of ``GetCurrentWorld`` and ``UnloadWorld``.
WorldCode = IntEnum('WorldCode', {'NO_WORLD_LOADED': 101})
#: Constants of the message ``SimulationState``.
StateCode = IntEnum('StateCode', {
    'STATE_STOPPED': 0, 'STATE_PLAYING': 1, 'STATE_PAUSED': 2, 'STATE_NO_WORLD': 4})
#: Constants of the request of ``ResetSimulation``.
ScopeCode = IntEnum('ScopeCode', {
    'SCOPE_DEFAULT': 0, 'SCOPE_TIME': 1, 'SCOPE_STATE': 2, 'SCOPE_SPAWNED': 4, 'SCOPE_ALL': 255})
#: Constants of the message ``EntityCategory``.
Category = IntEnum('Category', {
    'CATEGORY_OBJECT': 0, 'CATEGORY_ROBOT': 1, 'CATEGORY_HUMAN': 2,
    'CATEGORY_DYNAMIC_OBJECT': 4, 'CATEGORY_STATIC_OBJECT': 5})
#: Constants of the message ``Bounds``.
BoundsType = IntEnum('BoundsType', {
    'TYPE_EMPTY': 0, 'TYPE_BOX': 1, 'TYPE_CONVEX_HULL': 2, 'TYPE_SPHERE': 3})
#: Constants of the message ``TagsFilter``.
TagsMode = IntEnum('TagsMode', {'FILTER_MODE_ANY': 0, 'FILTER_MODE_ALL': 1})


class FeatureCode(IntEnum):
    """Constants of ``SimulatorFeatures`` for what is supported, and an interface of each."""

    needed: str

    def __new__(cls, number: int, needed: str = 'GetSimulatorFeatures') -> FeatureCode:
        """Return a feature that versions of the package without an interface do not have."""
        feature = int.__new__(cls, number)
        feature._value_, feature.needed = number, needed
        return feature

    SPAWNING = 0
    DELETING = 1
    NAMED_POSES = 2, 'GetNamedPoses'
    POSE_BOUNDS = 3, 'GetNamedPoseBounds'
    ENTITY_TAGS = 4, 'SetEntityInfo'
    ENTITY_BOUNDS = 5, 'GetEntityBounds'
    ENTITY_BOUNDS_BOX = 6
    ENTITY_CATEGORIES = 8
    SPAWNING_RESOURCE_STRING = 9
    ENTITY_STATE_GETTING = 10
    ENTITY_STATE_SETTING = 11
    ENTITY_INFO_GETTING = 12, 'GetEntityInfo'
    ENTITY_INFO_SETTING = 13, 'SetEntityInfo'
    SPAWNABLES = 14, 'GetSpawnables'
    SIMULATION_RESET = 20
    SIMULATION_RESET_STATE = 22
    SIMULATION_RESET_SPAWNED = 23
    SIMULATION_STATE_GETTING = 24
    SIMULATION_STATE_SETTING = 25
    SIMULATION_STATE_PAUSE = 26
    STEP_SIMULATION_SINGLE = 31
    STEP_SIMULATION_MULTIPLE = 32
    STEP_SIMULATION_ACTION = 33, 'SimulateSteps'
    WORLD_LOADING = 40, 'LoadWorld'
    WORLD_UNLOADING = 43, 'UnloadWorld'
    WORLD_INFO_GETTING = 44, 'GetCurrentWorld'
    AVAILABLE_WORLDS = 45, 'GetAvailableWorlds'
    SPAWNING_ENTITIES = 50, 'SpawnEntities'


@dataclass(frozen=True)
class StandardTypes:
    """
    The interfaces of the installed version of the package.

    :ivar services: such as ``simulation_interfaces.srv``
    :ivar messages: such as ``simulation_interfaces.msg``
    :ivar actions: such as ``simulation_interfaces.action``
    """

    services: Any
    messages: Any
    actions: Any

    def has(self, name: str) -> bool:
        """Return whether there is a service or an action of this name."""
        return hasattr(self.services, name) or hasattr(self.actions, name)

    def offer(self, node: Any, answers: Mapping[str, Callable[[Any, Any], Any]],
              group: CallbackGroup) -> None:
        """
        Offer the services that there are, under ``~/`` with their names in small letters.

        :param answers: callbacks by name of a service
        """
        for name, answer in answers.items():
            if hasattr(self.services, name):
                node.create_service(getattr(self.services, name), f'~/{_CAPITAL.sub("_", name)}'
                                    .lower(), answer, callback_group=group)


def resource_of(message: Any, field: str) -> Any:
    """
    Return the part of a message with the uri and the text; in older versions the message itself.

    :param field: name of that part in newer versions
    """
    return getattr(message, field, message)


class Rejection(ManipSimError):
    """A request cannot be served, with a result code that says more than that it failed."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


def check_frame(frame_id: str) -> None:
    """
    Check that a pose is in ``world``.

    :raises Rejection: if it is in another frame
    """
    if frame_id not in ('', WORLD):
        raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED, f'frame_id {quoted(frame_id)} is '
                        f"not supported: leave it empty or write '{WORLD}'")


def reject_if_diverged(context: NodeContext, code: int = ResultCode.RESULT_INCORRECT_STATE
                       ) -> None:
    """
    Reject a request while the physics is on hold.

    :raises Rejection: if the simulation has diverged
    """
    diverged = context.simulation.diverged
    if diverged is not None:
        raise Rejection(code, f'{diverged}; reset it first')


def change_unless_diverged(context: NodeContext, change: Callable[[], Any]) -> None:
    """
    Change the simulation in its thread.

    :raises Rejection: if it has diverged; then nothing is called
    """
    def checked() -> None:
        reject_if_diverged(context)
        change()
    context.thread.call(checked)


def free_name(wanted: str, may_rename: bool, taken: Collection[str], problem: str,
              check: Callable[[str], Any]) -> str:
    """
    Return the name of what comes.

    :param wanted: name that a client asks for
    :param may_rename: whether a number may follow it
    :param taken: names that something has
    :param problem: says that a name, which stands for ``{}``, is taken
    :param check: raises a ``ModelError`` if something cannot be a name
    :raises Rejection: if it cannot be a name, or something has it
    """
    free, number = wanted, 1
    while may_rename and free in taken:
        free, number = f'{wanted}_{number}', number + 1
    if free in taken:
        raise Rejection(SpawnCode.NAME_NOT_UNIQUE, problem.format(quoted(free)))
    try:
        check(free)
    except ModelError as error:
        raise Rejection(SpawnCode.NAME_INVALID, str(error)) from error
    return free


@contextmanager
def result_filled(result: Any) -> Iterator[None]:
    """Write into a ``Result`` whether the block succeeds; a ``ManipSimError`` is suppressed."""
    result.result = int(ResultCode.RESULT_OK)
    try:
        yield
    except ManipSimError as error:
        code: int = ResultCode.RESULT_OPERATION_FAILED
        if isinstance(error, Rejection):
            code = error.code
        elif isinstance(error, UnknownNameError):
            code = ResultCode.RESULT_NOT_FOUND
        result.result, result.error_message = int(code), str(error)


def answering(fill: Callable[[Any, Any], None]) -> Callable[[Any, Any], Any]:
    """
    Return the callback of a service, which writes into the response whether it succeeded.

    :param fill: fills the response to a request, or raises a ``ManipSimError``
    """
    def answer(request: Any, response: Any) -> Any:
        with result_filled(response.result):
            fill(request, response)
        return response
    return answer


def answering_later(fill: Callable[[Any, Any], Awaitable[None]]) -> Callable[[Any, Any], Any]:
    """Return the callback of a service as :func:`answering`, for a coroutine."""
    async def answer(request: Any, response: Any) -> Any:
        with result_filled(response.result):
            await fill(request, response)
        return response
    return answer


def add_robot(context: NodeContext, name: str, plan: RobotsPlan) -> None:
    """
    Add a robot, in the thread that spins the node.

    :param plan: with the robot
    :raises Rejection: if the physics is on hold
    """
    change_unless_diverged(context, partial(context.thread.change_robots, plan))
    context.add_robot(name)


async def delete_robot(context: NodeContext, name: str) -> None:
    """
    Remove a spawned robot, whose goals are aborted; awaited in the thread that spins the node.

    :raises ModelError: if the world cannot be without it
    """
    plan = await in_background(context.node, lambda: plan_without_robot(context.simulation, name))
    await context.remove_robot(name, partial(context.thread.change_robots, plan))


_OTHER_CHARACTERS = re.compile(r'[^A-Za-z0-9_]+')
#: Formats of files and texts.
FORMATS = ('mjcf', 'urdf', 'yaml')
_URDF = ('.urdf', '.xacro')
_YAML, _MJCF = ('.yaml', '.yml'), ('.xml', '.mjcf')
#: Ends of the names of files that can be spawned.
SUFFIXES = (*_MJCF, *_URDF, *_YAML)
#: Longest text that is read in the executor.
_MAX_QUICK = 5_000


@dataclass(frozen=True)
class _NewObject:
    """
    An object that comes.

    :ivar arguments: of the operation that spawns it
    :ivar response: to its request
    """

    item: ObjectModel
    arguments: list[Any]
    response: Any


class SpawningServices:
    """
    The services that add and delete objects and robots while the simulation runs.

    A new object or robot that may take long is read, tried and compiled in the background; the
    simulation's thread takes the new world over between two control periods, with everything else
    as it was.

    :param files: that a request may name
    :param types: the message types of the package
    :ivar files: as given
    :ivar group: of the services
    """

    def __init__(self, context: NodeContext, files: AllowedRoots, types: StandardTypes) -> None:
        self._context, self._simulation = context, context.simulation
        self.files, self._messages = files, types.messages
        # One group, because each plan is made from the one before.
        self.group = MutuallyExclusiveCallbackGroup()
        types.offer(context.node, {
            'SpawnEntity': answering_later(self._spawn),
            'SpawnEntities': answering_later(self._spawn_all),
            'DeleteEntity': answering_later(self._delete)}, self.group)

    async def _spawn_all(self, request: Any, response: Any) -> None:
        response.results = [self._messages.SpawnResult() for _ in request.spawn_requests]
        await self._spawn_in_turn([*zip(request.spawn_requests, response.results)])
        results = response.results
        reasons = [result.result.error_message for result in results
                   if result.result.result != ResultCode.RESULT_OK]
        if reasons:
            raise Rejection(SpawnAllCode.ENTITIES_SPAWN_FAILED,
                            f'{len(reasons)} of {len(results)} failed, the first: {reasons[0]}')

    async def _spawn(self, request: Any, response: Any) -> None:
        await self._spawn_in_turn([(request, response)])

    async def _spawn_in_turn(self, requests: list[tuple[Any, Any]]) -> None:
        """
        Spawn one after the other, whatever becomes of those before.

        Objects wait for each other, as compiling the world takes as long for many as for one.

        :param requests: and their responses
        """
        objects: list[_NewObject] = []
        for request, response in requests:
            with result_filled(response.result):
                pose = _pose(request.initial_pose)
                with _parsing():
                    is_quick, create = _prepared(request, self.files)
                    item = create() if is_quick else await in_background(
                        self._context.node, create)
                if isinstance(item, RequestedRobot):
                    await self._add_objects(objects)
                    objects = []
                    await self._add_robot(item, request, response, pose)
                else:
                    objects.append(self._new_object(item, request, response, pose, objects))
            if len(requests) > 1:
                await Rounds(self._context.node)
        await self._add_objects(objects)

    def _new_object(self, item: ObjectModel, request: Any, response: Any, pose: Pose,
                    before: list[_NewObject]) -> _NewObject:
        if request.entity_namespace.strip('/'):
            raise Rejection(SpawnCode.NAMESPACE_INVALID,
                            'an object is published below objects/ and has no namespace')
        if not (request.name or request.allow_renaming or item.name != UNNAMED):
            raise Rejection(SpawnCode.NAME_INVALID, 'it has no name: give one in the request, or '
                            'allow renaming')
        item.name = self._free_name(request.name or item.name, request.allow_renaming,
                                    {new.item.name for new in before})
        place = pose.position.tolist(), xyzw_to_wxyz(pose.quat_xyzw).tolist()
        item.place(*place)
        resource = resource_of(request, 'entity_resource')
        text = None if resource.uri else resource.resource_string.strip()
        return _NewObject(item, [item.name, text, *place], response)

    async def _add_objects(self, objects: list[_NewObject]) -> None:
        """Add objects in one change, but for those that the world cannot have."""
        if not objects:
            return
        simulation, half = self._simulation, len(objects) // 2
        try:
            plan = await in_background(self._context.node, lambda: plan_with(
                simulation.plan, *(new.item for new in objects)))
        except ModelError as error:
            if half:
                await self._add_objects(objects[:half])
                await self._add_objects(objects[half:])
                return
            with result_filled(objects[0].response.result):
                raise Rejection(SpawnCode.RESOURCE_PARSE_ERROR, str(error)) from error
            return
        arguments = [new.arguments for new in objects]
        try:
            self._take_over(plan, *(
                ('spawn_all', arguments) if half else ('spawn', *arguments[0])))
        except Rejection as error:
            for new in objects:
                with result_filled(new.response.result):
                    raise error
            return
        for new in objects:
            new.response.entity_name = new.item.name

    async def _add_robot(self, item: RequestedRobot, request: Any, response: Any, pose: Pose
                         ) -> None:
        name = self._free_robot_name(request.name or item.name, request.allow_renaming)
        if request.entity_namespace.strip('/') not in ('', name):
            raise Rejection(SpawnCode.NAMESPACE_INVALID, f'the namespace of a robot is its name, '
                            f'{quoted(name)}: leave entity_namespace empty')
        with _parsing():
            plan = await in_background(self._context.node, lambda: plan_with_robot(
                self._simulation, item.create(name, pose)))
        add_robot(self._context, name, plan)
        response.entity_name = name

    def _free_robot_name(self, requested: str, may_rename: bool) -> str:
        context, simulation = self._context, self._simulation
        taken = {*simulation.robots, *simulation.entities.names,
                 *(row.name.partition('/')[0] for row in context.table if '/' in row.name),
                 *(name.partition('.')[0] for name in context.parameters.names if '.' in name)}
        return free_name(requested, may_rename, taken, '{} is taken: by a robot, an object, a '
                         'topic or a parameter', check_robot_name)

    def _free_name(self, requested: str, may_rename: bool, also_taken: set[str]) -> str:
        if may_rename:
            requested = _OTHER_CHARACTERS.sub('_', requested).lstrip('_0123456789') or UNNAMED
        return free_name(requested, may_rename, {*self._simulation.entities.names, *also_taken},
                         'there is an entity {} already',
                         partial(check_object_name, source='name'))

    async def _delete(self, request: Any, _: Any) -> None:
        name, plan = request.entity, self._simulation.plan
        if name in self._simulation.spawned_robots:
            await delete_robot(self._context, name)
            return
        if name in self._simulation.entities.names and name not in plan.object_names:
            raise CommandError(f"'{name}' belongs to the arena or a robot that was there at the "
                               'start, and cannot be deleted')
        self._take_over(plan_without(plan, name), 'delete', name)

    async def despawn(self) -> None:
        """
        Remove all objects and robots that came while the simulation ran; in :attr:`group`.

        :raises Rejection: if the physics is on hold, and there are some
        """
        for robot in list(self._simulation.spawned_robots):
            await delete_robot(self._context, robot)
        names, plan = self._context.thread.changes.operations.spawned, self._simulation.plan
        if names:
            self._take_over(await in_background(
                self._context.node, lambda: plan_without(plan, *names)), 'despawn')

    def _take_over(self, plan: WorldPlan, operation: str, *arguments: Any) -> None:
        change_unless_diverged(self._context, partial(
            self._context.thread.change, operation, *arguments, using=plan))
        self._context.world_changed()


@contextmanager
def _parsing() -> Iterator[None]:
    try:
        yield
    except ModelError as error:
        code = next((code for kind, code in _CODES.items() if isinstance(error, kind)),
                    SpawnCode.RESOURCE_PARSE_ERROR)
        raise Rejection(code, str(error)) from error


#: Codes of errors of models that say more than that one cannot be read.
_CODES = {MissingAssetError: SpawnCode.MISSING_ASSETS,
          UnsupportedAssetError: SpawnCode.UNSUPPORTED_ASSETS}
#: Kinds of things that a request may bring.
_Item = ObjectModel | RequestedRobot


def _prepared(request: Any, files: AllowedRoots) -> tuple[bool, Callable[[], _Item]]:
    """Return whether it is quickly made for sure, and return what makes it."""
    resource = resource_of(request, 'entity_resource')
    if resource.uri:
        path = _path(resource.uri)
        return False, lambda: _from_file(path, files)
    # The text is used without a file.
    text = InMemoryFile(resource.resource_string.strip(), 'resource_string')
    if not text.content:
        raise Rejection(SpawnCode.NO_RESOURCE, 'give a file (uri) or a text (resource_string)')
    if len(text.content) > _MAX_QUICK:
        return False, lambda: _from_text(text, files)[1]()
    return _from_text(text, files)


def _from_text(text: InMemoryFile, files: AllowedRoots) -> tuple[bool, Callable[[], _Item]]:
    from manip_sim.models.files.urdf import is_moving_urdf
    if is_moving_urdf(text.content):
        return False, lambda: RequestedRobot.from_text(text, files)
    if not text.content.startswith(b'<'):
        values = parse_requested(text.content, str(text.file))
        if RequestedRobot.KEY in values:
            return False, lambda: RequestedRobot(values, str(text.file), files)
    return object_from_text(text)


def _from_file(path: str, files: AllowedRoots) -> _Item:
    file = files.first(files.places(path))
    if file.suffix in _YAML:
        values = parse_requested(files.read(file, 'YAML file'), str(file))
        if RequestedRobot.KEY in values:
            return RequestedRobot(values, str(file), files, file.parent)
        return create_object(file, files)
    if file.suffix in _URDF:
        return RequestedRobot({RequestedRobot.KEY: str(file)}, str(file), files)
    return named_by_itself(object_from_model(load_self_contained(file, files), UNNAMED))


def _path(uri: str) -> str:
    try:
        parts = urlsplit(uri)
    except ValueError as error:
        raise Rejection(SpawnCode.UNSUPPORTED_FORMAT, f'uri {quoted(uri)}: {error}') from error
    if parts.scheme not in ('', 'file') or parts.netloc not in ('', 'localhost'):
        raise Rejection(SpawnCode.UNSUPPORTED_FORMAT,
                        f'uri {quoted(uri)}: only paths and file:// can be read')
    path = unquote(parts.path)
    if Path(path).suffix not in SUFFIXES:
        raise Rejection(SpawnCode.UNSUPPORTED_FORMAT,
                        f'uri {quoted(uri)}: only MJCF (.xml, .mjcf), URDF and YAML can be read')
    return path


def _pose(message: Any) -> Pose:
    check_frame(message.header.frame_id)
    try:
        return Pose.checked(numbers_of(message.pose.position),
                            numbers_of(message.pose.orientation))
    except CommandError as error:
        raise Rejection(SpawnCode.INVALID_POSE, str(error)) from error
