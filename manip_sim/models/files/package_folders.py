# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Folders of ROS packages, and the meshes of URDF that are in them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
import hashlib
from itertools import islice
import logging
import os
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

from manip_sim.errors import ModelError
from manip_sim.models.asset_files import (
    check_fetched, check_suffix, Lost, LostShape, MissingMeshError, warnings_of)
from manip_sim.models.user_files import Files
from manip_sim.quoting import one_line, quoted
from manip_sim.resources import cache_folder, keep_in_cache, PACKAGE, share_directory

#: In how many folders above a file packages are looked for, how deep below each, and in how many
#: folders altogether.
_LEVELS, _DEPTH, _MAX_FOLDERS = 6, 5, 3000
#: Files that keep a folder and all below it out of a workspace.
_IGNORED = ('COLCON_IGNORE', 'AMENT_IGNORE', 'CATKIN_IGNORE', 'rospack_nosubdirs')
_NAME = re.compile(r'<name>\s*(\S+?)\s*</name>')


class PackageFolders:
    """
    The folders of packages that a file may name.

    A package is a folder with the name, or one whose ``package.xml`` has it: installed, in
    ``ROS_PACKAGE_PATH``, or above the file; else, as rospack finds it, anywhere below folders of
    ``ROS_PACKAGE_PATH`` or in the workspace of the file.

    :param file: that names them
    :param files: those that a request may read, of which none is looked for below folders
    """

    def __init__(self, file: Path, files: Files | None = None) -> None:
        self._file, self._requested = file, files is not None
        self._at = files or Files()
        self._known: dict[str, list[Path]] = {}
        self._below: list[tuple[str, Path]] | None = None
        self._within: dict[Path, list[Path]] = {}

    def find(self, package: str) -> list[Path]:
        """Return the folders that may be meant by the name of a package, the likeliest first."""
        if package not in self._known:
            self._known[package] = list(self._find(package))
        return self._known[package]

    def missing(self, package: str) -> tuple[str, str]:
        """Return a message that the package is missing, and a remedy."""
        return (f'package {quoted(package)} is neither in AMENT_PREFIX_PATH or ROS_PACKAGE_PATH '
                f'nor a folder above the file{self._at.rule}',
                f'source the workspace that has {quoted(package)}, or add its folder to '
                'ROS_PACKAGE_PATH')

    def file_in(self, folder: Path, rest: str) -> Path | None:
        """
        Return a file that a package installs in another place than where its sources have it.

        :param folder: of the sources
        :param rest: path of the file in the installed package
        :returns: the only file whose path ends as that does, or as its last two parts do
        """
        if self._requested or not (folder / 'package.xml').is_file():
            return None
        if folder not in self._within:
            self._within[folder] = list(_walk(folder, _DEPTH, set()))
        parts = Path(rest).parts
        places = [place for place in self._within[folder] if (place / parts[-1]).is_file()]
        for start in range(max(len(parts) - 1, 1)):
            ending = parts[start:-1]
            installed = [place / parts[-1] for place in places
                         if place.parts[len(place.parts) - len(ending):] == ending]
            if installed:
                return installed[0] if len(installed) == 1 else None
        return None

    def _find(self, package: str) -> Iterator[Path]:
        if package == PACKAGE:  # A URDF that was written here.
            yield share_directory()
            return
        folders = [Path(os.path.abspath(prefix)) / 'share' / package for prefix in
                   os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if prefix]
        for entry in _package_path():
            folders += [entry, entry / package]
        for folder in self._file.resolve().parents:
            folders += [folder, folder / package]
        named = [folder for folder in folders if self._at.is_folder(folder)
                 and (folder.name == package or _own_name(folder, self._at) == package)]
        yield from named
        if not named and not self._requested:  # A request could ask for any number of names.
            yield from self._crawled(package)

    def _crawled(self, package: str) -> list[Path]:
        if self._below is None:
            seen: set[str] = set()
            above = list(self._file.resolve().parents[:_LEVELS])
            near = self._levels_of_workspace(above)
            tops = [*((folder, _DEPTH) for folder in (*_package_path(), *above[:near])),
                    *((folder, 1) for folder in above[near:])]
            # Folders near the file come before the rest, and none is visited twice.
            folders = (folder for top, depth in tops for folder in _walk(top, depth, seen))
            self._below = [(name, folder) for folder in islice(folders, _MAX_FOLDERS)
                           if (name := _own_name(folder, self._at)) is not None]
        matches = [folder for name, folder in self._below if name == package]
        if matches:
            logging.getLogger(__name__).info('package %s is %s', package, matches[0])
        return matches

    def _levels_of_workspace(self, above: list[Path]) -> int:
        """Return how many of the folders above the file are likely to be of its workspace."""
        packages = [number for number, folder in enumerate(above)
                    if _own_name(folder, self._at) is not None]
        # Packages are in a repository, often in a folder of it, and that beside others.
        levels = packages[0] + 3 if packages else 2
        sources = [number + 1 for number, folder in enumerate(above)
                   if folder.name == 'src' or (folder / '.git').exists()]
        # Below these is everything of a user or of the machine.
        too_high = [number for number, folder in enumerate(above)
                    if len(folder.parts) <= 2 or folder == Path.home()]
        return min([max([levels, *sources]), *too_high])


