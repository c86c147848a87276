# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The files that a spec refers to: meshes, textures, height fields and skins.

Shapes whose files are missing or cannot be read are left out, and reported.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
import os
from pathlib import Path, PurePosixPath
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.spec_edits import delete_elements
from manip_sim.models.user_files import check_file, Files, read_file
from manip_sim.models.xml_model import AssetFolders, XmlModel
from manip_sim.quoting import one_line, pluralize, quoted

#: Types of files that a request may name.
SPAWNED_SUFFIXES = {'mesh': ('.obj', '.stl'), 'texture': ('.png',)}
#: First line of a file in a clone of a repository whose large files were not fetched.
_POINTER = b'version https://git-lfs'


class LostShape(str):
    """A sentence about what a model lost with a missing file, which is logged as a warning."""

    __slots__ = ()


class MissingAssetError(ModelError):
    """A mesh or texture of something that is spawned is not there."""


class UnsupportedAssetError(ModelError):
    """A mesh or texture is of a type that cannot be spawned."""


class MissingMeshError(Exception):
    """
    A mesh is missing or cannot be read.

    :param remedy: what to do, or empty
    :param cause: the same for all meshes that this remedies together
    """

    def __init__(self, why: str, remedy: str = '', cause: str = '') -> None:
        super().__init__(why)
        self.why, self.remedy, self.cause = why, remedy, cause


@dataclass(frozen=True)
class Lost:
    """
    A shape or texture that was left out.

    :ivar kind: ``visual shape``, ``collision shape``, ``texture`` or ``skin``
    :ivar mesh: name of its file
    :ivar element: the element that has it, such as ``link 'base'``
    """

    kind: str
    mesh: str
    element: str
    error: MissingMeshError


def check_fetched(mesh: Path) -> None:
    """
    Check that a file is there whole.

    :raises MissingMeshError: if it is not, or only says where Git's large file storage has it
    """
    if not mesh.exists():
        raise MissingMeshError(f'no such file: {mesh}', 'put it there, or correct its name',
                               'file')
    try:
        with mesh.open('rb') as stream:
            is_pointer = stream.read(len(_POINTER)) == _POINTER
    except OSError:
        return  # Whoever reads it tells why.
    if is_pointer:
        raise MissingMeshError(f'{mesh} was not fetched from Git LFS',
                               f"run 'git lfs pull' in {mesh.parent}", 'lfs')


def warnings_of(every: Iterable[Lost], file: Path) -> list[str]:
    """Return a sentence for each kind and cause."""
    groups: dict[tuple[str, str], list[Lost]] = {}
    for lost in every:
        groups.setdefault((lost.kind, lost.error.cause), []).append(lost)
    sentences = []
    # Lost collision shapes change what happens, so they come first.
    for (kind, _), group in sorted(groups.items(), key=lambda item: item[0][0]):
        first = group[0]
        untouched = '; nothing touches these links there' if kind == 'collision shape' else ''
        remedy = f'; {first.error.remedy}' if first.error.remedy else ''
        sentences.append(f'left out: {pluralize(len(group), kind)} of files that cannot be '
                         f'read, such as {quoted(first.mesh)} ({first.error.why}) of '
                         f'{first.element} in {file}{untouched}{remedy}')
    return sentences


#: Of a link whose shape is missing: density [kg/m^3], thickness over length, the range of its
#: length, and its length where nothing is known of it [m].
_DENSITY, _SLENDERNESS, _LENGTHS_M, _LENGTH_M = 1000.0, 0.25, (0.01, 1.0), 0.1
_NAMED_MASSES = 3

#: Causes of missing files, by kind of the file and name of the element that names it.
Missing = Mapping[tuple[str, str], MissingMeshError]


