# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write episodes as a data set of LeRobot, version 3.0 (huggingface.co/docs/lerobot)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.errors import RecordError
from manip_sim.records.episode_arrays import Columns, Frames
from manip_sim.records.video import VideoFile

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
        features = {**{key: _feature(quantity) for key, quantity in columns.items()}, **{
            key: _image_feature(next(frames.images(camera)).shape)
            for key, camera in cameras.items()}}
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
            arrays[key] = _fixed_lists(values) if values.shape[1] > 1 else values[:, 0]
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
        for image in images:
            statistics.add(image)
            video.add(image, video.frames == first)
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
        self._write_json('meta/stats.json', statistics)
        self._write_json('meta/info.json', self._info())
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

    def _write_json(self, name: str, content: Any) -> None:
        (self._folder / name).write_text(json.dumps(content, indent=4))


def _place(pattern: str, number: int, **names: str) -> str:
    return pattern.format(chunk_index=number // _CHUNK, file_index=number % _CHUNK, **names)


def _columns(frames: Frames) -> dict[str, Columns]:
    """Return observations and actions, a row per control period."""
    count = len(frames.actions)
    columns = {'action': Columns(frames.actions, _action_names(frames))}
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


def _action_names(frames: Frames) -> list[str]:
    names = json.loads(frames.recorded.about['action_names'])
    size = frames.actions.shape[1]
    return names if len(names) == size else [f'action{index}' for index in range(size)]


def _joined(quantities: list[Columns]) -> Columns:
    return Columns(np.concatenate([quantity.values for quantity in quantities], axis=1),
                   [name for quantity in quantities for name in quantity.names])


def _feature(quantity: Columns) -> dict[str, Any]:
    return {'dtype': str(quantity.values.dtype), 'shape': [quantity.values.shape[1]],
            'names': quantity.names}


def _image_feature(shape: tuple[int, ...]) -> dict[str, Any]:
    return {'dtype': 'video', 'shape': list(shape), 'names': ['height', 'width', 'channels']}


def _fixed_lists(values: NDArray[Any]) -> Any:
    import pyarrow
    return pyarrow.FixedSizeListArray.from_arrays(
        pyarrow.array(np.ascontiguousarray(values).ravel()), values.shape[1])


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