def _package_path() -> list[Path]:
    # Of a relative path, xacro would look beside the file that includes another.
    return [Path(os.path.abspath(entry))
            for entry in os.environ.get('ROS_PACKAGE_PATH', '').split(os.pathsep) if entry]


def _walk(top: Path, depth: int, seen: set[str]) -> Iterator[Path]:
    """
    Yield a folder and those below it, the highest first, but hidden and ignored ones.

    :param seen: real paths of folders that are left out; those that are yielded are added
    """
    queue = deque([(top, 0)])
    while queue:
        folder, level = queue.popleft()
        real = os.path.realpath(folder)
        if real in seen:
            continue
        seen.add(real)
        try:
            names = sorted(entry.name for entry in os.scandir(folder))
        except OSError:  # It is not a folder, or may not be read.
            continue
        if any(name in _IGNORED for name in names):
            continue
        yield folder
        if level < depth:
            queue += [(folder / name, level + 1) for name in names if not name.startswith('.')]


def _own_name(folder: Path, files: Files) -> str | None:
    """Return the name in the manifest of a package, or that of the folder of a rosbuild one."""
    manifest = folder / 'package.xml'
    try:
        if not files.is_file(manifest):
            return folder.name if files.is_file(folder / 'manifest.xml') else None
        match = _NAME.search(
            files.read(manifest, 'package manifest').decode('utf-8'))
    except (ModelError, UnicodeDecodeError):
        return None
    return match[1] if match else None


_MESHES = ('.stl', '.obj', '.msh')
_PACKAGE = re.compile(r'(?:package|model)://([^/]+)/(.+)')
#: Begin of a name without a package.
_NO_PACKAGE = 'package:///'
_CONVERTIBLE = ('.dae', '.glb', '.gltf', '.ply', '.off')
_MAX_MESH_BYTES = 200_000_000
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
    if (any(item.kind == 'collision shape' for item in lost)
            and robot.find('link/collision') is None):
        unseen = '' if robot.find('link/visual') is not None else ', and it cannot be seen'
        said.append(f'no collision shape is left in {file}: nothing touches it{unseen}')
    return [LostShape(sentence) for sentence in said] if expected else said


def _read(mesh: Path, files: Files | None) -> Path:
    """
    Return a mesh, or one of its stem or its content in a format that MuJoCo reads.

    :raises MissingMeshError: if there is none
    """
    file = _readable(mesh, files or Files()) or mesh
    if files is not None:
        try:
            files.read(file, 'mesh file')
            check_suffix('mesh', file)
        except ModelError as error:
            raise MissingMeshError(str(error)) from error
        return file
    check_fetched(file)
    if file.suffix.lower() in _MESHES:
        return file
    if file.suffix.lower() not in _CONVERTIBLE:
        raise MissingMeshError(f'not one of {", ".join((*_MESHES, *_CONVERTIBLE))}',
                               'convert it to STL or OBJ')
    made, why = _converted(file)
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
        if mesh.stat().st_size > _MAX_MESH_BYTES:
            return None, f'it is larger than {_MAX_MESH_BYTES // 1_000_000} MB'
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
