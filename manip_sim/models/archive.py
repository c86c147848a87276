# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Write a world to files that load elsewhere: MJCF with absolute paths, or MuJoCo's zip format.

The zip holds ``model.xml`` and ``assets/`` with the mesh, texture, height field and skin files
that it refers to (mujoco.readthedocs.io, Model Editing, "MJZ Archives").
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
import io
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
import zipfile

from manip_sim.errors import ModelError
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.robots import RobotModel
from manip_sim.models.world import World

_CUBE_FILES = ('fileright', 'fileleft', 'fileup', 'filedown', 'filefront', 'fileback')


@dataclass(frozen=True)
class FileReference:
    """
    A file that an element of a model refers to.

    :ivar kind: ``mesh``, ``texture``, ``hfield`` or ``skin``
    :ivar name: of the element in the composed model
    :ivar attribute: of the element in MJCF, such as ``file``
    :ivar path: where the file is looked for
    """

    kind: str
    name: str
    attribute: str
    path: Path


def file_references(spec: Any, prefix: str = '') -> Iterator[FileReference]:
    """
    Yield the files that a spec refers to, whether they are there or not.

    :param spec: a ``mujoco.MjSpec`` that was read from a file
    :param prefix: what the names begin with in the composed model
    """
    folder, compiler = Path(spec.modelfiledir), spec.compiler
    for kind, elements, within in (
            ('mesh', spec.meshes, compiler.meshdir), ('hfield', spec.hfields, compiler.meshdir),
            ('skin', spec.skins, compiler.meshdir),
            ('texture', spec.textures, compiler.texturedir)):
        for element in elements:
            files = {'file': element.file}
            if kind == 'texture':
                files.update(zip(_CUBE_FILES, element.cubefiles))
            for attribute, file in files.items():
                if file:
                    name = Path(file).name if spec.strippath else file
                    yield FileReference(kind, prefix + (element.name or Path(file).stem),
                                        attribute, folder / within / name)


def _references_of(world: World) -> dict[tuple[str, str, str], Path]:
    parts: list[MujocoXMLModel] = [world.arena]
    for robot in world.robots:
        parts += [robot, *robot.models] if isinstance(robot, RobotModel) else [robot]
    return {(r.kind, r.name, r.attribute): r.path for part in parts
            for r in file_references(part.spec, part.naming_prefix)}


def world_xml(world: World) -> str:
    """
    Return the MJCF of a world, with absolute paths of the files that it refers to.

    :raises ModelError: if the world does not compile, or it is not known where a file is
    """
    return _with_paths(world, lambda path: str(path.absolute()))


def write_archive(world: World, file: Path | io.BytesIO) -> int:
    """
    Write a world with all files that it refers to as a zip archive.

    ``mujoco.MjSpec.from_zip`` loads it; from MuJoCo 3.10 on so do ``MjSpec.from_file`` and the
    viewer.

    :param file: path of the file, overwritten, or a file object
    :returns: the number of files that travel along
    :raises ModelError: if the world does not compile, or a file is not there
    """
    inside: dict[Path, str] = {}

    def place(path: Path) -> str:
        if path not in inside:
            name, number = f'assets/{path.name}', 0
            while name in inside.values():
                number += 1
                name = f'assets/{number}_{path.name}'
            inside[path] = name
        return inside[path]

    xml = _with_paths(world, place)
    contents = {'model.xml': xml.encode(), **{n: _read(p) for p, n in inside.items()}}
    with zipfile.ZipFile(file, 'w') as archive:
        for name, content in contents.items():
            # An entry without a date, so that equal worlds make equal files.
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return len(inside)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ModelError(f'cannot read {path}: {error.strerror}') from error


def _with_paths(world: World, place: Callable[[Path], str]) -> str:
    xml = world.to_xml()
    references = _references_of(world)
    if not references:
        return xml
    root = ElementTree.fromstring(xml)
    for compiler in root.iter('compiler'):
        for attribute in ('meshdir', 'texturedir', 'assetdir', 'strippath'):
            compiler.attrib.pop(attribute, None)
    for kind in ('mesh', 'hfield', 'skin', 'texture'):
        for element in root.iter(kind):
            for attribute in ('file', *_CUBE_FILES):
                if element.get(attribute):
                    element.set(attribute, place(_path(references, element, attribute)))
    return ElementTree.tostring(root, encoding='unicode')


def _path(references: dict[tuple[str, str, str], Path], element: Any, attribute: str) -> Path:
    file = Path(element.get(attribute))
    name = element.get('name') or file.stem
    path = references.get((element.tag, name, attribute))
    if path is None and not file.is_absolute():
        raise ModelError(f"{element.tag} '{name}' refers to '{file}', and it is not known in "
                         'which folder that is')
    return path or file
