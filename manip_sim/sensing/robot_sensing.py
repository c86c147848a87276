# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Measurements of one robot: its sensors, their noise, and the age of their readings."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
import math
from typing import Any, Generic, Protocol, TypeVar
import weakref

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.sensing.randomness import NormalRows
from manip_sim.sensing.sensor_noise import Channel, OdometryChannel, SensingSettings, WrenchChannel

#: Share of a timestep by which a duration may miss a whole number of them.
ROUNDING = 1e-6
#: Names of the channels of all joints of a robot, and of the odometry of its base.
JOINTS, ODOM = 'joints', 'odom'
#: Returns exact numbers of the present instant, a copy.
Read = Callable[[], FloatArray]

Sent = TypeVar('Sent')


class Delay:
    """
    The single delays of one way; they depend on the seed, the name and the step only.

    :param name: of the way, unique in its world
    :ivar mean_s: mean of the delays before those below zero become zero [s]
    :ivar jitter_s: their standard deviation [s]
    """

    def __init__(self, name: str, timestep_s: float) -> None:
        self._name = name
        self._timestep_s = timestep_s
        self.mean_s = self.jitter_s = 0.0
        self.set_seed(0)

    def set_seed(self, seed: int) -> None:
        """Draw from a seed from now on."""
        self._rows = NormalRows(seed, self._name, 1)

    @property
    def mean_steps(self) -> int:
        """The mean in whole steps."""
        return self._in_steps(self.mean_s)

    def steps(self, count: int) -> int:
        """
        Return the delay of a message sent after some steps, in whole steps, from 0.

        :param count: steps since the reset
        """
        delay_s = self.mean_s
        if self.jitter_s:
            delay_s = delay_s + self.jitter_s * float(self._rows.row(count)[0])
        return self._in_steps(delay_s)

    def _in_steps(self, delay_s: float) -> int:
        return math.ceil(max(delay_s, 0.0) / self._timestep_s - ROUNDING)


class InTransit(Generic[Sent]):
    """Sent values, by their arrival in steps since the reset."""

    def __init__(self) -> None:
        self._queue: deque[tuple[int, Sent]] = deque()

    def __bool__(self) -> bool:
        return bool(self._queue)

    def __iter__(self) -> Iterator[tuple[int, Sent]]:
        return iter(self._queue)

    def send(self, value: Sent, arrival: int) -> None:
        """
        Add a value, which may overtake earlier ones.

        :param arrival: in steps since the reset
        """
        self._queue.append((arrival, value))

    def take(self, count: int) -> Iterator[Sent]:
        """
        Yield and forget the arrived values, in the order in which they were sent.

        :param count: steps since the reset
        """
        while self._queue and self._queue[0][0] <= count:
            yield self._queue.popleft()[1]

    def newest(self, count: int) -> Sent:
        """
        Return the newest value that has arrived, or the oldest of all while none has.

        Older values are forgotten.

        :param count: steps since the reset
        """
        place = next((index for index in range(len(self._queue) - 1, -1, -1)
                      if self._queue[index][0] <= count), 0)
        for _ in range(place):
            self._queue.popleft()
        return self._queue[0][1]

    def clear(self) -> None:
        """Forget everything."""
        self._queue.clear()


class Measurements(InTransit[tuple[int, Sent]]):
    """Measurements with their instants in steps since the reset, which arrive later."""

    def record(self, count: int, value: Sent, delay: int) -> None:
        """
        Add a measurement of the present instant; it replaces those made then or later.

        :param count: steps since the reset
        :param delay: until it arrives, in steps; the first one is known at once
        """
        arrival = count + delay if self else count
        while self._queue and self._queue[-1][1][0] >= count:
            arrival = self._queue.pop()[0]
        self.send((count, value), arrival)


class Steps(Protocol):
    """Counts physics steps."""

    @property
    def control_steps(self) -> int:
        """Steps since the last reset."""


