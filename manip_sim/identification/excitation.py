# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Motions that excite the dynamics of arms, within their limits and without collisions."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.channels.kinds import robot_channels
from manip_sim.errors import ModelError
from manip_sim.interface.topics import Scope
from manip_sim.records.record_file import definition, encoder, full_name, RecordFile
from manip_sim.simulation import Simulation

#: Frequencies of the series [Hz].
_FREQUENCIES_HZ = np.arange(1, 13) / 10.0
#: Exponent by which the amplitudes fall with the frequency.
_LESS = 0.7
#: Shares of the limits of velocity, acceleration and effort, and of the way to the end of a range.
_VELOCITY, _ACCELERATION, _EFFORT, _RANGE = 0.7, 0.5, 0.9, 0.9
#: Widest motion of a joint to each side [rad or m].
_WIDEST = 1.5
#: Time in which the motion begins, and in which it ends; shortest and longest motion [s].
_BLEND_S, _SHORTEST_S, _LONGEST_S = 2.0, 10.0, 600.0
#: Points of the trajectory, and poses that are checked, in a second.
_POINTS_HZ, _CHECKS_HZ = 16.0, 25.0
#: Shares of the widest motion that are tried, and how many series with each.
_SHARES, _DRAWS = (1.0, 0.8, 0.6, 0.45, 0.35, 0.25), 12
_KIND = 'sensor_msgs/JointState'


@dataclass(frozen=True)
class Excitation:
    """
    A Fourier series for each joint, which begins and ends at rest at the start pose.

    :ivar joints: names, n of them
    :ivar start: position at rest [rad or m], shape (n,)
    :ivar middle: position about which a joint swings [rad or m], shape (n,)
    :ivar series: amplitudes of sines and cosines by frequency [rad or m], shape (2, f, n)
    :ivar duration_s: [s]
    """

    joints: tuple[str, ...]
    start: FloatArray
    middle: FloatArray
    series: FloatArray
    duration_s: float

    def at(self, times_s: FloatArray) -> FloatArray:
        """
        Return position, velocity and acceleration.

        :param times_s: from the start [s], shape (t,)
        :returns: the three on the first axis, shape (3, t, n)
        """
        omega = 2.0 * np.pi * _FREQUENCIES_HZ
        sine, cosine = np.sin(np.outer(times_s, omega)), np.cos(np.outer(times_s, omega))
        sines, cosines = self.series
        swing = sine @ sines + cosine @ cosines + self.middle - self.start
        speed = (omega * cosine) @ sines - (omega * sine) @ cosines
        change = -(omega**2 * sine) @ sines - (omega**2 * cosine) @ cosines
        share, rate, bend = (column[:, None] for column in _blend(times_s, self.duration_s))
        return np.stack([self.start + share * swing, share * speed + rate * swing,
                         share * change + 2.0 * rate * speed + bend * swing])


def _blend(times_s: FloatArray, duration_s: float) -> FloatArray:
    """Return what rises from 0 to 1 at the start and falls at the end, and its derivatives."""
    found = np.zeros((3, len(times_s)))
    found[0] = 1.0
    for since, sign in ((times_s, 1.0), (duration_s - times_s, -1.0)):
        x, inside = np.clip(since / _BLEND_S, 0.0, 1.0), since < _BLEND_S
        found[:, inside] = np.stack([
            x**3 * (10.0 - 15.0 * x + 6.0 * x**2),
            sign * 30.0 * x**2 * (1.0 - x)**2 / _BLEND_S,
            60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / _BLEND_S**2])[:, inside]
    return found


