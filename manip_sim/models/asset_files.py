# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The files that a spec refers to: meshes, textures, height fields and skins."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
import os
from pathlib import Path, PurePosixPath
import struct
from typing import Any

import mujoco

from manip_sim.errors import ModelError
from manip_sim.models.missing_meshes import check_fetched, MissingMeshError
from manip_sim.models.regular_files import check_file, Files, read_file
from manip_sim.models.xml_check import AssetFolders, XmlModel
from manip_sim.quoting import one_line

#: Greatest size of a file [bytes].
MAX_FILE_BYTES = 20_000_000
#: Greatest number of faces of a mesh, and of pixels of an image.
MAX_FACES, MAX_PIXELS = 100_000, 4096**2
_PNG_SIGNATURE = b'\x89PNG\r\n\x1a\n'
_STL_HEADER_BYTES, _STL_FACE_BYTES = 84, 50
_OBJ_WORDS = (b'v', b'vt', b'vn', b'vp', b'f', b'g', b'o', b's', b'l', b'p', b'mtllib', b'usemtl')
_MAX_CORNERS = 100
#: Largest file [bytes]; a mesh of this size takes MuJoCo half a minute and 1.5 GB.
MAX_ASSET_BYTES = 50_000_000
#: Largest image [pixels]; a pixel of a height field takes 16 bytes, one of a texture 6.
_MAX_PIXELS = {'texture': 120_000_000, 'height field': 16_000_000}


def check_content(kind: str, suffix: str, content: bytes, name: str) -> None:
    """
    Check that a file is what its suffix says, and not too much work.

    :param kind: ``mesh`` or ``texture``
    :param suffix: of the file, in lower case
    :raises ModelError: if there is anything else in it, or too many faces or pixels
    """
    checks = _CHECKS.get(kind, {})
    where = f'{kind} file {one_line(name)}'
    if suffix not in checks:
        raise ModelError(f'{where} has a type that cannot be spawned; these types can: '
                         + ', '.join(known for each in _CHECKS.values() for known in each))
    problem = checks[suffix](content)
    if problem:
        raise ModelError(f'{where} {problem}')


def png_pixels(head: bytes) -> tuple[int, int] | None:
    """
    Return width and height of a PNG image; None if it is something else.

    :param head: its first 24 bytes or more
    """
    if not head.startswith(_PNG_SIGNATURE) or head[12:16] != b'IHDR' or len(head) < 24:
        return None
    width, height = struct.unpack('>II', head[16:24])
    return width, height


def _png(content: bytes) -> str:
    size = png_pixels(content)
    if size is None:
        return 'is not a PNG image'
    if size[0] * size[1] > MAX_PIXELS:
        return f'has {size[0]} times {size[1]} pixels, and at most {MAX_PIXELS} can be spawned'
    return ''


def _stl(content: bytes) -> str:
    faces = int.from_bytes(content[80:_STL_HEADER_BYTES], 'little')
    if faces > MAX_FACES:
        return _too_many_faces(faces)
    if len(content) != _STL_HEADER_BYTES + faces * _STL_FACE_BYTES or not faces:
        return 'is not a binary STL: its size does not fit the number of faces in its header'
    return ''


def _obj(content: bytes) -> str:
    faces = 0
    for number, line in enumerate(content.splitlines(), start=1):
        words = line.split(maxsplit=1)
        if not words or words[0].startswith(b'#'):
            continue
        if words[0] not in _OBJ_WORDS or not line.isascii():
            return f'is not an OBJ: line {number} is none of that format'
        if words[0] == b'f':
            corners = len(line.split()) - 1
            if corners > _MAX_CORNERS:
                return (f'has a face of {corners} corners in line {number}, and at most '
                        f'{_MAX_CORNERS} can be spawned')
            faces += max(corners - 2, 1)
            if faces > MAX_FACES:
                return _too_many_faces(faces)
    return ''


