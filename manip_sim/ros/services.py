# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Services and live parameters that control the simulation while it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import contextlib
from dataclasses import asdict
from functools import partial
from importlib import import_module
import json
import threading
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool

from manip_sim.control.cartesian.cartesian_settings import IMPEDANCE
from manip_sim.errors import (
    CommandError, describe_choices, ManipSimError, ModelError, SimulationEnded, UnknownNameError)
from manip_sim.interface.part_parameters import law_parameters
from manip_sim.interface.topics import Scope, SERVICES
from manip_sim.models.faults import fault_from_text
from manip_sim.models.user_files import parse_yaml
from manip_sim.physics.payload import Payload
from manip_sim.quoting import one_line, quoted
from manip_sim.ros.executor import in_background
from manip_sim.ros.feature import Feature, NodeContext
from manip_sim.sensing.sensor_noise import QUANTITIES
from manip_sim.simulation import SimulatedRobot, Simulation
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


#: Sets parameters as rclpy does.
SetAll = Callable[[Sequence[Parameter]], SetParametersResult]


class LiveParameters(Feature):
    """The parameters that may change while the node runs."""

    def __init__(self, context: NodeContext) -> None:
        self._context = context
        thread = context.thread
        self._robots: dict[Scope, SimulatedRobot] = {}
        #: Names of the laws that move parts, by part.
        self._laws: dict[Scope, Mapping[str, str]] = {}
        #: Functions that use a value, by the name of the parameter.
        self._uses: dict[str, Callable[[Any], object]] = {
            'real_time_factor': thread.set_real_time_factor, 'pause_at': thread.pause_at,
            'seed': partial(setattr, thread, 'next_seed'),
            'keyframe': partial(thread.change, 'keyframe')}
        for scope, robot in context.robots.items():
            self.robot_added(scope, robot)

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        self._robots[scope] = robot
        parameters = self._context.parameters
        for setting, acting in robot.settings.items():
            name = scope.parameter(setting)
            self._uses[name] = self._use_of(scope, robot, setting)
            # Values that randomization has drawn stay, unless the user sets others.
            if name in parameters.names and parameters.value(name) != acting and (
                    parameters.value(name) or setting not in QUANTITIES):
                self._uses[name](parameters.value(name))
        self._begin_laws()

    def _begin_laws(self) -> None:
        """Let parameters of laws that have begun to move parts act, with what the user gave."""
        for name in self._follow_laws():
            self._uses[name](self._context.parameters.value(name))

    def _follow_laws(self) -> list[str]:
        """Declare the parameters of the laws that move parts, and no others; return new names."""
        laws = self._context.thread.call(
            lambda: {scope: robot.laws for scope, robot in self._robots.items()})
        new = []
        for scope, robot in self._robots.items():
            before, self._laws[scope] = self._laws.get(scope, {}), laws[scope]
            for part in {**before, **laws[scope]}:
                if before.get(part) != laws[scope].get(part):
                    if part in before:
                        self._forget_law(scope.parameter(f'law.{part}.'))
                    new += self._declare_law(scope, robot, part)
        return new

    def _forget_law(self, begin: str) -> None:
        """Forget the parameters of the law that moved a part."""
        self._context.parameters.forget(begin)
        for name in [name for name in self._uses if name.startswith(begin)]:
            del self._uses[name]

    def _declare_law(self, scope: Scope, robot: SimulatedRobot, part: str) -> list[str]:
        """Declare the parameters of the law that moves a part, if there is one; return names."""
        parameters, law = self._context.parameters, self._laws[scope].get(part)
        specs = [] if law is None else law_parameters(scope, part, law)
        with parameters.without_acting():
            parameters.declare([spec for spec in specs if spec.name not in parameters.names])
        for spec in specs:
            self._uses[spec.name] = self._use_of(
                scope, robot, spec.name.removeprefix(scope.parameter('')))
        return [spec.name for spec in specs]

    def robot_removed(self, scope: Scope) -> None:
        self._laws.pop(scope, None)
        for setting in self._robots.pop(scope).settings:
            self._uses.pop(scope.parameter(setting), None)

    def _use_of(self, scope: Scope, robot: SimulatedRobot, setting: str
                ) -> Callable[[Any], object]:
        """Return the function that changes a setting of a robot."""
        change = partial(self._context.thread.change, *_operation(robot.name, setting))
        group, _, part = setting.partition('.')
        if group not in ('command_timeout', 'timeout_follows_mode'):
            return change
        timeout, follows = (scope.parameter(f'{group}.{part}') for group in (
            'command_timeout', 'timeout_follows_mode'))
        value_of = self._context.parameters.value
        # A Cartesian target comes to rest by itself: only a timeout that was set ends it.
        return lambda _: change(value_of(timeout), not value_of(follows))

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        for name in [parameter.name for parameter in parameters if parameter.name in self._uses]:
            self._context.thread.call(
                partial(self._uses[name], self._context.parameters.value(name)))
        if not self._context.parameters.showing:
            self._begin_laws()

    def show(self) -> None:
        """Let parameters have the values that act, as a reset or a restored state changes them."""
        with contextlib.suppress(SimulationEnded):
            self._follow_laws()
            self._context.parameters.show(self._context.thread.call(self._acting))

    def set_atomically(self, parameters: Sequence[Parameter], set_all: SetAll
                       ) -> SetParametersResult:
        """
        Set all of some parameters or none, and say more than rclpy about those that cannot be set.

        :param set_all: sets them as rclpy does
        """
        declared, thread = self._context.parameters, self._context.thread
        reason = declared.rejection(parameters)
        if reason is not None:
            return SetParametersResult(successful=False, reason=reason)
        before = {name: self._context.node.get_parameter(name) for name in declared.names}
        seed = thread.next_seed
        try:
            return set_all(parameters)
        except Exception as error:  # The class of a control mode may raise anything.
            # Parameters act as before a change that failed half-way.
            self.show()
            with contextlib.suppress(Exception):
                set_all(declared.changed_since(before))
            thread.next_seed = seed
            self.show()
            return SetParametersResult(successful=False, reason=one_line(str(error)))

    def _acting(self) -> dict[str, Any]:
        """Return acting values by name."""
        simulation, seed = self._context.simulation, self._context.thread.next_seed
        values: dict[str, Any] = {
            'seed': simulation.seed if seed is None else seed,
            'keyframe': simulation.episode_start.keyframe}
        for scope, robot in self._robots.items():
            values.update({
                scope.parameter(name): value for name, value in robot.settings.items()})
        return values


def _operation(robot: str, setting: str) -> tuple[str, ...]:
    """Return the operation that changes a setting of a robot, and its arguments but the value."""
    group, *which = setting.split('.')
    if setting in QUANTITIES:
        return 'sensing', robot, setting
    if group in IMPEDANCE:
        return 'cartesian', robot, *which, group
    return {'control_mode': 'mode', 'command_timeout': 'timeout',
            'timeout_follows_mode': 'timeout'}.get(group, group), robot, *which
