# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Create objects and fixtures from shapes, meshes, MJCF files and lists in YAML."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
import hashlib
import io
from os import PathLike
from pathlib import Path
from typing import Any, TYPE_CHECKING, TypeVar, Union
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.asset_files import SPAWNED_SUFFIXES
from manip_sim.models.loading import compile_spec, Document, load_spec, spec_from_documents
from manip_sim.models.object_model import FixtureModel, ObjectModel, PlacedModel, SHAPE_GEOM
from manip_sim.models.registry import find_source, is_of_others
from manip_sim.models.untrusted_models import load_self_contained, SelfContainedModel
from manip_sim.models.user_files import (
    check_file, Files, InMemoryFile, parse_requested, read_yaml, YAML_SUFFIXES)
from manip_sim.quoting import format_value, pluralize, quoted
from manip_sim.resources import cache_folder, keep_in_cache
from manip_sim.validation import listed

if TYPE_CHECKING:
    from manip_sim.models.descriptions import FileDescription, MeshDescription, ShapeDescription

__all__ = ['check_object_names', 'create_described', 'create_object', 'create_objects',
           'FixtureModel', 'load_objects', 'object_from_model', 'ObjectModel']


#: Greatest number of degrees of freedom of an object that is spawned.
_MAX_DOF = 100
P = TypeVar('P', ObjectModel, FixtureModel)
ObjectFile = Union[str, PathLike[str]]
Description = Union[ObjectModel, Mapping[str, Any], ObjectFile]
#: Name of an object that has none.
UNNAMED = 'object'


def create_object(description: Description, files: Files | None = None) -> ObjectModel:
    """
    Create an object.

    :param description: the keys of :class:`ShapeDescription`, :class:`MeshDescription` or
        :class:`FileDescription`, an MJCF file, or a YAML file that lists one object; an object is
        returned as it is
    :param files: those that may be read, for descriptions of somebody who is not trusted; they
        are checked as ``load_self_contained`` does. None: all
    :raises ModelError: if something is wrong with it, on one line with file, object and key
    """
    if isinstance(description, ObjectModel):
        return description
    if isinstance(description, Mapping):
        return _from_values(description, '', Path(), files=files)
    if not isinstance(description, (str, PathLike)):
        raise ModelError("an object must be keys with values, such as {'name': ...}, or the path "
                         f'of a file, got {format_value(description)}')
    path = Path(description)
    if path.suffix not in YAML_SUFFIXES:
        if files is not None:
            return object_from_model(load_self_contained(path, files))
        notes: list[str] = []
        spec = load_spec(path, notes)
        item = ObjectModel(_own_name(spec), spec, str(path))
        item.inferred += notes
        return item
    objects = load_objects(path, files)
    if len(objects) != 1:
        raise ModelError(f'{path} must list one object here, it lists {len(objects)}')
    return objects[0]


def object_from_model(model: SelfContainedModel, name: str | None = None) -> ObjectModel:
    """
    Create an object from a model.

    :param name: of the object; None: that of its root body, or of the model
    :raises ModelError: if it is not an object, or takes too long or too much memory
    """
    notes: list[str] = []
    spec = model.load(notes)
    item = ObjectModel(name or _own_name(spec), spec, model.name)
    item.inferred += notes
    _check_dof(item)
    return item


def _check_dof(item: PlacedModel) -> None:
    if item.dof > _MAX_DOF:
        raise ModelError(f'{item.origin} has {item.dof} degrees of freedom, and at most '
                         f'{_MAX_DOF} can be spawned')


def create_objects(descriptions: Iterable[Description]) -> list[ObjectModel]:
    """
    Create objects; a YAML file stands for its whole list.

    :raises ModelError: as :func:`create_object`, and if two have the same name
    """
    objects: list[ObjectModel] = []
    for description in listed(descriptions, 'objects'):
        if isinstance(description, (str, PathLike)) and Path(description).suffix in YAML_SUFFIXES:
            objects += load_objects(description)
        else:
            objects.append(create_object(description))
    check_object_names(objects)
    return objects


