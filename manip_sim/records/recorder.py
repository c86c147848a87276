# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Record the episodes of a task: observations of each control period, actions, digests.

Files are MCAP as rosbag2 writes it, readable if the writer dies, with the types of messages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
import functools
import json
import logging
import os
from pathlib import Path
import platform
import sys
import time
from types import SimpleNamespace, TracebackType
from typing import Any, TypeVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip_sim.arrays import FloatArray
from manip_sim.channels.contents import (
    Channel, compressed_image, Fields, multi_array, PatchedBytes, stamp_fields)
from manip_sim.channels.kinds import clock_channel, object_channel, offered_channel, robot_channels
from manip_sim.errors import ManipSimError, RecordError
from manip_sim.frame_names import FrameNames, OPTICAL
from manip_sim.interface.offered_sensors import offered_topics
from manip_sim.interface.topics import BY_NAME, Scope, topics_of_world
from manip_sim.resources import package_version
from manip_sim.simulation import Simulation
from manip_sim.tasks import Episode
from manip_sim.tasks.observation import IMAGE, Observation

#: Fields of each type, without the separator `/msg/` in its name.
_FIELDS = {
    'builtin_interfaces/Time': 'int32 sec; uint32 nanosec',
    'geometry_msgs/Point': 'float64 x; float64 y; float64 z',
    'geometry_msgs/Pose': 'geometry_msgs/Point position; geometry_msgs/Quaternion orientation',
    'geometry_msgs/PoseStamped': 'std_msgs/Header header; geometry_msgs/Pose pose',
    'geometry_msgs/Quaternion': 'float64 x 0; float64 y 0; float64 z 0; float64 w 1',
    'geometry_msgs/Twist': 'geometry_msgs/Vector3 linear; geometry_msgs/Vector3 angular',
    'geometry_msgs/TwistStamped': 'std_msgs/Header header; geometry_msgs/Twist twist',
    'geometry_msgs/Vector3': 'float64 x; float64 y; float64 z',
    'geometry_msgs/Wrench': 'geometry_msgs/Vector3 force; geometry_msgs/Vector3 torque',
    'geometry_msgs/WrenchStamped': 'std_msgs/Header header; geometry_msgs/Wrench wrench',
    'rosgraph_msgs/Clock': 'builtin_interfaces/Time clock',
    'sensor_msgs/CompressedImage': 'std_msgs/Header header; string format; uint8[] data',
    'sensor_msgs/Imu': 'std_msgs/Header header; geometry_msgs/Quaternion orientation; '
                       'float64[9] orientation_covariance; '
                       'geometry_msgs/Vector3 angular_velocity; '
                       'float64[9] angular_velocity_covariance; '
                       'geometry_msgs/Vector3 linear_acceleration; '
                       'float64[9] linear_acceleration_covariance',
    'sensor_msgs/JointState': 'std_msgs/Header header; string[] name; float64[] position; '
                              'float64[] velocity; float64[] effort',
    'sensor_msgs/LaserScan': 'std_msgs/Header header; float32 angle_min; float32 angle_max; '
                             'float32 angle_increment; float32 time_increment; '
                             'float32 scan_time; float32 range_min; float32 range_max; '
                             'float32[] ranges; float32[] intensities',
    'sensor_msgs/MagneticField': 'std_msgs/Header header; geometry_msgs/Vector3 magnetic_field; '
                                 'float64[9] magnetic_field_covariance',
    'sensor_msgs/Range': 'std_msgs/Header header; uint8 radiation_type; float32 field_of_view; '
                         'float32 min_range; float32 max_range; float32 range; float32 variance',
    'std_msgs/Bool': 'bool data',
    'std_msgs/Float64': 'float64 data',
    'std_msgs/Float64MultiArray': 'std_msgs/MultiArrayLayout layout; float64[] data',
    'std_msgs/Header': 'builtin_interfaces/Time stamp; string frame_id',
    'std_msgs/MultiArrayDimension': 'string label; uint32 size; uint32 stride',
    'std_msgs/MultiArrayLayout': 'std_msgs/MultiArrayDimension[] dim; uint32 data_offset',
    'std_msgs/String': 'string data'}
_SEPARATOR = '=' * 80


def full_name(name: str) -> str:
    """Return ``std_msgs/msg/Bool``, the name of a type in messages, from ``std_msgs/Bool``."""
    return name.replace('/', '/msg/')


