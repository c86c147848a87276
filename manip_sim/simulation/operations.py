# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What else than commands changes a simulation from outside, by name and with plain arguments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from manip_sim.errors import CommandError
from manip_sim.simulation.poses import Pose, Twist
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.saved_state import SimulationState
from manip_sim.simulation.simulation import Simulation


class Operations:
    """
    The operations on a simulation, between two control periods.

    Their names and arguments can be written to a record, and repeated from it.

    :param simulation: any
    :param steps: physics steps of a control period
    :ivar restart: puts the simulation to its start, from a seed, or as it was
    """

    def __init__(self, simulation: Simulation, steps: int) -> None:
        self._simulation, self._steps = simulation, steps
        self.restart: Callable[[int | None], None] = simulation.reset
        self._saved: SimulationState | None = None
        self._named: Mapping[str, Callable[..., Any]] = {
            'reset': self._reset, 'save': self._save, 'restore': self._restore,
            'tare': self._tare, 'reset_reflexes': self._reset_reflexes,
            'keyframe': self._keyframe, 'mode': self._mode, 'timeout': self._timeout,
            'stream_interval': self._stream_interval, 'stream_hold': self._stream_hold,
            'wrench_cutoff': self._wrench_cutoff, 'sensing': self._sensing,
            'reflex': self._reflex, 'cartesian': self._cartesian, 'place': self._place,
            'direct_command': self._direct_command, 'target': self._target,
            'pull': self._pull, 'end_pull': self._end_pull, 'answer': lambda: None}

    def run(self, name: str, *arguments: Any) -> Any:
        """
        Run an operation.

        :param name: of one of them
        :param arguments: what JSON can hold
        :raises ManipSimError: if it cannot be done
        """
        return self._named[name](*arguments)

    @property
    def names(self) -> frozenset[str]:
        """The names of all operations."""
        return frozenset(self._named)

    def _robot(self, name: str) -> SimulatedRobot:
        return self._simulation.robots[name]

    def _reset(self, seed: int | None, restart_time: bool) -> None:
        self.restart(seed)
        if restart_time:
            self._simulation.step_count = 0
        self._begin_instant()

    def _begin_instant(self) -> None:
        # A new state needs a new stamp, and zero means no stamp.
        self._simulation.step_count += self._steps

    def _save(self) -> str:
        self._saved = self._simulation.save()
        return self._simulation.digest()

    def _restore(self) -> str:
        if self._saved is None:
            raise CommandError('no state has been saved')
        count = self._simulation.step_count
        self._simulation.restore(self._saved)
        self._simulation.step_count = count
        digest = self._simulation.digest()
        self._begin_instant()
        return digest

    def _tare(self) -> None:
        for robot in self._simulation.robots.values():
            robot.tare_wrench()

    def _reset_reflexes(self) -> None:
        for robot in self._simulation.robots.values():
            robot.reset_reflexes()

    def _keyframe(self, name: str) -> None:
        self._simulation.keyframe = name

    def _mode(self, robot: str, part: str, mode: str) -> None:
        self._robot(robot).set_control_mode(part, mode)

    def _timeout(self, robot: str, part: str, timeout_s: float, ends_targets: bool) -> None:
        self._robot(robot).set_command_timeout(part, timeout_s, ends_targets)

    def _stream_interval(self, robot: str, part: str, longest_s: float) -> None:
        self._robot(robot).set_stream_interval(part, longest_s)

    def _stream_hold(self, robot: str, part: str, hold_s: float) -> None:
        self._robot(robot).set_stream_hold(part, hold_s)

    def _wrench_cutoff(self, robot: str, arm: str, cutoff_hz: float) -> None:
        self._robot(robot).set_wrench_cutoff(arm, cutoff_hz)

    def _sensing(self, robot: str, quantity: str, value: float) -> None:
        self._robot(robot).sensing.set(quantity, value)

    def _reflex(self, robot: str, name: str, quantity: str, value: float) -> None:
        self._robot(robot).set_reflex(name, quantity, value)

    def _cartesian(self, robot: str, arm: str, setting: str, value: float) -> None:
        self._robot(robot).joints.cartesian.set(arm, setting, value)

    def _place(self, name: str, pose: list[list[float]] | None, twist: list[list[float]] | None
               ) -> None:
        self._simulation.entities.place(
            self._simulation.data, name, None if pose is None else Pose.checked(*pose),
            None if twist is None else Twist.checked(*twist))

    def _direct_command(self, part: str, name: str, quantity: str, value: float) -> None:
        # Objects may have come or gone since the message came, and actuators with them.
        found = self._simulation.surroundings.commands[part]
        found.command(found.checked([name], **{
            one: [value] * (one == quantity) for one in ('position', 'velocity', 'effort')}))

    def _target(self, name: str, position: list[float], quat_xyzw: list[float]) -> None:
        self._simulation.surroundings.set_target(name, position, quat_xyzw)

    def _pull(self, body: str, point: list[float], target: list[float], number: int) -> None:
        self._simulation.pulls.pull(body, point, target, number)

    def _end_pull(self, body: str) -> None:
        self._simulation.pulls.end(body)
