# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish on ``/diagnostics``: the simulation, commands, images, and conflicts with others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import difflib
from itertools import chain, islice
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import mujoco
from rclpy.clock import Clock, ClockType
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

from manip_sim.control.cartesian.reports import CartesianReport
from manip_sim.control.gripper_controller import GripperController
from manip_sim.control.modes import MODES, POSITION
from manip_sim.control.surroundings import ARENA
from manip_sim.interface.topics import BY_NAME, Scope
from manip_sim.quoting import one_line, quoted, quoted_names
from manip_sim.rclpy_internals import describe_unheard, endpoint_counts, is_unheard
from manip_sim.ros.camera_publishers import Cameras
from manip_sim.ros.command_subscribers import (
    CommandStatistics, CommandSubscribers, RobotCommands, SurroundingsCommands)
from manip_sim.ros.feature import Feature, NodeContext
from manip_sim.ros.messages import stamp_of
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import SimulatedRobot

_PERIOD_S = 1.0
#: Share of simulation time; a smaller loss causes no warning.
_TOLERATED_LOSS = 0.01
#: Number of control periods over which the real-time factor is measured where they are long.
_WINDOW_PERIODS = 5
#: Share by which the rate of commands may differ from the expected one.
_TOLERATED_RATE = 0.1


class Pace:
    """
    Speed of the simulation, measured between control periods.

    The window reaches back by one second of wall time, or by several control periods where these
    are longer, and begins anew with a pause, another real-time factor or a restart of time.

    :ivar factor: simulation time per wall time; NaN when the window has just begun, 0 when paused
    :ivar loss: fraction of the simulation time that was dropped, from 0 to 1
    """

    def __init__(self, thread: SimulationThread) -> None:
        self._thread = thread
        self._window = [thread.progress]
        self._asked = thread.real_time_factor
        self._was_paused = True
        self.factor = math.nan
        self.loss = 0.0

    def measure(self, now_s: float) -> None:
        """Measure up to the last control period; ``now_s`` is monotonic wall time [s]."""
        thread, window = self._thread, self._window
        progress, paused, asked = thread.progress, thread.paused, thread.real_time_factor
        anew = (paused or self._was_paused or asked != self._asked
                or progress.time_ns < window[-1].time_ns)
        self._was_paused, self._asked = paused, asked
        if anew:
            window[:] = [progress]
            self.factor, self.loss = 0.0 if paused else math.nan, 0.0
            return
        realtime = thread.stepping == 'realtime'
        period_s = thread.period_s / asked if realtime else 0.0
        # Overdue time counts too, or a simulation that hangs would seem to run.
        overdue_s = max(0.0, now_s - progress.wall_s - period_s - _PERIOD_S)
        if progress != window[-1]:
            window.append(progress)
        elif not overdue_s:
            return
        span_s = 0.9 * max(_PERIOD_S, _WINDOW_PERIODS * period_s)
        while len(window) > 2 and progress.wall_s - window[1].wall_s > span_s:
            del window[0]
        first = window[0]
        simulated_s = (progress.time_ns - first.time_ns) * 1e-9
        lost_s = progress.lost_s - first.lost_s + (overdue_s * asked if realtime else 0.0)
        self.factor = simulated_s / (progress.wall_s - first.wall_s + overdue_s)
        self.loss = lost_s / (simulated_s + lost_s) if lost_s else 0.0


