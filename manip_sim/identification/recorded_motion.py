# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Motions that excite the dynamics of arms, and joint states of records and bags as arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass
import math
from pathlib import Path
import sqlite3
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.channels.kinds import robot_channels
from manip_sim.errors import describe_choices, ModelError, RecordError, UnknownNameError
from manip_sim.interface.topics import Scope
from manip_sim.models.user_files import opened
from manip_sim.quoting import one_line, pluralize, quoted, quoted_names
from manip_sim.records.record_file import decoder, definition, encoder, full_name, RecordFile
from manip_sim.records.recorded import check_topic, MAX_BYTES, MESSAGE_BYTES, Record
from manip_sim.simulation import Simulation

JOINT_STATE = 'sensor_msgs/JointState'
_NAME = '/joint_states'
#: A time between two states of more than so many usual ones is a gap.
_GAP = 2.5
#: No joint is faster, a robot was reset [rad/s or m/s].
_FASTEST = 30.0


@dataclass(frozen=True)
class Stretch:
    """
    States at equal intervals.

    :ivar interval_s: between two states [s]
    :ivar positions: by joint [rad or m], each of shape (t,)
    :ivar efforts: by joint that is identified [N m or N], each of shape (t,)
    """

    interval_s: float
    positions: dict[str, FloatArray]
    efforts: dict[str, FloatArray]

    def __len__(self) -> int:
        return len(next(iter(self.positions.values())))


@dataclass(frozen=True)
class RecordedMotion:
    """
    Joint states of a robot in a record.

    :ivar topic: that it was read from
    :ivar stretches: in the order of time
    :ivar missing: joints of the robot that it does not have
    :ivar notes: a sentence for each part that was left out
    """

    topic: str
    stretches: list[Stretch]
    missing: list[str]
    notes: list[str]

    @property
    def duration_s(self) -> float:
        """Time in all stretches [s]."""
        return sum((len(one) - 1) * one.interval_s for one in self.stretches)


def read_motion(path: Path, joints: Sequence[str], others: Sequence[str], topic: str | None = None,
                names: Mapping[str, str] | None = None) -> RecordedMotion:
    """
    Read positions and efforts of joints.

    :param path: of a record, an MCAP file, or a bag of rosbag2
    :param joints: that are identified
    :param others: joints whose positions matter too
    :param topic: of the type ``sensor_msgs/JointState``; None for the one called joint_states
    :param names: of joints in the record, by ours, where they differ
    :raises RecordError: if it cannot be read, or has no efforts of one of the joints
    :raises UnknownNameError: if it has no such topic
    """
    names = dict(names or {})
    of_topics: dict[str, list[tuple[int, Any]]] = {}
    for found, time_ns, message in bag_messages(path, JOINT_STATE):
        of_topics.setdefault(found, []).append((time_ns, message))
    topic = _choose(path, of_topics, topic)
    messages = of_topics[topic]
    where = f'{path}: {topic}'
    known = list(dict.fromkeys(name for _, message in messages for name in message.name))
    in_file = {joint: names.get(joint, joint) for joint in (*joints, *others)}
    for joint in joints:
        if in_file[joint] not in known:
            raise RecordError(_no_joint(where, joint, in_file[joint], joints, known))
    present = {joint: name for joint, name in in_file.items() if name in known}
    times, positions, efforts = _arrays(messages, present, joints, where)
    finite = np.isfinite([*positions.values(), *efforts.values()]).all(axis=0)
    for joint in joints:
        if not np.isfinite(efforts[joint]).any() or not np.any(efforts[joint]):
            raise RecordError(f'{where} has no efforts of {quoted(present[joint])}, without which '
                              'friction and inertia cannot be told')
    notes = [] if finite.all() else [f'{pluralize(int((~finite).sum()), "state")} with numbers '
                                     'that are not finite left out']
    stretches = _stretches(times[finite], {name: values[finite] for name, values in (
        positions.items())}, {name: values[finite] for name, values in efforts.items()})
    return RecordedMotion(topic, stretches, [name for name in others if name not in present],
                          notes)


def _choose(path: Path, of_topics: Mapping[str, Any], topic: str | None) -> str:
    if topic is not None:
        topic = f'/{topic.lstrip("/")}'
        if topic not in of_topics:
            raise UnknownNameError(f'topic of joint states in {path}', topic, of_topics)
        return topic
    found = [name for name in of_topics if name.endswith(_NAME)]
    if not of_topics:
        raise RecordError(f'{path} has no messages of {JOINT_STATE}')
    if _NAME not in found and len(found or of_topics) != 1:
        raise RecordError(f'{path} has several topics of joint states: choose one of '
                          f'{quoted_names(found or list(of_topics))} with --topic')
    return _NAME if _NAME in found else (found or list(of_topics))[0]


def _no_joint(where: str, joint: str, name: str, joints: Sequence[str], known: Sequence[str]
              ) -> str:
    """Return the error for a joint that is not there, with the prefix that would help, if any."""
    begin = math.inf
    for other in known:
        end = next((n for n in range(len(joint)) if other.endswith(joint[n:])
                    and joint[n - 1:n] in ('_', '')), len(joint))
        begin = min(begin, end)
    if begin < len(joint):
        rest = joint[int(begin):]
        prefix = next(other for other in known if other.endswith(rest)).removesuffix(rest)
        if all(prefix + one[int(begin):] in known for one in joints):
            return f"{where} has no joint {quoted(name)}; it fits with --prefix '{prefix}'"
    return (f'{where} has no joint {quoted(name)}: {describe_choices(name, known)}; --names gives '
            'names of the record in the order of the joints of the part')


