# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Topics of objects, the arena's joints, actuators of no part, and what pulls bodies."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import time
from typing import Any

from geometry_msgs.msg import Pose as PoseMessage, PoseStamped
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker

from manip_sim.arrays import FloatArray
from manip_sim.control.surroundings import ACTUATORS
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.interface.topics import BY_NAME, PUBLISHED, TOKEN, Topic
from manip_sim.interface.world_topics import topics_of_objects, topics_of_surroundings
from manip_sim.physics.entities import Entities
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quoting import counted, quoted
from manip_sim.ros import messages
from manip_sim.ros.command_subscribers import CommandStatistics, CommandSubscription
from manip_sim.ros.feature import Feature
from manip_sim.ros.lazy_publishers import (
    create_output, message_class, Output, Publication, Publications)
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.reading import read_command
from manip_sim.ros.rejection_log import kind_of
from manip_sim.simulation import Simulation

#: What the message of a pull holds: two points, and no pose of its own.
_ENDS, _NOWHERE = 2, PoseMessage()
#: The topics of actuators that come and go with objects.
_LOOSE = BY_NAME['actuators/states'], BY_NAME['actuators/command']
#: By the name in a row of the table: what is read of a free body, its message and its size.
_READERS = {'object_pose': (Entities.pose, messages.pose_stamped, 7),
            'object_twist': (Entities.twist, messages.twist_stamped, 6)}


class SurroundingsTopics(Publications, Feature):
    """
    Publishers and subscriptions of objects, surroundings and pulls; objects may come and go.

    :ivar statistics: counts of the commands, for ``arena``, ``actuators``,
        ``objects/<name>`` and ``pull``
    """

    def __init__(self, context: NodeContext) -> None:
        super().__init__()
        self._context, self._changes = context, context.thread.changes
        self._surroundings, self._pulls = context.simulation.surroundings, context.simulation.pulls
        self.statistics: dict[str, CommandStatistics] = {}
        self._take: dict[str, Callable[[str, Any], None]] = {
            'direct_command': self._command, 'mocap_pose': self._target, 'pull': self._pull}
        self._outputs: dict[Topic, Publication] = {}
        self._inputs: dict[Topic, CommandSubscription] = {}
        self._loose: tuple[tuple[str, ...], Output] | None = None
        self.world_changed()
        context.thread.observe(self.publish, look=self.look)

    def world_changed(self) -> None:
        """
        Serve the free and mocap bodies and the actuators of no part that there are now.

        Commands of actuators stay subscribed to.
        """
        simulation = self._context.simulation
        free = [name for name in simulation.entities.free_names if TOKEN.fullmatch(name)]
        rows = dict.fromkeys([*topics_of_objects(free), *(
            row for row in topics_of_surroundings(simulation.surroundings) if row not in _LOOSE)])
        gone = [self._outputs.pop(row) for row in [*self._outputs] if row not in rows]
        for row in [row for row in self._inputs if row not in rows]:
            self._inputs.pop(row).close()
            del self.statistics[_counted_as(row)]
        for row in rows:
            if row.direction == PUBLISHED and row not in self._outputs:
                self._outputs[row] = self._publication(row)
            elif row.direction != PUBLISHED and row not in self._inputs:
                self._inputs[row] = self._subscribe(row)
        closed = [topic.output for topic in gone] + self._follow_actuators(simulation)
        self.replace((*self._outputs.values(), *(
            () if self._loose is None else (self._loose_publication(*self._loose),))))
        for output in closed:
            output.close(self._context.node)

    def _follow_actuators(self, simulation: Simulation) -> list[Output]:
        """Serve the actuators of no part, and return what publishes nothing any more."""
        names, states = simulation.surroundings.other_actuators, self._loose
        if states is None and names:
            if ACTUATORS not in self.statistics:
                self._subscribe(_LOOSE[1])
            states = names, create_output(self._context, _LOOSE[0])
        self._loose = (names, states[1]) if states is not None and names else None
        return [states[1]] if states is not None and self._loose is None else []

    def _loose_publication(self, names: tuple[str, ...], output: Output) -> Publication:
        def read(simulation: Simulation) -> FloatArray | None:
            found = simulation.surroundings
            # Objects with actuators may have come or gone before world_changed() is called.
            return found.state_of_actuators() if found.other_actuators == names else None
        return Publication(output, partial(messages.joint_state, names), read, 3 * len(names))

    def _publication(self, row: Topic) -> Publication:
        found, output = self._surroundings, create_output(self._context, row)
        if row.by == 'arena_joints':
            return Publication(output, partial(messages.joint_state, found.joints),
                               lambda _: found.state(), 3 * len(found.joints))
        read, make, count = _READERS[row.by]

        def numbers(simulation: Simulation) -> FloatArray | None:
            # The body may be gone before world_changed() is called.
            if row.of in simulation.entities.free_names:
                return read(simulation.entities, simulation.data, row.of)
            return found.pose(row.of) if row.of in found.mocap_names else None
        world = self._context.frame_prefix + messages.WORLD
        return Publication(output, partial(make, world), numbers, count)

    def _subscribe(self, row: Topic) -> CommandSubscription:
        message_type, use = message_class(row), partial(self._take[row.by], row.of)
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
        found = self._surroundings.commands[part]
        controls = found.checked(
            message.name, message.position, message.velocity, message.effort)
        stamp_ns = messages.nanoseconds_of(message.header.stamp)
        if not controls:  # They go on as before, which answers a state too.
            self._changes.at_next_period(f'{part}/', 'answer', stamp_ns=stamp_ns)
        for name, value in controls.items():
            self._changes.at_next_period(
                f'{part}/{name}', 'direct_command', part, name, found.control(name)[0], value,
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
