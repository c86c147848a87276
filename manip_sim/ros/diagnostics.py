# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tell once a second how the simulation and its commands are doing, on ``/diagnostics``."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import mujoco
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from manip_sim.ros.commands import CommandStatistics, CommandSubscribers
from manip_sim.ros.messages import stamp_of
from manip_sim.ros.runner import Progress, Runner
from manip_sim.simulation import Simulation

_PERIOD_S = 1.0


class Diagnostics:
    """
    Publishes one status for the simulation and one for the commands of each part.

    :param node: the node
    :param simulation: only looked at
    :param runner: tells how far the simulation has come
    :param commands: tells what came in
    """

    def __init__(self, node: Node, simulation: Simulation, runner: Runner,
                 commands: CommandSubscribers) -> None:
        self._node = node
        self._simulation = simulation
        self._runner = runner
        self._commands = commands
        self._last: Progress = runner.progress
        self._last_accepted = {part: 0 for part in commands.statistics}
        self._last_s = time.monotonic()
        self._told: str | None = None
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        node.create_timer(_PERIOD_S, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self) -> None:
        now_s = time.monotonic()
        elapsed_s, self._last_s = now_s - self._last_s, now_s
        name = self._node.get_fully_qualified_name().lstrip('/')
        message = DiagnosticArray(status=[
            self._physics(f'{name}: simulation'),
            *(self._part(f'{name}: {part}', part, statistics, now_s, elapsed_s)
              for part, statistics in self._commands.statistics.items())])
        message.header.stamp = stamp_of(self._runner.progress.time_ns)
        self._publisher.publish(message)

    def _physics(self, name: str) -> DiagnosticStatus:
        progress, last = self._runner.progress, self._last
        self._last = progress
        wall_s = progress.wall_s - last.wall_s
        # A reset may have let simulation time begin again.
        simulated_s = max(0, progress.time_ns - last.time_ns) * 1e-9
        factor = simulated_s / wall_s if wall_s > 0.0 else 0.0
        missed = progress.missed - last.missed
        warnings = {kind.name: int(self._simulation.data.warning[int(kind)].number)
                    for kind in _WARNINGS}
        status = _status(name, 'running', {
            'state': 'paused' if self._runner.paused else self._runner.stepping,
            'real_time_factor': f'{factor:.4f}', 'missed_deadlines': progress.missed,
            'simulation_time': f'{progress.time_ns * 1e-9:.9f}', **warnings,
            **{f'failed_{what}': n for what, n in self._node.rejections.failed.items()}})
        if missed:
            status.level = DiagnosticStatus.WARN
            status.message = f'{missed} control periods were dropped: the machine is too slow'
        if self._simulation.diverged is not None:
            status.level, status.message = DiagnosticStatus.ERROR, self._simulation.diverged
        self._tell(status)
        return status

    def _tell(self, status: DiagnosticStatus) -> None:
        if status.level == DiagnosticStatus.OK:
            self._told = None
        elif status.level == DiagnosticStatus.WARN:
            self._node.get_logger().warning(status.message, throttle_duration_sec=5.0)
        elif status.message != self._told:
            self._told = status.message
            self._node.get_logger().error(f'{status.message}; call ~/reset')

    def _part(self, name: str, part: str, statistics: CommandStatistics, now_s: float,
              elapsed_s: float) -> DiagnosticStatus:
        came = statistics.accepted - self._last_accepted[part]
        self._last_accepted[part] = statistics.accepted
        values: dict[str, object] = {
            'rate': f'{came / elapsed_s:.1f}' if elapsed_s > 0.0 else '0.0',
            'age': 'never' if statistics.last_s is None else f'{now_s - statistics.last_s:.3f}',
            'accepted': statistics.accepted, 'dropped': statistics.refused,
            'clamped': statistics.clamped, 'slowed': statistics.slowed}
        if part in self._simulation.grippers:
            values['control_mode'] = 'position'
        elif part in self._simulation.parts:
            joints = self._simulation.joints
            modes = dict.fromkeys(joints.modes_of(joints.indices_of(part)))
            values['control_mode'] = ' and '.join(modes)
            values['timeouts'] = sum(
                joints.timeouts[atomic] for atomic in self._simulation.parts[part].atomic)
            values['limited'] = joints.limited(part)
        return _status(name, 'commands', values)


_WARNINGS = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL,
             mujoco.mjtWarning.mjWARN_BADQACC, mujoco.mjtWarning.mjWARN_CONTACTFULL)


def _status(name: str, message: str, values: dict[str, object]) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=DiagnosticStatus.OK, name=name, message=message, hardware_id='mujoco',
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])