def skip_missing(spec: mujoco.MjSpec, missing: Missing, file: Path) -> list[str]:
    """
    Delete shapes, textures, height fields and skins whose files are missing.

    A body whose mass follows from nothing else has that of a box of water, as long as the body is
    to its farthest child, and a quarter as thick.

    :returns: a :class:`LostShape` for each kind and cause, and for the masses
    """
    if not missing:
        return []
    infer_inertias_once(spec)
    geoms = [(geom, error) for geom in spec.geoms if (
        error := missing.get(('mesh', geom.meshname))
        or missing.get(('height field', geom.hfieldname)))]
    masses = [_give_mass(body, [geom for geom, _ in geoms if geom.parent == body])
              for body in spec.bodies[1:] if _lacks_mass(body, geoms)]
    lost = [Lost(f'{"collision" if geom.contype or geom.conaffinity else "visual"} shape',
                 geom.meshname or geom.hfieldname, f'body {quoted(geom.parent.name)}', error)
            for geom, error in geoms]
    delete_elements(spec, [geom for geom, _ in geoms])
    for kind, elements in (('mesh', spec.meshes), ('height field', spec.hfields),
                           ('texture', spec.textures), ('skin', spec.skins)):
        for element in list(elements):
            error = missing.get((kind, element.name))
            if error is None:
                continue
            if kind in ('texture', 'skin'):
                lost.append(Lost(kind, element.name, 'the model', error))
            if kind == 'texture':  # Materials have their own colour in place of it.
                for material in spec.materials:
                    for role, name in enumerate(list(material.textures)):
                        if name == element.name:
                            material.textures[role] = ''
            spec.delete(element)
    return [*map(LostShape, warnings_of(lost, file)), *_mass_notes(masses, file)]


def infer_inertias_once(spec: mujoco.MjSpec) -> None:
    """
    Let masses come from shapes where a file says so for all bodies, whatever else it says of them.

    With ``inertiafromgeom`` true, MuJoCo compiles no model whose visual shapes are left out.
    """
    if int(spec.compiler.inertiafromgeom) == int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE):
        for body in spec.bodies:
            body.explicitinertial, body.ipos = False, [np.nan] * 3
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO


def _lacks_mass(body: Any, lost: list[tuple[Any, MissingMeshError]]) -> bool:
    """Return whether the mass of a body follows from lost shapes only."""
    shapes = [geom for geom, _ in lost if geom.parent == body and _weighs(geom)]
    left = [geom for geom in body.geoms if _weighs(geom)]
    return bool(shapes) and len(shapes) == len(left) and not body.explicitinertial


def _weighs(geom: Any) -> bool:
    return bool(geom.mass != 0.0 and geom.density != 0.0)


def _give_mass(body: Any, lost: list[Any]) -> tuple[str, float]:
    """Give a body a mass, and return its name and the mass [kg]."""
    ends: list[FloatArray] = [np.array(child.pos) for child in body.bodies]
    end = max(ends, key=lambda pos: float(np.linalg.norm(pos)), default=np.zeros(3))
    length = float(np.linalg.norm(end)) or float(np.linalg.norm(body.pos)) or _LENGTH_M
    length = float(np.clip(length, *_LENGTHS_M))
    masses = [geom.mass for geom in lost if geom.mass > 0.0]
    mass = float(sum(masses)) or _DENSITY * length * (_SLENDERNESS * length)**2
    body.mass, body.ipos = mass, end / 2.0
    body.inertia = [mass * length**2 / 12.0] * 3
    body.explicitinertial = True
    return str(body.name), mass


def _mass_notes(masses: list[tuple[str, float]], file: Path) -> list[str]:
    """Return which bodies have a guessed mass, in a sentence."""
    named = ', '.join(f'{quoted(name)} {mass:.3g} kg' for name, mass in masses[:_NAMED_MASSES])
    more = f' and {len(masses) - _NAMED_MASSES} more' if len(masses) > _NAMED_MASSES else ''
    return [LostShape(
        f'guessed: the mass of {pluralize(len(masses), "body")} of {file} from the distance to '
        f'the next one, as it followed from missing meshes: {named}{more}; put the meshes there, '
        'or give these bodies an <inertial>')] if masses else []


def check_suffix(kind: str, file: Path) -> None:
    """
    Check that a file is of a type that can be spawned.

    :param kind: ``mesh`` or ``texture``
    :raises UnsupportedAssetError: if it is not
    """
    if file.suffix.lower() not in SPAWNED_SUFFIXES.get(kind, ()):
        raise UnsupportedAssetError(
            f'{kind} file {one_line(str(file))} has a type that cannot be spawned; these types '
            f'can: {", ".join(sum(SPAWNED_SUFFIXES.values(), ()))}')


