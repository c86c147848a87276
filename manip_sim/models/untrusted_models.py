# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The door for models that somebody names or sends who must not read every file of the user.

Files are read here, through a :class:`Files` that says which ones may be, as far as is needed to
know which files a model names. MuJoCo gets their contents under other names, so it opens no file
by itself. As it cannot be interrupted, models are first made in a process that has little time,
memory and stack, can open no file, and can be given up. What passes there is small, and is loaded
here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import gc
import hashlib
import os
from pathlib import Path, PurePosixPath
import pickle
import re
import resource
import signal
import subprocess
import sys
from typing import Any
from xml.etree import ElementTree

import mujoco

from manip_sim.errors import ModelError
from manip_sim.models.asset_files import (
    check_suffix, MissingAssetError, places, references)
from manip_sim.models.loading import compile_spec, Document, documents_of, spec_from_documents
from manip_sim.models.user_files import CachedFiles, Files
from manip_sim.models.xml_model import AssetFolders, XmlModel
from manip_sim.quoting import one_line, quoted
from manip_sim.startup import spare_garbage

#: Limits of the process: CPU time [s], wall time [s] and address space [bytes].
MAX_CPU_S, MAX_WALL_S, MAX_MEMORY_BYTES = 3, 60.0, 2 * 1024**3
#: Stack of the process [bytes], half of that of a thread here, and its exit code after an error.
_STACK_BYTES, _FAILED = 4 * 1024**2, 3
_REMEMBERED = 1000

_passed: dict[bytes, None] = {}
_running: set[subprocess.Popen[bytes]] = set()
#: Limits of a compiled model: bytes, and bodies, joints, shapes and so on of objects and robots.
_MAX_MODEL_BYTES, MAX_OBJECT, MAX_ROBOT = 200_000_000, 1000, 5000
_COUNTED = ('nbody', 'njnt', 'ngeom', 'nsite', 'ncam', 'nlight', 'nmat', 'nmesh', 'ntex', 'npair',
            'nexclude', 'neq', 'ntendon', 'nwrap', 'nu', 'nsensor', 'ntuple', 'nkey')
#: Numbers in the attribute ``user`` of elements.
_USER_DATA = tuple(f'nuser_{kind}' for kind in (
    'body', 'jnt', 'geom', 'site', 'cam', 'tendon', 'actuator', 'sensor'))
_MAX_USER_DATA = 100
_NAMES_A_FILE = re.compile(r'file.*', re.IGNORECASE)
#: A NaN among numbers: MuJoCo takes it for no value, and prints a line for each.
_NAN = re.compile(r'(?:.*\s)?[+-]?nan(?:[\s(].*)?', re.IGNORECASE | re.DOTALL)
#: Attributes of files; MuJoCo gets all files by names without a folder and with a known suffix.
_OF_FILES = ('meshdir', 'texturedir', 'assetdir', 'strippath')
#: Elements of a model that compiles so quickly that it need not be tried before.
_LIGHT = frozenset((
    'mujoco', 'compiler', 'option', 'flag', 'default', 'asset', 'material', 'worldbody', 'body',
    'frame', 'geom', 'joint', 'freejoint', 'inertial', 'site', 'camera', 'light', 'contact',
    'exclude'))
_MAX_LIGHT_ELEMENTS, _MAX_LIGHT_CHARACTERS = 100, 20_000


