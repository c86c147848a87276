# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Check a model's XML files before MuJoCo reads them, which cannot be interrupted.

A model that is loaded into itself, or a line that makes a billion geoms, would crash the process
or exhaust the memory.
"""

from __future__ import annotations

from dataclasses import dataclass
import os
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from manip_sim.errors import ModelError
from manip_sim.models.regular_files import read_file
from manip_sim.models.xml_limits import (
    Budget, excess, MAX_BYTES, MAX_DEPTH, MAX_FILES, MAX_KEYS, MAX_MADE, product)
from manip_sim.quoting import one_line, quoted


@dataclass
class AssetFolders:
    """
    The folders in which a model looks for asset files with relative names.

    :ivar folder: of the model's file
    :ivar meshdir: of its compiler settings, as ``texturedir``
    :ivar prefix: of its elements, if an ``attach`` element adds them, else empty
    """

    folder: Path
    meshdir: str = ''
    texturedir: str = ''
    prefix: str = ''


@dataclass
class XmlFacts:
    """
    What the XML files of a model say of its asset files.

    :ivar is_urdf: whether it is URDF, not MJCF
    :ivar folders: of the model, then of the models that are attached to it
    :ivar mesh_files: names of mesh files in a URDF, by the last part of the name
    """

    is_urdf: bool
    folders: list[AssetFolders]
    mesh_files: dict[str, str]


def check_xml(file: Path) -> XmlFacts:
    """
    Read all XML files of a model, and reject what could crash the process.

    :param file: MJCF or URDF
    :raises ModelError: naming file and line
    """
    model = _Model(file, Budget(), ())
    return XmlFacts(model.root == 'robot', model.folders, model.mesh_files)


class _Model:
    """One model: its file and all that it includes; models that it attaches have their own."""

    def __init__(self, file: Path, budget: Budget, loaded_by: tuple[Path, ...]) -> None:
        self.root = self.name = ''
        self.elements = 0
        self.mesh_files: dict[str, str] = {}
        self.folders = [AssetFolders(file.parent)]
        self._file = file
        self._budget = budget
        #: How the current file is reached: the files of models that are being loaded, the
        #: outermost first, then those that include each other, down to the current one.
        self._chain = list(loaded_by)
        self._parsers: list[expat.XMLParserType] = []
        #: Number of copies that are made of each open element.
        self._times = [1]
        self._models: dict[str, _Model] = {}
        self._attached: list[tuple[str, str, int]] = []
        self._read(file, 'model file' if loaded_by else 'MJCF file')
        for attached in self._attached:
            self._count_attached(*attached)

    def _read(self, file: Path, kind: str) -> None:
        data = read_file(file, kind, MAX_BYTES)
        real = Path(os.path.realpath(file))
        if real in self._chain:
            loop = [*self._chain[self._chain.index(real):], real]
            raise ModelError(f'{one_line(str(self._file))} is loaded into itself: '
                             + one_line(' > '.join(path.name for path in loop)))
        self._budget.bytes -= len(data)
        self._budget.files -= 1
        if min(self._budget.bytes, self._budget.files, MAX_DEPTH - len(self._chain)) < 0:
            raise ModelError(f'{one_line(str(self._file))} is loaded from more than {MAX_FILES} '
                             f'files, {MAX_BYTES / 1e6:.0f} MB of XML, or files that are loaded '
                             f'by others {MAX_DEPTH} deep')
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.EntityDeclHandler = self._reject_entities
        self._chain.append(real)
        self._parsers.append(parser)
        try:
            parser.Parse(data, True)
        except (expat.ExpatError, LookupError) as error:
            raise ModelError(f'{one_line(str(file))} is not well-formed XML: {error}') from error
        self._parsers.pop()
        self._chain.pop()

    @property
    def _place(self) -> str:
        line = self._parsers[-1].CurrentLineNumber
        return f'{one_line(str(self._chain[-1]))}, line {line}'

    def _reject_entities(self, name: str, *_: object) -> NoReturn:
        raise ModelError(f'{self._place}: the entity {quoted(name)} is declared; models must not '
                         'declare any')

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        if not self.root:
            self._begin(tag, attributes)
        times = self._times[-1]
        self.elements += times
        if times > 1:
            self._make(times)
        if tag == 'replicate':
            times *= product(attributes, 'count')
        elif tag in ('composite', 'flexcomp'):
            self._make(times * product(attributes, 'count'))
        self._times.append(times)
        self._check_numbers(tag, attributes)
        self._follow(tag, attributes)

    def _end(self, tag: str) -> None:
        self._times.pop()

    def _begin(self, tag: str, attributes: dict[str, str]) -> None:
        if tag not in ('mujoco', 'robot'):
            raise ModelError(f'{one_line(str(self._file))} is not a model: its root element is '
                             f'<{tag[:60]}>, that of MJCF is <mujoco>, that of URDF is <robot>')
        self.root = tag
        self.name = attributes.get('model', '')

    def _check_numbers(self, tag: str, attributes: dict[str, str]) -> None:
        found = excess(tag, attributes)
        if tag == 'key':
            self._budget.keys -= 1
            if self._budget.keys < 0:
                found = f'the number of keyframes is more than {MAX_KEYS}'
        if found:
            raise ModelError(f'{self._place}: {found}')

    def _follow(self, tag: str, attributes: dict[str, str]) -> None:
        file = attributes.get('file', '')
        if tag == 'include' and file:
            self._include(file)
        elif tag == 'model' and file:
            model = _Model(self._file.parent / file, self._budget, tuple(self._chain))
            self._models[attributes.get('name', model.name)] = model
        elif tag == 'attach':
            self._attached.append((attributes.get('model', ''), attributes.get('prefix', ''),
                                   self._times[-1]))
        elif tag == 'compiler':
            own = self.folders[0]
            directory = attributes.get('assetdir')
            own.meshdir = attributes.get('meshdir', directory or own.meshdir)
            own.texturedir = attributes.get('texturedir', directory or own.texturedir)
        elif tag == 'mesh' and 'filename' in attributes:
            name = attributes['filename']
            self.mesh_files[name.rpartition('/')[2]] = name

    def _include(self, name: str) -> None:
        places = [self._file.parent / name, self._chain[-1].parent / name]
        self._read(next((place for place in places if os.path.exists(place)), places[0]),
                   'included file')

    def _count_attached(self, name: str, prefix: str, times: int) -> None:
        model = self._models.get(name)
        if model is None:
            return  # MuJoCo reports it.
        self.elements += times * model.elements
        self._make((times - 1) * model.elements)
        self.folders += [AssetFolders(f.folder, f.meshdir, f.texturedir, prefix + f.prefix)
                         for f in model.folders]

    def _make(self, count: int) -> None:
        self._budget.made -= count
        if self._budget.made < 0:
            where = self._place if self._parsers else one_line(str(self._file))
            raise ModelError(f'{where}: elements that make several, such as replicate, would make '
                             f'more than {MAX_MADE}')
