# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Expand xacro files into URDF, also old ones, with the arguments that a user gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
import os
from pathlib import Path
import re
import shlex
import threading
from typing import Any
from xml.dom import minidom
from xml.parsers.expat import ExpatError

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.files.package_folders import PackageFolders
from manip_sim.models.xml_model import declared_first
from manip_sim.quoting import one_line, quoted
from manip_sim.ros_environment import apt_names

#: Tags that xacro had without prefix, the attributes of which one is needed, and all they have.
_TAGS: Mapping[str, tuple[frozenset[str], frozenset[str]]] = {
    tag: (frozenset(needed), frozenset((*needed, *others))) for tag, needed, others in (
        ('include', ('filename',), ('ns', 'optional')),
        ('property', ('name',), ('value', 'default', 'scope')),
        ('macro', ('name',), ('params',)), ('arg', ('name', 'default'), ()),
        ('if', ('value',), ()), ('unless', ('value',), ()), ('insert_block', ('name',), ()))}
#: Elements whose content is of another format, which has tags of these names, too.
_OTHERS = ('gazebo', 'plugin', 'sdf')
#: Elements of URDF, which are never calls of macros without prefix.
_URDF = frozenset((
    'actuator', 'axis', 'bounce', 'box', 'calibration', 'capsule', 'child', 'collision', 'color',
    'cylinder', 'dynamics', 'gazebo', 'geometry', 'hardware', 'inertia', 'inertial', 'joint',
    'limit', 'link', 'mass', 'material', 'mesh', 'mimic', 'origin', 'param', 'parent', 'robot',
    'ros2_control', 'safety_controller', 'sensor', 'sphere', 'texture', 'transmission', 'visual'))


def parsed(parse: Callable[..., Any], text: Any, filename: Any = None) -> Any:
    """
    Return the document of a file with the tags that xacro has now.

    :param parse: xacro's function, with the other parameters
    """
    try:
        document = parse(text, filename)
    except ExpatError:
        content = None if filename is None else Path(filename).read_bytes()
        if content is None or declared_first(content) == content:
            raise
        document = minidom.parseString(declared_first(content))  # noqa: S318
    root = document.documentElement
    if root is not None:
        for element in list(_elements(root)):
            _prefix(element)
            if element.tagName == 'xacro:property' and not element.getAttribute('name'):
                element.parentNode.removeChild(element)  # Nothing can use it.
            if element.tagName == 'xacro:arg' and not element.hasAttribute('default'):
                # Thus xacro says that it is undefined, unless it is given.
                element.setAttribute('default', f'$(arg {element.getAttribute("name")})')
    return document


def called(handle: Callable[..., bool], grab: Callable[..., None], resolve: Callable[..., Any],
           node: Any, macros: Any, symbols: Any) -> bool:
    """
    Expand a node if it calls a macro, also without prefix or before the definition.

    :param handle: xacro's function of the last parameters
    :param grab: xacro's function that takes a definition out of a document
    :param resolve: xacro's function that returns a macro
    """
    name = node.tagName.removeprefix('xacro:')
    is_prefixed = node.tagName != name
    if name == 'call' or (not is_prefixed and (name in _URDF or ':' in name)):
        return handle(node, macros, symbols)
    try:
        resolve(name, macros, symbols)
    except (AttributeError, KeyError, NameError, TypeError):
        later = [element for element in _elements(node.ownerDocument.documentElement)
                 if element.tagName == 'xacro:macro' and element.getAttribute('name') == name]
        if len(later) != 1:
            return handle(node, macros, symbols)
        # xacro goes on with the definition itself, so it stays where it is.
        copy = later[0].parentNode.insertBefore(later[0].cloneNode(deep=True), later[0])
        grab(copy, macros)
    if not is_prefixed:
        node.tagName = node.nodeName = f'xacro:{name}'
    return handle(node, macros, symbols)


def _elements(root: Any) -> Iterator[Any]:
    """Yield an element and the elements below it, except of other formats."""
    left = [root]
    while left:
        element = left.pop()
        yield element
        if element.tagName not in _OTHERS:
            left += [child for child in reversed(element.childNodes)
                     if child.nodeType == child.ELEMENT_NODE]


def _prefix(element: Any) -> None:
    """Give a tag of xacro the prefix that it lacks."""
    needed, known = _TAGS.get(element.tagName, (frozenset(), frozenset()))
    attributes = set(element.attributes.keys())
    if needed and needed <= attributes <= known:
        element.tagName = element.nodeName = f'xacro:{element.tagName}'


