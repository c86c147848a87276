# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Services that control the simulation; a response says why a call has failed."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
import json
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from std_srvs.srv import SetBool

from manip_sim.errors import ManipSimError
from manip_sim.interface.topics import SERVICES
from manip_sim.models.faults import fault_from_text
from manip_sim.ros.feature import Feature, NodeContext
from manip_sim.ros.payload_services import PayloadServices


class SimulationServices(Feature):
    """
    Services that control the simulation.

    The table ``manip_sim.interface.topics.SERVICES`` lists them, and services that answer later.
    """

    def __init__(self, context: NodeContext) -> None:
        thread = self._thread = context.thread
        self._simulation, self._logger = context.simulation, context.node.get_logger()
        payloads = PayloadServices(context)
        answers: dict[str, Callable[[Any, Any], Any]] = {
            '~/pause': self._pause,
            '~/step': partial(_answer, thread.step, 'advanced by one control period'),
            '~/reset': partial(_answer, thread.reset, 'back at the start'),
            '~/reset_reflex': partial(_answer, partial(thread.change, 'reset_reflexes'),
                                      'all parts take commands again'),
            '~/emergency_stop': partial(_answer, partial(thread.change, 'emergency_stop'),
                                        'all robots are in emergency stop'),
            '~/recover': partial(_answer, partial(thread.change, 'recover'),
                                 'all robots take commands again as soon as they rest'),
            '~/inject_fault': partial(_answer_text, self._faults),
            '~/set_payload': partial(_answer_text, payloads.set),
            '~/estimate_payload': payloads.answer_estimate,
            '~/tare_wrench': partial(_answer, partial(thread.change, 'tare'),
                                     'external wrenches read zero now'),
            '~/save_state': partial(_answer, partial(thread.change, 'save'), ''),
            '~/restore_state': partial(_answer, thread.restore, '')}
        for row in SERVICES:
            if row.name not in answers:
                continue
            package, _, kind = row.type.partition('/')
            # An estimate takes long, so it does not hold up the others.
            group = MutuallyExclusiveCallbackGroup() if row.name == '~/estimate_payload' else None
            context.node.create_service(getattr(import_module(f'{package}.srv'), kind), row.name,
                                        answers[row.name], callback_group=group)

    def _faults(self, text: str) -> str:
        """Inject the fault of a text, if there is one, and return all of the episode as JSON."""
        if text:
            self._thread.change('fault', fault_from_text(text))
        return json.dumps(self._thread.call(self._simulation.faults.summary))

    def close(self) -> None:
        """Log the faults that were injected in the last episode."""
        for fault in self._simulation.faults.summary():
            self._logger.info(f'fault of this episode: {json.dumps(fault)}')

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        already = 'already ' if self._thread.paused == request.data else ''
        return _answer(lambda: self._thread.pause(request.data),
                       already + ('paused' if request.data else 'running'), request, response)


def _answer_text(function: Callable[[str], str], request: Any, response: Any) -> Any:
    """Call a function with the text of a request, and return what it returned, or why not."""
    return _answer(partial(function, request.load_namespace), '', request, response)


def _answer(function: Callable[[], str | None], done: str, _: Any, response: Any) -> Any:
    """Call a function, and return what it returned or did, or why it failed."""
    try:
        response.message = function() or done
        response.success = True
    except ManipSimError as error:
        response.success, response.message = False, str(error)
    return response
