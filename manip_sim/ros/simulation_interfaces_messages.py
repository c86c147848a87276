# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Answers of ``simulation_interfaces``, with its numbers, the same in its versions 1 and 2.

The services are offered that the installed version has: :class:`StandardTypes`.

The numbers are copied because the package may be absent; where it is installed, a test compares
them with it.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
import re
from typing import Any

from rclpy.callback_groups import CallbackGroup

from manip_sim.errors import ManipSimError, ModelError, UnknownNameError
from manip_sim.quoting import quoted
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import Simulation


#: Before a word within a name such as ``GetEntities``.
_CAPITAL = re.compile('(?<!^)(?=[A-Z])')


class ResultCode(IntEnum):
    """Constants of the message ``Result``."""

    RESULT_FEATURE_UNSUPPORTED = 0
    RESULT_OK = 1
    RESULT_NOT_FOUND = 2
    RESULT_INCORRECT_STATE = 3
    RESULT_OPERATION_FAILED = 4


class SetStateCode(IntEnum):
    """Constants of the response of ``SetSimulationState``."""

    ALREADY_IN_TARGET_STATE = 101
    STATE_TRANSITION_ERROR = 102


class SetEntityCode(IntEnum):
    """Constants of the response of ``SetEntityState``."""

    INVALID_POSE = 101


class SpawnCode(IntEnum):
    """Constants of the response of ``SpawnEntity``."""

    NAME_NOT_UNIQUE = 101
    NAME_INVALID = 102
    UNSUPPORTED_FORMAT = 103
    NO_RESOURCE = 104
    NAMESPACE_INVALID = 105
    RESOURCE_PARSE_ERROR = 106
    INVALID_POSE = 109


class SpawnAllCode(IntEnum):
    """Constants of the response of ``SpawnEntities``."""

    ENTITIES_SPAWN_FAILED = 150


class LoadCode(IntEnum):
    """Constants of the response of ``LoadWorld``."""

    UNSUPPORTED_FORMAT = 101
    NO_RESOURCE = 102


class WorldCode(IntEnum):
    """Constants of the responses of ``GetCurrentWorld`` and ``UnloadWorld``."""

    NO_WORLD_LOADED = 101


class StateCode(IntEnum):
    """Constants of the message ``SimulationState``."""

    STATE_STOPPED = 0
    STATE_PLAYING = 1
    STATE_PAUSED = 2
    STATE_NO_WORLD = 4


class ScopeCode(IntEnum):
    """Constants of the request of ``ResetSimulation``."""

    SCOPE_DEFAULT = 0
    SCOPE_TIME = 1
    SCOPE_STATE = 2
    SCOPE_ALL = 255


class Category(IntEnum):
    """Constants of the message ``EntityCategory``."""

    CATEGORY_OBJECT = 0
    CATEGORY_ROBOT = 1
    CATEGORY_HUMAN = 2
    CATEGORY_DYNAMIC_OBJECT = 4
    CATEGORY_STATIC_OBJECT = 5


class BoundsType(IntEnum):
    """Constants of the message ``Bounds``."""

    TYPE_EMPTY = 0
    TYPE_BOX = 1
    TYPE_CONVEX_HULL = 2
    TYPE_SPHERE = 3


class TagsMode(IntEnum):
    """Constants of the message ``TagsFilter``."""

    FILTER_MODE_ANY = 0
    FILTER_MODE_ALL = 1


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
    """A request cannot be served, with the result code that says why."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


def reject_if_diverged(simulation: Simulation,
                       code: int = ResultCode.RESULT_INCORRECT_STATE) -> None:
    """
    Reject a request while the physics is on hold.

    :raises Rejection: if the simulation has diverged
    """
    if simulation.diverged is not None:
        raise Rejection(code, f'{simulation.diverged}; reset it first')


def change_unless_diverged(simulation: Simulation, thread: SimulationThread,
                           change: Callable[[], Any]) -> None:
    """
    Change a simulation in its thread.

    :raises Rejection: if it has diverged; then nothing is called
    """
    def checked() -> None:
        reject_if_diverged(simulation)
        change()
    thread.call(checked)


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