class Diagnostics(Feature):
    """Publishes the status of the simulation, commands of each part, images and other nodes."""

    def __init__(self, context: NodeContext, commands: RobotCommands,
                 surroundings: SurroundingsCommands, cameras: Cameras) -> None:
        self._context, self._simulation, self._thread = context, context.simulation, context.thread
        self._commands, self._surroundings, self._cameras = commands.robots, surroundings, cameras
        self._pace = Pace(context.thread)
        self._neighbours = GraphMonitor(context.node, [c.scope for c in self._commands])
        self._last_accepted: dict[str, int] = {}
        self._last_faults: dict[str, int] = {}
        self._last_s = time.monotonic()
        self._reported: str | None = None
        row = BY_NAME['/diagnostics']
        self._publisher = context.node.create_publisher(DiagnosticArray, row.name, row.depth)
        context.node.create_timer(_PERIOD_S, self._publish,
                                  clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self) -> None:
        now_s = time.monotonic()
        elapsed_s, self._last_s = now_s - self._last_s, now_s
        name = self._context.node.get_fully_qualified_name().lstrip('/')
        message = DiagnosticArray(status=[
            self._physics(f'{name}: simulation'),
            *(self._part(f'{name}: {commands.scope.topic(part)}', commands, part, now_s, elapsed_s)
              for commands in self._commands for part in commands.statistics),
            *(_status(f'{name}: {group}', 'commands',
                      self._counts(f'{name}: {group}', statistics, now_s, elapsed_s))
              for group, statistics in self._surroundings.statistics.items()),
            *self._images(f'{name}: cameras', elapsed_s),
            self._others(f'{name}: other nodes')])
        message.header.stamp = stamp_of(self._thread.progress.time_ns)
        self._publisher.publish(message)

    def _physics(self, name: str) -> DiagnosticStatus:
        thread, progress, pace = self._thread, self._thread.progress, self._pace
        pace.measure(time.monotonic())
        warnings = {kind.name: int(self._simulation.data.warning[int(kind)].number)
                    for kind in _WARNINGS}
        waits_for = '' if thread.paused else ', '.join([
            *(commands.scope.topic(part) for commands in self._commands
              for part in progress.waits_for.get(commands.robot.name, ())),
            *progress.waits_for.get(ARENA, ())])
        running = f'waits for commands: {waits_for}' if waits_for else 'running'
        status = _status(name, 'paused' if thread.paused else running, {
            'state': 'paused' if thread.paused else thread.stepping,
            'real_time_factor': f'{pace.factor:.4f}', 'missed_deadlines': progress.missed,
            'simulation_time': f'{progress.time_ns * 1e-9:.9f}',
            'waits_for': waits_for or 'none', **warnings,
            'start_defects': '; '.join(self._simulation.start_defects) or 'none',
            **{f'failed_{activity}': n for activity, n in self._context.log.failed.items()}})
        if pace.loss > _TOLERATED_LOSS and not thread.paused:
            status.level = DiagnosticStatus.WARN
            status.message = (
                f'the machine is too slow: the real-time factor is {pace.factor:.3g} instead '
                f'of {thread.real_time_factor:g}; control periods are dropped')
        if self._simulation.diverged is not None:
            status.level, status.message = DiagnosticStatus.ERROR, self._simulation.diverged
        self._report(status)
        return status

    def _images(self, name: str, elapsed_s: float) -> Iterator[DiagnosticStatus]:
        if not self._cameras.names:
            return
        failed = self._cameras.failed
        yield _status(name, one_line(str(failed or 'images')),
                      self._cameras.statistics(elapsed_s), failed is not None)

    def _others(self, name: str) -> DiagnosticStatus:
        conflicts = self._neighbours.conflicts()
        return _status(name, '; '.join(conflicts) or 'no conflict', {}, bool(conflicts))

    def _report(self, status: DiagnosticStatus) -> None:
        if status.level == DiagnosticStatus.OK:
            self._reported = None
        elif status.level == DiagnosticStatus.WARN:
            self._context.node.get_logger().warning(status.message, throttle_duration_sec=5.0)
        elif status.message != self._reported:
            self._reported = status.message
            self._context.node.get_logger().error(f'{status.message}; call ~/reset')

    def _counts(self, name: str, statistics: CommandStatistics, now_s: float, elapsed_s: float
                ) -> dict[str, object]:
        came = statistics.accepted - self._last_accepted.get(name, 0)
        self._last_accepted[name] = statistics.accepted
        return {
            'rate': f'{came / elapsed_s:.1f}' if elapsed_s > 0.0 else '0.0',
            'age': 'never' if statistics.last_s is None else f'{now_s - statistics.last_s:.3f}',
            'accepted': statistics.accepted, 'dropped': statistics.rejected}

    def _part(self, name: str, commands: CommandSubscribers, part: str, now_s: float,
              elapsed_s: float) -> DiagnosticStatus:
        robot, statistics = commands.robot, commands.statistics[part]
        period_s = statistics.take_period()
        values = {**self._counts(name, statistics, now_s, elapsed_s),
                  'period': 'none' if period_s is None else f'{period_s:.6f}',
                  'clamped': statistics.clamped, 'slowed': statistics.slowed}
        if part in robot.grippers:
            values['control_mode'] = POSITION.name
            values['command_interface'] = POSITION.field
            values['action_size'] = robot.grippers[part].dof
            values['faults'] = robot.grippers[part].faults
        elif part in robot.parts:
            joints = robot.joints
            modes = dict.fromkeys(joints.modes_of(joints.indices_of(part)))
            values['control_mode'] = ' and '.join(modes)
            values['command_interface'] = ' and '.join(
                dict.fromkeys(MODES[mode].field for mode in modes))
            values['timeouts'] = sum(
                joints.timeouts[atomic] for atomic in robot.parts[part].atomic)
            values['limited'], values['lost'] = joints.limited(part), joints.lost(part)
            values['reflexes'] = sum(
                robot.reflexes.counts[atomic] for atomic in robot.parts[part].atomic)
        reports = _reports_of(robot, part)
        values.update({f'cartesian_{kind}': sum(report.counts[kind] for report in reports)
                       for kind in (reports[0].counts if reports else ())})
        status = _status(name, 'commands', values)
        if period_s is not None:
            self._compare_rate(status, period_s)
        for stopped in robot.reflexes.tripped:
            if part in robot.parts and stopped in robot.parts[part].atomic:
                remedy = 'recover' if robot.reflexes.is_emergency else 'reset_reflex'
                self._warn(status, 'reflex', 'stopped by a reflex: '
                           f'{robot.reflexes.tripped[stopped]}; call ~/{remedy}')
                status.level = DiagnosticStatus.ERROR
        if part in robot.grippers:
            self._report_faults(status, robot.grippers[part])
        for report in reports:
            self._report_new(status.name, report)
        return status

    def _compare_rate(self, status: DiagnosticStatus, period_s: float) -> None:
        """Warn of commands that come at another rate than is expected."""
        expected_hz = self._context.parameters.value('expected_command_rate')
        if expected_hz and abs(period_s * expected_hz - 1.0) > _TOLERATED_RATE:
            rate = f'{1.0 / period_s:.4g} Hz' if period_s else 'more than publish_rate'
            self._warn(status, 'rate', f'commands come at {rate} of simulation time, not at '
                       f'{expected_hz:g} Hz as expected_command_rate says')

    def _report_new(self, name: str, report: CartesianReport) -> None:
        """Warn of causes since the last status that keep an end effector from its target."""
        for kind, count in report.counts.items():
            if count > self._last_faults.get(f'{name} {kind}', 0):
                self._last_faults[f'{name} {kind}'] = count
                self._context.log.warn(name, kind, report.texts[kind])

    def _report_faults(self, status: DiagnosticStatus, gripper: GripperController) -> None:
        """Warn if a gripper's own code has failed since the last status."""
        faults, before = gripper.faults, self._last_faults.get(status.name, 0)
        self._last_faults[status.name] = faults
        if faults > before:
            self._warn(status, 'fault', one_line(f'the fingers hold, {gripper.last_fault}'))

    def _warn(self, status: DiagnosticStatus, kind: str, message: str) -> None:
        """Turn a status into a warning, and log it."""
        status.level, status.message = DiagnosticStatus.WARN, message
        self._context.log.warn(status.name, kind, f'{status.name}: {message}')


