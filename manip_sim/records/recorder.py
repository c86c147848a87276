# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Record the episodes of a task: what is observed at each control period, actions, digests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
import json
from pathlib import Path
import platform
from types import TracebackType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip_sim.arrays import FloatArray
from manip_sim.cdr_patching import PatchedBytes
from manip_sim.errors import RecordError
from manip_sim.frame_names import FrameNames, OPTICAL
from manip_sim.interface.scope import Scope
from manip_sim.records.definitions import definition, encoder, full_name
from manip_sim.records.record_file import RecordFile
from manip_sim.rendering.jpeg import JPEG_FORMAT, jpeg_of
from manip_sim.resources import package_version
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.tasks import Episode
from manip_sim.tasks.observation import IMAGE, Observation

#: Of the metadata below; a reader rejects others.
FORMAT = '1'
#: Names of metadata: of an episode at its begin, and at its end.
EPISODE, RESULT = 'manip_sim/episode', 'manip_sim/result'
#: Name of metadata with what is known of a node.
NODE = 'manip_sim/node'
#: Name of the attachment with the model.
MODEL = 'model.mjz'
ACTION, STATE, GOAL, REWARD, SUCCESS, DIGEST = (
    f'/episode/{name}' for name in ('action', 'state', 'goal', 'reward', 'success', 'digest'))
#: What :data:`STATE` holds, one after the other: what it takes to draw all bodies.
STATE_PARTS = int(mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_QVEL
                  | mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT)
_WORLD = 'world'


class EpisodeRecorder:
    """
    A recorder of episodes in an MCAP file, with all that it takes to repeat them.

    Call :meth:`begin` after ``Episode.reset``, :meth:`period` after each ``Episode.step``, and
    :meth:`end`. Times are those of the simulation. Used as a context, it closes its file.

    Joints, poses, external wrenches and the goal are recorded as a policy observes them. Where
    noise or latency make that differ, the exact values of the instant are below ``truth/``.

    :param path: of the file
    :param episode: what is recorded
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
                'robots': json.dumps(_joints(episode.simulation)),
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
        :param images: by camera, shape (h, w, 3); None for those of the observation
        :param observation: of the start; None to read it
        :raises RecordError: if the file cannot be written
        """
        self._number += 1
        self._return = 0.0
        self._file.describe(EPISODE, {
            **self._about, 'number': str(self._number), 'seed': str(seed),
            'steps': str(self._episode.simulation.step_count),
            'drawn': json.dumps(self._episode.simulation.randomized.drawn)})
        self._topics.write(observation, images)
        self._digest()

    def period(self, action: ArrayLike | None = None, reward: float | None = None,
               success: bool | None = None,
               images: Mapping[str, NDArray[np.uint8]] | None = None,
               observation: Observation | None = None) -> None:
        """
        Record a control period, after it.

        :param action: that was applied; None if commands came in another way
        :param reward: of the present instant; None to compute it
        :param success: whether the task is done; None to compute it
        :param images: by camera, shape (h, w, 3); None for those of the observation
        :param observation: after the period; None to read it
        :raises RecordError: if the file cannot be written
        """
        if action is not None:
            self._topics.write_action(np.asarray(action, dtype=np.float64))
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


#: Reader of numbers of an observation, or of the present instant.
_Read = Callable[[Observation], FloatArray]
#: What makes the content of a message of a stamp and numbers.
_Make = Callable[[dict[str, int], FloatArray], Any]
#: A topic, its type, its messages and what reads their numbers.
_Numbers = tuple[str, str, PatchedBytes, _Read]