SUFFIX = '.xacro'
_WITH_ARGUMENTS = re.compile(r'(.*?\.xacro)\s+(\S.*)', re.IGNORECASE | re.DOTALL)
_USED = re.compile(r'\$\(arg\s+(\w+)\s*\)')
_WITH_DEFAULT = re.compile(r'<(?:xacro:)?arg\s(?=[^>]*\bdefault\s*=)[^>]*\bname\s*=\s*["\'](\w+)')
#: Remedies, by words in the messages of xacro.
_REMEDIES = {
    'unbound prefix': 'write xmlns:xacro="http://www.ros.org/wiki/xacro" into its <robot>',
    'environment variable': "type 'export NAME=VALUE' with that name",
    'unknown macro name': 'include the file that defines it',
    'is not defined when evaluating': 'define it by <xacro:property name="..." value="..."/>, or '
                                      'include the file that does',
    'not a boolean expression': 'write true, false, or an expression in ${}',
    'Undefined parameters': 'give them where it is called, or defaults',
    'Invalid parameter': 'take it out where it is called, or name it in params where the macro '
                         'is defined'}
#: xacro keeps the files and arguments that it works with in its module.
_ONE_FILE = threading.Lock()


def split_arguments(name: str) -> tuple[str, dict[str, str]]:
    """
    Return a path and the arguments behind it, as in ``arm.urdf.xacro prefix:=left_ reach:=0.8``.

    :raises ModelError: if something behind the path is not ``name:=value``
    """
    match = _WITH_ARGUMENTS.fullmatch(name)
    if match is None:
        return name, {}
    file, rest = match.groups()
    arguments: dict[str, str] = {}
    try:
        for word in shlex.split(rest):
            key, sign, value = word.partition(':=')
            if not (sign and key.isidentifier()):
                raise ValueError(f'{quoted(word)} is not name:=value')
            if key in arguments:
                raise ValueError(f'{quoted(key)} is given twice')
            arguments[key] = value
    except ValueError as error:
        raise ModelError(f'arguments of {one_line(file, 200)}: {error}') from error
    return file, arguments


def stem_of(file: Path) -> str:
    """Return the name of a file without its suffix, and without ``.urdf`` before ``.xacro``."""
    if file.suffix.lower() == SUFFIX:
        return Path(file.stem).stem if file.stem.lower().endswith('.urdf') else file.stem
    return file.stem


class _Arguments(dict[str, str]):
    """Arguments that remember which names xacro asked for."""

    def __init__(self, values: Mapping[str, str]) -> None:
        super().__init__(values)
        self.known: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.known.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.known.add(name)
        return super().__getitem__(name)


def expanded(file: Path, arguments: Mapping[str, str]) -> str:
    """
    Return the URDF that a xacro file makes.

    ``$(find PACKAGE)`` is looked up as ``package://`` is, and files that a package installs
    elsewhere are found where its sources have them. The file may read others and compute, so it
    must be one that the user of the process has chosen.

    :raises ModelError: with xacro's message, or if xacro is not installed
    :raises UnknownNameError: if the file has no such argument
    """
    try:
        import xacro
        from xacro import substitution_args
    except ImportError as error:
        raise ModelError(f'{file} needs xacro: pip install xacro, or apt install '
                         f'{apt_names("xacro")}') from error
    mapping = _Arguments(arguments)
    with _ONE_FILE:
        finder = _Finder(xacro, file)
        with finder.replacing(substitution_args):
            try:
                document = xacro.process_file(str(file), mappings=mapping)
            except Exception as error:  # Expressions in the file may raise anything.
                raise ModelError(_explained(file, error, mapping, finder)) from error
    for name in arguments:
        if name not in mapping.known:
            raise UnknownNameError(f'argument of {file}', name, sorted(mapping.known))
    if not document.getElementsByTagName('link'):
        raise ModelError(f'{file} makes no link: it only defines what another xacro file uses; '
                         'load the one that calls its macros')
    return str(document.toxml())


