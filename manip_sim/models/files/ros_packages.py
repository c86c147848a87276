# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Files of ROS packages: folders of packages, meshes of URDF, and xacro, also of old files."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
import hashlib
from itertools import islice
import logging
import os
from pathlib import Path
import re
import threading
from typing import Any
from xml.dom import minidom
from xml.etree import ElementTree
from xml.parsers.expat import ExpatError

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.asset_files import (
    check_fetched, check_suffix, Lost, LostShape, MissingMeshError, warnings_of)
from manip_sim.models.user_files import Files
from manip_sim.models.xml_model import declared_first
from manip_sim.quoting import one_line, quoted
from manip_sim.resources import cache_folder, keep_in_cache, PACKAGE, share_directory
from manip_sim.ros_environment import apt_names

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
