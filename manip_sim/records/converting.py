# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Convert records to data sets; an unfinished data set is never left behind."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import json
from pathlib import Path
import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.errors import RecordError
from manip_sim.records.episode_arrays import Frames, Quantities
from manip_sim.records.lerobot import write_lerobot
from manip_sim.records.recorded import Record
from manip_sim.records.untrusted_records import model_xml

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

    :param episodes: in order
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
                for index, image in enumerate(frames.images(camera)):
                    images[index] = image
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
    return {'env_name': f'manip_sim/{_camel(about["task"])}-v0', 'type': _GYM,
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


def _camel(name: str) -> str:
    return ''.join(word.capitalize() for word in name.split('_'))


#: By name: what writes a format.
FORMATS: dict[str, Callable[[Iterable[Frames], Path], int]] = {
    'lerobot': write_lerobot, 'hdf5': write_hdf5}


def convert(paths: Iterable[Path], name: str, target: Path,
            progress: Callable[[int], object] = lambda done: None,
            only_success: bool = False) -> tuple[int, int, list[str]]:
    """
    Convert the complete episodes of records to one data set.

    :param paths: of the records, in order
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
    done, where = 0, ''

    def frames() -> Iterator[Frames]:
        nonlocal done, where
        for path in paths:
            for recorded in Record(path).episodes():
                if recorded.result is None or recorded.result.get('error'):
                    notes.append(f'{path}: episode {recorded.number} is not complete, and was '
                                 'left out')
                elif recorded.success or not only_success:
                    where = f'{path}: '
                    yield Frames(recorded)
                    where = ''
                    done += 1
                    progress(done)
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
        raise RecordError(f'{where}{error}{left_out}') from error
    except OSError as error:
        raise RecordError(f'{target}: {error.strerror or error}') from error
    except ImportError as error:
        raise RecordError(f"{name} needs the package {error.name}: "
                          "pip install 'manip_sim[records]'") from error
    return done, periods, notes


def records_in(paths: Iterable[Path]) -> list[Path]:
    """
    Return files, and in place of folders the records in them by name.

    :param paths: of files and folders
    :raises RecordError: if a folder has no records
    """
    records: list[Path] = []
    for path in paths:
        files = sorted(path.rglob('*.mcap')) if path.is_dir() else [path]
        if not files:
            raise RecordError(f'{path}: this folder has no *.mcap file')
        records += files
    return records