def _too_many_faces(faces: int) -> str:
    return f'has {faces} faces or more, and at most {MAX_FACES} can be spawned'


_CHECKS: dict[str, dict[str, Callable[[bytes], str]]] = {
    'mesh': {'.stl': _stl, '.obj': _obj}, 'texture': {'.png': _png}}


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
    :param model: what ``check_xml`` read of it; None: the spec has been resolved before
    :param missing: is given why files are missing, by their kind and the name of the element;
        None: that is an error
    :raises ModelError: if a file is missing, not regular, too large or not readable
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
        path = _find(reference, folders, model, base_name_too)
        if missing is not None:
            try:
                check_fetched(path)
            except MissingMeshError as error:
                missing[reference.kind, reference.element_name] = error
                continue
        check_file(path, f'{reference.kind} file', MAX_ASSET_BYTES)
        check_image(path, reference.kind)
        reference.set_file(path.as_posix())
    spec.strippath = False
    if model is None and spec.assets:
        _hold_all(spec)


def _hold_all(spec: mujoco.MjSpec) -> None:
    # When a spec that holds some files is attached, MuJoCo renames the others too and loses them.
    held = dict(spec.assets)
    for reference in references(spec):
        if not _is_held(spec, reference):
            kind = f'{reference.kind} file'
            held[reference.file] = read_file(Path(reference.file), kind, MAX_ASSET_BYTES)
    spec.assets = held


def _is_held(spec: mujoco.MjSpec, reference: Reference) -> bool:
    held = spec.assets
    if not held:
        return False
    folder = spec.texturedir if reference.kind == 'texture' else spec.meshdir
    return reference.file in held or str(PurePosixPath(folder, reference.file)) in held


def _find(reference: Reference, folders: list[AssetFolders], model: XmlModel | None,
          base_name_too: bool) -> Path:
    """Return the first place where the file exists, or the first place if it is in none."""
    name = reference.file
    if model is not None and model.is_urdf:
        # Some versions of MuJoCo keep only the last part of the path.
        name = model.mesh_files.get(name.rpartition('/')[2], name)
    names = [name, PurePosixPath(name).name] if base_name_too else [name]
    return Files().first([place for folder in _own_first(reference, folders) for each in names
                          for place in places(reference.kind, each, folder)])


def _own_first(reference: Reference, folders: list[AssetFolders]) -> list[AssetFolders]:
    fitting = [f for f in folders if reference.element_name.startswith(f.prefix)]
    return sorted(fitting, key=lambda folder: -len(folder.prefix))


def places(kind: str, name: str, folder: AssetFolders) -> Iterator[Path]:
    """
    Yield where a file may be that an element names, the likeliest first.

    :param name: a path or URI
    """
    root = Path(os.path.abspath(folder.folder))
    scheme, separator, rest = name.partition('://')
    if separator and scheme == 'file':
        yield Path(rest)
    elif separator:
        yield from _places_of_package(root, rest)
        name = rest
    directory = folder.texturedir if kind == 'texture' else folder.meshdir
    yield Path(os.path.normpath(root / directory / name))


def _places_of_package(root: Path, name: str) -> Iterator[Path]:
    """Return where a file of a ROS package may be: in the folder of that name above the model."""
    package, _, rest = name.partition('/')
    for parent in (root, *root.parents):
        if parent.name == package:
            yield parent / rest
        if (parent / package).is_dir():
            yield parent / package / rest


def check_image(path: Path, kind: str) -> None:
    """
    Check that an image is not too large to be loaded.

    :param kind: ``texture`` or ``height field``; others are not looked at
    """
    most = _MAX_PIXELS.get(kind)
    if most is None:
        return
    with path.open('rb') as stream:
        header = stream.read(24)
    size = png_pixels(header)
    if size is not None and size[0] * size[1] > most:
        raise ModelError(f'{kind} file {one_line(str(path))} has {size[0]} times {size[1]} '
                         f'pixels, and at most {most} are loaded')