class ExternalWrenchChannel(Channel):
    """
    The external wrench of an arm, which is computed from its force/torque sensor.

    The noise of the sensor comes with the turned sign, is filtered as the wrench is, and a tare
    takes it away as it is at that moment.
    """

    def __init__(self, of: WrenchChannel) -> None:
        super().__init__(f'{of.name} external', 6)
        self._of = of
        self.weight = 1.0
        self.filtered: FloatArray | None = None
        self.tare: FloatArray = np.zeros(6)

    def end_period(self, count: int, timestep_s: float, weight: float) -> None:
        """
        Filter the noise of the sensor.

        :param weight: of the new value in the low-pass of first order; 1 for no filter
        """
        noise = self._of.noise(count, timestep_s)
        if weight >= 1.0:
            self.filtered = None
        elif self.filtered is None:
            self.filtered = noise
        else:
            self.filtered = self.filtered + weight * (noise - self.filtered)

    def noise(self, count: int, timestep_s: float) -> FloatArray:
        """Return the noise before the tare, shape (6,)."""
        of_sensor = self._of.noise(count, timestep_s) if self.filtered is None else self.filtered
        return -of_sensor

    def measure(self, exact: FloatArray, count: int, timestep_s: float) -> FloatArray:
        """Return the wrench with the noise that is left after the tare, shape (6,)."""
        measured: FloatArray = exact + self.noise(count, timestep_s) - self.tare
        return measured


