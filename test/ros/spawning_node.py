# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A node whose services of spawning have a type that is always installed.

The fields of a request of ``SpawnEntity`` and ``DeleteEntity`` are sent as parameters; the answer
is the name of the entity, or why there is none. All else is as in the node.
"""

from __future__ import annotations

from dataclasses import replace
import inspect
import sys
import threading
from types import SimpleNamespace as Plain
from typing import Any

from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import SetParametersAtomically
import rclpy
from rclpy.parameter import Parameter

from manip_sim.models.user_files import AllowedRoots
from manip_sim.ros.executor import GuardedExecutor
from manip_sim.ros.sim_node import SimNode
from manip_sim.ros.spawning_services import SpawningServices, StandardTypes

DEFAULTS = {'name': '', 'allow_renaming': False, 'uri': '', 'resource_string': '',
            'entity_namespace': '', 'entity': '', 'frame': '', 'position': [0.0] * 3,
            'orientation': [0.0, 0.0, 0.0, 1.0]}


class SpawningByParameters:
    """
    The services of a node, which has none of them where simulation_interfaces is missing.

    :param node: the node
    :param folder: whose files requests may name
    """

    def __init__(self, node: Any, folder: Any) -> None:
        self._node = node
        SpawningServices(replace(node.shared, node=self), AllowedRoots([folder], 'spawn_roots'),
                         StandardTypes(Plain(SpawnEntity=SetParametersAtomically,
                                             DeleteEntity=SetParametersAtomically), None, None))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._node, name)

    def create_service(self, service_type: Any, name: str, callback: Any, callback_group: Any
                       ) -> None:
        async def answer(request: Any, response: Any) -> Any:
            fields = {**DEFAULTS, **{
                given.name: Parameter.from_parameter_msg(given).value
                for given in request.parameters}}
            pose = PoseStamped()
            pose.header.frame_id = fields.pop('frame')
            place, turn = pose.pose.position, pose.pose.orientation
            place.x, place.y, place.z = fields.pop('position')
            turn.x, turn.y, turn.z, turn.w = fields.pop('orientation')
            answered = Plain(result=Plain(result=0, error_message=''), entity_name='')
            outcome = callback(Plain(**fields, initial_pose=pose), answered)
            if inspect.isawaitable(outcome):
                await outcome
            response.result.successful = answered.result.result == 1
            response.result.reason = answered.entity_name or answered.result.error_message
            return response
        self._node.create_service(service_type, f'{name}_by_parameters', answer,
                                  callback_group=callback_group)


def ask(client: Any, service: str, **fields: Any) -> Any:
    """Return the result of a request, sent by a client of ``harness``."""
    request = SetParametersAtomically.Request(parameters=[
        Parameter(name, value=value).to_parameter_msg() for name, value in fields.items()])
    return client.call(SetParametersAtomically,
                       f'manip_sim/{service}_by_parameters', request).result


def main() -> None:
    """Serve a Panda at a table until the standard input ends."""
    rclpy.init()
    node = SimNode(parameter_overrides=[
        Parameter('real_time_factor', value=2.0), Parameter('arena', value='table')])
    SpawningByParameters(node, '.')
    executor = GuardedExecutor(node.rejections)
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin)
    spinning.start()
    node.start()
    sys.stdin.read()
    executor.end()
    spinning.join()
    executor.shutdown()
    node.stop()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main()