@dataclass
class SelfContainedModel:
    """
    A model and the contents of all files that it names.

    :ivar name: what it was read from, for messages
    :ivar documents: its MJCF or URDF, then the MJCF that it attaches
    :ivar is_light: whether it compiles quickly for sure
    :ivar assets: meshes and images, by their names in the documents
    """

    name: str
    documents: list[Document]
    is_light: bool
    assets: dict[str, bytes] = field(default_factory=dict)

    def load(self, notes: list[str] | None = None) -> mujoco.MjSpec:
        """
        Return a new spec.

        A model that may take long, or crash MuJoCo, is compiled in another process first.

        :param notes: as for ``spec_from_documents``
        :raises ModelError: if it is not a model, or compiling it takes too long or too much memory
        """
        if not self.is_light:
            run_limited(self.name, compile_held, {
                document.name: document.text() for document in self.documents}, self.assets)
        return self.load_tried(notes)

    def load_tried(self, notes: list[str] | None = None) -> mujoco.MjSpec:
        """Return a new spec, of a model that is compiled elsewhere first."""
        spec = spec_from_documents(self.documents, Path(self.name), self.assets, notes)
        for reference in references(spec):
            if reference.file not in self.assets:
                raise ModelError(f'{one_line(self.name)}: {reference.kind} '
                                 f'{quoted(reference.element_name)} names a file')
        return spec

    def hold(self, files: Files, as_robot: bool) -> None:
        """Read the files that the documents name, and let them name what was read."""
        for document in self.documents:
            self._hold_document(document, files, as_robot)

    def _hold_document(self, document: Document, files: Files, as_robot: bool) -> None:
        root, folders = document.root, document.folders
        # They have no meaning in a part of a world, but may ask for any amount of memory.
        left_out = ('size',) if as_robot else ('size', 'keyframe')
        for section in [child for child in root if child.tag in left_out]:
            root.remove(section)
        for element in root.iter():
            self.is_light = self.is_light and element.tag in _LIGHT
            if element.tag == 'plugin':
                raise ModelError(f'{one_line(self.name)}: what is spawned cannot have plugins')
            for attribute in _OF_FILES if element.tag == 'compiler' else ('content_type',):
                element.attrib.pop(attribute, None)
            for attribute, name in element.items():
                if attribute != 'name' and _NAN.fullmatch(name):
                    raise ModelError(f'{one_line(self.name)}: {attribute[:60]} of '
                                     f'<{element.tag[:60]}> must be a number, got {quoted(name)}')
                if _NAMES_A_FILE.fullmatch(attribute) and name and element.tag != 'model':
                    element.set(attribute, self._hold_asset(
                        element.tag, name, folders, root.tag == 'robot', files))

    def _hold_asset(self, tag: str, name: str, folders: AssetFolders, is_urdf: bool, files: Files
                    ) -> str:
        if tag not in ('mesh', 'texture'):
            raise ModelError(f'{one_line(self.name)}: <{tag[:60]}> names the file '
                             f'{quoted(name, 200)}, which what is spawned cannot have')
        names = [name, PurePosixPath(name).name] if is_urdf else [name]
        file = files.first([place for each in names for place in places(tag, each, folders)])
        return self.hold_file(tag, file, files)

    def hold_file(self, kind: str, file: Path, files: Files) -> str:
        """
        Read a mesh or texture, and return its name in the model.

        :raises MissingAssetError: if it is not there
        :raises ModelError: if it cannot be read, or is of a type that cannot be spawned
        """
        try:
            content = files.read(file, f'{kind} file')
        except ModelError as error:
            if files.is_file(file):
                raise
            raise MissingAssetError(str(error)) from error
        check_suffix(kind, file)
        name = held_name(file, content)
        self.assets[name] = content
        return name


def load_self_contained(file: Path, files: Files, as_robot: bool = False) -> SelfContainedModel:
    """
    Read a model and the files that it names.

    :param as_robot: keep the keyframes
    :raises ModelError: if a file must not be or cannot be read, or there is too much to read
    """
    files = files if isinstance(files, CachedFiles) else CachedFiles(files)
    documents = documents_of(XmlModel(file, files=files))
    elements = list(documents[0].root.iter())
    characters = sum(len(value) for element in elements for value in element.attrib.values())
    held = SelfContainedModel(
        str(file), documents, not as_robot and len(elements) <= _MAX_LIGHT_ELEMENTS
        and characters <= _MAX_LIGHT_CHARACTERS)
    held.hold(files, as_robot)
    held.is_light = held.is_light and not held.assets
    return held


def held_name(file: Path, content: bytes) -> str:
    """Return a name for the content of a file that no other content has."""
    stem = re.sub(r'[^A-Za-z0-9-]', '_', file.stem)[:40]
    return f'{stem}_{hashlib.sha256(content).hexdigest()[:16]}{file.suffix.lower()}'


def compile_held(texts: Mapping[str, str], assets: Mapping[str, bytes]) -> None:
    """Compile a model of an object from the texts of its documents by name."""
    documents = [Document(ElementTree.fromstring(text), {}, name) for name, text in texts.items()]
    spec = spec_from_documents(documents, Path('it'), assets)
    check_size(compile_spec(spec, 'it'), MAX_OBJECT, 'it')