def check_object_names(objects: Iterable[ObjectModel]) -> None:
    """Reject two objects with the same name."""
    by_name: dict[str, ObjectModel] = {}
    for item in objects:
        first = by_name.setdefault(item.name, item)
        if first is not item:
            origins = ' and '.join(dict.fromkeys([first.origin, item.origin]))
            raise ModelError(f"two objects have the name '{item.name}' ({origins}): give one of "
                             'them another name, or leave it out')


def load_objects(file: ObjectFile, files: Files | None = None) -> list[ObjectModel]:
    """
    Read the objects that a YAML file lists below its key ``objects``.

    :param files: those that may be read, as for :func:`create_object`
    :raises ModelError: on one line, with file, object, key and the nearest valid names
    """
    path = Path(file)
    values = read_yaml(file) if files is None else parse_requested(
        files.read(path, 'YAML file'), str(path))
    for key in values:
        if key != 'objects':
            raise ModelError(f"{path}: unknown key {quoted(key)}: the only one here is 'objects'")
    listed = values.get('objects')
    if not isinstance(listed, list):
        raise ModelError(f"{path}: 'objects' must be a list, got {format_value(listed)}")
    objects = []
    for number, entry in enumerate(listed, start=1):
        if not isinstance(entry, dict):
            raise ModelError(f'{path}: object {number} must be keys and values, got '
                             f'{format_value(entry)}')
        objects.append(_from_values(entry, f'{path}: ', path.parent, f'object {number}',
                                    files))
    check_object_names(objects)
    return objects


def create_described(values: Mapping[str, Any], kind: type[P], source: str, folder: Path = Path(),
                     files: Files | None = None) -> P:
    """
    Create an object or a fixture from its description.

    :param values: the keys of :class:`ShapeDescription`, :class:`MeshDescription` or
        :class:`FileDescription`
    :param kind: :class:`ObjectModel` or :class:`FixtureModel`
    :param folder: where relative paths begin
    :param files: those that may be read, as for :func:`create_object`
    :raises ModelError: if something is wrong with it
    """
    # Imported late: it needs pydantic 2, which Ubuntu 24.04 does not have.
    from manip_sim.models.descriptions import checked, kind_of, MeshDescription, ShapeDescription
    try:
        form = kind_of(values)
    except ValueError as error:
        raise ModelError(f'{source}: {error}') from None
    description = checked(form, values, source)
    inferred: list[str] = []
    try:
        if isinstance(description, ShapeDescription):
            spec, origin = _shape_spec(description), source
        elif isinstance(description, MeshDescription):
            (spec, inferred), origin = mesh_spec(description, folder, source, files), source
        else:
            spec, origin = _file_spec(description, folder, files, inferred)
        item = kind(description.name or _own_name(spec), spec, origin, description.visual)
    except ModelError as error:
        if isinstance(error, UnknownNameError) or str(error).startswith(source):
            raise
        raise ModelError(f'{source}: {error}') from error
    if files is not None:
        _check_dof(item)
    item.inferred += inferred
    item.place(description.position, description.quat_wxyz)
    return item


def _from_values(values: Mapping[str, Any], begin: str, folder: Path,
                 unnamed: str = 'object without a name', files: Files | None = None
                 ) -> ObjectModel:
    name = values.get('name')
    source = begin + (unnamed if name is None else f'object {quoted(name)}')
    return create_described(values, ObjectModel, source, folder, files)


def _shape_spec(description: ShapeDescription) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name='body')
    geom = body.add_geom(
        name=SHAPE_GEOM, type=getattr(mujoco.mjtGeom, f'mjGEOM_{description.shape.upper()}'),
        size=description.mujoco_size, mass=description.mass_kg, condim=description.condim,
        rgba=description.colour)
    geom.friction[:len(description.friction)] = description.friction
    return spec