@functools.cache
def definition(name: str) -> str:
    """
    Return the definition of a type such as ``std_msgs/Bool``, and of those it refers to.

    :raises RecordError: if it is not known here and no such package is installed
    """
    def text(kind: str) -> str:
        fields = _FIELDS.get(kind.replace('/msg/', '/'))
        return installed(kind) if fields is None else fields.replace('; ', '\n')

    return joined(full_name(name), text)


def installed(kind: str) -> str:
    """
    Return the definition of a type such as ``std_msgs/msg/Bool`` in an installed package.

    :raises RecordError: if it is not installed
    """
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    for prefix in filter(None, prefixes):
        file = Path(prefix, 'share', f'{kind}.msg')
        if file.is_file():
            return file.read_text()
    raise RecordError(f'the definition of {kind} is not installed')


@functools.cache
def encoder(name: str) -> Callable[[Any], bytes]:
    """Return what writes messages of a type such as ``std_msgs/Bool``, as mappings, as CDR."""
    # It is public only as part of a writer of files.
    from mcap_ros2._dynamic import serialize_dynamic
    encode: Callable[[Any], bytes] = serialize_dynamic(full_name(name), definition(name))[
        full_name(name)]
    return encode


@functools.cache
def decoder(name: str) -> Callable[[bytes], Any]:
    """Return what reads messages of a type such as ``std_msgs/Bool`` from CDR."""
    from mcap_ros2._dynamic import generate_dynamic
    decode: Callable[[bytes], Any] = generate_dynamic(full_name(name), definition(name))[
        full_name(name)]
    return decode


def new_message(name: str) -> Any:
    """
    Return a message of a type such as ``std_msgs/Bool``, to be filled and :func:`encoded`.

    :raises RecordError: if it has no :func:`definition`
    """
    return decoder(name)(encoder(name)({}))


def encoded(name: str, message: Any) -> bytes:
    """
    Return a message of :func:`new_message` as CDR.

    :raises AttributeError: if a field was set that the type does not have
    :raises Exception: anything, if a value does not fit its field
    """
    return encoder(name)(_fields(message))