_WARNINGS = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL,
             mujoco.mjtWarning.mjWARN_BADQACC, mujoco.mjtWarning.mjWARN_BADCTRL,
             mujoco.mjtWarning.mjWARN_CONTACTFULL)


def _reports_of(robot: SimulatedRobot, part: str) -> list[CartesianReport]:
    """Return the reports of a part's arms: causes that kept end effectors from their targets."""
    if part not in robot.parts:
        return []
    return [report for arm, report in robot.joints.cartesian.reports.items()
            if robot.parts[arm].atomic == robot.parts[part].atomic]


def _status(name: str, message: str, values: dict[str, object], warns: bool = False
            ) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=DiagnosticStatus.WARN if warns else DiagnosticStatus.OK, name=name,
        message=message, hardware_id='mujoco',
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])


#: Programs of this package; what they publish may outlive a node by a moment.
_OWN_PROGRAMS = ('sim_view', 'pick_cube', 'hand_over')
#: Least similarity of a topic with one end to a topic of the node with the other end.
_SIMILAR = 0.8
#: And of a topic of another kind: MoveIt's ``planning_scene`` is no ``planning_scene_world``.
_MISSPELT = 0.9
#: The packages of services that every node has, so that a call of one may be for any other node.
_OF_EVERY_NODE = ('rcl_interfaces', 'type_description_interfaces')
#: Longest time of messages of a node after its endpoints [s].
_UNHEARD_S = 5.0
#: Greatest number of conflicts that are reported.
_MOST_CONFLICTS = 20


