# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Read all XML files of a model as one tree, with the place of each element.

It rejects what makes MuJoCo's reader hang or crash: models that load themselves, and ``<model>``
without a file.
"""

from __future__ import annotations

from dataclasses import dataclass
import os
from pathlib import Path
import re
from typing import NoReturn
from xml.etree import ElementTree
from xml.parsers import expat

from manip_sim.errors import ModelError
from manip_sim.models.user_files import Files
from manip_sim.quoting import one_line, quoted

#: The elements that name files, or say where they are.
_FOLLOWED = frozenset(('include', 'model', 'attach', 'compiler'))
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


class XmlModel:
    """
    One model: its file and the files that it includes; models that it attaches have their own.

    :param loaded_by: the files of models that are being loaded, the outermost first
    :param files: those that may be read; None: all
    :raises ModelError: naming file and line
    :ivar root: tag of its root element, ``mujoco`` or ``robot``
    :ivar tree: its root element, with what included files hold in place of the includes
    :ivar folders: of the model, then of the models that are attached to it
    :ivar models: the models that it loads, by the name of the file in the element ``model``
    :ivar origins: file and line of each element
    """

    def __init__(self, file: Path, loaded_by: tuple[Path, ...] = (), files: Files | None = None
                 ) -> None:
        self.root = self.name = ''
        self.origins: dict[ElementTree.Element, tuple[Path, int]] = {}
        self.models: dict[str, XmlModel] = {}
        self._files = files or Files()
        self.folders = [AssetFolders(file.parent)]
        self._file = file
        #: Way to the current file: the files of models that are being loaded, the
        #: outermost first, then those that include each other, down to the current one.
        self._chain = list(loaded_by)
        self._by_name: dict[str, XmlModel] = {}
        self._attached: list[tuple[str, str]] = []
        self.tree = self._read(file, 'model file' if loaded_by else 'MJCF file')
        for name, prefix in self._attached:
            if name in self._by_name:  # Of others MuJoCo reports it.
                self.folders += [AssetFolders(f.folder, f.meshdir, f.texturedir, prefix + f.prefix)
                                 for f in self._by_name[name].folders]

    @property
    def is_urdf(self) -> bool:
        """True for URDF, False for MJCF."""
        return self.root == 'robot'

    def _read(self, file: Path, kind: str) -> ElementTree.Element:
        """Return the root element of a file."""
        data = self._files.read(file, kind)
        real = Path(os.path.realpath(file)) if file.exists() else file
        if real in self._chain:
            loop = [*self._chain[self._chain.index(real):], real]
            raise ModelError(f'{one_line(str(self._file))} is loaded into itself: '
                             + one_line(' > '.join(path.name for path in loop)))
        data = in_utf8(declared_first(data))
        self._chain.append(real)
        try:
            root = self._parsed_as_mujoco_does(data)
        except ModelError:
            raise
        except (expat.ExpatError, LookupError, ValueError) as error:
            raise ModelError(f'{one_line(str(file))} is not well-formed XML: {error}; correct it '
                             'there') from error
        if not self.root:
            if root.tag not in ('mujoco', 'robot'):
                raise ModelError(
                    f'{one_line(str(self._file))} is not a model: its root element is '
                    f'<{root.tag[:60]}>, that of MJCF is <mujoco>, that of URDF is <robot>')
            self.root, self.name = root.tag, root.get('model', '')
        # Those of the files that it names are followed where these are read.
        elements = [(root, None), *((child, parent) for parent in root.iter() for child in parent)]
        for element, around in elements:
            if element.tag in _FOLLOWED:
                self._follow(element, around)
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
            return self._parsed(mended)

    def _parsed(self, data: bytes) -> ElementTree.Element:
        """Return the root element, and note the line of each."""
        parser, builder = expat.ParserCreate(), ElementTree.TreeBuilder()

        def trace(tag: str, attributes: dict[str, str]) -> None:
            element = builder.start(tag, attributes)
            self.origins[element] = self._chain[-1], parser.CurrentLineNumber

        def reject_entities(name: str, *_: object) -> NoReturn:
            place = f'{one_line(str(self._chain[-1]))}, line {parser.CurrentLineNumber}'
            raise ModelError(f'{place}: the entity {quoted(name)} is declared; models must not '
                             'declare any')

        parser.StartElementHandler = trace
        parser.EndElementHandler = builder.end
        parser.CharacterDataHandler, parser.buffer_text = builder.data, True
        parser.EntityDeclHandler = reject_entities
        parser.specified_attributes = True  # MuJoCo does not know defaults of a document type.
        parser.Parse(data, True)
        return builder.close()

    def _place(self, element: ElementTree.Element) -> str:
        file, line = self.origins[element]
        return f'{one_line(str(file))}, line {line}'

    def _follow(self, element: ElementTree.Element, parent: ElementTree.Element | None) -> None:
        tag, attributes = element.tag, element.attrib
        file = attributes.get('file', '')
        if tag == 'include' and file:
            places = [self._file.parent / file, self._chain[-1].parent / file]
            included = self._files.first(places)
            if not self._files.rule and not os.path.lexists(included):
                raise ModelError(
                    f"no such included file: {self._place(element)} names it; put it there ('git "
                    "submodule update --init' does if it is of a submodule), or correct the name: "
                    f'{one_line(str(included))}')
            content = [*self._read(included, 'included file'), *element]
            if parent is None:  # A root stays.
                element[:] = content
            else:
                place = list(parent).index(element)
                parent[place:place + 1] = content
        elif tag == 'model':
            if not file:
                # After it MuJoCo hangs when it attaches another spec.
                raise ModelError(f'{self._place(element)}: <model> needs a file')
            model = XmlModel(self._file.parent / file, tuple(self._chain), self._files)
            self._by_name[attributes.get('name', model.name)] = self.models[file] = model
        elif tag == 'attach':
            self._attached.append((attributes.get('model', ''), attributes.get('prefix', '')))
        elif tag == 'compiler':
            folders = self.folders[0]
            directory = attributes.get('assetdir')
            folders.meshdir = attributes.get('meshdir', directory or folders.meshdir)
            folders.texturedir = attributes.get('texturedir', directory or folders.texturedir)


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
    if (not before or not declaration or _ends_in_comment(before)
            or _COMMENT.sub(b'', before).strip(_BLANKS)):
        return data
    rest, end, after = after.partition(b'?>')
    return before + re.sub(rb'[^\n]', b' ', declaration + rest + end) + after


def _ends_in_comment(data: bytes) -> bool:
    """Return whether the last comment has no end, which would be looked for from each of them."""
    return data.rfind(b'<!--') > data.rfind(b'-->')


def mended_xml(data: bytes) -> bytes:
    """
    Return a document with what MuJoCo and other readers accept written as XML; no line moves.

    Hyphens in comments become blanks, characters of other encodings there a question mark,
    attributes get a blank between them, values without quotes get these, and a lone ampersand is
    that character.
    """
    if b'<![CDATA[' in data or _ends_in_comment(data):
        return data
    parts = _COMMENT.split(data)
    comments = [b'<!--' + comment[4:-3].replace(b'-', b' ').decode(errors='replace').encode()
                + b'-->' for comment in _COMMENT.findall(data)]
    parts = [_ATTRIBUTE.sub(rb'\1 ', _TAG.sub(_with_quotes, _AMPERSAND.sub(b'&amp;', part)))
             for part in parts]
    return b''.join(part + comment for part, comment in zip(parts, [*comments, b'']))


def _with_quotes(tag: re.Match[bytes]) -> bytes:
    """Return a tag with its values in quotes."""
    return _UNQUOTED.sub(lambda match: match[1] + b'"' + match[2] + b'"' if match[1] else match[0],
                         tag[0])