class _Topics:
    """The topics of an episode; those of a robot are named as in the node."""

    def __init__(self, file: RecordFile, episode: Episode) -> None:
        self._file = file
        self._episode = episode
        self._simulation = simulation = episode.simulation
        self._channels: dict[str, int] = {}
        self._always: list[_Numbers] = []
        self._truths: list[_Numbers] = []
        self._action: tuple[int, PatchedBytes] | None = None
        self._seen = episode.observer.read()
        self._add(self._always, '/clock', 'rosgraph_msgs/Clock',
                  lambda stamp, _: {'clock': stamp}, lambda _: np.empty(0))
        self._add(self._always, STATE, 'std_msgs/Float64MultiArray', _array('qpos, qvel, mocap'),
                  lambda _: physics_state(simulation))
        if 'goal' in self._seen:
            self._add(self._always, GOAL, 'std_msgs/Float64MultiArray', _array('goal'),
                      lambda seen: np.asarray(seen['goal'], dtype=np.float64))
        several, joint, arm = len(simulation.robots) > 1, 0, 0
        for name, robot in simulation.robots.items():
            self._add_robot(robot, Scope(name if several else ''), joint, arm)
            joint, arm = joint + len(robot.joint_names), arm + len(robot.end_effectors)
        for index, name in enumerate(simulation.entities.free_names):
            self._add_both(Scope(''), f'objects/{name}/pose', 'geometry_msgs/PoseStamped', _pose,
                           partial(_row, 'object_pose', index), _object_pose(simulation, name))

    def _add_robot(self, robot: SimulatedRobot, scope: Scope, joint: int, arm: int) -> None:
        """Add the topics of a robot whose joints and arms begin at some rows of observations."""
        joints, exact = slice(joint, joint + len(robot.joint_names)), robot.sensing.exact
        self._add_both(scope, 'joint_states', 'sensor_msgs/JointState',
                       _joint_state(robot.joint_names),
                       lambda seen: np.concatenate([seen[f'joint_{kind}'][joints] for kind in (
                           'position', 'velocity', 'effort')]), lambda: exact('joints'))
        for row, (name, reader) in enumerate(robot.end_effectors.items(), arm):
            make, kind = _wrench(reader.wrench_frame), 'geometry_msgs/WrenchStamped'
            # No part of observations.
            self._add_both(scope, f'{name}/wrench', kind, make,
                           _present(partial(robot.sensing.measured, f'{name}/wrench')),
                           partial(exact, f'{name}/wrench'))
            self._add_both(scope, f'{name}/external_wrench', kind, make,
                           partial(_row, 'external_wrench', row),
                           partial(exact, f'{name}/external_wrench'))
            self._add_both(scope, f'{name}/eef_pose', 'geometry_msgs/PoseStamped', _pose,
                           partial(_row, 'eef_pose', row), partial(exact, f'{name}/pose'))

    def _add_both(self, scope: Scope, topic: str, kind: str, make: _Make, read: _Read,
                  exact: Callable[[], FloatArray]) -> None:
        """Add what is observed, and beside it what is true."""
        self._add(self._always, f'/{scope.topic(topic)}', kind, make, read)
        self._add(self._truths, f'/{scope.topic(f"truth/{topic}")}', kind, make, _present(exact))

    def _add(self, numbers: list[_Numbers], topic: str, kind: str, make: _Make, read: _Read
             ) -> None:
        numbers.append((topic, kind, self._patched(kind, make, len(read(self._seen))), read))

    def _patched(self, kind: str, make: _Make, count: int) -> PatchedBytes:
        encode = encoder(kind)
        return PatchedBytes(lambda time_ns, numbers: encode(make(_stamp(time_ns), numbers)), count)

    def _channel(self, topic: str, kind: str) -> int:
        if topic not in self._channels:
            self._channels[topic] = self._file.channel(topic, full_name(kind), definition(kind))
        return self._channels[topic]

    def write(self, observation: Observation | None,
              images: Mapping[str, NDArray[np.uint8]] | None) -> None:
        """Write what is observed at the present instant, and where it differs what is true."""
        time_ns, seen = self._simulation.time_ns, observation or self._episode.observation
        truths = [] if self._episode.observes_exactly else self._truths
        for topic, kind, patched, read in (*self._always, *truths):
            self._file.write(self._channel(topic, kind), time_ns,
                             patched.at(time_ns, read(seen)))
        self._write_images({key.removeprefix(IMAGE): value for key, value in seen.items()
                            if key.startswith(IMAGE)} if images is None else images)

    def write_action(self, action: FloatArray) -> None:
        """Write an action, shape (n,)."""
        if self._action is None:
            kind = 'std_msgs/Float64MultiArray'
            self._action = (self._channel(ACTION, kind),
                            self._patched(kind, _array('action'), len(action)))
        channel, patched = self._action
        time_ns = self._simulation.time_ns
        self._file.write(channel, time_ns, patched.at(time_ns, action))

    def write_value(self, topic: str, value: str | float | bool) -> None:
        """Write a text, a number or whether something is so."""
        kind = {str: 'std_msgs/String', float: 'std_msgs/Float64', bool: 'std_msgs/Bool'}[
            type(value)]
        self._file.write(self._channel(topic, kind), self._simulation.time_ns,
                         encoder(kind)({'data': value}))

    def _write_images(self, images: Mapping[str, NDArray[np.uint8]]) -> None:
        """Write images by camera as JPEG; the topics are those of cameras of the node."""
        kind, time_ns = 'sensor_msgs/CompressedImage', self._simulation.time_ns
        model = self._simulation.model
        names = [str(model.camera(number).name) for number in range(model.ncam)]
        frames = dict(zip(names, FrameNames(model).opticals))
        for camera, rgb in images.items():
            self._file.write(
                self._channel(f'/{camera}/color/image_raw/compressed', kind), time_ns,
                encoder(kind)({
                    'header': _header(_stamp(time_ns), frames.get(camera, camera + OPTICAL)),
                    'format': JPEG_FORMAT, 'data': jpeg_of(rgb)}))