class GraphMonitor:
    """
    Conflicts with other nodes; each is logged once for as long as it lasts.

    A conflict is reported when two looks in a row find it, because discovery has no order: the
    name of a node may come after its endpoints. As long as neither the graph nor the conflicts
    change, a look is a comparison of the names and numbers of its endpoints.

    :param scopes: namespace of the topics of each robot
    """

    def __init__(self, node: Node, scopes: Sequence[Scope]) -> None:
        self._node = node
        self._graph: tuple[Any, ...] = ()
        self._looks = 0
        self._unheard_since_s: float | None = None
        self._found: dict[str, str] = {}
        self._reported: dict[str, str] = {}
        self._own = (node.get_name(), node.get_namespace())
        self._topics = {
            '/clock': 'time goes back and forth; set publish_clock:=false in all but one',
            **{node.resolve_topic_name(scope.topic('joint_states')):
               'subscribers see two robots in one; give each node a namespace'
               for scope in scopes}}

    def conflicts(self) -> list[str]:
        """
        Return the present conflicts: names, topics of two publishers, and what does not match.

        To be called from time to time; new conflicts are logged as warnings.
        """
        topics = self._node.get_topic_names_and_types()
        graph = (self._node.get_node_names_and_namespaces(), topics,
                 self._node.get_service_names_and_types(),
                 endpoint_counts(self._node, [name for name, _ in topics]))
        if graph != self._graph:
            self._graph, self._looks = graph, 2
        if self._looks:
            self._looks -= 1
            self._look(dict(topics))
        return list(self._reported.values())

    def _look(self, topics: Mapping[str, Sequence[str]]) -> None:
        seen = {**self._same_name(), **self._same_topics(), **self._unheard(),
                **{text: text for text in islice(chain(
                    self._mismatches(topics), self._missed_services()), _MOST_CONFLICTS)}}
        confirmed = {key: text for key, text in seen.items() if key in self._found}
        for key in confirmed.keys() - self._reported.keys():
            self._node.get_logger().warning(confirmed[key])
        if seen != self._found or self._unheard_since_s is not None and 'unheard' not in seen:
            self._looks = max(1, self._looks)
        self._found, self._reported = seen, confirmed

    def _same_name(self) -> dict[str, str]:
        count = self._node.get_node_names_and_namespaces().count(self._own)
        if count < 2:
            return {}
        return {'name': f'{count} nodes are named {self._node.get_fully_qualified_name()}: '
                'services and parameters reach any of them; rename all but one with '
                '-r __node:=NAME (one that was killed counts for 20 s more)'}

    def _unheard(self) -> dict[str, str]:
        text = describe_unheard(self._node)
        if not text:
            self._unheard_since_s = None
        elif self._unheard_since_s is None:
            self._unheard_since_s = time.monotonic()
        elif time.monotonic() - self._unheard_since_s > _UNHEARD_S:
            return {'unheard': text}
        return {}

    def _same_topics(self) -> dict[str, str]:
        published = [publisher.topic_name for publisher in self._node.publishers]
        others = {topic: self._others(topic) for topic in self._topics if topic in published}
        return {topic: f'{topic} is also published by {names}: {self._topics[topic]}'
                for topic, names in others.items() if names}

    def _others(self, topic: str) -> str:
        names = [(info.node_name, info.node_namespace)
                 for info in self._node.get_publishers_info_by_topic(topic)
                 if not is_unheard(info)]
        if self._own in names:
            # One of the nodes that have this name is this node.
            names.remove(self._own)
        return quoted_names(sorted({f'{space.rstrip("/")}/{name}' for name, space in names}))

    def _mismatches(self, topics: Mapping[str, Sequence[str]]) -> Iterator[str]:
        """Yield a line for each endpoint of others that does not match one of this node."""
        node = self._node
        taken, published = _types(node.subscriptions), _types(node.publishers)
        for topic, kind in taken.items():
            for info in self._others_of(node.get_publishers_info_by_topic(topic)):
                if info.topic_type != kind:
                    yield (f'{topic} takes {_short(kind)}; {_name(info)} publishes '
                           f'{_short(info.topic_type)}{_taking(topic, info.topic_type, taken)}')
                elif reason := _incompatible([(info.qos_profile, qos) for qos in self._own_qos(
                        node.get_subscriptions_info_by_topic(topic))]):
                    yield f'{topic} cannot take what {_name(info)} publishes: {reason}'
        for topic, kind in published.items():
            for info in self._others_of(node.get_subscriptions_info_by_topic(topic)):
                if info.topic_type != kind:
                    yield (f'{topic} is {_short(kind)}; {_name(info)} subscribes to '
                           f'{_short(info.topic_type)}')
                elif reason := _incompatible([(qos, info.qos_profile) for qos in self._own_qos(
                        node.get_publishers_info_by_topic(topic))]):
                    yield f'{_name(info)} cannot receive {topic}: {reason}'
        for topic in sorted(topics.keys() - taken.keys() - published.keys()):
            senders = node.get_publishers_info_by_topic(topic)
            readers = node.get_subscriptions_info_by_topic(topic)
            if senders and readers:
                continue
            other, verb, names = (('publishes', 'takes', taken) if senders else
                                  ('subscribes to', 'publishes', published))
            near = _nearest(topic, topics[topic], names)
            for info in self._others_of([*senders, *readers] if near else ()):
                yield (f'{_name(info)} {other} {quoted(topic)}, which nobody {verb}; this node '
                       f'{verb} {near}')

    def _missed_services(self) -> Iterator[str]:
        """Yield a line for each service that others wait for, and that this node has otherwise."""
        node = self._node
        services = {service: kinds for service, kinds in node.get_service_names_and_types_by_node(
            *self._own) if kinds[0].partition('/')[0] not in _OF_EVERY_NODE}
        for name, space in node.get_node_names_and_namespaces():
            if (name, space) == self._own or name in _OWN_PROGRAMS:
                continue
            try:
                asked = node.get_client_names_and_types_by_node(name, space)
            except NodeNameNonExistentError:  # It has ended.
                continue
            for service, kinds in asked:
                client = quoted(f'{space.rstrip("/")}/{name}')
                if service in services and not set(kinds) <= set(services[service]):
                    yield (f'{service} is {_short(services[service][0])}; {client} calls it as '
                           f'{_short(kinds[0])}')
                elif not node.count_services(service):
                    last = f"/{service.rpartition('/')[2]}"
                    alike = [other for other in services if other.endswith(last)]
                    for near in difflib.get_close_matches(service, alike, n=1, cutoff=0.0):
                        yield (f'{client} calls {quoted(service)}, which nobody offers; this node '
                               f'offers {near}')

    def _others_of(self, infos: Sequence[TopicEndpointInfo]) -> Iterator[TopicEndpointInfo]:
        for info in infos:
            if not (self._is_own(info) or is_unheard(info)
                    or info.node_name in _OWN_PROGRAMS):
                yield info

    def _own_qos(self, infos: Sequence[TopicEndpointInfo]) -> list[QoSProfile]:
        # As the middleware has them: in the node's own profiles, zero stands for a default.
        return [info.qos_profile for info in infos if self._is_own(info)]

    def _is_own(self, info: TopicEndpointInfo) -> bool:
        return (info.node_name, info.node_namespace) == self._own


