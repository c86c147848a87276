# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
How joints follow streams whose messages jitter or get lost, as a table.

    python3 benchmark/streams.py [--seconds S]

Joint 1 of a Panda follows a sine of 0.2 rad and 0.5 Hz, in simulated time, so the figures are the
same on every machine. Each row is compared with the same stream on schedule: the greatest
acceleration of the joint's setpoint and the greatest torque, after the first two seconds; and the
ripple, what is left of the setpoint's velocity without the sine, as a share of its amplitude.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models import compose
from manip_sim.simulation import Simulation

AMPLITUDE, TURN, SETTLED_S, TIMESTEP_S = 0.2, np.pi, 2.0, 0.002


@dataclass(frozen=True)
class Row:
    """
    A stream and what happens to its messages.

    :ivar rate: of the stream [Hz]
    :ivar control_rate: of the simulation [Hz]
    :ivar jitter_s: standard deviation of what messages come late, the absolute value of a normal
        distribution [s]
    :ivar timer: standard deviation of the times of sending, in intervals
    :ivar lost: share of the messages
    :ivar due: if each message is a trajectory of one point, when that is due, in intervals
    :ivar noise: standard deviation of the goals [rad]
    :ivar copied: when each message comes again, in intervals; 0: never
    :ivar stall_s: for how long nothing comes, and then one message each ms [s]
    """

    rate: int
    control_rate: int
    jitter_s: float = 0.0
    timer: float = 0.0
    lost: float = 0.0
    due: float = 0.0
    noise: float = 0.0
    copied: float = 0.0
    stall_s: float = 0.0

    def __str__(self) -> str:
        what = [f'{self.jitter_s * 1e3:g} ms on the way'] if self.jitter_s else []
        what += [f"{self.timer:.0%} of the sender's timer"] if self.timer else []
        what += [f'{self.lost:.0%} lost'] if self.lost else []
        what += [f'goals off by {self.noise * 1e3:g} mrad'] if self.noise else []
        what += [f'each again {self.copied:g} intervals later'] if self.copied else []
        what += [f'a stall of {self.stall_s * 1e3:g} ms, then one each ms'] if self.stall_s else []
        points = f', points due in {1e3 * self.due / self.rate:.3g} ms' if self.due else ''
        return (f'{self.rate} Hz, {self.control_rate} Hz{points} | '
                + (', '.join(what) or 'on schedule'))

    @property
    def stream(self) -> tuple[int, int, float]:
        """Rates and due time, which the stream on schedule has too."""
        return self.rate, self.control_rate, self.due

    def deliver(self, seconds: float) -> tuple[FloatArray, FloatArray]:
        """Return when messages are sent and when they come [s], in the order of arrival."""
        random = np.random.default_rng(0)
        number = np.arange(int(seconds * self.rate))
        sent = (number + 0.37 + random.normal(0.0, self.timer, len(number))) / self.rate
        sent = np.sort(np.maximum(sent, 0.0))
        came = sent + np.abs(random.normal(0.0, self.jitter_s, len(sent)))
        stalled = (sent > 3.6) & (sent < 3.6 + self.stall_s)
        came[stalled] = 3.6 + self.stall_s + 1e-3 * np.arange(np.count_nonzero(stalled))
        kept = random.random(len(sent)) >= self.lost
        sent, came = sent[kept], np.maximum.accumulate(came)[kept]
        if self.copied:
            sent, came = np.repeat(sent, 2), np.repeat(came, 2)
            came[1::2] += self.copied / self.rate
        return sent, came


ROWS = tuple(row for rate, control_rate, jitter_s in (
    (100, 100, 0.002), (250, 250, 0.001), (500, 500, 0.0005), (250, 500, 0.001))
    for row in (Row(rate, control_rate), Row(rate, control_rate, jitter_s),
                Row(rate, control_rate, lost=0.01))) + (
    Row(10, 500), Row(10, 500, timer=0.2), Row(100, 500), Row(100, 500, timer=0.2),
    Row(100, 500, 0.002, timer=0.2), Row(100, 100, 0.002, timer=0.1),
    Row(250, 250, 0.001, timer=0.2), Row(100, 100, noise=1e-3), Row(500, 500, noise=1e-4),
    Row(250, 500, copied=0.3), Row(500, 500, stall_s=0.06), *(
        Row(rate, 500, jitter_s, due=due) for rate, due in ((100, 1.0), (100, 2.0), (30, 1.0))
        for jitter_s in (0.0, 0.002)))


def follow(row: Row, seconds: float) -> tuple[float, float, float]:
    """Return acceleration [rad/s^2], torque [N m] and ripple of a stream."""
    simulation = Simulation(compose('Panda', arena='empty', timestep_s=TIMESTEP_S))
    robot = simulation.robot
    names = [robot.joints.names[index] for index in robot.joints.indices_of('arm')]
    start = robot.measured('arm')[:7]
    steps = round(1.0 / (row.control_rate * TIMESTEP_S))
    sent, came = row.deliver(seconds)
    noise = np.random.default_rng(1).normal(0.0, row.noise, len(sent))
    taken = 0
    rows: list[tuple[float, float, float]] = []
    for period in range(int(seconds * row.control_rate)):
        now_s, goal = period / row.control_rate, None
        while taken < len(came) and came[taken] <= now_s + 1e-9:
            time_s = sent[taken]
            goal = start.copy()
            goal[0] += AMPLITUDE * min(1.0, time_s) * np.sin(TURN * time_s) + noise[taken]
            due_s = row.due / row.rate
            commands = ([robot.parse.trajectory('arm', names, [due_s], [goal])] if row.due
                        else robot.parse.joint_command(names, position=goal))
            robot.apply(*commands, period_s=1.0 / row.control_rate)
            taken += 1
        simulation.advance(steps)
        if now_s >= SETTLED_S:
            rows.append((now_s, robot.controller_state('arm').reference.velocity[0],
                         robot.measured('arm')[14]))
    times, velocities, torques = np.array(rows).T
    waves = np.stack([np.sin(TURN * times), np.cos(TURN * times)], axis=1)
    sine = waves @ np.linalg.lstsq(waves, velocities, rcond=None)[0]
    return (float(np.abs(np.diff(velocities)).max()) * row.control_rate,
            float(np.abs(torques).max()),
            float(np.sqrt(np.mean((velocities - sine)**2)) / (AMPLITUDE * TURN)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0].strip())
    parser.add_argument('--seconds', type=float, default=12.0, help='of each stream (%(default)s)')
    seconds = parser.parse_args().seconds
    print('| stream, control rate | messages | acceleration | torque | of the torque on schedule '
          '| ripple |\n|---|---|---|---|---|---|')
    # Those on schedule come first.
    ideal: dict[tuple[int, int, float], float] = {}
    for row in ROWS:
        acceleration, torque, ripple = follow(row, seconds)
        ideal.setdefault(row.stream, torque)
        print(f'| {row} | {acceleration:.1f} rad/s^2 | {torque:.1f} N m '
              f'| {torque / ideal[row.stream]:.2f} '
              f'| {ripple:.1%} |', flush=True)


if __name__ == '__main__':
    main()