def _joints(simulation: Simulation) -> dict[str, dict[str, list[str]]]:
    """Return the names of joints by robot and part."""
    return {robot.name: {name: list(part.joints) for name, part in robot.parts.items()
                         if part.atomic == (name,)} for robot in simulation.robots.values()}


def physics_state(simulation: Simulation) -> FloatArray:
    """
    Return positions, velocities and mocap poses of the present instant, a copy.

    :param simulation: any
    :returns: :data:`STATE_PARTS`, as ``mj_getState`` orders them, shape (n,)
    """
    model = simulation.model
    state = np.empty(mujoco.mj_stateSize(model, STATE_PARTS))
    mujoco.mj_getState(model, simulation.data, state, STATE_PARTS)
    return state


def _stamp(time_ns: int) -> dict[str, int]:
    return {'sec': time_ns // 1_000_000_000, 'nanosec': time_ns % 1_000_000_000}


def _header(stamp: dict[str, int], frame: str) -> dict[str, Any]:
    return {'stamp': stamp, 'frame_id': frame}


def _array(label: str) -> _Make:
    def make(_: dict[str, int], numbers: FloatArray) -> Any:
        count = len(numbers)
        return {'layout': {'dim': [{'label': label, 'size': count, 'stride': count}]},
                'data': numbers.tolist()}
    return make


def _joint_state(names: tuple[str, ...]) -> _Make:
    def make(stamp: dict[str, int], numbers: FloatArray) -> Any:
        position, velocity, effort = numbers.reshape(3, -1).tolist()
        return {'header': _header(stamp, ''), 'name': list(names), 'position': position,
                'velocity': velocity, 'effort': effort}
    return make


def _vector(numbers: list[float]) -> dict[str, float]:
    return dict(zip('xyzw', numbers))


def _wrench(frame: str) -> _Make:
    def make(stamp: dict[str, int], numbers: FloatArray) -> Any:
        return {'header': _header(stamp, frame), 'wrench': {
            'force': _vector(numbers[:3].tolist()), 'torque': _vector(numbers[3:].tolist())}}
    return make


def _pose(stamp: dict[str, int], numbers: FloatArray) -> Any:
    return {'header': _header(stamp, _WORLD), 'pose': {
        'position': _vector(numbers[:3].tolist()), 'orientation': _vector(numbers[3:].tolist())}}


def _present(read: Callable[[], FloatArray]) -> _Read:
    """Return what reads the present instant, whatever is observed."""
    return lambda _: read()


def _row(key: str, index: int, seen: Observation) -> FloatArray:
    row: FloatArray = seen[key][index]
    return row


def _object_pose(simulation: Simulation, name: str) -> Callable[[], FloatArray]:
    return lambda: simulation.entities.pose(simulation.data, name)
