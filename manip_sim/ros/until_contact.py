# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Motions until contact: the service that begins one and answers at its end, and ``~/contact``."""

from __future__ import annotations

from collections.abc import Mapping
import json
import queue
import threading
from typing import Any, NamedTuple

from diagnostic_msgs.srv import AddDiagnostics
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from std_msgs.msg import String

from manip_sim.control.cartesian.cartesian_commands import GuardedTwist
from manip_sim.control.cartesian.reports import Contact
from manip_sim.control.commands import CommandHandle, Status
from manip_sim.errors import CommandError, ManipSimError, UnknownNameError
from manip_sim.interface.topics import BY_NAME
from manip_sim.models.strict_yaml import parse_yaml
from manip_sim.quoting import format_value
from manip_sim.ros.command_subscribers import RobotCommands
from manip_sim.ros.executor import let_clients_know
from manip_sim.ros.feature import create_publisher, Feature, NodeContext
from manip_sim.simulation import SimulatedRobot, Simulation

_SERVICE = '~/move_until_contact'
_STANDS = (0.0, 0.0, 0.0)
_ENDING = 'the node is ending'
#: Keys of a request with their defaults, None for those that have none.
_KEYS: Mapping[str, Any] = {'robot': '', 'arm': 'right', 'linear': _STANDS, 'angular': _STANDS,
                            'frame': '', 'force': None, 'distance': None, 'duration': None}


class _Motion(NamedTuple):
    """
    A motion whose client waits for its end.

    :ivar robot: its name
    :ivar handle: of the command
    :ivar answer: set to whether a limit has ended it, and to the message
    """

    robot: str
    arm: str
    handle: CommandHandle
    answer: Future


class MotionsUntilContact(Feature):
    """
    The service ``~/move_until_contact``, and a latched publisher of the ends, ``~/contact``.

    :param context: with a thread that has not been started
    :param commands: count the motions
    """

    def __init__(self, context: NodeContext, commands: RobotCommands) -> None:
        self._context, self._commands = context, commands
        self._publisher = create_publisher(context, BY_NAME['~/contact'])
        self._simulation: Simulation = context.simulation
        self._published = self._present()
        # The executor adds to them, the thread of the simulation takes away.
        self._motions: tuple[_Motion, ...] = ()
        self._lock, self._ends = threading.Lock(), False
        self._ended: queue.SimpleQueue[tuple[_Motion, bool, str]] = queue.SimpleQueue()
        # A group of their own: nothing else waits for the end of a motion, nor for one another.
        group = ReentrantCallbackGroup()
        self._guard = context.node.create_guard_condition(self._answer, group)
        context.node.create_service(AddDiagnostics, _SERVICE, self._serve, callback_group=group)
        context.thread.observe(self._observe, look=self._has_ended)

    def _present(self) -> dict[tuple[str, str], Contact | None]:
        return {(name, arm): report.contact for name, robot in self._simulation.robots.items()
                for arm, report in robot.joints.cartesian.reports.items()}

    def _new(self) -> dict[tuple[str, str], Contact]:
        return {place: contact for place, contact in self._present().items()
                if contact is not None and contact is not self._published.get(place)}

    def _has_ended(self) -> bool:
        return bool(self._new()) or not all([
            motion.handle.is_active for motion in self._motions])

    def _observe(self, _: Simulation) -> None:
        """Publish the ends of motions, and hand over the answers of those that were requested."""
        present = self._present()
        for (robot, arm), contact in self._new().items():
            self._publisher.publish(String(data=_described(robot, arm, contact)))
        self._published = present
        ended = [motion for motion in self._motions if not motion.handle.is_active]
        for motion in ended:
            done = motion.handle.status is Status.DONE
            end = present.get((motion.robot, motion.arm))
            self._ended.put((motion, done, _described(motion.robot, motion.arm, end)
                             if done and end else _why(motion.handle)))
        if ended:
            with self._lock:
                self._motions = tuple([m for m in self._motions if m not in ended])
            self._guard.trigger()

    def _answer(self) -> None:
        while not self._ended.empty():
            motion, success, message = self._ended.get()
            if not motion.answer.done():
                motion.answer.set_result((success, message))

    async def _serve(self, request: Any, response: Any) -> Any:
        """Begin the motion that a text in ``load_namespace`` describes, and wait for its end."""
        try:
            robot, command = self._command(request.load_namespace)
            handle, = self._context.thread.submit([command], robot=robot.name)
        except ManipSimError as error:
            response.success, response.message = False, str(error)
            return response
        motion = _Motion(robot.name, command.arm, handle, Future())
        with self._lock:
            self._motions = (*self._motions, motion)
            if self._ends:
                motion.answer.set_result((False, _ENDING))
        next(commands for commands in self._commands.robots if commands.robot is robot).count(
            _SERVICE, command.arm, [command])
        self._context.thread.observers.refresh()
        response.success, response.message = await motion.answer
        return response

    def _command(self, text: str) -> tuple[SimulatedRobot, GuardedTwist]:
        """
        Return the robot and the command of a request.

        :raises ManipSimError: if it cannot be used
        """
        values = parse_yaml(text, 'the motion')
        for key in values:
            if key not in _KEYS:
                raise UnknownNameError('key of a motion until contact', key, _KEYS)
        values = {**_KEYS, **values}
        for key in ('robot', 'arm', 'frame'):
            if not isinstance(values[key], str):
                raise CommandError(f"the motion: '{key}' must be a name, "
                                   f'got {format_value(values[key])}')
        robots = self._simulation.robots
        name = values['robot'] or self._simulation.robot.name
        if name not in robots:
            raise UnknownNameError('robot', name, robots)
        command = robots[name].parse_cartesian.until_contact(
            values['arm'], values['linear'], values['angular'], force=values['force'],
            distance=values['distance'], duration_s=values['duration'], frame=values['frame'])
        refusal = robots[name].reflexes.refusal(command)
        if refusal is not None:
            raise CommandError(refusal)
        return robots[name], command

    def end(self) -> None:
        """Answer clients that wait still, and wait until they know."""
        with self._lock:
            self._ends, motions = True, self._motions
        for motion in motions:
            self._ended.put((motion, False, _ENDING))
        if motions:
            self._guard.trigger()
            let_clients_know(self._context.node)


def _described(robot: str, arm: str, contact: Contact) -> str:
    """Return JSON of the end of a motion."""
    return json.dumps({
        'robot': robot, 'arm': arm, 'cause': contact.cause,
        'position': contact.position.tolist(), 'wrench': contact.wrench.tolist(),
        'distance': contact.distance, 'duration': contact.duration_s})


def _why(handle: CommandHandle) -> str:
    """Return why none of its limits has ended a motion."""
    replaced = handle.status is Status.REPLACED
    return f'the motion was {"replaced by a newer command" if replaced else "aborted"}' + (
        f': {handle.reason}' if handle.reason else '')
