# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands of mocap bodies, the arena's joints, actuators of no part, and pulls of bodies."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import time
from typing import Any

from geometry_msgs.msg import Pose as PoseMessage, PoseStamped
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker

from manip_sim.control.surroundings import ACTUATORS
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.interface.topics import SUBSCRIBED, Topic
from manip_sim.interface.world_topics import topics_of_surroundings
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quoting import counted, quoted
from manip_sim.ros import messages
from manip_sim.ros.command_subscribers import CommandStatistics, CommandSubscription
from manip_sim.ros.feature import Feature, NodeContext
from manip_sim.ros.rejection_log import kind_of
from manip_sim.ros.serialization import read_command

#: What the message of a pull holds: two points, and no pose of its own.
_ENDS, _NOWHERE = 2, PoseMessage()


class SurroundingsCommands(Feature):
    """
    Subscriptions of mocap bodies, of actuators of no robot and of pulls; objects may come and go.

    :ivar statistics: counts of the commands, for ``arena``, ``actuators``,
        ``objects/<name>`` and ``pull``
    """

    def __init__(self, context: NodeContext) -> None:
        self._context, self._changes = context, context.thread.changes
        self._surroundings, self._pulls = context.simulation.surroundings, context.simulation.pulls
        self.statistics: dict[str, CommandStatistics] = {}
        self._take: dict[str, Callable[[str, Any], None]] = {
            'direct_command': self._command, 'mocap_pose': self._target, 'pull': self._pull}
        self._inputs: dict[Topic, CommandSubscription] = {}
        self.world_changed()

    def world_changed(self) -> None:
        """
        Take commands of the mocap bodies and the actuators of no part that there are now.

        Commands of actuators stay subscribed to.
        """
        rows = [row for row in topics_of_surroundings(self._surroundings)
                if row.direction == SUBSCRIBED]
        for row in [row for row in self._inputs if row not in rows and row.of != ACTUATORS]:
            self._inputs.pop(row).close()
            del self.statistics[_counted_as(row)]
        for row in rows:
            if row not in self._inputs:
                self._inputs[row] = self._subscribe(row)

    def _subscribe(self, row: Topic) -> CommandSubscription:
        message_type, use = messages.message_class(row.type), partial(self._take[row.by], row.of)
        counts = self.statistics[_counted_as(row)] = CommandStatistics()

        def take(data: bytes) -> None:
            try:
                use(read_command(message_type, data))
                counts.accepted, counts.last_s = counts.accepted + 1, time.monotonic()
            except (CommandError, UnknownNameError) as error:
                counts.rejected += 1
                self._context.log.warn(row.name, kind_of(error),
                                       f'rejected a message on {row.name}: {error}')

        return CommandSubscription(
            self._context, message_type, row.name, take, self._context.inbox)

    def _command(self, part: str, message: JointState) -> None:
        direct = self._surroundings.commands[part]
        controls = direct.checked(
            message.name, message.position, message.velocity, message.effort)
        stamp_ns = messages.nanoseconds_of(message.header.stamp)
        if not controls:  # They go on as before, which answers a state too.
            self._changes.at_next_period(f'{part}/', 'answer', stamp_ns=stamp_ns)
        for name, value in controls.items():
            self._changes.at_next_period(
                f'{part}/{name}', 'direct_command', part, name, direct.control(name)[0], value,
                stamp_ns=stamp_ns)

    def _check_frame(self, frame_id: str) -> None:
        if frame_id.removeprefix(self._context.frame_prefix) not in ('', messages.WORLD):
            raise CommandError(f'frame_id {quoted(frame_id)} is not supported: '
                               f"leave it empty or write '{messages.WORLD}'")

    def _target(self, name: str, message: PoseStamped) -> None:
        self._check_frame(message.header.frame_id)
        pose = Pose.checked(*map(messages.numbers_of, (
            message.pose.position, message.pose.orientation)))
        self._changes.at_next_period(f'objects/{name}', 'target', name,
                                     pose.position.tolist(), pose.quat_xyzw.tolist())

    def _pull(self, _: str, message: Marker) -> None:
        pulls, key = self._pulls, f'pull/{message.ns}'
        if message.action == Marker.DELETE:
            pulls.check_body(message.ns)
            self._changes.at_next_period(key, 'end_pull', message.ns)
            return
        self._check_frame(message.header.frame_id)
        if message.action != Marker.ADD or message.type != Marker.ARROW or (
                len(message.points) != _ENDS or message.pose != _NOWHERE):
            raise CommandError('pull: expected an ARROW to ADD, with two points and no pose, or '
                               f'to DELETE, got action {message.action}, type {message.type} and '
                               f'{counted(len(message.points), "point")}')
        point, target = map(messages.numbers_of, message.points)
        pulls.check(message.ns, point, target)
        self._changes.at_next_period(
            key, 'pull', message.ns, point, target, message.id)


def _counted_as(row: Topic) -> str:
    """Return the key of a topic in the statistics."""
    return 'pull' if row.by == 'pull' else row.name.rpartition('/')[0]