def check_size(model: mujoco.MjModel, most: int, name: str) -> None:
    """
    Check that a world with a model remains fast and small.

    :param most: bodies, joints, shapes and so on
    """
    for numbers in _USER_DATA:  # The whole world has as many for each of its bodies and so on.
        if getattr(model, numbers) > _MAX_USER_DATA:
            raise ModelError(f'{name} has {numbers} {getattr(model, numbers)}, and at most '
                             f'{_MAX_USER_DATA} can be spawned')
    count = sum(getattr(model, field) for field in _COUNTED)
    size = mujoco.mj_sizeModel(model)
    if count > most or size > _MAX_MODEL_BYTES:
        raise ModelError(f'{name} has {count} bodies, joints, shapes and so on in '
                         f'{size / 1e6:.0f} MB, and at most {most} in '
                         f'{_MAX_MODEL_BYTES / 1e6:.0f} MB can be spawned')


def run_limited(name: str, function: Callable[..., bytes | None], *arguments: Any,
                max_cpu_s: int | None = None) -> bytes:
    """
    Call a function in another process, which has little time and memory and can open no file.

    A function that returned nothing is not called again with the same arguments.

    :param function: of a module; imports nothing when it is called
    :param max_cpu_s: CPU time that it may take [s]; None: :data:`MAX_CPU_S`
    :returns: what the function returns
    :raises ModelError: if the function does, or does not end within the limits
    """
    cpu_s = max_cpu_s or MAX_CPU_S
    work = pickle.dumps((cpu_s, MAX_MEMORY_BYTES, function, arguments))
    digest = hashlib.sha256(work).digest()
    if digest in _passed:
        return b''
    code, output = _answer(work)
    if code == _FAILED:
        raise ModelError(f'{one_line(name)} {output.decode()}')
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        raise ModelError(f'{one_line(name)} takes more than {cpu_s} s to load, which is the limit')
    if code:
        raise ModelError(f'{one_line(name)} cannot be compiled: MuJoCo crashes, or needs more '
                         f'than {MAX_MEMORY_BYTES / 1e9:.0f} GB')
    if not output:
        if len(_passed) >= _REMEMBERED:
            del _passed[next(iter(_passed))]
        _passed[digest] = None
    return output


def _answer(work: bytes) -> tuple[int, bytes]:
    """Return the exit code of the process and its output, a result or an error."""
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path)),
                   'OPENBLAS_NUM_THREADS': '1', 'MUJOCO_GL': 'disable'}  # It renders nothing.
    program = f'from {__name__} import main; main()'
    with subprocess.Popen([sys.executable, '-c', program], env=environment, cwd='/',
                          stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL) as process:
        _running.add(process)
        output = b''
        try:
            output, _ = process.communicate(work, timeout=MAX_WALL_S)
        except subprocess.TimeoutExpired:
            process.kill()
        finally:
            _running.discard(process)
    return process.returncode, output


def give_up() -> None:
    """End the processes in which models are compiled: this one is ending."""
    for process in list(_running):
        process.kill()


def main() -> None:
    """Do the task read from standard input, and write its result or error to standard output."""
    gc.disable()  # It is too short for it.
    # No file can be opened later, and numpy imports this only when it is used.
    import numpy.random  # noqa: F401

    # By the function above, so that it can be trusted.
    cpu_s, memory, function, arguments = pickle.loads(sys.stdin.buffer.read())  # noqa: S301
    descriptions = sys.modules.get('manip_sim.models.descriptions')
    if descriptions is not None:  # The function may read some.
        descriptions.compile_descriptions()
    os.nice(5)
    result = os.dup(1)
    os.dup2(2, 1)  # What libraries print is no part of the result.
    for limit, value in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CORE, 0),
                         (resource.RLIMIT_STACK, _STACK_BYTES), (resource.RLIMIT_FSIZE, 0),
                         (resource.RLIMIT_NOFILE, 0)):
        resource.setrlimit(limit, (value, value))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    code = 0
    try:
        output = function(*arguments) or b''
    except ModelError as error:
        code, output = _FAILED, str(error).removeprefix('it ').encode(errors='replace')
    except (ArithmeticError, AttributeError, LookupError, MemoryError, OSError, RecursionError,
            TypeError, ValueError) as error:
        code, output = _FAILED, (f'cannot be loaded: {type(error).__name__}: '
                                 f'{one_line(str(error), 200)}').encode(errors='replace')
    with os.fdopen(result, 'wb') as stream:
        stream.write(output)
    spare_garbage()
    sys.exit(code)
