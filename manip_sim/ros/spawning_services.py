# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``SpawnEntity`` and ``DeleteEntity`` of the package ``simulation_interfaces``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import tempfile
from typing import Any
from urllib.parse import unquote, urlsplit

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from manip_sim.errors import CommandError, ModelError
from manip_sim.models.object_model import check_object_name
from manip_sim.models.objects import create_object, ObjectModel
from manip_sim.models.quaternion import xyzw_to_wxyz
from manip_sim.models.strict_yaml import parse_yaml
from manip_sim.quoting import quoted
from manip_sim.ros.messages import WORLD
from manip_sim.ros.rejection import answering, Rejection
from manip_sim.ros.standard_codes import ResultCode, SpawnCode
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import Simulation
from manip_sim.simulation.poses import Pose
from manip_sim.simulation.spawning import Plan, plan_with, plan_without

_OTHER_CHARACTERS = re.compile(r'[^A-Za-z0-9_]+')
#: Name of an object that has none.
_UNNAMED = 'object'
#: Formats of files and texts.
FORMATS = ('mjcf', 'yaml')


class SpawningServices:
    """
    The services that add and delete objects while the simulation runs.

    The new world is compiled in the thread of the executor; the simulation's thread takes it over
    between two control periods, with everything else as it was.

    :param node: the node
    :param simulation: what is changed
    :param thread: runs it
    :param changed: is called after objects have come or gone
    :param types: of the services, as ``simulation_interfaces.srv`` has them
    """

    def __init__(self, node: Node, simulation: Simulation, thread: SimulationThread,
                 changed: Callable[[Simulation], None], types: Any) -> None:
        self._simulation = simulation
        self._thread = thread
        self._changed = changed
        # One group, because each plan is made from the one before.
        group = MutuallyExclusiveCallbackGroup()
        for service_type, name, meet in ((types.SpawnEntity, 'spawn_entity', self._spawn),
                                         (types.DeleteEntity, 'delete_entity', self._delete)):
            node.create_service(service_type, f'~/{name}', answering(meet), callback_group=group)

    def _spawn(self, request: Any, response: Any) -> None:
        if request.entity_namespace.strip('/'):
            raise Rejection(SpawnCode.NAMESPACE_INVALID,
                            'an object is published below objects/ and has no namespace')
        item = _created(request)
        item.name = self._free_name(request.name or item.name, request.allow_renaming)
        _place(item, request.initial_pose)
        try:
            self._take_over(plan_with(self._simulation.plan, item))
        except ModelError as error:
            raise Rejection(SpawnCode.RESOURCE_PARSE_ERROR, str(error)) from error
        response.entity_name = item.name

    def _free_name(self, wanted: str, may_rename: bool) -> str:
        taken = self._simulation.entities.names
        if may_rename:
            wanted = _OTHER_CHARACTERS.sub('_', wanted).lstrip('_0123456789') or _UNNAMED
            free, number = wanted, 1
            while free in taken:
                free, number = f'{wanted}_{number}', number + 1
            wanted = free
        elif wanted in taken:
            raise Rejection(SpawnCode.NAME_NOT_UNIQUE,
                            f'there is an entity {quoted(wanted)} already')
        try:
            check_object_name(wanted, 'name')
        except ModelError as error:
            raise Rejection(SpawnCode.NAME_INVALID, str(error)) from error
        return wanted

    def _delete(self, request: Any, response: Any) -> None:
        name, plan = request.entity, self._simulation.plan
        if name in self._simulation.entities.names and name not in plan.object_names:
            raise Rejection(ResultCode.RESULT_OPERATION_FAILED,
                            f"'{name}' belongs to a robot or the arena and cannot be deleted")
        self._take_over(plan_without(plan, name))

    def _take_over(self, plan: Plan) -> None:
        def change() -> None:
            if self._simulation.diverged is not None:
                raise Rejection(ResultCode.RESULT_INCORRECT_STATE,
                                f'{self._simulation.diverged}; reset it first')
            self._simulation.change_objects(plan)
        self._thread.call(change)
        self._changed(self._simulation)


def _created(request: Any) -> ObjectModel:
    """Return the object of a file or a text; the text is used where there is no file."""
    try:
        if request.uri:
            return _from_file(_path(request.uri))
        text = request.resource_string.strip()
        if not text:
            raise Rejection(SpawnCode.NO_RESOURCE,
                            'give a file (uri) or a text (resource_string)')
        if not text.startswith('<'):
            return create_object({'name': _UNNAMED, **parse_yaml(text, 'resource_string')})
        with tempfile.TemporaryDirectory(prefix='manip_sim_') as folder:
            file = Path(folder, 'object.xml')
            file.write_text(text)
            return _from_file(str(file))
    except ModelError as error:
        raise Rejection(SpawnCode.RESOURCE_PARSE_ERROR, str(error)) from error


def _from_file(path: str) -> ObjectModel:
    if Path(path).suffix in ('.yaml', '.yml'):
        return create_object(path)
    found = create_object({'name': _UNNAMED, 'file': path})
    own_name = found.spec.worldbody.bodies[0].name
    found.name = own_name or _UNNAMED
    return found


def _path(uri: str) -> str:
    parts = urlsplit(uri)
    if parts.scheme not in ('', 'file'):
        raise Rejection(SpawnCode.UNSUPPORTED_FORMAT,
                        f'uri {quoted(uri)}: only paths and file:// can be read')
    if Path(parts.path).suffix not in ('.xml', '.mjcf', '.yaml', '.yml'):
        raise Rejection(SpawnCode.UNSUPPORTED_FORMAT,
                        f'uri {quoted(uri)}: only MJCF (.xml, .mjcf) and YAML can be read')
    return unquote(parts.path)


def _place(item: ObjectModel, pose: Any) -> None:
    if pose.header.frame_id not in ('', WORLD):
        raise Rejection(ResultCode.RESULT_FEATURE_UNSUPPORTED,
                        f"frame_id {quoted(pose.header.frame_id)} is not supported: leave it "
                        f"empty or write '{WORLD}'")
    position, turn = pose.pose.position, pose.pose.orientation
    try:
        place = Pose.checked([position.x, position.y, position.z],
                             [turn.x, turn.y, turn.z, turn.w])
    except CommandError as error:
        raise Rejection(SpawnCode.INVALID_POSE, str(error)) from error
    item.place(place.position, xyzw_to_wxyz(place.quat_xyzw))