def _types(endpoints: Iterator[Any]) -> dict[str, str]:
    """Return the types of the publishers or subscriptions of the node, by topic."""
    return {endpoint.topic_name: f'{endpoint.msg_type.__module__.partition(".")[0]}/msg/'
            f'{endpoint.msg_type.__name__}' for endpoint in list(endpoints)}


def _incompatible(pairs: Sequence[tuple[QoSProfile, QoSProfile]]) -> str:
    """Return why none of some pairs of publisher and subscription match, or nothing."""
    results = [qos_check_compatible(*pair) for pair in pairs]
    if not results or any(result != QoSCompatibility.ERROR for result, _ in results):
        return ''
    return results[0][1].replace('ERROR: ', '').rstrip(';').replace(';', ', ').lower()


def _taking(topic: str, kind: str, taken: Mapping[str, str]) -> str:
    """Return the hint that another topic with a similar name takes a type."""
    near = difflib.get_close_matches(
        topic, [name for name, other in taken.items() if other == kind], n=1, cutoff=0.7)
    return f', which {near[0]} takes' if near else ''


def _nearest(topic: str, kinds: Sequence[str], taken: Mapping[str, str]) -> str | None:
    """Return the topic of the node that was probably meant by one that it does not have."""
    in_other_namespace = [name for name in taken if name.endswith(topic) or topic.endswith(name)]
    of_one_kind = [name for name, kind in taken.items() if kind in kinds]
    of_one_name = [name for name in of_one_kind
                   if name.rpartition('/')[2] == topic.rpartition('/')[2]]
    for names, similarity in (
            (in_other_namespace, 0.0), (of_one_name, 0.0), (of_one_kind, _SIMILAR),
            (taken, _MISSPELT)):
        near = difflib.get_close_matches(topic, names, n=1, cutoff=similarity)
        if near:
            return near[0]
    return None


def _short(kind: str) -> str:
    return one_line(kind.rpartition('/')[2])


def _name(info: TopicEndpointInfo) -> str:
    return quoted(f'{info.node_namespace.rstrip("/")}/{info.node_name}')
