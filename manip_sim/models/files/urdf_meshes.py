# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the meshes that a URDF names, and convert what MuJoCo cannot read; leave out the rest."""

from __future__ import annotations

from collections.abc import Iterator
import hashlib
import logging
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

from manip_sim.errors import ModelError
from manip_sim.models.asset_files import check_content, MAX_FILE_BYTES
from manip_sim.models.files.package_folders import PackageFolders
from manip_sim.models.missing_meshes import (
    check_fetched, Lost, LostShape, MissingMeshError, warnings_of)
from manip_sim.models.regular_files import Files
from manip_sim.quoting import one_line, quoted
from manip_sim.resources import cache_folder, keep_in_cache

_MESHES = ('.stl', '.obj', '.msh')
_PACKAGE = re.compile(r'(?:package|model)://([^/]+)/(.+)')
#: What begins a name without a package.
_NO_PACKAGE = 'package:///'
_CONVERTIBLE = ('.dae', '.glb', '.gltf', '.ply', '.off')
_MAX_BYTES = 200_000_000
_MAX_FACES = 2_000_000


def find_meshes(robot: ElementTree.Element, file: Path, expected: bool,
                files: Files | None = None) -> list[str]:
    """
    Make the paths of meshes absolute; remove shapes that are missing or MuJoCo cannot read.

    :returns: sentences about them, a :class:`LostShape` each if they are expected
    """
    extension = robot.find('mujoco/compiler')
    folder = file.parent / (extension.get('meshdir', '') if extension is not None else '')
    lost, packages = [], PackageFolders(file, files)
    for link in robot.iter('link'):
        for shape in [*link.findall('visual'), *link.findall('collision')]:
            mesh = shape.find('geometry/mesh')
            if mesh is None:
                continue
            name = mesh.get('filename', '')
            try:
                path = _resolve(name, folder, file, packages, files)
                mesh.set('filename', str(_read(path, files)))
            except MissingMeshError as error:
                lost.append(Lost(f'{shape.tag} shape', name, f'link {quoted(link.get("name"))}',
                                 error))
                link.remove(shape)
    said = warnings_of(lost, file)
    if any(one.kind == 'collision shape' for one in lost) and robot.find('link/collision') is None:
        unseen = '' if robot.find('link/visual') is not None else ', and it cannot be seen'
        said.append(f'no collision shape is left in {file}: nothing touches it{unseen}')
    return [LostShape(sentence) for sentence in said] if expected else said


def _read(mesh: Path, files: Files | None) -> Path:
    """
    Return a mesh, or one of its stem or its content in a format that MuJoCo reads.

    :raises MissingMeshError: if there is none
    """
    found = _readable(mesh, files or Files()) or mesh
    if files is not None:
        try:
            content = files.read(found, 'mesh file', MAX_FILE_BYTES)
            check_content('mesh', found.suffix.lower(), content, str(found))
        except ModelError as error:
            raise MissingMeshError(str(error)) from error
        return found
    check_fetched(found)
    if found.suffix.lower() in _MESHES:
        return found
    if found.suffix.lower() not in _CONVERTIBLE:
        raise MissingMeshError(f'not one of {", ".join((*_MESHES, *_CONVERTIBLE))}',
                               'convert it to STL or OBJ')
    made, why = _converted(found)
    if made is None:
        raise MissingMeshError(why)
    return made


def _readable(mesh: Path, files: Files) -> Path | None:
    """Return a mesh, or one of its stem in a format that MuJoCo reads, or None."""
    if mesh.suffix.lower() in _MESHES:
        return mesh
    return next((other for suffix in _MESHES
                 if files.is_file(other := mesh.with_suffix(suffix))), None)


def _resolve(name: str, folder: Path, file: Path, packages: PackageFolders, files: Files | None
             ) -> Path:
    """
    Return the path of a mesh.

    :raises MissingMeshError: if its package or its file does not exist
    """
    match, at = _PACKAGE.fullmatch(name), files or Files()
    roots, rest = list[Path](), ''
    if match is None:
        unnamed = name.startswith(_NO_PACKAGE)  # Onshape's exporter means the folder of the file.
        path = folder / name.removeprefix(_NO_PACKAGE if unnamed else 'file://')
        candidates = [path, *(_elsewhere(path, packages) if files is None else ())]
    else:
        package, rest = match.groups()
        roots = packages.find(package) or [
            # The package has another name here.
            folder for folder in file.resolve().parents[:2] if at.is_file(folder / rest)]
        if not roots:
            raise MissingMeshError(*packages.missing(package), f'package {package}')
        candidates = [root / rest for root in roots]
    for candidate in candidates:
        if at.is_file(candidate) or _readable(candidate, at) not in (None, candidate):
            return Path(candidate.resolve())
    for root in roots:
        installed = packages.file_in(root, rest)
        if installed is not None:
            return installed.resolve()
    if files is None:
        check_fetched(candidates[0])
    raise MissingMeshError(f'{candidates[0]} is no file{at.rule}', cause='file')


def _elsewhere(path: Path, packages: PackageFolders) -> Iterator[Path]:
    """Yield where a mesh of an absolute path of another machine may be: in a package it names."""
    if path.is_absolute() and not path.is_file():
        for number, part in enumerate(path.parts[1:-1], start=2):
            for root in packages.find(part):
                yield root.joinpath(*path.parts[number:])


def _converted(mesh: Path) -> tuple[Path | None, str]:
    """
    Return an OBJ file with the shape of a mesh, in metres, or None and why not.

    It is in ``$XDG_CACHE_HOME/manip_sim/meshes``, by the content of the mesh, and is made once.

    :param mesh: a file of one of :data:`_CONVERTIBLE`
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
        target = cache_folder('meshes') / f'{key}.obj'
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
