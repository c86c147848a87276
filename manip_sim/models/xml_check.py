# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Check a model's XML files before MuJoCo reads them, which cannot be interrupted.

A model that is loaded into itself, or a line that makes a billion geoms, would crash the process
or exhaust the memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import math
import os
from pathlib import Path
import re
import sys
from typing import NoReturn
from xml.etree import ElementTree
from xml.parsers import expat

from manip_sim.errors import ModelError
from manip_sim.models.regular_files import Files, InMemoryFile
from manip_sim.quoting import one_line, quoted

#: Number of keyframes, which MuJoCo takes long to remove.
MAX_KEYS = 1000
_MAX_USER = 1000
#: Largest products of the numbers in attributes, by element.
_MAX_PRODUCTS: Mapping[str, tuple[tuple[tuple[str, ...], float], ...]] = {
    'hfield': ((('nrow', 'ncol'), 4000**2),),
    'numeric': ((('size',), 1e6),),
    'size': ((('nkey',), MAX_KEYS), (('nuserdata',), 1e7), *(
        ((f'nuser_{kind}',), _MAX_USER) for kind in (
            'body', 'jnt', 'geom', 'site', 'cam', 'tendon', 'actuator', 'sensor')))}
#: The elements that :func:`excess` and :func:`flex_vertices` look at, and keyframes.
LIMITED = frozenset(
    ['mesh', 'texture', 'flexcomp', 'flex', 'key', *_MAX_PRODUCTS])
#: Larger textures and meshes take many seconds and gigabytes.
_MAX_PIXELS = 120_000_000
_MAX_MESH_PARAMETER = 500


@dataclass(frozen=True)
class Limits:
    """
    Limits of all files of a model together.

    :ivar files: that it is loaded from; one that is used twice counts twice
    :ivar depth: to which files may load each other
    :ivar made: bodies, geoms and so on that ``replicate``, ``composite`` and the like make
    :ivar flex: vertices of flexes, for which MuJoCo takes time that grows with their square
    :ivar keys: keyframes, which MuJoCo takes long to remove
    :ivar elements: of a model, copies included
    :ivar nested: depth to which these may be in each other
    """

    bytes: int = 50_000_000
    files: int = 1000
    depth: int = 50
    made: int = 20_000
    flex: int = 5000
    keys: int = MAX_KEYS
    elements: int = sys.maxsize
    nested: int = sys.maxsize


@dataclass
class Budget:
    """
    Remainder of the limits of a model; below zero it is spent.

    :ivar limits: what it was at the start
    """

    limits: Limits = Limits()

    def __post_init__(self) -> None:
        self.bytes, self.files = self.limits.bytes, self.limits.files
        self.made, self.keys = self.limits.made, self.limits.keys
        self.flex = self.limits.flex


def excess(tag: str, attributes: Mapping[str, str]) -> str:
    """
    Return which number in an element's attributes is too great.

    :returns: the excess in words; empty if there is none
    """
    for names, most in _MAX_PRODUCTS.get(tag, ()):
        if product(attributes, *names) > most:
            return _more(f'{" times ".join(names)} of {tag}', most)
    if tag == 'mesh' and max(_numbers(attributes, 'params'), default=0) > _MAX_MESH_PARAMETER:
        return _more('a parameter of a builtin mesh', _MAX_MESH_PARAMETER)
    if tag == 'texture':
        width, height = (product(attributes, name) for name in ('width', 'height'))
        if width * (height if attributes.get('type') == '2d' else 6 * width) > _MAX_PIXELS:
            return _more('the number of pixels of a texture', _MAX_PIXELS)
    return ''


