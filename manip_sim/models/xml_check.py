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
from xml.etree import ElementTree
from xml.parsers import expat

from manip_sim.errors import ModelError
from manip_sim.models.regular_files import Files
from manip_sim.models.xml_limits import Budget, excess, flex_vertices, LIMITED, product
from manip_sim.quoting import one_line, quoted

#: The elements that name files, or say where they are.
_FOLLOWED = frozenset(('include', 'model', 'attach', 'compiler', 'mesh'))


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
    model = XmlModel(file, Budget())
    return XmlFacts(model.root == 'robot', model.folders, model.mesh_files)


class XmlModel:
    """
    One model: its file and all that it includes; models that it attaches have their own.

    :param file: MJCF or URDF
    :param budget: what its files may still use
    :param loaded_by: the files of models that are being loaded, the outermost first
    :param files: those that it may be loaded from
    :param keep_tree: whether to keep :attr:`tree`
    :raises ModelError: naming file and line
    :ivar root: tag of its root element, ``mujoco`` or ``robot``
    :ivar elements: how many there are, copies included
    :ivar folders: of the model, then of the models that are attached to it
    :ivar mesh_files: names of mesh files in a URDF, by the last part of the name
    :ivar models: the models that it loads, by the name of the file in the element ``model``
    """

    def __init__(self, file: Path, budget: Budget, loaded_by: tuple[Path, ...] = (),
                 files: Files | None = None, keep_tree: bool = False) -> None:
        self.root = self.name = ''
        self.elements = 0
        self.models: dict[str, XmlModel] = {}
        self._files = files or Files()
        self._builder = ElementTree.TreeBuilder() if keep_tree else None
        #: For each open element, whether the tree gets it.
        self._kept: list[bool] = []
        self._includes = False
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
        self._by_name: dict[str, XmlModel] = {}
        self._attached: list[tuple[str, str, int]] = []
        self._read(file, 'model file' if loaded_by else 'MJCF file')
        for attached in self._attached:
            self._count_attached(*attached)

    @property
    def tree(self) -> ElementTree.Element:
        """The root element, with what included files hold in place of the includes."""
        assert self._builder is not None
        return self._builder.close()

    def _read(self, file: Path, kind: str) -> None:
        limits = self._budget.limits
        data = self._files.read(file, kind, limits.bytes)
        real = Path(os.path.realpath(file))
        if real in self._chain:
            loop = [*self._chain[self._chain.index(real):], real]
            raise ModelError(f'{one_line(str(self._file))} is loaded into itself: '
                             + one_line(' > '.join(path.name for path in loop)))
        self._budget.bytes -= len(data)
        self._budget.files -= 1
        if min(self._budget.bytes, self._budget.files, limits.depth - len(self._chain)) < 0:
            raise ModelError(f'{one_line(str(self._file))} is loaded from more than '
                             f'{limits.files} files, {limits.bytes / 1e6:.0f} MB of XML, or files '
                             f'that are loaded by others {limits.depth} deep')
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start if self._builder is None else self._keep
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
        if tag in LIMITED:
            self._count_vertices(times * flex_vertices(tag, attributes))
            self._check_numbers(tag, attributes)
        if tag in _FOLLOWED:
            self._follow(tag, attributes)

    def _keep(self, tag: str, attributes: dict[str, str]) -> None:
        assert self._builder is not None
        if not self.root:
            self._begin(tag, attributes)
        limits = self._budget.limits
        if self.elements >= limits.elements or len(self._kept) >= limits.nested:
            raise ModelError(f'{self._place}: a model may have at most {limits.elements} '
                             f'elements, {limits.nested} in each other')
        # What is in the root of an included file takes the place of the include.
        is_included_root, self._includes = self._includes, False
        self._kept.append(
            not is_included_root and not (tag == 'include' and bool(attributes.get('file'))))
        if self._kept[-1]:
            self._builder.start(tag, attributes)
        self._start(tag, attributes)

    def _end(self, tag: str) -> None:
        self._times.pop()
        if self._builder is not None and self._kept.pop():
            self._builder.end(tag)

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
                found = f'the number of keyframes is more than {self._budget.limits.keys}'
        if found:
            raise ModelError(f'{self._place}: {found}')

    def _follow(self, tag: str, attributes: dict[str, str]) -> None:
        file = attributes.get('file', '')
        if tag == 'include' and file:
            self._include(file)
        elif tag == 'model':
            if not file:
                # After it MuJoCo hangs when it attaches another spec.
                raise ModelError(f'{self._place}: <model> needs a file')
            model = XmlModel(self._file.parent / file, self._budget, tuple(self._chain),
                             self._files, self._builder is not None)
            self._by_name[attributes.get('name', model.name)] = self.models[file] = model
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
        self._includes = True
        self._read(self._files.first(places), 'included file')

    def _count_attached(self, name: str, prefix: str, times: int) -> None:
        model = self._by_name.get(name)
        if model is None:
            return  # MuJoCo reports it.
        self.elements += times * model.elements
        self._make((times - 1) * model.elements)
        self.folders += [AssetFolders(f.folder, f.meshdir, f.texturedir, prefix + f.prefix)
                         for f in model.folders]

    def _count_vertices(self, count: int) -> None:
        self._budget.flex -= count
        if self._budget.flex < 0:
            raise ModelError(f'{self._place}: flexes with more than {self._budget.limits.flex} '
                             'vertices take MuJoCo too long')

    def _make(self, count: int) -> None:
        self._budget.made -= count
        if self._budget.made < 0:
            where = self._place if self._parsers else one_line(str(self._file))
            raise ModelError(f'{where}: elements that make several, such as replicate, would make '
                             f'more than {self._budget.limits.made}')