class _Finder:
    """Finds files for xacro, and reads what it reads no longer."""

    def __init__(self, xacro: Any, file: Path) -> None:
        self._xacro = xacro
        self._packages = PackageFolders(file)
        #: The folders that were found, by name of the package.
        self._found: dict[str, Path] = {}

    @contextmanager
    def replacing(self, substitution: Any) -> Iterator[None]:
        """Let functions of xacro do more, until the end."""
        xacro = self._xacro
        places = [(substitution, '_eval_find', self._folder),
                  (xacro, 'abs_filename_spec', partial(self._file, xacro.abs_filename_spec)),
                  (xacro, 'parse', partial(parsed, xacro.parse)),
                  (xacro, 'handle_macro_call', partial(
                      called, xacro.handle_macro_call, xacro.grab_macro, xacro.resolve_macro))]
        before = [(module, name, getattr(module, name)) for module, name, _ in places]
        try:
            for module, name, function in places:
                setattr(module, name, function)
            yield
        finally:
            for module, name, function in before:
                setattr(module, name, function)

    def package_of(self, path: str) -> str | None:
        """Return the package in whose folder a path is, of those that were found."""
        return next((package for package, folder in self._found.items()
                     if Path(path).is_relative_to(folder)), None)

    def current_file(self) -> str:
        """Return the file that xacro works on."""
        return str((self._xacro.filestack or [''])[-1])

    def _folder(self, package: str) -> str:
        folders = self._packages.find(package)
        if not folders:
            raise ModelError('; '.join(self._packages.missing(package)))
        self._found[package] = folders[0]
        return str(folders[0])

    def _file(self, absolute: Callable[[str], str], name: str) -> str:
        path = absolute(name)
        package = None if os.path.exists(path) else self.package_of(path)
        if package is not None:
            folder = self._found[package]
            installed = self._packages.file_in(folder, str(Path(path).relative_to(folder)))
            return path if installed is None else str(installed)
        return path


def _explained(file: Path, error: Exception, arguments: _Arguments, finder: _Finder) -> str:
    """Return the message of an error, without repetitions, and a remedy."""
    causes = list(_causes(error))
    inside = finder.current_file()
    included = '' if inside == str(file) or not inside else f'{one_line(inside, 200)}: '
    begin = f'{file} cannot be expanded by xacro: {included}'
    for cause in causes:
        if isinstance(cause, ModelError):
            return f'{begin}{cause}'
        if isinstance(cause, UnicodeDecodeError):
            line = cause.object.count(b'\n', 0, cause.start) + 1
            return f'{begin}line {line} is not UTF-8: save the file as UTF-8'
        if isinstance(cause, OSError) and cause.filename:
            package = finder.package_of(str(cause.filename))
            return (f'{begin}no such file: {one_line(str(cause.filename), 300)}; ' + (
                f'if package {quoted(package)} makes it or installs it from elsewhere, build '
                'and source the package' if package else 'put it there, or correct the name'))
    missing = next((str(cause) for cause in causes if type(cause).__name__ == 'ArgException'), '')
    if missing:
        values = ' '.join(f'{name}:=VALUE' for name in _required(file, missing, arguments))
        return (f'{begin}Undefined substitution argument {one_line(missing, 60)}: give it, as in '
                f'{quoted(f"{file.name} {values}", 300)}, or by xacro_args in the YAML file')
    message = one_line(_message(causes), 300)
    remedy = next((f': {advice}' for words, advice in _REMEDIES.items() if words in message), '')
    return begin + message + remedy


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an exception and those that it tells of, the innermost last."""
    while error is not None:
        yield error
        error = getattr(error, 'exc', None)


def _message(causes: list[BaseException]) -> str:
    """Return what exceptions of xacro say, each once; they repeat those that they tell of."""
    said: list[str] = []
    for cause in reversed(causes):
        text = str(cause.args[0]) if hasattr(cause, 'exc') and cause.args else str(cause)
        macros = [macro.body.getAttribute('name') for macro in getattr(cause, 'macros', ())]
        suffix = (getattr(cause, 'suffix', None) or '').strip()
        parts = [text if text != 'None' and not text.startswith('<class ') else '',
                 f'of macro {quoted(macros[0])}' if macros else '', suffix]
        said += [part for part in parts if part and part not in said]
    return ' '.join(said) or type(causes[-1]).__name__


def _required(file: Path, missing: str, arguments: Mapping[str, str]) -> list[str]:
    """Return the arguments that a file uses and has no value for, with one that is missing."""
    text = file.read_text(encoding='utf-8', errors='replace')
    known = {*arguments, *_WITH_DEFAULT.findall(text)}
    return list(dict.fromkeys([missing, *(
        name for name in _USED.findall(text) if name not in known)]))
