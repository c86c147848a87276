# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Names, order, units and rate of what a policy gets and gives, as plain data for a file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import json
from pathlib import Path
from typing import Any

import mujoco

from manip_sim.errors import describe_choices, ModelError
from manip_sim.quoting import format_value, quoted
from manip_sim.tasks.episode import Episode
from manip_sim.tasks.observation import IMAGE

FORMAT = 1
#: After the name of a policy's file.
SUFFIX = '.interface.json'
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
_POSE = (('x', 'm'), ('y', 'm'), ('z', 'm'), ('qx', ''), ('qy', ''), ('qz', ''), ('qw', ''))
#: By key, names and units of the numbers of a row.
_COLUMNS = {
    'eef_pose': _POSE, 'object_pose': _POSE,
    'eef_twist': (*((f'v{axis}', 'm/s') for axis in 'xyz'),
                  *((f'w{axis}', 'rad/s') for axis in 'xyz')),
    'external_wrench': (*((f'f{axis}', 'N') for axis in 'xyz'),
                        *((f't{axis}', 'N m') for axis in 'xyz'))}
#: By key, the units of hinges and of slide joints.
_OF_JOINTS = {'joint_position': ('rad', 'm'), 'joint_velocity': ('rad/s', 'm/s'),
              'joint_effort': ('N m', 'N')}
#: Content of a file, by the key of its part.
_KNOWN: Mapping[str, tuple[str, ...]] = {
    '': ('format', 'control_hz', 'action', 'observation'),
    'action': ('kind', 'names', 'units', 'bounds'),
    'observation': ('shape', 'dtype', 'names', 'columns', 'units')}


def interface_of(episode: Episode) -> dict[str, Any]:
    """
    Return what a policy gets and gives in an episode, as JSON can hold it.

    ``control_hz`` is the number of actions in a second. ``action`` has ``kind``, ``names``,
    ``units`` and ``bounds`` of the numbers in their order; the unit ``0.05 m`` means that 1 is
    0.05 m. ``observation`` has by key ``shape`` and ``dtype`` of an array, ``names`` along its
    first axis, ``columns`` along its second axis, and ``units`` along its last axis.

    :param episode: any
    """
    actions, names = episode.actions, episode.observer.names
    observed: dict[str, Any] = {}
    for key, value in episode.observation.items():
        entry = observed[key] = {'shape': list(value.shape), 'dtype': str(value.dtype)}
        if key in names:
            entry['names'] = list(names[key])
        if key in _COLUMNS:
            entry['columns'], entry['units'] = map(list, zip(*_COLUMNS[key]))
        elif key in _OF_JOINTS:
            model = episode.simulation.model
            entry['units'] = [
                _OF_JOINTS[key][int(model.joint(name).type[0]) == _SLIDE] for name in names[key]]
        elif key.startswith(IMAGE):
            entry['columns'], entry['units'] = ['y', 'x'], ['red', 'green', 'blue']
    return {'format': FORMAT, 'control_hz': 1.0 / episode.period_s,
            'action': {'kind': episode.kind, 'names': actions.names, 'units': actions.units,
                       'bounds': actions.bounds.tolist()},
            'observation': observed}


def read_interface(file: Path) -> dict[str, Any]:
    """
    Read the file beside a policy.

    :param file: JSON as of :func:`interface_of`, of which parts may be missing
    :raises ModelError: if it cannot be read, or holds something else
    """
    try:
        content = json.loads(file.read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise ModelError(f'{file} cannot be read: {error}') from error
    _check_keys(content, '', file)
    if content.get('format', FORMAT) != FORMAT:
        raise ModelError(f'{file} has the format {format_value(content["format"])}, not {FORMAT}')
    if 'action' in content:
        _check_keys(content['action'], 'action', file)
    observed = content.get('observation', {})
    if not isinstance(observed, dict):
        raise ModelError(f'{file}: observation must be an object, by key')
    for described in observed.values():
        _check_keys(described, 'observation', file)
    return dict(content)


def _check_keys(content: Any, part: str, file: Path) -> None:
    if not isinstance(content, dict):
        raise ModelError(f'{file}: {part or "an interface"} must be an object')
    for key in content:
        if key not in _KNOWN[part]:
            raise ModelError(f'{file}: unknown key {quoted(key)}: '
                             + describe_choices(key, _KNOWN[part]))


def check_interface(expected: Mapping[str, Any], actual: Mapping[str, Any], source: str) -> None:
    """
    Reject a policy in episodes that have another rate, order or unit than it was made for.

    :param expected: of the policy, as :func:`read_interface` returns it; missing values may
        be anything, and episodes may observe more
    :param actual: of the episodes, as :func:`interface_of` returns it
    :param source: of the former, for the message
    :raises ModelError: with the first difference
    """
    for name, needed, present in _values(expected, actual):
        if isinstance(needed, list) and isinstance(present, list) and len(needed) == len(present):
            for index, (item, other) in enumerate(zip(needed, present)):
                _compare(f'{name}, number {index}', item, other, source)
        _compare(name, needed, present, source)


def _values(expected: Mapping[str, Any], actual: Mapping[str, Any]
            ) -> Iterator[tuple[str, Any, Any]]:
    """Yield the name of each compared value, its expected and its actual value."""
    if 'control_hz' in expected:
        yield 'control_hz', expected['control_hz'], actual['control_hz']
    for key, needed in expected.get('action', {}).items():
        yield f'{key} of actions', needed, actual['action'][key]
    for name, described in expected.get('observation', {}).items():
        present = actual['observation'].get(name)
        if present is None:
            yield f'observation {quoted(name)}', 'there', 'not there'
        else:
            for key, needed in described.items():
                yield f'{key} of {name}', needed, present.get(key)


def _compare(name: str, needed: Any, present: Any, source: str) -> None:
    same = needed == present or (
        isinstance(needed, (int, float)) and isinstance(present, (int, float))
        and abs(needed - present) <= 1e-6 * abs(present))
    if not same:
        raise ModelError(f'{source}: the policy was made for other episodes: {name}: it needs '
                         f'{format_value(needed, 100)}, this is {format_value(present, 100)}')
