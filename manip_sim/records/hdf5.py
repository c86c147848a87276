# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write episodes as a data set of robomimic, in HDF5 (robomimic.github.io, Dataset Structure)."""

from __future__ import annotations

from collections.abc import Iterable
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.errors import RecordError
from manip_sim.records.episode_arrays import Frames, Quantities
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
    :raises RecordError: if there is no episode, or one cannot be written
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
    found: dict[str, NDArray[Any]] = {}
    for kind, source in (('pos', frames.positions), ('vel', frames.velocities)):
        for number, quantity in enumerate(source.values()):
            is_finger = np.array([name in fingers for name in quantity.names], dtype=bool)
            found[f'robot{number}_joint_{kind}'] = quantity.values[:, ~is_finger]
            if is_finger.any():
                found[f'robot{number}_gripper_q{kind}'] = quantity.values[:, is_finger]
    robots = list(frames.positions)
    for name, quantity in frames.end_effectors.items():
        robot, _, arm = name.rpartition('/')
        number = robots.index(robot) if robot in robots else 0
        several = sum(other.rpartition('/')[0] == robot for other in frames.end_effectors) > 1
        prefix = f'robot{number}_{arm}_eef' if several else f'robot{number}_eef'
        found[f'{prefix}_pos'] = quantity.values[:, :3]
        found[f'{prefix}_quat'] = quantity.values[:, 3:]
    if frames.objects:
        found['object'] = np.concatenate(
            [quantity.values for quantity in frames.objects.values()], axis=1)
    if frames.goal is not None:
        found['goal'] = frames.goal.values
    return found


def _camel(name: str) -> str:
    return ''.join(word.capitalize() for word in name.split('_'))