def _file_spec(description: FileDescription, folder: Path, files: Files | None,
               notes: list[str]) -> tuple[mujoco.MjSpec, str]:
    """Return a spec and the file that it was read from; omissions are added to the notes."""
    if files is None and is_of_others(description.file):
        file = find_source(description.file, 'objects') or Path()
    else:
        file = folder / description.file
    return (load_spec(file, notes) if files is None
            else load_self_contained(file, files).load(notes)), str(file)


def _own_name(spec: mujoco.MjSpec) -> str:
    roots = spec.worldbody.bodies
    return (roots[0].name if roots else '') or str(spec.modelname)


def object_from_text(text: InMemoryFile) -> tuple[bool, Callable[[], ObjectModel]]:
    """
    Return whether an object is quickly made for sure, and return what makes it.

    :param text: MJCF, or a description in YAML
    """
    if not text.content.startswith(b'<'):
        values = parse_requested(text.content, str(text.file))
        return True, lambda: create_object({'name': UNNAMED, **values}, text)
    model = load_self_contained(text.file, text)
    return model.is_light, lambda: named_by_itself(object_from_model(model, UNNAMED))


def named_by_itself(item: ObjectModel) -> ObjectModel:
    """Return an object with the name of its root body."""
    item.name = item.spec.worldbody.bodies[0].name or UNNAMED
    return item


#: As visual shapes and collision shapes have in the catalogue.
_SEEN, _TOUCHED = 2, 3
#: Of coacd: the allowed distance of the surface from the parts, in the unit of the whole, and the
#: seed of its search.
_CONCAVITY, _SEED = 0.05, 0


def mesh_spec(description: MeshDescription, folder: Path, source: str, files: Files | None
              ) -> tuple[mujoco.MjSpec, list[str]]:
    """
    Return a spec with one body of the shape of a mesh, and the inferences.

    Mass and inertia belong to the convex hull, or to the parts, with constant density.

    :param files: those that may be read, whose contents are kept; None: all, by their paths
    """
    spec = _read_mesh(description, folder, source, files)
    spec.compiler.balanceinertia = True
    compiled = compile_spec(spec, source)
    hull_kg = float(compiled.body_mass[1])
    if description.visual:
        return spec, []
    if description.collision == 'hull':
        if description.mass is None:
            return spec, [f'touched at its convex hull, {hull_kg:.4g} kg']
        return spec, ["touched at its convex hull ('collision: parts' keeps holes)"]
    if files is not None:
        raise ModelError(f"{source}: 'collision: parts' takes long, and is not for requests: use "
                         "'hull', or MJCF with the parts")
    parts = _parts_of(compiled)
    if parts is None:
        return spec, ['touched at its convex hull, as coacd, which finds convex parts, is not '
                      'installed']
    _add_parts(spec, parts, description, source)
    return spec, [f'touched at {pluralize(len(parts), "convex part")}, found by coacd']


def _read_mesh(description: MeshDescription, folder: Path, source: str, files: Files | None
               ) -> mujoco.MjSpec:
    root = ElementTree.Element('mujoco')
    asset = ElementTree.SubElement(root, 'asset')
    held = SelfContainedModel(source, [Document(root, {})], is_light=False)
    named = {'mesh': description.file}
    if description.texture is not None:
        named['texture'] = description.texture
    for kind, name in named.items():
        named[kind] = _file(kind, folder / name, source, files, held)
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
    return spec_from_documents(held.documents, Path(source)) if files is None else held.load()


def _file(kind: str, file: Path, source: str, files: Files | None, held: SelfContainedModel
          ) -> str:
    """Return the name of a file in MJCF, after checks."""
    if file.suffix.lower() not in SPAWNED_SUFFIXES[kind]:
        raise ModelError(f'{source}: the {kind} {quoted(str(file), 200)} must be '
                         f'{" or ".join(SPAWNED_SUFFIXES[kind])}')
    if files is None:
        check_file(file, f'{kind} file')
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
               description: MeshDescription, source: str) -> None:
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
        whole_kg = float(compile_spec(spec, source).body_mass[1])
        for geom in geoms:
            geom.density *= description.mass / whole_kg