def _arrays(messages: Sequence[tuple[int, Any]], present: Mapping[str, str],
            joints: Sequence[str], where: str
            ) -> tuple[FloatArray, dict[str, FloatArray], dict[str, FloatArray]]:
    """Return times, positions and efforts of the messages that have all joints."""
    rows: list[list[float]] = []
    columns: dict[tuple[str, ...], tuple[list[int], list[int]] | None] = {}
    for time_ns, message in messages:
        names = tuple(message.name)
        if names not in columns:
            places = {name: index for index, name in enumerate(names)}
            whole = all(name in places for name in present.values())
            columns[names] = ([places[name] for name in present.values()],
                              [places[present[joint]] for joint in joints]) if whole else None
        found = columns[names]
        if found is None:
            continue
        stamp = message.header.stamp
        now = stamp.sec + 1e-9 * stamp.nanosec or 1e-9 * time_ns
        position, effort = message.position, message.effort
        if len(position) != len(names) or len(effort) not in (0, len(names)):
            raise RecordError(f'{where}: a message has arrays of different lengths')
        rows.append([now, *(position[i] for i in found[0]),
                     *(effort[i] if len(effort) else math.nan for i in found[1])])
    if not rows:
        raise RecordError(f'{where} has no message with all joints of the robot: they are in '
                          'several messages')
    table = np.array(rows, dtype=np.float64).T
    positions = dict(zip(present, table[1:len(present) + 1]))
    return table[0], positions, dict(zip(joints, table[len(present) + 1:]))


def _stretches(times: FloatArray, positions: Mapping[str, FloatArray],
               efforts: Mapping[str, FloatArray]) -> list[Stretch]:
    """Return the stretches between gaps, jumps and steps back in time, at equal intervals."""
    if len(times) < 2:
        return []
    steps = np.diff(times)
    # A paused simulation repeats a state.
    keep = np.concatenate([[True], steps != 0.0])
    times, steps = times[keep], np.diff(times[keep])
    kept = {name: values[keep] for name, values in positions.items()}
    forward = steps[steps > 0.0]
    if not forward.size:
        return []
    interval = float(np.median(forward))
    fast = np.any([np.abs(np.diff(values)) > _FASTEST * np.abs(steps)
                   for values in kept.values()], axis=0)
    cuts = np.flatnonzero((steps < 0.0) | (steps > _GAP * interval) | fast) + 1
    found = []
    for part in np.split(np.arange(len(times)), cuts):
        count = int((times[part[-1]] - times[part[0]]) / interval + 1.5)
        if len(part) < 3:
            continue
        even = times[part[0]] + interval * np.arange(count)
        at = [{name: np.interp(even, times[part], values[part]) for name, values in of.items()}
              for of in (kept, {name: values[keep] for name, values in efforts.items()})]
        found.append(Stretch(interval, *at))
    return found


_SUFFIXES = ('.mcap', '.db3')
_MESSAGES = ('SELECT topics.name, messages.timestamp, messages.data FROM messages '
             'JOIN topics ON messages.topic_id = topics.id '
             'WHERE topics.type = ? ORDER BY messages.timestamp, messages.id')


def bag_messages(path: Path, type_name: str) -> Iterator[tuple[str, int, Any]]:
    """
    Yield topic, time of recording [ns] and message of all messages of a type.

    :param path: of an MCAP file, a file of SQLite of rosbag2, or a folder with such files
    :param type_name: such as ``std_msgs/Bool``
    :raises RecordError: if the bag is missing, damaged or too large
    """
    decode, size = decoder(type_name), 0
    for file in _files(path):
        for topic, time_ns, content in (_read_sqlite(file, type_name) if file.suffix == '.db3'
                                        else Record(file).messages(type_name)):
            size += len(content) + MESSAGE_BYTES
            if size > MAX_BYTES:
                raise RecordError(f'{path}: it has more than {MAX_BYTES} bytes of {type_name}')
            try:
                message = decode(content)
            except Exception as error:  # The reader raises whatever its operations do.
                raise RecordError(f'{file}: a message of {topic} cannot be read: '
                                  f'{one_line(str(error))}') from error
            yield topic, time_ns, message


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)
    if not found:
        raise RecordError(f'{path}: this folder has no *.mcap and no *.db3 file')
    return found


def _read_sqlite(file: Path, type_name: str) -> Iterator[tuple[str, int, bytes]]:
    try:
        # SQLite would say only that it cannot open it.
        with open(opened(file), 'rb'), contextlib.closing(sqlite3.connect(
                f'{file.absolute().as_uri()}?mode=ro', uri=True)) as bag:
            for topic, time_ns, content in bag.execute(_MESSAGES, [full_name(type_name)]):
                yield check_topic(topic), int(time_ns), bytes(content)
    except OSError as error:
        raise RecordError(f'{file}: {error.strerror or error}') from error
    except (sqlite3.Error, TypeError, ValueError, RecordError) as error:
        raise RecordError(f'{file}: no bag of rosbag2, or damaged: {one_line(str(error))}'
                          ) from error


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
        number = record.channel('/joint_states', full_name(JOINT_STATE), definition(JOINT_STATE))
        times = np.linspace(0.0, excitation.duration_s,
                            round(excitation.duration_s * _POINTS_HZ) + 1)[1:]
        robot.apply(robot.parse.trajectory(
            part, excitation.joints, times.tolist(), *excitation.at(times)))
        for done in range(count):
            # The efforts of every second step of a longer period are a little higher.
            simulation.advance(1)
            numbers = channel.read(simulation)
            assert numbers is not None
            record.write(number, simulation.time_ns, encoder(JOINT_STATE)(
                channel.fields(simulation.time_ns, numbers)))
            progress(done + 1)
    return count
