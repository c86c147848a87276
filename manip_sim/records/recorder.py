# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Record the episodes of a task: observations of each control period, actions, digests."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
import json
import logging
from pathlib import Path
import platform
from types import TracebackType
from typing import Any

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
from manip_sim.records.record_file import (
    definition, encoded, encoder, full_name, new_message, RecordFile)
from manip_sim.resources import package_version
from manip_sim.simulation import Simulation
from manip_sim.tasks import Episode
from manip_sim.tasks.observation import IMAGE, Observation

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
