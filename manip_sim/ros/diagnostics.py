# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish on ``/diagnostics``: the simulation, commands, images, and conflicts with others."""

from __future__ import annotations

from collections.abc import Iterator
import math
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import mujoco
from rclpy.clock import Clock, ClockType

from manip_sim.control.cartesian.reports import CartesianReport
from manip_sim.control.gripper_controller import GripperController
from manip_sim.control.modes import MODES, POSITION
from manip_sim.control.surroundings import ARENA
from manip_sim.interface.topics import BY_NAME
from manip_sim.quoting import one_line
from manip_sim.ros.camera_publishers import Cameras
from manip_sim.ros.command_subscribers import (
    CommandStatistics, CommandSubscribers, RobotCommands, SurroundingsCommands)
from manip_sim.ros.feature import Feature, NodeContext
from manip_sim.ros.graph_monitor import GraphMonitor
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
            **{f'failed_{what}': n for what, n in self._context.log.failed.items()}})
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
                status.level = DiagnosticStatus.ERROR
                remedy = 'recover' if robot.reflexes.is_emergency else 'reset_reflex'
                status.message = (f'stopped by a reflex: {robot.reflexes.tripped[stopped]}; '
                                  f'call ~/{remedy}')
                self._context.log.warn(name, 'reflex', f'{name}: {status.message}')
        if part in robot.grippers:
            self._report_faults(status, robot.grippers[part])
        for report in reports:
            self._report_new(status.name, report)
        return status

    def _compare_rate(self, status: DiagnosticStatus, period_s: float) -> None:
        """Warn of commands that come at another rate than is expected."""
        expected_hz = self._context.parameters.value('expected_command_rate')
        if expected_hz and abs(period_s * expected_hz - 1.0) > _TOLERATED_RATE:
            status.level = DiagnosticStatus.WARN
            rate = f'{1.0 / period_s:.4g} Hz' if period_s else 'more than publish_rate'
            status.message = (f'commands come at {rate} of simulation time, not at '
                              f'{expected_hz:g} Hz as expected_command_rate says')
            self._context.log.warn(status.name, 'rate', f'{status.name}: {status.message}')

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
            status.level = DiagnosticStatus.WARN
            status.message = one_line(f'the fingers hold, {gripper.last_fault}')
            self._context.log.warn(status.name, 'fault', f'{status.name}: {status.message}')


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
