# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Bodies whose shape is a mesh in a file: visual shapes, and convex collision shapes."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.asset_files import check_image, MAX_ASSET_BYTES
from manip_sim.models.loading import compile_spec, spec_from_string
from manip_sim.models.object_model import SHAPE_GEOM
from manip_sim.models.regular_files import check_file, Files
from manip_sim.models.untrusted_models import HeldModel
from manip_sim.quoting import counted, quoted
from manip_sim.resources import cache_folder, keep_in_cache

if TYPE_CHECKING:
    from manip_sim.models.placed_descriptions import MeshDescription

_SUFFIXES = {'mesh': ('.obj', '.stl'), 'texture': ('.png',)}
#: As visual shapes and collision shapes have in the catalogue.
_SEEN, _TOUCHED = 2, 3
#: Of coacd: the allowed distance of the surface from the parts, in the unit of the whole, and the
#: seed of its search.
_CONCAVITY, _SEED = 0.05, 0


def mesh_spec(description: MeshDescription, folder: Path, where: str, files: Files | None
              ) -> tuple[mujoco.MjSpec, list[str]]:
    """
    Return a spec with one body of the shape of a mesh, and the inferences.

    Mass and inertia belong to the convex hull, or to the parts, with constant density.

    :param files: those that may be read, whose contents are kept; None: all, by their paths
    """
    spec = _read(description, folder, where, files)
    spec.compiler.balanceinertia = True
    compiled = compile_spec(spec, where)
    hull_kg = float(compiled.body_mass[1])
    if description.visual:
        return spec, []
    if description.collision == 'hull':
        if description.mass is None:
            return spec, [f'touched at its convex hull, {hull_kg:.4g} kg']
        return spec, ["touched at its convex hull ('collision: parts' keeps holes)"]
    if files is not None:
        raise ModelError(f"{where}: 'collision: parts' takes long, and is not for requests: use "
                         "'hull', or MJCF with the parts")
    parts = _parts_of(compiled)
    if parts is None:
        return spec, ['touched at its convex hull, as coacd, which finds convex parts, is not '
                      'installed']
    _add_parts(spec, parts, description, where)
    return spec, [f'touched at {counted(len(parts), "convex part")}, found by coacd']


def _read(description: MeshDescription, folder: Path, where: str, files: Files | None
          ) -> mujoco.MjSpec:
    root = ElementTree.Element('mujoco')
    asset = ElementTree.SubElement(root, 'asset')
    held = HeldModel(where, is_light=False)
    named = {'mesh': description.file}
    if description.texture is not None:
        named['texture'] = description.texture
    for kind, name in named.items():
        named[kind] = _file(kind, folder / name, where, files, held)
    scale = (description.scale * 3)[:3]
    ElementTree.SubElement(asset, 'mesh', name='mesh', file=named['mesh'], inertia='convex',
                           scale=' '.join(map(repr, scale)))
    body = ElementTree.SubElement(ElementTree.SubElement(root, 'worldbody'), 'body', name='body')
    geom = ElementTree.SubElement(
        body, 'geom', name=SHAPE_GEOM, type='mesh', mesh='mesh', condim=str(description.condim),
        rgba=' '.join(map(repr, description.colour)),
        friction=' '.join(map(repr, description.friction)))
    if description.mass is None:
        geom.set('density', repr(description.density_kg_m3))
    else:
        geom.set('mass', repr(description.mass))
    if 'texture' in named:
        ElementTree.SubElement(asset, 'texture', name='texture', type='2d', file=named['texture'])
        ElementTree.SubElement(asset, 'material', name='material', texture='texture')
        geom.set('material', 'material')
        if 'rgba' not in description.model_fields_set:
            geom.set('rgba', '1 1 1 1')
    held.xml = ElementTree.tostring(root, encoding='unicode')
    return spec_from_string(held.xml, Path(where)) if files is None else held.load()


def _file(kind: str, file: Path, where: str, files: Files | None, held: HeldModel) -> str:
    """Return the name of a file in MJCF, after checks."""
    if file.suffix.lower() not in _SUFFIXES[kind]:
        raise ModelError(f'{where}: the {kind} {quoted(str(file), 200)} must be '
                         f'{" or ".join(_SUFFIXES[kind])}')
    if files is None:
        check_file(file, f'{kind} file', MAX_ASSET_BYTES)
        check_image(file, kind)
        return file.resolve().as_posix()
    return held.hold_file(kind, file, files)


def _parts_of(compiled: mujoco.MjModel) -> list[tuple[FloatArray, FloatArray]] | None:
    """
    Return vertices in the frame of the body [m] and faces of parts; None without coacd.

    Finding them takes seconds, so they are kept with meshes that were converted.
    """
    try:
        import coacd
    except ImportError:
        return None
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, compiled.geom_quat[0])
    vertices = compiled.mesh_vert @ rotation.reshape(3, 3).T + compiled.geom_pos[0]
    key = hashlib.sha256(b'coacd 1' + vertices.tobytes() + compiled.mesh_face.tobytes())
    kept = cache_folder('meshes') / f'{key.hexdigest()}.npz'
    if not kept.is_file():
        coacd.set_log_level('error')
        parts = coacd.run_coacd(coacd.Mesh(vertices, compiled.mesh_face), threshold=_CONCAVITY,
                                seed=_SEED)
        content = io.BytesIO()
        np.savez(content, *(array for part in parts for array in part))
        keep_in_cache(kept, content.getvalue())
    with np.load(kept) as cached:
        arrays = [cached[name] for name in cached.files]
    return list(zip(arrays[::2], arrays[1::2]))


def _add_parts(spec: mujoco.MjSpec, parts: list[tuple[FloatArray, FloatArray]],
               description: MeshDescription, where: str) -> None:
    """Add shapes that touch and have the mass, and let the mesh only be seen."""
    body, seen = spec.worldbody.bodies[0], spec.geom(SHAPE_GEOM)
    seen.contype, seen.conaffinity, seen.group, seen.mass = 0, 0, _SEEN, 0.0
    geoms = []
    for number, (vertices, faces) in enumerate(parts):
        spec.add_mesh(name=f'part{number}', uservert=np.asarray(vertices).ravel(),
                      userface=np.asarray(faces).ravel(), inertia=mujoco.mjtMeshInertia.
                      mjMESH_INERTIA_CONVEX)
        geom = body.add_geom(name=f'part{number}', type=mujoco.mjtGeom.mjGEOM_MESH,
                             meshname=f'part{number}', group=_TOUCHED, condim=seen.condim,
                             density=description.density_kg_m3)
        geom.friction = seen.friction
        geoms.append(geom)
    if description.mass is not None:
        whole_kg = float(compile_spec(spec, where).body_mass[1])
        for geom in geoms:
            geom.density *= description.mass / whole_kg
