# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Convert records to data sets of LeRobot 3.0 (huggingface.co/docs/lerobot) and robomimic.

Episodes are read as arrays, in which an action has the row of the state that it was for. An
unfinished data set is never left behind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
import json
from pathlib import Path
import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import RecordError
from manip_sim.interface.topics import BY_NAME
from manip_sim.quoting import quoted
from manip_sim.records.recorded import finite, image, model_xml, Record, RecordedEpisode
from manip_sim.records.recorder import ACTION, GOAL, REWARD, SUCCESS
from manip_sim.records.video import VideoFile

#: Of the topics of exact values, after the name of the robot if there are several, and of objects.
_TRUTH, _OBJECTS = 'truth', 'objects'
_IMAGE = BY_NAME['<camera>/color/image_raw/compressed']


@dataclass(frozen=True)
class Columns:
    """
    Something that was observed.

    :ivar values: at the start and after each control period, in SI units, shape (periods + 1, n)
    """

    values: NDArray[Any]
    names: list[str]


@dataclass
class Quantities:
    """
    Measured quantities of robots and objects at the start and after each control period.

    :ivar positions: joint positions by robot [rad or m]
    :ivar velocities: joint velocities by robot [rad/s or m/s]
    :ivar end_effectors: poses of ``grip_site`` by robot and arm: position [m] and quaternion
        x, y, z, w
    :ivar objects: poses of free bodies by name
    :ivar goal: what the task has as its goal, or None
    """

    positions: dict[str, Columns] = field(default_factory=dict)
    velocities: dict[str, Columns] = field(default_factory=dict)
    end_effectors: dict[str, Columns] = field(default_factory=dict)
    objects: dict[str, Columns] = field(default_factory=dict)
    goal: Columns | None = None