@dataclass
class Reference:
    """
    A file that an element of a spec names.

    :ivar kind: ``mesh``, ``texture``, ``height field`` or ``skin``
    """

    kind: str
    _element: Any
    #: Number among the six images of a cube texture; None for any other file.
    _side: int | None = None

    @property
    def file(self) -> str:
        """The file, as the element names it."""
        if self._side is None:
            return str(self._element.file)
        return str(self._element.cubefiles[self._side])

    def set_file(self, file: str) -> None:
        """Make the element name another file."""
        if self._side is None:
            self._element.file = file
        else:
            self._element.cubefiles[self._side] = file

    @property
    def element_name(self) -> str:
        """Name of the element, which may be empty."""
        return str(self._element.name)


def references(spec: mujoco.MjSpec) -> Iterator[Reference]:
    """Yield the files that meshes, height fields, textures and skins of a spec name."""
    for kind, elements in (('mesh', spec.meshes), ('height field', spec.hfields),
                           ('texture', spec.textures), ('skin', spec.skins)):
        for element in elements:
            sides = range(len(element.cubefiles)) if kind == 'texture' else ()
            for reference in (Reference(kind, element),
                              *(Reference(kind, element, side) for side in sides)):
                if reference.file:
                    yield reference


def resolve_files(spec: mujoco.MjSpec, file: Path, model: XmlModel | None = None,
                  missing: dict[tuple[str, str], MissingMeshError] | None = None) -> None:
    """
    Make a spec name its files by absolute paths, so that it can be composed and written anywhere.

    Files that :attr:`spec.assets` holds stay as they are.

    :param file: the file that the spec was loaded from
    :param model: its tree; None: the spec has been resolved before
    :param missing: is given why files are missing, by their kind and the name of the element;
        None: that is an error
    :raises ModelError: if a file is missing, not regular or not readable
    """
    folders = [AssetFolders(file.parent, spec.meshdir, spec.texturedir)]
    if model is not None:
        folders += model.folders[1:]
    base_name_too = bool(spec.strippath) or (model is not None and model.is_urdf)
    for reference in references(spec):
        if os.path.isabs(reference.file) and model is None:
            continue
        if _is_held(spec, reference):
            continue
        path = _find(reference, folders, base_name_too)
        if missing is not None:
            try:
                check_fetched(path)
            except MissingMeshError as error:
                missing[reference.kind, reference.element_name] = error
                continue
        check_file(path, f'{reference.kind} file')
        reference.set_file(path.as_posix())
    spec.strippath = False
    if model is None and spec.assets:
        # When a spec that holds some files is attached, MuJoCo renames the others too and loses
        # them.
        spec.assets = {**spec.assets, **{
            reference.file: read_file(Path(reference.file), f'{reference.kind} file')
            for reference in references(spec) if not _is_held(spec, reference)}}


def _is_held(spec: mujoco.MjSpec, reference: Reference) -> bool:
    held = spec.assets
    if not held:
        return False
    folder = spec.texturedir if reference.kind == 'texture' else spec.meshdir
    return reference.file in held or str(PurePosixPath(folder, reference.file)) in held


def _find(reference: Reference, folders: list[AssetFolders], base_name_too: bool) -> Path:
    """Return the first place where the file exists, or the first place if it is in none."""
    name = reference.file
    names = [name, PurePosixPath(name).name] if base_name_too else [name]
    fitting = [f for f in folders if reference.element_name.startswith(f.prefix)]
    own_first = sorted(fitting, key=lambda folder: -len(folder.prefix))
    return Files().first([place for folder in own_first for each in names
                          for place in places(reference.kind, each, folder)])


def places(kind: str, name: str, folder: AssetFolders) -> Iterator[Path]:
    """Yield where a file may be that an element names, the likeliest first."""
    root = Path(os.path.abspath(folder.folder))
    scheme, separator, rest = name.partition('://')
    if separator and scheme == 'file':
        yield Path(rest)
    elif separator:  # A ROS package is a folder of that name above the model.
        package, _, path = rest.partition('/')
        for parent in (root, *root.parents):
            if parent.name == package:
                yield parent / path
            if (parent / package).is_dir():
                yield parent / package / path
        name = rest
    directory = folder.texturedir if kind == 'texture' else folder.meshdir
    yield Path(os.path.normpath(root / directory / name))