def flex_vertices(tag: str, attributes: Mapping[str, str]) -> int:
    """Return how many vertices an element makes, but for those in a file."""
    if tag == 'flexcomp':
        return max(product(attributes, 'count'), len(attributes.get('point', '').split()) // 3)
    if tag == 'flex':
        return max(len(attributes.get('vertex', '').split()) // 3,
                   len(attributes.get('body', '').split()))
    return 0


def _more(what: str, most: float) -> str:
    return f'{what} is more than {most:g}'


def product(attributes: Mapping[str, str], *names: str) -> int:
    """
    Return the product of the numbers in attributes.

    :param names: of those to multiply; one that is missing or below 1 counts as 1
    :returns: the product, at most 1e15
    """
    result = math.prod(number if number > 1.0 else 1.0 for name in names
                       for number in _numbers(attributes, name))
    return int(min(result, 1e15))


def _numbers(attributes: Mapping[str, str], name: str) -> list[float]:
    try:
        return [float(word) for word in attributes.get(name, '').split()]
    except ValueError:
        return []  # MuJoCo reports it.


#: Signs that begin a tag for each element that is allowed: its own, its end, a comment.
_MAX_SIGNS = 3
#: The elements that name files, or say where they are.
_FOLLOWED = frozenset(('include', 'model', 'attach', 'compiler', 'mesh'))
_CHECKED = _FOLLOWED | LIMITED | {'composite'}
#: Comments that some old files have before the XML declaration.
_COMMENT, _BLANKS = re.compile(rb'<!--.*?-->', re.DOTALL), b' \t\r\n\xef\xbb\xbf'
#: The encoding that a document declares, and those that the parser reads by itself.
_ENCODING = re.compile(rb'(<\?xml\s[^>]*?\sencoding\s*=\s*["\'])([A-Za-z][\w.-]*)')
_NATIVE = (b'utf-8', b'utf-16', b'iso-8859-1', b'us-ascii')
#: An attribute that another one follows without a blank, and an ampersand that begins no entity.
_ATTRIBUTE = re.compile(rb'(=\s*(?:"[^"<]*"|\'[^\'<]*\'))(?=[A-Za-z_])')
_AMPERSAND = re.compile(rb'&(?!#?\w+;)')
#: A tag, and in it a value in quotes or an attribute whose value has none.
_TAG = re.compile(rb'<[A-Za-z_](?:"[^"]*"|\'[^\']*\'|[^"\'<>])*>')
_UNQUOTED = re.compile(rb'"[^"]*"|\'[^\']*\'|'
                       rb'(\s[A-Za-z_][\w:.-]*\s*=\s*)([^\s"\'<>=]+?)(?=\s|/?>)')


@dataclass
class AssetFolders:
    """
    The folders in which a model looks for asset files with relative names.

    :ivar meshdir: of its compiler settings, as ``texturedir``
    :ivar prefix: of its elements, if an ``attach`` element adds them, else empty
    """

    folder: Path
    meshdir: str = ''
    texturedir: str = ''
    prefix: str = ''


def check_xml(file: Path, traced: bool = False) -> XmlModel:
    """
    Read all XML files of a model, and reject what could crash the process.

    :param traced: keep the :attr:`XmlModel.origins`
    """
    return XmlModel(file, Budget(), traced=traced)


@dataclass
class _OpenFile:
    """A file that is looked through, and how many of its elements were looked at."""

    data: bytes
    looked_at: int = 0

    def line(self) -> int:
        """Return the line of the last of them; it is read again, since trees have no lines."""
        parser, lines = expat.ParserCreate(), []
        parser.StartElementHandler = lambda *_: lines.append(parser.CurrentLineNumber)
        parser.Parse(self.data, True)
        return lines[self.looked_at - 1]


class XmlModel:
    """
    One model: its file and the files that it includes; models that it attaches have their own.

    :param loaded_by: the files of models that are being loaded, the outermost first
    :param traced: keep the origins
    :raises ModelError: naming file and line
    :ivar root: tag of its root element, ``mujoco`` or ``robot``
    :ivar tree: its root element, with what included files hold in place of the includes
    :ivar elements: how many there are, copies included
    :ivar folders: of the model, then of the models that are attached to it
    :ivar mesh_files: names of mesh files in a URDF, by the last part of the name
    :ivar models: the models that it loads, by the name of the file in the element ``model``
    :ivar origins: file and line of each element, or nothing
    """

    def __init__(self, file: Path, budget: Budget, loaded_by: tuple[Path, ...] = (),
                 files: Files | None = None, traced: bool = False) -> None:
        self.root = self.name = ''
        self.origins: dict[ElementTree.Element, tuple[Path, int]] = {}
        self._traced = traced
        self.elements = 0
        self.models: dict[str, XmlModel] = {}
        self._files = files or Files()
        self.mesh_files: dict[str, str] = {}
        self.folders = [AssetFolders(file.parent)]
        self._file = file
        self._budget = budget
        #: Way to the current file: the files of models that are being loaded, the
        #: outermost first, then those that include each other, down to the current one.
        self._chain = list(loaded_by)
        #: The contents of these files of this model, and how many elements were looked at in each.
        self._open: list[_OpenFile] = []
        self._by_name: dict[str, XmlModel] = {}
        self._attached: list[tuple[str, str, int]] = []
        self.tree = self._read(file, 'model file' if loaded_by else 'MJCF file')
        for attached in self._attached:
            self._count_attached(*attached)

    @property
    def origins_in_order(self) -> list[tuple[Path, int]]:
        """File and line of each element of the tree as it is now, if they were traced."""
        return [self.origins[element] for element in self.tree.iter()]

    @property
    def is_urdf(self) -> bool:
        """True for URDF, False for MJCF."""
        return self.root == 'robot'

    def _read(self, file: Path, kind: str, times: int = 1, depth: int = 0) -> ElementTree.Element:
        """Return the root element of a file, which is made some times, in so many elements."""
        limits = self._budget.limits
        data = self._files.read(file, kind, limits.bytes)
        real = file if isinstance(self._files, InMemoryFile) else Path(os.path.realpath(file))
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
        if data.count(b'<') > _MAX_SIGNS * limits.elements:  # Before it takes memory as a tree.
            raise ModelError(f'{one_line(str(file))}: {_too_many_elements(limits)}')
        data = in_utf8(declared_first(data))
        self._chain.append(real)
        self._open.append(_OpenFile(data))
        try:
            root = self._parsed_as_mujoco_does(data)
        except ModelError:
            raise
        except (expat.ExpatError, LookupError, ValueError) as error:
            raise ModelError(f'{one_line(str(file))} is not well-formed XML: {error}; correct it '
                             'there') from error
        self._look_through(root, times, depth)
        self._open.pop()
        self._chain.pop()
        return root

    def _parsed_as_mujoco_does(self, data: bytes) -> ElementTree.Element:
        """Return the root element, also of a document that MuJoCo reads despite invalid XML."""
        try:
            return self._parsed(data)
        except expat.ExpatError:
            mended = mended_xml(data)
            if mended == data:
                raise
            self._open[-1].data = mended
            return self._parsed(mended)

    def _parsed(self, data: bytes) -> ElementTree.Element:
        """Return the root element; Python runs for no other element, unless they are traced."""
        parser, builder = expat.ParserCreate(), ElementTree.TreeBuilder()

        def trace(tag: str, attributes: dict[str, str]) -> None:
            element = builder.start(tag, attributes)
            self.origins[element] = self._chain[-1], parser.CurrentLineNumber

        def reject_entities(name: str, *_: object) -> NoReturn:
            where = self._place(parser.CurrentLineNumber)
            raise ModelError(f'{where}: the entity {quoted(name)} is declared; models must not '
                             'declare any')

        parser.StartElementHandler = trace if self._traced else builder.start
        parser.EndElementHandler = builder.end
        parser.CharacterDataHandler, parser.buffer_text = builder.data, True
        parser.EntityDeclHandler = reject_entities
        parser.Parse(data, True)
        return builder.close()

    def _look_through(self, root: ElementTree.Element, times: int, depth: int) -> None:
        """Check all elements of a file in its order, and follow those that name files."""
        if not self.root:
            self._begin(root.tag, root.attrib)
        current, limits = self._open[-1], self._budget.limits
        #: For each open element, its children that are left, itself and the copies of a child.
        levels: list[tuple[Iterator[ElementTree.Element], ElementTree.Element | None, int]] = [
            (iter([root]), None, times)]
        while levels:
            siblings, parent, times = levels[-1]
            for element in siblings:
                current.looked_at += 1
                if (self.elements >= limits.elements
                        or depth + len(levels) > limits.nested):
                    raise ModelError(f'{self._place()}: {_too_many_elements(limits)}')
                self.elements += times
                if times > 1:
                    self._make(times)
                children = element[:]
                if element.tag in _CHECKED:
                    self._check(element, parent, times, depth + len(levels))
                if children:
                    copies = times * (product(element.attrib, 'count')
                                      if element.tag == 'replicate' else 1)
                    levels.append((iter(children), element, copies))
                    break
            else:
                levels.pop()

    def _check(self, element: ElementTree.Element, parent: ElementTree.Element | None,
               times: int, depth: int) -> None:
        tag, attributes = element.tag, element.attrib
        if tag in ('composite', 'flexcomp'):
            self._make(times * product(attributes, 'count'))
        if tag in LIMITED:
            self._count_vertices(times * flex_vertices(tag, attributes))
            self._check_numbers(tag, attributes)
        if tag in _FOLLOWED:
            self._follow(element, parent, times, depth)

    def _place(self, line: int | None = None) -> str:
        return f'{one_line(str(self._chain[-1]))}, line {line or self._open[-1].line()}'

    def _begin(self, tag: str, attributes: dict[str, str]) -> None:
        if tag not in ('mujoco', 'robot'):
            raise ModelError(f'{one_line(str(self._file))} is not a model: its root element is '
                             f'<{tag[:60]}>, that of MJCF is <mujoco>, that of URDF is <robot>')
        self.root = tag
        self.name = attributes.get('model', '')

    def _check_numbers(self, tag: str, attributes: dict[str, str]) -> None:
        problem = excess(tag, attributes)
        if tag == 'key':
            self._budget.keys -= 1
            if self._budget.keys < 0:
                problem = f'the number of keyframes is more than {self._budget.limits.keys}'
        if problem:
            raise ModelError(f'{self._place()}: {problem}')

    def _follow(self, element: ElementTree.Element, parent: ElementTree.Element | None,
                times: int, depth: int) -> None:
        tag, attributes = element.tag, element.attrib
        file = attributes.get('file', '')
        if tag == 'include' and file:
            places = [self._file.parent / file, self._chain[-1].parent / file]
            included = self._files.first(places)
            if not self._files.rule and not os.path.lexists(included):
                raise ModelError(
                    f"no such included file: {self._place()} names it; put it there ('git "
                    "submodule update --init' does if it is of a submodule), or correct the name: "
                    f'{one_line(str(included))}')
            content = self._read(included, 'included file', times, depth)
            _replace(element, parent, [*content, *element])
        elif tag == 'model':
            if not file:
                # After it MuJoCo hangs when it attaches another spec.
                raise ModelError(f'{self._place()}: <model> needs a file')
            model = XmlModel(self._file.parent / file, self._budget, tuple(self._chain),
                             self._files, self._traced)
            self._by_name[attributes.get('name', model.name)] = self.models[file] = model
        elif tag == 'attach':
            self._attached.append((attributes.get('model', ''), attributes.get('prefix', ''),
                                   times))
        elif tag == 'compiler':
            folders = self.folders[0]
            directory = attributes.get('assetdir')
            folders.meshdir = attributes.get('meshdir', directory or folders.meshdir)
            folders.texturedir = attributes.get('texturedir', directory or folders.texturedir)
        elif tag == 'mesh' and 'filename' in attributes:
            name = attributes['filename']
            self.mesh_files[name.rpartition('/')[2]] = name

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
            raise ModelError(f'{self._place()}: flexes with more than {self._budget.limits.flex} '
                             'vertices take MuJoCo too long')

    def _make(self, count: int) -> None:
        self._budget.made -= count
        if self._budget.made < 0:
            where = self._place() if self._open else one_line(str(self._file))
            raise ModelError(f'{where}: elements that make several, such as replicate, would make '
                             f'more than {self._budget.limits.made}')


def _too_many_elements(limits: Limits) -> str:
    return f'a model may have at most {limits.elements} elements, {limits.nested} in each other'


def in_utf8(data: bytes) -> bytes:
    """Return a document in UTF-8 if it declares an encoding that the parser cannot read."""
    declared = _ENCODING.match(data)
    if declared is None or declared[2].lower() in _NATIVE:
        return data
    try:
        text = data[declared.end():].decode(declared[2].decode())
    except (LookupError, UnicodeDecodeError):
        return data  # The parser says why not.
    return declared[1] + b'utf-8' + text.encode()


def declared_first(data: bytes) -> bytes:
    """Return a document whose XML declaration is blank if comments precede it; no line moves."""
    before, declaration, after = data.partition(b'<?xml ')
    if not before or not declaration or _COMMENT.sub(b'', before).strip(_BLANKS):
        return data
    rest, end, after = after.partition(b'?>')
    return before + re.sub(rb'[^\n]', b' ', declaration + rest + end) + after


def mended_xml(data: bytes) -> bytes:
    """
    Return a document with what MuJoCo and other readers accept written as XML; no line moves.

    Hyphens in comments become blanks, characters of other encodings there a question mark,
    attributes get a blank between them, values without quotes get these, and a lone ampersand is
    that character.
    """
    if b'<![CDATA[' in data:
        return data
    parts = _COMMENT.split(data)
    comments = [b'<!--' + comment[4:-3].replace(b'-', b' ').decode(errors='replace').encode()
                + b'-->' for comment in _COMMENT.findall(data)]
    parts = [_ATTRIBUTE.sub(rb'\1 ', _TAG.sub(_with_quotes, _AMPERSAND.sub(b'&amp;', part)))
             for part in parts]
    return b''.join(part + comment for part, comment in zip(parts, [*comments, b'']))


def _with_quotes(tag: re.Match[bytes]) -> bytes:
    """Return a tag with its values in quotes."""
    return _UNQUOTED.sub(lambda found: found[1] + b'"' + found[2] + b'"' if found[1] else found[0],
                         tag[0])


def _replace(element: ElementTree.Element, parent: ElementTree.Element | None,
             content: list[ElementTree.Element]) -> None:
    """Put other elements in place of one; in a root, which is left out, in place of its own."""
    if parent is None:
        element[:] = content
    else:
        place = list(parent).index(element)
        parent[place:place + 1] = content
