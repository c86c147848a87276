# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Services that control the simulation; each says why it refuses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from manip_sim.errors import ManipSimError
from manip_sim.ros.runner import Runner
from manip_sim.simulation import Simulation


class SimulationServices:
    """
    ``~/pause``, ``~/step``, ``~/reset`` and ``~/tare_wrench``.

    :param node: the node
    :param simulation: what is controlled
    :param runner: runs it
    """

    def __init__(self, node: Node, simulation: Simulation, runner: Runner) -> None:
        self._runner = runner
        self._simulation = simulation
        node.create_service(SetBool, '~/pause', self._pause)
        for name, function, done in (
                ('~/step', runner.step, 'advanced by one control period'),
                ('~/reset', runner.reset, 'back at the start'),
                ('~/tare_wrench', self._tare, 'external wrenches read zero now')):
            node.create_service(Trigger, name, self._trigger(function, done))

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        already = 'already ' if self._runner.paused == request.data else ''
        return _answer(response, lambda: self._runner.pause(request.data),
                       already + ('paused' if request.data else 'running'))

    def _tare(self) -> None:
        self._runner.call(self._simulation.tare_wrench)

    def _trigger(self, function: Callable[[], None], done: str) -> Callable[[Any, Any], Any]:
        return lambda _, response: _answer(response, function, done)


def _answer(response: Any, function: Callable[[], None], done: str) -> Any:
    """Call a function and tell in the response whether it worked, or why not."""
    try:
        function()
        response.success, response.message = True, done
    except ManipSimError as error:
        response.success, response.message = False, str(error)
    return response