def _fields(value: Any) -> Any:
    """Return the fields of a message by name; NumPy arrays become lists, as the encoder needs."""
    if isinstance(value, SimpleNamespace):
        for name in vars(value):  # Fields are in slots.
            raise AttributeError(f'{type(value).__name__} has no field {name!r}')
        return {name: _fields(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, list):
        return [_fields(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def joined(kind: str, text_of: Callable[[str], str]) -> str:
    """
    Return the definition of a type followed by those that it refers to, as rosbag2 stores it.

    :param kind: such as ``std_msgs/msg/Bool``
    :param text_of: returns the fields of a type, one a line
    """
    known = [kind]
    parts: list[str] = []
    for name in known:
        title = f'{_SEPARATOR}\nMSG: {name.replace("/msg/", "/")}\n' if parts else ''
        text = text_of(name).rstrip('\n')
        parts.append(title + text)
        package = name.partition('/')[0]
        for line in text.splitlines():
            field = line.partition('#')[0].split()
            base = field[0].partition('[')[0].partition('<')[0] if field else ''
            if not base or base[0].islower() and '/' not in base:
                continue
            other = base if '/' in base else f'{package}/{base}'
            other = other if '/msg/' in other else full_name(other)
            if other not in known:
                known.append(other)
    return '\n'.join(parts)


#: A chunk is written at this size [bytes], and after this time [s].
_CHUNK_BYTES, _FLUSH_S = 2**18, 1.0
#: Greater than any chunk: we decide when one is written.
_NEVER = 2**40
_T = TypeVar('_T')


class RecordFile:
    """
    An MCAP file that is being written, in the profile ``ros2``.

    Chunks are handed to the operating system once they are complete, at the latest a second after
    their first message, so that the file can be read up to there when the process is killed. If
    the disk is full, incomplete data is cut off. All methods raise a RecordError if the file
    cannot be written.

    :param path: of the file
    :param overwrite: replace a file that is there
    :raises RecordError: if it is there, or ``mcap`` is not installed
    """

    def __init__(self, path: Path, overwrite: bool = False) -> None:
        try:
            from mcap.writer import CompressionType, LIBRARY_IDENTIFIER, Writer
        except ImportError as error:
            raise RecordError(f"records need the package {error.name or 'mcap'}: "
                              "pip install 'manip_sim[records]'") from error
        self.path = path
        self._error: RecordError | None = None
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._pending, self._written_s, self._complete = 0, time.monotonic(), 0
        try:
            self._file = _WholeWrites(path, overwrite)
        except FileExistsError:
            raise RecordError(f'{path} already exists and is not overwritten') from None
        except OSError as error:
            raise RecordError(f'{path}: {error.strerror or error}') from error
        self._writer = Writer(self._file, chunk_size=_NEVER, compression=CompressionType.LZ4,
                              enable_data_crcs=True)
        self._do(lambda: self._writer.start('ros2', f'{LIBRARY_IDENTIFIER} manip_sim'))

    def channel(self, topic: str, type_name: str, definition: str,
                metadata: Mapping[str, str] | None = None) -> int:
        """
        Add a topic, once.

        :param type_name: such as ``std_msgs/msg/Bool``
        :param metadata: of the topic, such as its quality of service
        :returns: its number for :meth:`write`
        """
        if topic not in self._channels:
            if type_name not in self._schemas:
                self._schemas[type_name] = self._writer.register_schema(
                    type_name, 'ros2msg', definition.encode())
            self._channels[topic] = self._writer.register_channel(
                topic, 'cdr', self._schemas[type_name], dict(metadata or {}))
        return self._channels[topic]

    def write(self, channel: int, time_ns: int, data: bytes, published_ns: int | None = None
              ) -> None:
        """
        Write a message.

        :param channel: from :meth:`channel`
        :param time_ns: when it was recorded [ns]
        :param data: serialized, as CDR
        :param published_ns: when it was published [ns]; None for the same time
        """
        self._check()
        self._writer.add_message(
            channel, time_ns, data, time_ns if published_ns is None else published_ns)
        self._pending += len(data)
        if self._pending > _CHUNK_BYTES:
            self.flush()
        self.flush_when_due()

    def flush_when_due(self) -> None:
        """Write the chunk that is begun if a second has passed; call it where no messages come."""
        if self._pending and time.monotonic() - self._written_s > _FLUSH_S:
            self.flush()

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int = 0) -> None:
        """Attach a file, such as ``model.mjz`` of the type ``application/zip``; time in [ns]."""
        self.flush()
        self._do(lambda: self._writer.add_attachment(time_ns, time_ns, name, media_type, data))

    def describe(self, name: str, values: Mapping[str, str]) -> None:
        """Write metadata of all messages that follow, or of all earlier ones, by a name."""
        self.flush()
        self._do(lambda: self._writer.add_metadata(name, dict(values)))

    def flush(self) -> None:
        """Write the chunk that is begun."""
        self._do(self._writer.flush)
        self._pending, self._written_s = 0, time.monotonic()

    def close(self) -> None:
        """Write the index and close the file; what could not be written was reported before."""
        if self._error is None and not self._file.closed:
            self._do(self._writer.finish)
            self._file.close()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _do(self, write: Callable[[], _T]) -> _T:
        self._check()
        try:
            result = write()
        except OSError as error:
            self._file.cut(self._complete)
            self._error = RecordError(
                f'{self.path}: {error.strerror or error}; what was recorded before can be read')
            raise self._error from error
        self._complete = self._file.tell()
        return result


class _WholeWrites:
    """A new file that is written without a buffer, and each time completely or with an error."""

    def __init__(self, path: Path, overwrite: bool) -> None:
        flags = os.O_WRONLY | os.O_CREAT | (os.O_TRUNC if overwrite else os.O_EXCL)
        self._descriptor = os.open(path, flags | os.O_CLOEXEC, 0o666)
        self._size = 0
        self.closed = False

    def write(self, data: Any) -> int:
        left = memoryview(data)
        while left:
            written = os.write(self._descriptor, left)
            self._size += written
            left = left[written:]
        return len(data)

    def tell(self) -> int:
        return self._size

    def flush(self) -> None:
        """Do nothing, without a buffer."""

    def cut(self, size: int) -> None:
        """Cut the file off at a size [bytes], and close it."""
        os.ftruncate(self._descriptor, size)
        self.close()

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            os.close(self._descriptor)


_LOGGER = logging.getLogger('manip_sim.records')
#: Of the metadata below; a reader rejects others.
FORMAT = '1'
#: Names of metadata: of an episode at its begin, and at its end.
EPISODE, RESULT = 'manip_sim/episode', 'manip_sim/result'
#: Name of the metadata of a node.
NODE = 'manip_sim/node'
#: Name of the attachment with the model.
MODEL = 'model.mjz'
ACTION, STATE, GOAL, REWARD, SUCCESS, DIGEST, ANSWER = (
    f'/episode/{name}' for name in ('action', 'state', 'goal', 'reward', 'success', 'digest',
                                    'answer_time'))
#: The number of steps until the effect of an action, and the action; before its control period.
TAKEN = '/episode/taken'
#: Parts of :data:`STATE`, one after the other: they suffice to draw all bodies.
STATE_PARTS = int(mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_QVEL
                  | mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT)


class EpisodeRecorder:
    """
    A recorder of episodes in an MCAP file, with everything needed to repeat them.

    Call :meth:`begin` after ``Episode.reset``, :meth:`period` after each ``Episode.step``, and
    :meth:`end`. Times are simulation times. Used as a context, it closes its file.

    Joints, poses, external wrenches and the goal are recorded as a policy observes them. Where
    noise or latency make that differ, the exact values of the instant are below ``truth/``.
    Sensors of other packages are recorded as the node publishes them, with the noise of the seed;
    one that fails is logged and left out from then on.

    :param path: of the file
    :param episode: that is recorded
    :param settings: of the run, with which the metadata are extended; JSON
    :param digest_every: control periods between two digests of the state
    :param overwrite: replace a file that is there
    :raises RecordError: if the file is there, or cannot be written, or the arguments of the task
        cannot be written as JSON
    """

    def __init__(self, path: Path, episode: Episode,
                 settings: Mapping[str, Any] | None = None, digest_every: int = 20,
                 overwrite: bool = False) -> None:
        self._episode = episode
        self._every = digest_every
        self._number = -1
        self._return = 0.0
        task = episode.task
        try:
            self._about = {
                'format': FORMAT, 'task': task.name, 'instruction': task.instruction,
                'arguments': json.dumps(task.arguments), 'robot': task.robot.type_name,
                'robots': json.dumps({robot.name: {
                    name: list(part.joints) for name, part in robot.parts.items()
                    if part.atomic == (name,)} for robot in episode.simulation.robots.values()}),
                'period_s': repr(episode.period_s), 'action': episode.kind,
                'action_names': json.dumps(episode.actions.names),
                **({'noise': json.dumps(episode.noise)} if episode.noise else {}),
                'latency': json.dumps(episode.latency.as_mapping()),
                'settings': json.dumps(dict(settings or {})), 'manip_sim': package_version(),
                'mujoco': mujoco.mj_versionString(), 'numpy': np.__version__,
                'python': platform.python_version(), 'machine': platform.machine()}
        except TypeError as error:
            raise RecordError(f'{path}: the arguments of {task.name} cannot be recorded: {error}'
                              ) from error
        self._file = RecordFile(path, overwrite)
        self._file.attach(MODEL, 'application/zip', task.world.to_archive())
        self._topics = _Topics(self._file, episode)

    def begin(self, seed: int, images: Mapping[str, NDArray[np.uint8]] | None = None,
              observation: Observation | None = None) -> None:
        """
        Begin an episode, at its start.

        :param seed: that it was reset with
        :param images: by camera, shape (h, w, 3); None for the images of the observation
        :param observation: of the start; None to read it
        :raises RecordError: if the file cannot be written
        """
        self._number += 1
        self._return = 0.0
        self._file.describe(EPISODE, {
            **self._about, 'number': str(self._number), 'seed': str(seed),
            'steps': str(self._episode.simulation.step_count),
            'drawn': json.dumps(self._episode.simulation.randomized.drawn)})
        self._topics.begin()
        self._topics.write(observation, images)
        self._digest()

    def taken(self, actions: Iterable[tuple[int, FloatArray]]) -> None:
        """
        Record actions that take effect within the next control period, before it.

        :param actions: each with the number of timesteps until its effect
        :raises RecordError: if the file cannot be written
        """
        for steps, action in actions:
            self._topics.write_numbers(TAKEN, 'steps, action', np.array([steps, *action]))

    def period(self, action: ArrayLike | None = None, reward: float | None = None,
               success: bool | None = None,
               images: Mapping[str, NDArray[np.uint8]] | None = None,
               observation: Observation | None = None, answer_s: float | None = None) -> None:
        """
        Record a control period, after it.

        :param action: that was applied; None if commands came in another way
        :param reward: of the present instant; None to compute it
        :param success: whether the task is done; None to compute it
        :param images: by camera, shape (h, w, 3); None for the images of the observation
        :param observation: after the period; None to read it
        :param answer_s: wall time that the policy took for the action [s]; None if it is unknown
        :raises RecordError: if the file cannot be written
        """
        if action is not None:
            self._topics.write_numbers(ACTION, 'action', np.asarray(action, dtype=np.float64))
        if answer_s is not None:
            self._topics.write_value(ANSWER, float(answer_s))
        self._topics.write(observation, images)
        reward = self._episode.reward if reward is None else reward
        self._return += reward
        self._topics.write_value(REWARD, float(reward))
        self._topics.write_value(
            SUCCESS, bool(self._episode.success if success is None else success))
        if self._episode.periods % self._every == 0:
            self._digest()

    def _digest(self) -> None:
        self._topics.write_value(DIGEST, self._episode.digest)

    def end(self, success: bool | None = None, digest: str | None = None, error: str = '') -> None:
        """
        End an episode.

        :param success: whether the task is done; None to compute it
        :param digest: of the final state; None to compute it
        :param error: why it ended early, such as what a policy raised
        :raises RecordError: if the file cannot be written
        """
        success = self._episode.success if success is None else success
        self._file.describe(RESULT, {
            'number': str(self._number), 'periods': str(self._episode.periods),
            'success': str(bool(success)).lower(), 'return': repr(self._return),
            'digest': digest or self._episode.digest, 'error': error})
        self._file.flush()

    def close(self) -> None:
        """
        Complete the file.

        :raises RecordError: if it cannot be written
        """
        self._file.close()

    def __enter__(self) -> EpisodeRecorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if not isinstance(error, RecordError):
            self.close()


#: Functions of the table of topics whose channels are recorded; of joints that of all.
_RECORDED = ('joints', 'wrench', 'external_wrench', 'pose')
#: Returns the content of a message for a simulation time [ns] and numbers.
_Fields = Callable[[int, FloatArray], Fields]


class _Topics:
    """The topics of an episode; topics of a robot are named as in the node."""

    def __init__(self, file: RecordFile, episode: Episode) -> None:
        self._file = file
        self._episode = episode
        self._simulation = episode.simulation
        self._channels: dict[str, int] = {}
        self._patched: dict[str, PatchedBytes] = {}
        model = self._simulation.model
        names = [str(model.camera(number).name) for number in range(model.ncam)]
        self._frames = dict(zip(names, FrameNames(model).opticals))
        robots = self._simulation.robots
        scopes = {Scope(name if len(robots) > 1 else ''): robot for name, robot in robots.items()}
        self._robots = [
            channel for scope, robot in scopes.items() for channel in robot_channels(robot, scope)
            if channel.topic.by in _RECORDED and not (
                channel.topic.by == 'joints' and channel.topic.of)]
        self._objects: dict[str, Channel] = {}
        #: Topics of sensors of other packages, and their channels in this episode.
        self._offered = {offered.topic.name: offered for offered in offered_topics(
            scopes, topics_of_world(self._simulation, scopes), _LOGGER.warning)}
        self._sensors: list[Channel] = []

    def begin(self) -> None:
        """Create the sensors of other packages for an episode."""
        self._sensors = []
        for name, offered in [*self._offered.items()]:
            try:
                definition(offered.topic.type)
                self._sensors.append(offered_channel(offered, self._simulation))
            except ManipSimError as error:
                self._leave_out(name, error)

    def _leave_out(self, name: str, error: Exception) -> None:
        """Record no more of a sensor of another package."""
        _LOGGER.warning('%s is not recorded any more, sensor %s: %s: %s', name,
                        self._offered.pop(name).offer, type(error).__name__, error)

    def _channel(self, topic: str, kind: str) -> int:
        if topic not in self._channels:
            self._channels[topic] = self._file.channel(topic, full_name(kind), definition(kind))
        return self._channels[topic]

    def write(self, observation: Observation | None,
              images: Mapping[str, NDArray[np.uint8]] | None) -> None:
        """Write the observation at the present instant, and exact values where they differ."""
        seen = observation or self._episode.observation
        self._write_channel(clock_channel(), np.empty(0))
        self.write_numbers(STATE, 'qpos, qvel, mocap', physics_state(self._simulation))
        if 'goal' in seen:
            self.write_numbers(GOAL, 'goal', np.asarray(seen['goal'], dtype=np.float64))
        exactly = self._episode.observes_exactly
        for channel in self._robots:
            self._write_channel(channel, channel.read(self._simulation), exactly)
        for index, name in enumerate(self._simulation.entities.free_names):
            self._write_channel(self._object(name), seen['object_pose'][index], exactly)
        self._write_sensors()
        self._write_images({key.removeprefix(IMAGE): value for key, value in seen.items()
                            if key.startswith(IMAGE)} if images is None else images)

    def _object(self, name: str) -> Channel:
        """Return the pose of a free body, whose name need not be that of a topic of a node."""
        if name not in self._objects:
            row = BY_NAME['objects/<name>/pose'].filled_in(name)
            pose = object_channel(self._simulation, row)
            self._objects[name] = replace(pose, exact=replace(
                pose, topic=replace(row, name=f'truth/{row.name}')))
        return self._objects[name]

    def _write_channel(self, channel: Channel, numbers: FloatArray | None, exactly: bool = True
                       ) -> None:
        """
        Write numbers of a channel.

        :param exactly: whether they are exact; if not, the exact ones are written too
        """
        assert numbers is not None
        self._write(_recorded_as(channel), channel.topic.type, channel.fields, numbers)
        if not exactly and channel.exact is not None:
            self._write_channel(channel.exact, channel.exact.read(self._simulation))

    def _write_sensors(self) -> None:
        """Write what sensors of other packages have to say at the present instant."""
        for channel in [*self._sensors]:
            kind = channel.topic.type
            try:
                message = channel.written(new_message(kind), self._simulation)
                content = None if message is None else encoded(kind, message)
            except Exception as error:  # Code of another package may raise anything.
                self._sensors.remove(channel)
                self._leave_out(channel.topic.name, error)
                continue
            if content is not None:
                self._file.write(self._channel(_recorded_as(channel), kind),
                                 self._simulation.time_ns, content)

    def write_numbers(self, topic: str, label: str, numbers: FloatArray) -> None:
        """Write an array, shape (n,)."""
        make = multi_array((label, len(numbers)))
        self._write(topic, 'std_msgs/Float64MultiArray',
                    lambda _, numbers: make({}, numbers), numbers)

    def _write(self, topic: str, kind: str, fields: _Fields, numbers: FloatArray) -> None:
        if topic not in self._patched:
            encode = encoder(kind)
            self._patched[topic] = PatchedBytes(
                lambda time_ns, numbers: encode(fields(time_ns, numbers)), len(numbers))
        time_ns = self._simulation.time_ns
        self._file.write(self._channel(topic, kind), time_ns,
                         self._patched[topic].at(time_ns, numbers))

    def write_value(self, topic: str, value: str | float | bool) -> None:
        """Write a text, a number or whether something is so."""
        kind = {str: 'std_msgs/String', float: 'std_msgs/Float64', bool: 'std_msgs/Bool'}[
            type(value)]
        self._file.write(self._channel(topic, kind), self._simulation.time_ns,
                         encoder(kind)({'data': value}))

    def _write_images(self, images: Mapping[str, NDArray[np.uint8]]) -> None:
        """Write images by camera as JPEG, on the topics of the node's cameras."""
        time_ns = self._simulation.time_ns
        for camera, rgb in images.items():
            row = BY_NAME['<camera>/color/image_raw/compressed'].filled_in(camera)
            head = {'stamp': stamp_fields(time_ns),
                    'frame_id': self._frames.get(camera, camera + OPTICAL)}
            self._file.write(self._channel(f'/{row.name}', row.type), time_ns,
                             encoder(row.type)(compressed_image(head, rgb)))


def _recorded_as(channel: Channel) -> str:
    """Return the name of a topic as that of a node without a namespace."""
    name = channel.topic.name
    return f'/manip_sim{name[1:]}' if name[0] == '~' else f'/{name.lstrip("/")}'


def physics_state(simulation: Simulation) -> FloatArray:
    """
    Return positions, velocities and mocap poses of the present instant, a copy.

    :returns: :data:`STATE_PARTS`, as ``mj_getState`` orders them, shape (n,)
    """
    model = simulation.model
    state = np.empty(mujoco.mj_stateSize(model, STATE_PARTS))
    mujoco.mj_getState(model, simulation.data, state, STATE_PARTS)
    return state