def find_excitation(simulation: Simulation, part: str, duration_s: float, seed: int) -> Excitation:
    """
    Draw a motion of a part from the present pose, within its limits and without contacts.

    :param simulation: of one robot, which is not moved
    :param part: such as ``arm``
    :param duration_s: [s]
    :param seed: of the series
    :raises ModelError: if there is none, or it is too short or too long
    :raises UnknownNameError: if the part is unknown
    """
    if not _SHORTEST_S <= duration_s <= _LONGEST_S:
        raise ModelError(f'an excitation takes {_SHORTEST_S:g} to {_LONGEST_S:g} s, got '
                         f'{duration_s:g} s')
    joints, random = simulation.robot.joints, np.random.default_rng(seed)
    indices = joints.indices_of(part)
    start = joints.measured(indices, simulation.data)[0]
    low, high = joints.ranges_of('position', indices).T
    unlimited = high - low > 4.0 * _WIDEST
    low, high = (np.where(unlimited, start + sign * _WIDEST, end)
                 for sign, end in ((-1.0, low), (1.0, high)))
    fits = _Checker(simulation, indices)
    times = np.arange(0.0, duration_s, 1.0 / _CHECKS_HZ)
    for share in _SHARES:
        # A joint at the end of its range swings about another position.
        reach = share * np.minimum(_RANGE * 0.5 * (high - low), _WIDEST)
        middle = np.clip(start, low + reach / _RANGE, high - reach / _RANGE)
        for _ in range(_DRAWS):
            drawn = random.normal(size=(2, len(_FREQUENCIES_HZ), len(indices)))
            unit = Excitation(tuple(joints.names[i] for i in indices), 0.0 * start, 0.0 * start,
                              drawn / _FREQUENCIES_HZ[:, None]**_LESS, duration_s)
            most = np.abs(unit.at(times)).max(axis=1)
            scale = np.min([reach / most[0],
                            _VELOCITY * joints.velocity_limits(indices) / most[1],
                            _ACCELERATION * joints.acceleration_limits(indices) / most[2],
                            ], axis=0)
            found = Excitation(unit.joints, start, middle, unit.series * scale, duration_s)
            if fits.all(found.at(times)):
                return found
    raise ModelError(f'found no motion of {part} from its start pose that meets nothing and needs '
                     'no more than its efforts; another --keyframe or --arena may help')


class _Checker:
    """Checks a motion for contacts and efforts, on the data of its own."""

    def __init__(self, simulation: Simulation, indices: IntArray) -> None:
        self._model, robot = simulation.model, simulation.robot
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = simulation.data.qpos
        self._dofs = robot.joints.dofs(indices)
        self._qpos = self._model.jnt_qposadr[self._model.dof_jntid[self._dofs]]
        self._efforts = _EFFORT * robot.joints.efforts_allowed(indices)
        mujoco.mj_forward(self._model, self._data)
        self._touching = self._contacts()

    def _contacts(self) -> set[tuple[int, int]]:
        contact = self._data.contact
        return {(int(one), int(two)) for (one, two), distance in zip(contact.geom, contact.dist)
                if distance < 0.0}

    def all(self, motion: FloatArray) -> bool:
        """Tell whether all states of a motion, shape (3, t, n), are possible."""
        data = self._data
        for position, velocity, acceleration in zip(*motion):
            data.qpos[self._qpos], data.qvel[self._dofs] = position, velocity
            mujoco.mj_fwdPosition(self._model, data)
            if not self._contacts() <= self._touching:
                return False
            data.qacc[self._dofs] = acceleration
            mujoco.mj_inverse(self._model, data)
            # Motors carry what compensates gravity too.
            efforts = (data.qfrc_inverse + data.qfrc_gravcomp)[self._dofs]
            if (np.abs(efforts) > self._efforts).any():
                return False
        return True


def record_excitation(simulation: Simulation, excitation: Excitation, part: str, file: Path,
                      progress: Callable[[int], object] = lambda done: None) -> int:
    """
    Let the robot of a simulation follow a motion, and record its joint states at each step.

    :param part: whose motion it is
    :param file: new MCAP file
    :param progress: is called with the number of states that are recorded
    :returns: the number of states
    :raises RecordError: if the file is there or cannot be written
    """
    robot = simulation.robot
    channel = next(found for found in robot_channels(robot, Scope())
                   if found.topic.by == 'joints' and not found.topic.of)
    count = int(excitation.duration_s / simulation.timestep_s)
    with contextlib.closing(RecordFile(file)) as record:
        number = record.channel('/joint_states', full_name(_KIND), definition(_KIND))
        times = np.linspace(0.0, excitation.duration_s,
                            round(excitation.duration_s * _POINTS_HZ) + 1)[1:]
        robot.apply(robot.parse.trajectory(
            part, excitation.joints, times.tolist(), *excitation.at(times)))
        for done in range(count):
            # The efforts of every second step of a longer period are a little higher.
            simulation.advance(1)
            numbers = channel.read(simulation)
            assert numbers is not None
            record.write(number, simulation.time_ns, encoder(_KIND)(
                channel.fields(simulation.time_ns, numbers)))
            progress(done + 1)
    return count