class Frames:
    """
    The control periods of an episode.

    :raises RecordError: if it has no actions, or a topic does not have a message of each period
    :ivar recorded: the episode
    :ivar actions: shape (periods, n)
    :ivar rewards: after each period, shape (periods,)
    :ivar done: whether the task is done after each period, shape (periods,)
    :ivar observed: as a policy observes it, with noise and latency
    :ivar truth: exactly, at the present instant; None where observations are exact
    """

    def __init__(self, recorded: RecordedEpisode) -> None:
        self.recorded = recorded
        self.actions = finite(recorded.actions, ACTION)
        self._count = len(self.actions)
        if not self.actions.size:
            raise RecordError(f'episode {recorded.number} has no actions')
        if not 0 <= recorded.seed < 2**63:
            raise RecordError(f'episode {recorded.number} has the seed {quoted(recorded.seed)}, '
                              'and data sets hold whole numbers below 2^63')
        self.rewards = finite(np.array([
            m.data for m in recorded.decoded(REWARD, 'std_msgs/Float64')]), REWARD)
        self.done = np.array([m.data for m in recorded.decoded(SUCCESS, 'std_msgs/Bool')], bool)
        for values, noun in ((self.rewards, 'rewards'), (self.done, 'results')):
            self._check(len(values), noun, self._count)
        self.observed, truth = Quantities(), Quantities()
        for topic in recorded.types:
            names = topic.strip('/').split('/')
            is_truth = _TRUTH in names[:2] and names[0] != _OBJECTS
            if is_truth:
                names.remove(_TRUTH)
            self._read(truth if is_truth else self.observed, topic, names)
        self.truth = truth if truth.positions else None
        goal = finite(recorded.arrays(GOAL), GOAL)
        if goal.size:
            self.observed.goal = Columns(goal, [f'goal{n}' for n in range(goal.shape[1])])

    def _read(self, into: Quantities, topic: str, names: list[str]) -> None:
        *scope, last = names
        if last == 'joint_states' and len(scope) < 2:
            robot = scope[0] if scope else next(iter(self.robots), '')
            messages = self.recorded.decoded(topic, 'sensor_msgs/JointState')
            self._check(len(messages), topic)
            names = list(messages[0].name)
            for series, member in ((into.positions, 'position'), (into.velocities, 'velocity')):
                self._add(series, robot, topic, Columns(
                    _rows([getattr(m, member) for m in messages], topic, len(names)), names))
        elif last == 'eef_pose' and scope:
            name = '/'.join(scope if len(scope) > 1 else [next(iter(self.robots), ''), *scope])
            self._add(into.end_effectors, name, topic, self._poses(topic, name))
        elif last == 'pose' and scope[:1] == [_OBJECTS]:
            name = '/'.join(scope[1:])
            self._add(into.objects, name, topic, self._poses(topic, name))

    def _add(self, columns: dict[str, Columns], name: str, topic: str, quantity: Columns) -> None:
        if not name:
            raise RecordError(f'{topic} does not say of what it is')
        if name in columns:
            raise RecordError(f'{topic} is of {quoted(name)}, as another topic is')
        columns[name] = Columns(finite(quantity.values, topic), quantity.names)

    def _poses(self, topic: str, name: str) -> Columns:
        messages = self.recorded.decoded(topic, 'geometry_msgs/PoseStamped')
        self._check(len(messages), topic)
        poses = [m.pose for m in messages]
        return Columns(np.array([[p.position.x, p.position.y, p.position.z, p.orientation.x,
                                  p.orientation.y, p.orientation.z, p.orientation.w]
                                 for p in poses]),
                       [f'{name}/{axis}' for axis in ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')])

    def _check(self, count: int, noun: str, expected: int | None = None) -> None:
        expected = self._count + 1 if expected is None else expected
        if count != expected:
            raise RecordError(f'episode {self.recorded.number} has {count} messages of {noun} for '
                              f'{self._count} control periods, it should have {expected}')

    @property
    def robots(self) -> dict[str, dict[str, list[str]]]:
        """The names of joints by robot and part."""
        robots: dict[str, Any] = json.loads(self.recorded.about['robots'])
        return robots

    @property
    def fingers(self) -> set[str]:
        """The names of the joints of grippers."""
        return {joint for parts in self.robots.values() for part, joints in parts.items()
                if part.endswith('gripper') for joint in joints}

    @property
    def cameras(self) -> dict[str, str]:
        """The topics of images by camera."""
        return {camera: topic for topic in self.recorded.types
                if (camera := _IMAGE.of_name(topic.removeprefix('/')))}

    def images(self, camera: str) -> Iterator[NDArray[np.uint8]]:
        """
        Yield the images of a camera, at the start and after each period but the last.

        :returns: arrays of one shape (height, width, 3), rgb
        :raises RecordError: if one is missing or cannot be read, or they differ in size
        """
        topic = self.cameras[camera]
        messages = self.recorded.decoded(topic, 'sensor_msgs/CompressedImage')
        self._check(len(messages), topic)
        shape: tuple[int, ...] = ()
        for message in messages[:-1]:
            picture = image(bytes(message.data), f'an image of {camera}')
            if picture.shape != (shape or picture.shape):
                raise RecordError(f'images of {camera} differ in size')
            shape = picture.shape
            yield picture


def _rows(rows: list[Any], topic: str, count: int) -> FloatArray:
    if any(len(row) != count for row in rows):
        raise RecordError(f'{topic} has arrays of different lengths')
    return np.array(rows, dtype=np.float64).reshape(len(rows), count)


#: robomimic's number for environments of gymnasium.
_GYM = 2


def write_hdf5(episodes: Iterable[Frames], path: Path) -> int:
    """
    Write episodes as ``data/demo_0`` and so on; those with success are also in ``mask/success``.

    Observations are named as in robosuite: ``robot0_joint_pos`` (of arms and bodies [rad or m]),
    ``robot0_gripper_qpos``, ``robot0_eef_pos`` [m], ``robot0_eef_quat`` (x, y, z, w), ``object``
    (poses one after the other), ``goal`` and ``CAMERA_image``. Where noise or latency change them,
    ``truth`` has the exact values beside ``obs``. ``states`` are qpos, qvel and mocap poses. All
    numbers are float64.

    :param path: of the file, which must not be there
    :returns: the number of control periods
    :raises RecordError: without an episode, or if one cannot be written
    """
    import h5py
    total, successes = 0, []
    with h5py.File(path, 'x') as file:
        data = file.create_group('data')
        for number, frames in enumerate(episodes):
            demo = data.create_group(f'demo_{number}')
            if number == 0:
                data.attrs['env_args'] = json.dumps(_environment(frames))
            count = len(frames.actions)
            demo.attrs.update(num_samples=count, seed=frames.recorded.seed,
                              success=frames.recorded.success, model_file=model_xml(
                                  frames.recorded.model))
            states = frames.recorded.states
            if len(states) != count + 1:
                raise RecordError(f'episode {frames.recorded.number} has {len(states)} states for '
                                  f'{count} control periods')
            demo['actions'], demo['states'] = frames.actions, states[:-1]
            demo['rewards'], demo['dones'] = frames.rewards, frames.done.astype(np.int64)
            for key, values in _observations(frames.observed, frames.fingers).items():
                demo[f'obs/{key}'], demo[f'next_obs/{key}'] = values[:-1], values[1:]
            if frames.truth is not None:
                for key, values in _observations(frames.truth, frames.fingers).items():
                    demo[f'truth/{key}'] = values[:-1]
            for camera in frames.cameras:
                shape = next(frames.images(camera)).shape
                images = demo.create_dataset(
                    f'obs/{camera}_image', (count, *shape), np.uint8, compression='gzip',
                    compression_opts=1, chunks=(1, *shape))
                for index, picture in enumerate(frames.images(camera)):
                    images[index] = picture
            total += count
            if frames.recorded.success:
                successes.append(f'demo_{number}')
        if not total:
            raise RecordError('there are no episodes')
        data.attrs['total'] = total
        file.create_group('mask')['success'] = np.array(successes, dtype='S')
    return total


def _environment(frames: Frames) -> dict[str, Any]:
    """Return what robomimic makes the environment from, which gives observations like these."""
    about, recorded = frames.recorded.about, frames.recorded
    keywords = {**recorded.json('arguments'), 'action': about['action'],
                'control_hz': float(f'{1.0 / recorded.period_s:.12g}'),
                'latency': recorded.json('latency'), 'noise': recorded.json('noise')}
    if frames.cameras:
        height, width, _ = next(frames.images(next(iter(frames.cameras)))).shape
        keywords.update(cameras=list(frames.cameras), image_size=[width, height])
    task = ''.join(word.capitalize() for word in about['task'].split('_'))
    return {'env_name': f'manip_sim/{task}-v0', 'type': _GYM,
            'env_version': about['manip_sim'], 'env_kwargs': keywords}


def _observations(frames: Quantities, fingers: set[str]) -> dict[str, NDArray[Any]]:
    observations: dict[str, NDArray[Any]] = {}
    for kind, source in (('pos', frames.positions), ('vel', frames.velocities)):
        for number, quantity in enumerate(source.values()):
            is_finger = np.array([name in fingers for name in quantity.names], dtype=bool)
            observations[f'robot{number}_joint_{kind}'] = quantity.values[:, ~is_finger]
            if is_finger.any():
                observations[f'robot{number}_gripper_q{kind}'] = quantity.values[:, is_finger]
    robots = list(frames.positions)
    for name, quantity in frames.end_effectors.items():
        robot, _, arm = name.rpartition('/')
        number = robots.index(robot) if robot in robots else 0
        several = sum(other.rpartition('/')[0] == robot for other in frames.end_effectors) > 1
        prefix = f'robot{number}_{arm}_eef' if several else f'robot{number}_eef'
        observations[f'{prefix}_pos'] = quantity.values[:, :3]
        observations[f'{prefix}_quat'] = quantity.values[:, 3:]
    if frames.objects:
        observations['object'] = np.concatenate(
            [quantity.values for quantity in frames.objects.values()], axis=1)
    if frames.goal is not None:
        observations['goal'] = frames.goal.values
    return observations


def convert(paths: Iterable[Path], name: str, target: Path,
            progress: Callable[[int], object] = lambda done: None,
            only_success: bool = False) -> tuple[int, int, list[str]]:
    """
    Convert the complete episodes of records to one data set.

    :param name: one of :data:`FORMATS`
    :param target: of the data set; it must not be there
    :param progress: is called with the number of episodes that are done
    :param only_success: leave out episodes without success
    :returns: numbers of episodes and of control periods, and notes on omissions
    :raises RecordError: if a record cannot be read, or an episode cannot be written
    """
    if target.exists():
        raise RecordError(f'{target} already exists and is not overwritten')
    if not target.parent.is_dir():
        raise RecordError(f'no such folder: {target.parent}')
    notes: list[str] = []
    done, location = 0, ''

    def leave_out(path: Path, number: int) -> None:
        notes.append(f'{path}: episode {number} is not complete, and was left out')

    def frames() -> Iterator[Frames]:
        nonlocal done, location
        for path in paths:
            record = Record(path)
            for recorded in record.episodes():
                if recorded.result is None or recorded.result.get('error'):
                    leave_out(path, recorded.number)
                elif recorded.success or not only_success:
                    location = f'{path}: '
                    yield Frames(recorded)
                    location = ''
                    done += 1
                    progress(done)
            if record.begun is not None:
                leave_out(path, record.begun)
    try:
        # Of its own name, as another process may write the same data set.
        with tempfile.TemporaryDirectory(prefix='.unfinished', dir=target.parent) as folder:
            unfinished = Path(folder, 'set')
            periods = FORMATS[name](frames(), unfinished)
            if target.exists():
                raise RecordError(f'{target} is there by now, and is not overwritten')
            unfinished.rename(target)
    except RecordError as error:
        left_out = f'; {len(notes)} incomplete' if notes and not done else ''
        raise RecordError(f'{location}{error}{left_out}') from error
    except OSError as error:
        raise RecordError(f'{target}: {error.strerror or error}') from error
    except ImportError as error:
        raise RecordError(f"{name} needs the package {error.name}: "
                          "pip install 'manip_sim[records]'") from error
    return done, periods, notes


def records_in(paths: Iterable[Path]) -> list[Path]:
    """
    Return files, and in place of folders the records in them by name.

    :raises RecordError: if a folder has no records
    """
    records: list[Path] = []
    for path in paths:
        files = sorted(path.rglob('*.mcap')) if path.is_dir() else [path]
        if not files:
            raise RecordError(f'{path}: this folder has no *.mcap file')
        records += files
    return records


_DATA = 'data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet'
_VIDEO = 'videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4'
_EPISODES = 'meta/episodes/chunk-000/file-000.parquet'
_CHUNK, _DATA_MB, _VIDEO_MB = 1000, 100, 200
_QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
#: Pixels between two that count in the statistics of images.
_STRIDE = 4


def write_lerobot(episodes: Iterable[Frames], folder: Path) -> int:
    """
    Write a data set of which LeRobot's own class reads every number and image.

    ``observation.state`` holds positions of joints and poses of end effectors;
    ``observation.environment_state`` poses of objects and the goal; ``truth.`` in place of
    ``observation.`` holds exact values, where noise or latency change observations. Numbers but
    rewards are float64. Videos are H.264, and each episode begins with a key frame.

    :param episodes: in order, of one task world with the same cameras
    :param folder: is created
    :returns: the number of control periods
    :raises RecordError: without an episode, or if they do not fit together
    """
    writer = _Writer(folder)
    for frames in episodes:
        writer.add(frames)
    return writer.finish()


class _Writer:
    """Writes episodes one by one, the description at the end."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self._folder = folder
        self._tasks: list[str] = []
        self._rows: list[dict[str, Any]] = []
        self._features: dict[str, Any] = {}
        self._statistics: dict[str, list[NDArray[Any]]] = {}
        self._images: dict[str, _ImageStatistics] = {}
        self._videos: dict[str, VideoFile] = {}
        self._total, self._fps = 0, 0
        self._robot = ''
        self._tables: list[Any] = []
        self._table_bytes, self._table_number = 0, 0

    def add(self, frames: Frames) -> None:
        """Add an episode."""
        columns = _columns(frames)
        cameras = {f'observation.images.{camera}': camera for camera in frames.cameras}
        features: dict[str, Any] = {
            key: {'dtype': str(quantity.values.dtype), 'shape': [quantity.values.shape[1]],
                  'names': quantity.names} for key, quantity in columns.items()}
        for key, camera in cameras.items():
            features[key] = {'dtype': 'video', 'shape': list(next(frames.images(camera)).shape),
                             'names': ['height', 'width', 'channels']}
        rate_hz = 1.0 / frames.recorded.period_s
        fps = round(rate_hz)
        # A period of whole nanoseconds cannot be 1/30 s.
        if abs(rate_hz - fps) > 1e-6 * rate_hz:
            raise RecordError('LeRobot needs a whole number of control periods in a second, not '
                              f'{rate_hz:g}')
        if not self._rows:
            self._features, self._fps = features, fps
            self._robot = frames.recorded.about['robot']
        elif (features, fps) != (self._features, self._fps):
            raise RecordError(f'episode {frames.recorded.number} has other joints, objects or '
                              'cameras than those before, or another control period')
        number, count = len(self._rows), len(frames.actions)
        row = {'episode_index': number, 'tasks': [frames.recorded.about['instruction']],
               'length': count, 'dataset_from_index': self._total,
               'dataset_to_index': self._total + count, 'seed': frames.recorded.seed,
               'success': frames.recorded.success}
        for key, camera in cameras.items():
            row.update(self._add_video(key, frames.images(camera)))
        row.update(self._add_table(columns, frames, number, count))
        row.update({'meta/episodes/chunk_index': 0, 'meta/episodes/file_index': 0})
        self._rows.append(row)
        self._total += count

    def _add_table(self, columns: dict[str, Columns], frames: Frames, number: int, count: int
                   ) -> dict[str, Any]:
        import pyarrow
        instruction = frames.recorded.about['instruction']
        if instruction not in self._tasks:
            self._tasks.append(instruction)
        arrays: dict[str, Any] = {}
        for key, quantity in columns.items():
            values = quantity.values[:count]
            self._statistics.setdefault(key, []).append(values)
            arrays[key] = values[:, 0] if values.shape[1] == 1 else (
                pyarrow.FixedSizeListArray.from_arrays(
                    pyarrow.array(np.ascontiguousarray(values).ravel()), values.shape[1]))
        index = np.arange(count)
        arrays.update({
            'timestamp': (index / self._fps).astype(np.float32), 'frame_index': index,
            'episode_index': np.full(count, number), 'index': index + self._total,
            'task_index': np.full(count, self._tasks.index(instruction))})
        table = pyarrow.table(arrays)
        if self._table_bytes + table.nbytes > _DATA_MB * 2**20 and self._tables:
            self._write_tables()
        self._tables.append(table)
        self._table_bytes += table.nbytes
        return {'data/chunk_index': self._table_number // _CHUNK,
                'data/file_index': self._table_number % _CHUNK}

    def _write_tables(self) -> None:
        import pyarrow
        self._write(_place(_DATA, self._table_number), pyarrow.concat_tables(self._tables))
        self._tables, self._table_bytes = [], 0
        self._table_number += 1

    def _write(self, name: str, table: Any) -> None:
        import pyarrow.parquet
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        pyarrow.parquet.write_table(table, path, compression='snappy')

    def _add_video(self, key: str, images: Iterator[NDArray[np.uint8]]) -> dict[str, Any]:
        video = self._videos.get(key)
        if video is None or video.is_large:
            number = 0 if video is None else video.number + 1
            if video is not None:
                video.close()
            path = self._folder / _place(_VIDEO, number, video_key=key)
            video = self._videos[key] = VideoFile(
                path, number, self._fps, self._features[key]['shape'])
        statistics = self._images.setdefault(key, _ImageStatistics())
        begin, first = video.frames / self._fps, video.frames
        for picture in images:
            statistics.add(picture)
            video.add(picture, video.frames == first)
        return {f'videos/{key}/chunk_index': video.number // _CHUNK,
                f'videos/{key}/file_index': video.number % _CHUNK,
                f'videos/{key}/from_timestamp': begin,
                f'videos/{key}/to_timestamp': video.frames / self._fps}

    def finish(self) -> int:
        """Write the description and return the number of control periods."""
        import pyarrow
        if not self._rows:
            raise RecordError('there are no episodes')
        self._write_tables()
        for video in self._videos.values():
            video.close()
        self._write(_EPISODES, pyarrow.Table.from_pylist(self._rows))
        tasks = pyarrow.table({'task_index': np.arange(len(self._tasks)), 'task': self._tasks})
        # pandas, with which LeRobot reads it, takes the column from here as the index.
        self._write('meta/tasks.parquet', tasks.replace_schema_metadata({'pandas': json.dumps({
            'index_columns': ['task'], 'column_indexes': [], 'columns': [
                {'name': 'task_index', 'field_name': 'task_index', 'pandas_type': 'int64',
                 'numpy_type': 'int64', 'metadata': None},
                {'name': 'task', 'field_name': 'task', 'pandas_type': 'unicode',
                 'numpy_type': 'object', 'metadata': None}],
            'pandas_version': '2.0.0'})}))
        statistics = {key: _statistics(np.concatenate(values))
                      for key, values in self._statistics.items()}
        statistics.update((key, images.result()) for key, images in self._images.items())
        for name, content in (('stats', statistics), ('info', self._info())):
            (self._folder / f'meta/{name}.json').write_text(json.dumps(content, indent=4))
        return self._total

    def _info(self) -> dict[str, Any]:
        features = dict(self._features)
        for key, video in self._videos.items():
            features[key]['info'] = video.info
        for key, kind in (('timestamp', 'float32'), ('frame_index', 'int64'),
                          ('episode_index', 'int64'), ('index', 'int64'),
                          ('task_index', 'int64')):
            features[key] = {'dtype': kind, 'shape': [1], 'names': None}
        return {
            'codebase_version': 'v3.0', 'robot_type': self._robot,
            'total_episodes': len(self._rows), 'total_frames': self._total,
            'total_tasks': len(self._tasks), 'chunks_size': _CHUNK,
            'data_files_size_in_mb': _DATA_MB, 'video_files_size_in_mb': _VIDEO_MB,
            'fps': self._fps, 'splits': {'train': f'0:{len(self._rows)}'}, 'data_path': _DATA,
            'video_path': _VIDEO if self._videos else None, 'features': features}


def _place(pattern: str, number: int, **names: str) -> str:
    return pattern.format(chunk_index=number // _CHUNK, file_index=number % _CHUNK, **names)


def _columns(frames: Frames) -> dict[str, Columns]:
    """Return observations and actions, a row per control period."""
    count = len(frames.actions)
    names, size = json.loads(frames.recorded.about['action_names']), frames.actions.shape[1]
    columns = {'action': Columns(frames.actions, names if len(names) == size else [
        f'action{index}' for index in range(size)])}
    for place, quantities in (('observation.', frames.observed), ('truth.', frames.truth)):
        if quantities is None:
            continue
        columns[f'{place}state'] = _joined(
            [*quantities.positions.values(), *quantities.end_effectors.values()])
        surroundings = [*quantities.objects.values(),
                        *([] if quantities.goal is None else [quantities.goal])]
        if surroundings:
            columns[f'{place}environment_state'] = _joined(surroundings)
    done = np.zeros((count, 1), bool)
    done[-1] = True
    columns['next.reward'] = Columns(frames.rewards.astype(np.float32)[:, None], ['reward'])
    columns['next.done'] = Columns(done, ['done'])
    columns['next.success'] = Columns(frames.done[:, None], ['success'])
    return columns


def _joined(quantities: list[Columns]) -> Columns:
    return Columns(np.concatenate([quantity.values for quantity in quantities], axis=1),
                   [name for quantity in quantities for name in quantity.names])


def _statistics(values: NDArray[Any]) -> dict[str, Any]:
    numbers = values.astype(np.float64)
    stats = {'min': numbers.min(axis=0), 'max': numbers.max(axis=0), 'mean': numbers.mean(axis=0),
             'std': numbers.std(axis=0)}
    stats.update((f'q{round(100 * q):02d}', np.quantile(numbers, q, axis=0)) for q in _QUANTILES)
    return {**{name: value.tolist() for name, value in stats.items()}, 'count': [len(values)]}


class _ImageStatistics:
    """Statistics of the pixels of images, by colour, from 0 to 1."""

    def __init__(self) -> None:
        self._histogram = np.zeros((3, 256))
        self._count = 0

    def add(self, image: NDArray[np.uint8]) -> None:
        """Count the pixels of an image."""
        self._count += 1
        for colour in range(3):
            self._histogram[colour] += np.bincount(
                image[::_STRIDE, ::_STRIDE, colour].ravel(), minlength=256)

    def result(self) -> dict[str, Any]:
        """Return the statistics, each of shape (3, 1, 1)."""
        levels = np.arange(256) / 255.0
        share = self._histogram / self._histogram.sum(axis=1, keepdims=True)
        below = share.cumsum(axis=1)
        mean = share @ levels
        stats: dict[str, Any] = {
            'min': [levels[np.flatnonzero(row)[0]] for row in share],
            'max': [levels[np.flatnonzero(row)[-1]] for row in share], 'mean': mean,
            'std': np.sqrt(np.maximum(share @ levels**2 - mean**2, 0.0))}
        stats.update((f'q{round(100 * q):02d}', [
            levels[min(int(np.searchsorted(row, q)), 255)] for row in below]) for q in _QUANTILES)
        return {**{name: np.reshape(value, (3, 1, 1)).tolist() for name, value in stats.items()},
                'count': [self._count]}


#: Writer of each format.
FORMATS: dict[str, Callable[[Iterable[Frames], Path], int]] = {
    'lerobot': write_lerobot, 'hdf5': write_hdf5}
