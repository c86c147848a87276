# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Convert meshes that MuJoCo cannot read, such as Collada, into OBJ files in a cache."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path
from typing import Any

from manip_sim.quoting import one_line
from manip_sim.resources import keep_in_cache, mesh_cache

SUFFIXES = ('.dae', '.glb', '.gltf', '.ply', '.off')
_MAX_BYTES = 200_000_000
_MAX_FACES = 2_000_000


def converted(mesh: Path) -> tuple[Path | None, str]:
    """
    Return an OBJ file with the shape of a mesh, in metres, or None and why not.

    It is in ``$XDG_CACHE_HOME/manip_sim/meshes``, by the content of the mesh, and is made once.

    :param mesh: a file of one of :data:`SUFFIXES`
    """
    try:
        import trimesh
    except ImportError:
        return None, 'trimesh, which converts it, is not installed: pip install trimesh pycollada'
    try:
        if mesh.stat().st_size > _MAX_BYTES:
            return None, f'it is larger than {_MAX_BYTES // 1_000_000} MB'
        content = mesh.read_bytes()
        key = hashlib.sha256(b'2' + mesh.suffix.lower().encode() + content).hexdigest()
        target = mesh_cache() / f'{key}.obj'
        if not target.is_file():
            _convert(trimesh, mesh, target)
        return target, ''
    except Exception as error:  # Each format has a reader with exceptions of its own.
        logging.getLogger(__name__).debug('cannot convert %s', mesh, exc_info=True)
        return None, one_line(f'{type(error).__name__}: {error}', 120)


def _convert(trimesh: Any, mesh: Path, target: Path) -> None:
    scene = trimesh.load_scene(mesh)
    # As URDF's readers do, take the unit of a Collada file, but not its upward axis.
    scale = trimesh.units.unit_conversion(scene.units, 'meters') if scene.units else 1.0
    whole = scene.to_mesh()
    whole.apply_scale(scale)
    if not len(whole.faces) or len(whole.faces) > _MAX_FACES:
        raise ValueError(f'it has {len(whole.faces)} faces')
    text = trimesh.exchange.obj.export_obj(
        trimesh.Trimesh(whole.vertices, whole.faces), include_normals=False)
    keep_in_cache(target, text.encode())
