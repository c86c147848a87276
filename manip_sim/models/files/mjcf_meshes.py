# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Leave out the shapes of an MJCF file whose meshes are missing, if no mass follows from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco

from manip_sim.errors import ModelError
from manip_sim.models.lost_shapes import Lost, LostShape, MissingMeshError, warnings_of
from manip_sim.models.loading import load_spec
from manip_sim.quoting import quoted


def load_mjcf(file: Path, expects_meshes: bool) -> tuple[mujoco.MjSpec, list[str]]:
    """
    Read a spec from an MJCF file, without the shapes whose meshes are missing.

    :raises ModelError: if it cannot be read, or the mass of a body follows from a missing mesh
    """
    missing: dict[str, MissingMeshError] = {}
    spec = load_spec(file, missing)
    lost = []
    for geom in list(spec.geoms) if missing else []:
        if geom.meshname in missing:
            error = missing[geom.meshname]
            if _gives_mass(spec, geom):
                raise ModelError(f'{file}: body {quoted(geom.parent.name)} has its mass from mesh '
                                 f'{quoted(geom.meshname)}: {error.why}; {error.remedy}, or give '
                                 'the body an <inertial>')
            kind = 'collision' if geom.contype or geom.conaffinity else 'visual'
            lost.append(Lost(kind, geom.meshname, f'body {quoted(geom.parent.name)}', error))
            for pair in [pair for pair in spec.pairs if geom.name
                         and geom.name in (pair.geomname1, pair.geomname2)]:
                spec.delete(pair)
            spec.delete(geom)
    for mesh in [mesh for mesh in spec.meshes if mesh.name in missing]:
        spec.delete(mesh)
    said = warnings_of(lost, file)
    return spec, [LostShape(sentence) for sentence in said] if expects_meshes else said


def _gives_mass(spec: mujoco.MjSpec, geom: Any) -> bool:
    body, ruled = geom.parent, mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if geom.mass == 0.0 or geom.density == 0.0 or body.name == 'world':
        return False
    return not body.explicitinertial or int(spec.compiler.inertiafromgeom) == int(ruled)