class RobotSensing:
    """
    Measurements of a robot, by the names of channels.

    With all settings at zero, measured values are exact. Everything depends on the seed,
    the settings and the steps since the reset, and not on who reads what when.

    With a latency of states, each control period measures one instant: the one whose measurement
    arrives, without jitter, exactly at the end of a period of that length.

    :param name: of the robot, unique in its world
    :param interrupt: called before settings change
    :ivar delays: of measurements, images and commands, by ``state``, ``image``, ``command``
    """

    def __init__(self, name: str, steps: Steps, timestep_s: float,
                 interrupt: Callable[[], None]) -> None:
        self._interrupt = interrupt
        self._steps, self._timestep_s = steps, timestep_s
        self.settings = SensingSettings()
        self.seed = 0
        self._channels: dict[str, tuple[Channel | None, Read]] = {}
        self._external: dict[str, ExternalWrenchChannel] = {}
        self._history: Measurements[Mapping[str, FloatArray]] = Measurements()
        self._recorders: list[weakref.WeakMethod[Callable[[], None]]] = []
        #: Returns the measurements of the joints while states are at fault, else None.
        self.faulty: Callable[[], FloatArray | None] = _no_faults
        self.delays = {kind: Delay(f'{name} latency.{kind}', timestep_s)
                       for kind in ('state', 'image', 'command')}
        self._draw()

    def _draw(self) -> None:
        for delay in self.delays.values():
            delay.set_seed(self.seed)
        for channel, _ in self._channels.values():
            if channel is not None:
                channel.set_seed(self.seed)

    def add(self, name: str, read: Read, channel: Channel | None = None) -> None:
        """
        Add a channel.

        :param name: of the channel; one of this name is replaced
        """
        if channel is not None:
            channel.set_seed(self.seed)
            channel.adapt(self.settings)
        if isinstance(channel, ExternalWrenchChannel):
            self._external[name] = channel
        self._channels[name] = channel, read

    def forget(self, begin: str) -> None:
        """Remove the channels whose names begin so."""
        self._channels = {name: channel for name, channel in self._channels.items()
                          if not name.startswith(begin)}

    def set(self, name: str, value: float) -> None:
        """
        Change a setting from now on.

        :param name: one of ``manip_sim.sensing.sensor_noise.QUANTITIES``
        :param value: from 0, which is off
        :raises UnknownNameError: if the setting is unknown
        :raises CommandError: if the value is out of range
        """
        self.settings.set(name, value)
        self._adapt()

    def _adapt(self) -> None:
        self._interrupt()
        for channel, _ in self._channels.values():
            if channel is not None:
                channel.adapt(self.settings)
        for kind, delay in self.delays.items():
            delay.mean_s = self.settings[f'latency.{kind}']
            delay.jitter_s = self.settings[f'latency.{kind}_jitter']
        if not self.settings.delays:
            self._history.clear()
        elif not self._history:
            self.record()

    @property
    def odometry(self) -> OdometryChannel | None:
        """The drift of the odometry of the base, if the robot has one that moves."""
        channel, _ = self._channels.get(ODOM, (None, None))
        return channel if isinstance(channel, OdometryChannel) else None

    # ------------------------------------------------------------------ values

    @property
    def count(self) -> int:
        """Steps since the last reset."""
        return self._steps.control_steps

    @property
    def instant(self) -> int:
        """Steps from the last reset to the newest state that has arrived."""
        return self._history.newest(self.count)[0] if self._history else self.count

    def exact(self, name: str) -> FloatArray:
        """Return the exact numbers of the present instant, a copy."""
        return self._channels[name][1]()

    def measured(self, name: str) -> FloatArray:
        """Return the present measurement of a channel, a copy."""
        faulty = self.faulty() if name == JOINTS else None
        return self.without_faults(name) if faulty is None else faulty.copy()

    def without_faults(self, name: str) -> FloatArray:
        """Return what would be measured at present if no state was at fault, a copy."""
        if not self.settings.measures:
            channel, read = self._channels[name]
            return read() if channel is None or not channel.is_noisy else self._measure(name)
        if self.settings.delays:
            value = self._history.newest(self.count)[1].get(name)
            if value is not None:
                return value.copy()
        return self._measure(name)

    def _measure(self, name: str) -> FloatArray:
        channel, read = self._channels[name]
        exact = read()
        return exact if channel is None else channel.measure(
            exact, self._steps.control_steps, self._timestep_s)

    # ------------------------------------------------------------------ in the physics loop

    def steps_to_measuring(self, steps: int) -> int | None:
        """
        Return after how many steps of a control period the state is measured; None for never.

        :param steps: of the period
        """
        if not self.settings.delays:
            return None
        return steps - self.delays['state'].mean_steps % steps

    def end_period(self, weights: Mapping[str, float], steps: int) -> None:
        """
        Measure the end of a control period, where something is to be remembered.

        :param weights: of the low-passes of the external wrenches, by channel; 1 for no filter
        :param steps: of the period
        """
        for name, channel in self._external.items():
            channel.end_period(self._steps.control_steps, self._timestep_s, weights[name])
        if self.odometry is not None and self.odometry.drifts:
            self.odometry.end_period(self.exact(ODOM), self._steps.control_steps)
        if self.steps_to_measuring(steps) == steps:
            self.record()

    def record(self) -> None:
        """Measure the present instant, which arrives later."""
        self._history.record(
            self.count, {name: self._measure(name) for name in self._channels},
            self.delays['state'].steps(self.count))
        for reference in [*self._recorders]:
            recorder = reference()
            if recorder is None:
                self._recorders.remove(reference)
            else:
                recorder()

    def record_too(self, recorder: Callable[[], None]) -> None:
        """
        Let what else has the latency of states be recorded with them.

        :param recorder: a bound method, which is called while its object is there
        """
        self._recorders.append(weakref.WeakMethod(recorder))

    def tare(self) -> None:
        """Let the noise of the external wrenches be zero at present."""
        for channel in self._external.values():
            channel.tare = channel.noise(self._steps.control_steps, self._timestep_s)

    def reset(self, seed: int | None = None) -> None:
        """
        Forget all measurements, as the robot is at its start.

        :param seed: of the noise from now on; None keeps it
        """
        if seed is not None:
            self.seed = seed
            self._draw()
        for channel in self._external.values():
            channel.filtered, channel.tare = None, np.zeros(6)
        if self.odometry is not None:
            self.odometry.poses = None
        self.restart()

    def restart(self) -> None:
        """Forget measurements from before the present instant."""
        self._history.clear()
        if self.settings.delays:
            self.record()

    # ------------------------------------------------------------------ saved states

    def save(self) -> dict[str, Any]:
        """Return everything that future measurements depend on; it can be pickled."""
        return {'seed': self.seed, 'settings': self.settings.as_dict(),
                'external': {name: (channel.filtered, channel.tare)
                             for name, channel in self._external.items()},
                'odometry': None if self.odometry is None else self.odometry.poses,
                'history': [(count, arrival, dict(values))
                            for arrival, (count, values) in self._history]}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore what :meth:`save` has returned."""
        self.seed = state['seed']
        self._draw()
        self.settings.replace(state['settings'])
        for name, (filtered, tare) in state['external'].items():
            self._external[name].filtered, self._external[name].tare = filtered, tare
        if self.odometry is not None:
            self.odometry.poses = state['odometry']
        self._history.clear()
        for count, arrival, values in state['history']:
            self._history.send((count, values), arrival)
        self._adapt()

    def digested(self) -> dict[str, Any] | None:
        """
        Return what :meth:`save` returns without what makes no difference.

        That is all while all settings are zero, what nobody wants again, read or not, and channels
        without noise, such as the odometry of a node, which follow from the others.
        """
        if not self.settings.as_dict():
            return None
        if self._history:
            self._history.newest(self.count)
        state = self.save()
        noisy = {name for name, (channel, _) in self._channels.items() if channel is not None}
        state['history'] = [(count, arrival, {
            name: value for name, value in values.items() if name in noisy})
            for count, arrival, values in state['history']]
        return state


def _no_faults() -> None:
    """Return that no state is at fault."""
