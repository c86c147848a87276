# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Services that control the simulation; a response says why a call has failed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from importlib import import_module
import json
import threading
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from std_srvs.srv import SetBool

from manip_sim.errors import (
    CommandError, describe_choices, ManipSimError, ModelError, UnknownNameError)
from manip_sim.interface.topics import SERVICES
from manip_sim.models.faults import fault_from_text
from manip_sim.models.user_files import parse_yaml
from manip_sim.physics.payload import Payload
from manip_sim.quoting import quoted
from manip_sim.ros.executor import in_background
from manip_sim.ros.feature import Feature, NodeContext
from manip_sim.simulation import Simulation
from manip_sim.simulation.payload_estimation import PayloadEstimation

_ARM = ('robot', 'arm')
_PAYLOAD = ('mass', 'center_of_mass', 'inertia')


class PayloadServices:
    """
    The answers of ``~/set_payload`` and ``~/estimate_payload``, each JSON.

    :param context: of the node
    """

    def __init__(self, context: NodeContext) -> None:
        self._context, self._thread = context, context.thread
        self._simulation = context.simulation

    def set(self, text: str) -> str:
        """
        Declare the payload of a text, if there is one, and return all payloads.

        :param text: keys ``arm``, ``mass``, ``center_of_mass``, ``inertia`` and ``robot``
        :raises ManipSimError: if it cannot be used; then nothing changes
        """
        if text:
            values = _read(text, (*_ARM, *_PAYLOAD))
            robot, arm = self._find(values)
            if 'mass' not in values:
                raise CommandError("the payload needs a 'mass' [kg], 0 for nothing")
            payload = Payload.checked(**{
                name: values[name] for name in _PAYLOAD if name in values})
            self._thread.change('set_payload', robot, arm, payload.mass,
                                list(payload.center_of_mass), list(payload.inertia))
            self._thread.restarted()  # Parameters show what acts.
        return json.dumps(self._thread.call(self._declared))

    def _declared(self) -> list[dict[str, Any]]:
        return [{'robot': name, 'arm': arm, **asdict(robot.payload(arm))}
                for name, robot in self._simulation.robots.items()
                for arm in robot.end_effectors]

    def _find(self, values: Mapping[str, Any]) -> tuple[str, str]:
        """Return the names of the robot and the arm that are meant."""
        robots = self._simulation.robots
        name, arm = (values.get(key) for key in _ARM)
        if name is not None and name not in robots:
            raise UnknownNameError('robot', str(name), robots)
        known = [(robot, side) for robot in robots if name in (None, robot)
                 for side in robots[robot].end_effectors]
        arms = [(robot, side) for robot, side in known if arm in (None, side)]
        if len(arms) == 1:
            return arms[0]
        if not arms:
            raise UnknownNameError(
                'arm with a gripper', str(arm), dict.fromkeys(side for _, side in known))
        raise CommandError("name the 'arm', and where several robots have it the 'robot': there "
                           f"are {', '.join(f'{side} of {robot}' for robot, side in arms)}")

    async def answer_estimate(self, request: Any, response: Any) -> Any:
        """Fill the response of ``~/estimate_payload``."""
        try:
            response.message = await self._estimate(request.load_namespace)
            response.success = True
        except ManipSimError as error:
            response.success, response.message = False, str(error)
        return response

    async def _estimate(self, text: str) -> str:
        """
        Let an arm turn its wrist, and return what it holds.

        :param text: keys ``arm`` and ``robot``, where there are several
        :raises ManipSimError: if it cannot be estimated
        """
        robot, arm = self._find(_read(text, _ARM) if text else {})
        if self._thread.paused:
            raise CommandError('the simulation is paused: a payload is estimated in a motion')

        def begin() -> PayloadEstimation:
            estimation = PayloadEstimation(
                self._simulation.physics, self._simulation.robots[robot], arm)
            self._thread.submit([estimation.command], robot=robot)
            return estimation
        estimation = self._thread.call(begin)

        ended = threading.Event()

        def observe(_: Simulation) -> None:
            estimation.record()
            if not estimation.command.handle.is_active:
                ended.set()
        self._thread.observe(observe)
        try:
            await in_background(self._context.node, ended.wait)
        finally:
            self._thread.unobserve(observe)
        estimate = estimation.result()
        return json.dumps({
            'robot': robot, 'arm': arm, **asdict(estimate.payload), 'error': {
                'mass': estimate.mass_error, 'center_of_mass': estimate.center_of_mass_error}})


def _read(text: str, known: tuple[str, ...]) -> dict[str, Any]:
    """Return the keys and values of a request."""
    values = parse_yaml(text, 'the payload')
    for key in values:
        if key not in known:
            raise ModelError(f'the payload: unknown key {quoted(key)}: '
                             f'{describe_choices(key, known)}')
    return values


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
