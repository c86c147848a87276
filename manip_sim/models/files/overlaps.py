# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Links that overlap at the start, and links that an SRDF says do not collide."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from manip_sim.errors import ModelError
from manip_sim.models.files.xacro_expansion import stem_of
from manip_sim.models.regular_files import Files
from manip_sim.quoting import one_line, pluralize, quoted

#: Links that are nearer to each other than this touch [m].
_TOUCHING_M = 1e-4
#: Links of a URDF that overlap by more than this at the start are drawn so [m].
_OVERLAPPING_M = 1e-3
_MAX_BYTES = 10_000_000


def exclude_overlaps(spec: mujoco.MjSpec, model: mujoco.MjModel, start: Mapping[str, float],
                     file: Path, urdf: bool, files: Files | None = None) -> list[str]:
    """
    Exclude collisions of links that overlap at the start.

    MuJoCo excludes collisions with a parent by itself, except with one that cannot move: links are
    excluded with the fixed links that they move on. A URDF has no place for exclusions: there all
    links that overlap are excluded, and the pairs of the SRDF beside the file.

    :param start: where joints start, by name [rad or m]
    :returns: the changes, in sentences
    """
    pairs, notes = disabled_pairs(file, files or Files()) if urdf else (set(), [])
    excluded = 0
    for one, other in sorted(pairs):
        if spec.body(one) is not None and spec.body(other) is not None:
            spec.add_exclude(bodyname1=one, bodyname2=other)
            excluded += 1
    if excluded:
        notes.append(f'left out: collisions of {pluralize(excluded, "pair")} of links, '
                     'as its SRDF says')
    for one, other in _overlapping(model, start, urdf):
        if _key(one, other) in pairs or spec.body(one) is None or spec.body(other) is None:
            continue
        pairs.add(_key(one, other))
        spec.add_exclude(bodyname1=one, bodyname2=other)
        notes.append(f"'{one}' and '{other}' overlap at the start, so they do not collide")
    return notes


def _key(one: str, other: str) -> tuple[str, str]:
    return (one, other) if one < other else (other, one)


def _overlapping(model: mujoco.MjModel, start: Mapping[str, float], everywhere: bool
                 ) -> Iterator[tuple[str, str]]:
    data = mujoco.MjData(model)
    for joint, position in start.items():
        data.joint(joint).qpos[0] = position
    margins = model.geom_margin.copy()
    model.geom_margin[:] += _TOUCHING_M
    mujoco.mj_forward(model, data)
    model.geom_margin[:] = margins
    for contact in data.contact:
        fixed, other = sorted(model.geom_bodyid[contact.geom].tolist(),
                              key=lambda body: int(model.body_weldid[body]))
        mover = int(model.body_weldid[other])
        neighbours = mover and fixed and not model.body_weldid[fixed] and not model.body_weldid[
            model.body_parentid[mover]]
        if (neighbours and contact.dist < _TOUCHING_M) or (
                everywhere and fixed and other and contact.dist < -_OVERLAPPING_M):
            yield model.body(fixed).name, model.body(other).name


def disabled_pairs(file: Path, files: Files) -> tuple[set[tuple[str, str]], list[str]]:
    """Return the pairs that the SRDF beside a URDF disables, and what to say of it."""
    srdf = file.with_name(f'{stem_of(file)}.srdf')
    if not files.is_file(srdf):
        return set(), []
    try:
        text = files.read(srdf, 'SRDF', _MAX_BYTES).decode('utf-8')
        if '<!ENTITY' in text:
            raise OSError('it declares entities')
        root = ElementTree.fromstring(text)
    except (OSError, ModelError, UnicodeDecodeError, ElementTree.ParseError) as error:
        return set(), [f'{quoted(srdf.name)} is ignored: {one_line(str(error))}']
    return {_key(pair.get('link1', ''), pair.get('link2', ''))
            for pair in root.iter('disable_collisions')}, []
