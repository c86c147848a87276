# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Policies by name: an expert, a class, a function, a TorchScript or ONNX file, a ROS node.

A file beside that of a policy says which numbers of an episode it was made for.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
import contextlib
import functools
import hashlib
import importlib
import importlib.util
import inspect
import json
import os
from pathlib import Path
import re
import signal
import sys
import sysconfig
from typing import Any
import warnings

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import describe_choices, ManipSimError, ModelError
from manip_sim.quoting import format_value, one_line, quoted
from manip_sim.ros_environment import check_ros_environment, missing_module
from manip_sim.tasks import Episode, interface_of
from manip_sim.tasks.episode import INTERFACE_FORMAT
from manip_sim.tasks.expert import Policy
from manip_sim.tasks.observation import IMAGE, Observation

EXPERT = 'expert'
#: Before the namespace of a node.
ROS = 'ros:'
#: Longest wait for the answer of a node, and of a policy in a process of the run, wall time [s].
LIMIT_S, LOCAL_LIMIT_S = 10.0, 600.0
_FORMS = ("'expert', MODULE:CLASS, MODULE:FUNCTION, FILE.py:CLASS, FILE.pt, FILE.onnx or "
          'ros:/NAMESPACE')
#: Folders of installed packages, also of Debian's, and of files that the kernel makes.
_INSTALLED, _KERNEL = ('site-packages', 'dist-packages'), ('/proc', '/sys')
#: Files that loading has read in this process, by policy, and files of policies that load now.
_READ: dict[str, set[Path]] = {}
_WATCHERS: list[set[Path]] = []


class PolicyFailure(ManipSimError):
    """A policy raised an error."""


def policy_content(name: str, read: Iterable[str] = ()) -> str | None:
    """
    Return a hash of the files that a policy is made of.

    These are its file, and of a Python policy also the modules that it imports from its own folder
    or package, the files that a text constant in them names, such as weights, and the files that
    loading it has read.

    :param name: as for :func:`load_policy`
    :param read: the latter, from :func:`files_read`
    :returns: SHA-256; None for an expert, which is a part of the package, and a ROS node
    """
    if name == EXPERT or name.startswith(ROS):
        return None
    file = _policy_file(name)
    files: set[Path] = set()
    if file is not None:
        more = (Path(os.path.abspath(file.parent / path)) for path in read)
        files = _files([file, *filter(os.path.isfile, more)])
    # Sorted by content: other machines have them in other folders.
    return hashlib.sha256(b''.join(sorted(map(_digest, files)))).hexdigest()


def files_read(name: str) -> list[str]:
    """
    Return the files that loading a policy has read in this process, and its text does not name.

    Those count that are below the folder of the policy or the working directory, also if a
    variable of a module has the path of one that other code than Python's opens.

    :param name: as for :func:`load_policy`
    :returns: paths from the folder of the policy, sorted
    """
    file = _policy_file(name)
    if file is None or name not in _READ:
        return []
    return sorted(os.path.relpath(path, file.resolve().parent)
                  for path in _READ[name] - _files([file]))


def _policy_file(name: str) -> Path | None:
    """Return the file of a policy, or None if it cannot be found."""
    location = name if os.path.isfile(name) else name.rpartition(':')[0]
    return Path(location) if os.path.isfile(location) else _source(location, [Path(), *sys.path])


def _checked_interface(name: str, episode: Episode) -> Mapping[str, Any]:
    """Return what the file beside a policy says, if there is one, after checking the episode."""
    file = _policy_file(name)
    beside = None if file is None else file.with_name(file.name + SUFFIX)
    if beside is None or not beside.is_file():
        return {}
    expected = read_interface(beside)
    check_interface(expected, interface_of(episode), str(beside))
    return expected


def _digest(path: Path) -> bytes:
    digest = hashlib.sha256()
    with path.open('rb') as file:
        while block := file.read(2**20):
            digest.update(block)
    return digest.digest()


def _files(beginning: Sequence[Path]) -> set[Path]:
    """Return files and what they import or name, but no packages that the first is none of."""
    files, waiting = set[Path](), [path.resolve() for path in beginning]
    package = _installed(waiting[0])
    while waiting:
        path = waiting.pop()
        if path in files or _installed(path) not in (None, package):
            continue
        files.add(path)
        if path.suffix == '.py':
            with contextlib.suppress(SyntaxError, ValueError):
                waiting += _referred(path, ast.parse(path.read_bytes()))
        elif path.suffix == '.onnx':  # Large weights are in files beside it.
            waiting += path.parent.glob(f'{path.name}.*')
    return files


def _installed(file: Path) -> Path | None:
    """Return the installed package or module that a file belongs to; None if it is in none."""
    standard = Path(sysconfig.get_path('stdlib')).resolve()
    return next((path for path in (file, *file.parents)
                 if path.parent.name in _INSTALLED or path.parent == standard), None)


def _referred(path: Path, tree: ast.Module) -> Iterator[Path]:
    """Yield the files that a module imports, or names in a text constant."""
    written = {id(part) for node in ast.walk(tree) if _writes(node) for part in ast.walk(node)}
    for node in ast.walk(tree):
        if id(node) in written:
            continue
        names: list[str] = []
        folders: list[Path | str] = [path.parent, Path(), *sys.path]
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                folders = [path.parents[node.level - 1]]
            parents = [node.module] if node.module else []
            names = [*parents, *('.'.join([*parents, alias.name]) for alias in node.names)]
        for text in _texts(node):
            # Any text, which os.path.isfile takes: pathlib raises for some.
            yield from (file.resolve() for file in (Path(text), path.parent / text)
                        if os.path.isfile(file) and os.access(file, os.R_OK)
                        and not any(map(file.is_relative_to, _KERNEL)))
        sources = (_source(name, folders) for name in names)
        yield from (source.resolve() for source in sources if source is not None)


def _writes(node: ast.AST) -> bool:
    """Return whether a node opens a file to write it, such as a log."""
    if not isinstance(node, ast.Call) or 'open' not in (
            getattr(node.func, 'id', ''), getattr(node.func, 'attr', '')):
        return False
    modes = [*node.args, *(keyword.value for keyword in node.keywords if keyword.arg == 'mode')]
    return any(isinstance(value, ast.Constant) and isinstance(value.value, str)
               and re.fullmatch('[rwaxbt+]*[wax+][rwaxbt+]*', value.value) for value in modes)


def _texts(node: ast.AST) -> Iterator[str]:
    """Yield the texts of a node that may name a file: a constant, or several that are joined."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):  # HERE / 'folder' / 'file'
        right = next(_texts(node.right), '')
        yield from (os.path.join(left, right) for left in (*_texts(node.left), '') if right)
    elif isinstance(node, ast.Call):  # os.path.join(HERE, 'folder', 'file')
        parts = [text for argument in node.args if isinstance(argument, ast.Constant)
                 for text in _texts(argument)]
        yield from [os.path.join(*parts)] if parts else []


def _source(module: str, folders: Iterable[Path | str]) -> Path | None:
    """Return the source file of a module, in the first of some folders that has it."""
    parts = Path(*module.split('.'))
    candidates = (path for folder in folders for path in (
        Path(folder, f'{parts}.py'), Path(folder, parts, '__init__.py')))
    return next(filter(os.path.isfile, candidates), None)


@contextlib.contextmanager
def wrap_errors(activity: str, kind: type[ManipSimError]) -> Iterator[None]:
    """
    Let code of a user, which may raise anything, raise one error.

    :param activity: of the block, for the message
    :param kind: of the error
    :raises ManipSimError: of that kind
    :raises KeyboardInterrupt: by Ctrl-C, unless that is ignored
    :raises MemoryError: if memory is exhausted, which other code may have caused
    """
    try:
        yield
    except MemoryError:
        raise
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and (
                signal.getsignal(signal.SIGINT) is not signal.SIG_IGN):
            raise
        try:
            text = one_line(str(error), 200)
        except Exception:
            text = 'it has no text'
        raise kind(f'{activity}: {type(error).__name__}: {text}') from error


def load_policy(name: str, episode: Episode, limit_s: float = LIMIT_S, batched: bool = False
                ) -> Policy:
    """
    Return a policy, or one of a batch of episodes, whose ``act`` also takes their seeds.

    :param name: ``expert``; ``module:Class`` of a class without arguments, with ``reset`` and
        ``act``; ``module:function`` of a function of an observation; ``.py`` file in place of the
        module; a ``.pt`` or ``.onnx`` file; or ``ros:/namespace`` of a node
    :param episode: in which it acts
    :param limit_s: how long an answer of a node may take, wall time [s]
    :param batched: whether it gets observations of several episodes, with a leading axis
    :raises ModelError: if it cannot be used, with the cause
    """
    if batched and (name == EXPERT or name.startswith(ROS)):
        raise ModelError(f'policy {quoted(name)} acts in one episode at a time: it needs no '
                         '--batch')
    if name == EXPERT:
        return episode.task.expert(episode.simulation)
    if name.startswith(ROS):
        check_ros_environment()
        try:
            from manip_sim.experiments.ros_policy import RosPolicy
        except ImportError as error:
            raise ModelError(f'policy {quoted(name)}: {missing_module(error)}') from error
        return RosPolicy(name.removeprefix(ROS), episode, limit_s)
    keys = _checked_interface(name, episode).get('observation')
    with _watched(name):
        return _loaded(name, keys, batched)


def _loaded(name: str, keys: Collection[str] | None, batched: bool) -> Policy:
    suffix = Path(name).suffix.lower()
    if suffix in ('.pt', '.pth', '.onnx'):
        if not Path(name).is_file():
            raise ModelError(f'policy {quoted(name)}: there is no such file')
        network = (_onnx if suffix == '.onnx' else _torch_script)(name, keys)
        return _Function(network if batched else lambda observation: _answer(network(
            {key: value[None] for key, value in observation.items()})))
    module, colon, attribute = name.rpartition(':')
    if not (colon and module and attribute):
        raise ModelError(f'policy {quoted(name)} must be {_FORMS}')
    item: Any = _module(module)
    for part in attribute.split('.'):
        if not hasattr(item, part):
            raise ModelError(f'policy {quoted(name)}: no {quoted(part)} in {module}: '
                             + describe_choices(part, [n for n in vars(item) if n[0] != '_']))
        item = getattr(item, part)
    return _made(name, item)


@contextlib.contextmanager
def _watched(name: str) -> Iterator[None]:
    """Note which files below the policy's folder or the working directory are read within."""
    file, here = _policy_file(name), Path.cwd()
    if file is None:
        yield
        return
    folder, opened, package = file.resolve().parent, set[Path](), _installed(file.resolve())
    _watch_opening()
    _WATCHERS.append(opened)
    before = sys.modules.copy()
    try:
        yield
        # A file of the same name may have been loaded before, from another folder.
        for module in [module for key, module in sys.modules.items()
                       if module is not before.get(key)]:
            if _is_below(Path(getattr(module, '__file__', None) or '/'), folder):
                opened.update(Path(value) for value in vars(module).values()
                              if isinstance(value, (str, Path)) and os.path.isfile(value))
    finally:
        _WATCHERS.remove(opened)
        paths = {Path(os.path.abspath(here / path)) for path in opened}
        _READ.setdefault(name, set()).update(
            path.resolve() for path in map(_source_of, paths) if path.is_file()
            and (_is_below(path, folder) or _is_below(path, here))
            and _installed(path) in (None, package))


def _is_below(path: Path, folder: Path) -> bool:
    return path.is_relative_to(folder) and not any(map(path.is_relative_to, _KERNEL))


def _source_of(path: Path) -> Path:
    """Return the source of what Python has compiled, or the path itself."""
    if path.suffix != '.pyc':
        return path
    with contextlib.suppress(ValueError):
        return Path(importlib.util.source_from_cache(str(path)))
    return path


@functools.cache
def _watch_opening() -> None:
    """Let Python report the files that it opens, from now on: that cannot be ended."""
    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if event == 'open' and _WATCHERS and isinstance(arguments[0], (str, bytes, os.PathLike)):
            path, mode, flags = arguments
            if not flags & (os.O_WRONLY | os.O_RDWR):
                for opened in _WATCHERS:
                    opened.add(Path(os.path.abspath(os.fsdecode(path))))
    sys.addaudithook(note)


def _module(location: str) -> Any:
    """Import a module by its name or its file."""
    with wrap_errors(f'policy: cannot import {quoted(location)}', ModelError):
        if not location.endswith('.py'):
            if '' not in sys.path:  # As python -m does, modules of the working directory count.
                sys.path.insert(0, '')
            return importlib.import_module(location)
        file = Path(location).resolve()
        if str(file.parent) not in sys.path:  # Last, where its modules replace none of others.
            sys.path.append(str(file.parent))
        # A name of its own: a policy in random.py must not replace the module random.
        spec = importlib.util.spec_from_file_location(f'policy_{file.stem}', file)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[spec.name]
            raise
        return module


def _made(name: str, item: Any) -> Policy:
    if inspect.isclass(item):
        with wrap_errors(f'policy {quoted(name)} cannot be created without arguments', ModelError):
            item = item()
        with wrap_errors(f'policy {quoted(name)}', ModelError):
            missing = [method for method in ('reset', 'act')
                       if not callable(getattr(item, method, None))]
        if missing:
            raise ModelError(f'policy {quoted(name)} needs reset(seed) and act(observation); it '
                             f'has no {" and no ".join(missing)}')
        if not inspect.signature(item.reset).parameters:
            return _Function(item.act, item.reset)
        policy: Policy = item
        return policy
    if not callable(item):
        raise ModelError(f'policy {quoted(name)} must be a class or a function, got '
                         f'{type(item).__name__}')
    return _Function(item)


class _Function:
    """A policy that is a function of the observation."""

    def __init__(self, act: Callable[..., FloatArray],
                 reset: Callable[[], None] = lambda: None) -> None:
        self.act = act
        self._reset = reset

    def reset(self, seed: int) -> None:
        """Begin an episode."""
        self._reset()


def inputs(observation: Observation, names: list[str], keys: Collection[str] | None
           ) -> dict[str, Any]:
    """
    Return what a network takes of observations with a leading axis, numbers as float32.

    A single input that is no key gets all but images as gymnasium's ``FlattenObservation`` has it.

    :param names: of the inputs
    :param keys: of the part that such an input gets; None for all of it
    """
    if len(names) == 1 and names[0] not in observation:
        return {names[0]: np.concatenate(
            [observation[key].reshape(len(observation[key]), -1) for key in sorted(observation)
             if not key.startswith(IMAGE) and (keys is None or key in keys)],
            axis=1).astype(np.float32)}
    return {key: value if value.dtype == np.uint8 else value.astype(np.float32)
            for key, value in observation.items() if key in names}


def _answer(output: Any) -> FloatArray:
    """Return the action of a network, shape (n,); if it has three axes, a chunk, (actions, n)."""
    numbers = np.asarray(output, dtype=float)
    return numbers.reshape(numbers.shape[1:]) if numbers.ndim == 3 and len(numbers) == 1 else (
        numbers.ravel())


def _onnx(file: str, keys: Collection[str] | None) -> Callable[..., Any]:
    """Return a network, a function of observations with a leading axis."""
    try:
        import onnxruntime
    except ImportError as error:
        raise ModelError(f"policy {quoted(file)} needs onnxruntime: pip install "
                         "'manip_sim[onnx]'") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(file, options, ['CPUExecutionProvider'])
    except Exception as error:
        raise ModelError(f'policy {quoted(file)}: {one_line(str(error), 200)}') from error
    names = [item.name for item in session.get_inputs()]
    return lambda observations, seeds=None: session.run(
        None, inputs(observations, names, keys))[0]


def _torch_script(file: str, keys: Collection[str] | None) -> Callable[..., Any]:
    try:
        import torch
    except ImportError as error:
        raise ModelError(f"policy {quoted(file)} needs torch: pip install 'manip_sim[torch]'"
                         ) from error
    torch.set_num_threads(1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # It is deprecated in favour of torch.export.
            module = torch.jit.load(file, map_location='cpu').eval()
    except Exception as error:
        raise ModelError(f'policy {quoted(file)}: {one_line(str(error), 200)}') from error
    takes_dict = 'Dict' in str(module.forward.schema.arguments[1].type)

    def act(observations: Observation, seeds: IntArray | None = None) -> Any:
        names = list(observations) if takes_dict else ['']
        tensors = {key: torch.from_numpy(value)
                   for key, value in inputs(observations, names, keys).items()}
        with torch.no_grad():
            return module(tensors if takes_dict else tensors['']).numpy()
    return act


#: After the name of a policy's file.
SUFFIX = '.interface.json'
#: Content of a file, by the key of its part.
_KNOWN: Mapping[str, tuple[str, ...]] = {
    '': ('format', 'control_hz', 'action', 'observation'),
    'action': ('kind', 'names', 'units', 'bounds'),
    'observation': ('shape', 'dtype', 'names', 'columns', 'units')}


def read_interface(file: Path) -> dict[str, Any]:
    """
    Read the file beside a policy.

    :param file: JSON as of :func:`interface_of`, of which parts may be missing
    :raises ModelError: if it cannot be read, or holds something else
    """
    try:
        content = json.loads(file.read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise ModelError(f'{file} cannot be read: {error}') from error
    _check_keys(content, '', file)
    if content.get('format', INTERFACE_FORMAT) != INTERFACE_FORMAT:
        raise ModelError(f'{file} has the format {format_value(content["format"])}, not '
                         f'{INTERFACE_FORMAT}')
    if 'action' in content:
        _check_keys(content['action'], 'action', file)
    observed = content.get('observation', {})
    if not isinstance(observed, dict):
        raise ModelError(f'{file}: observation must be an object, by key')
    for described in observed.values():
        _check_keys(described, 'observation', file)
    return dict(content)


def _check_keys(content: Any, part: str, file: Path) -> None:
    if not isinstance(content, dict):
        raise ModelError(f'{file}: {part or "an interface"} must be an object')
    for key in content:
        if key not in _KNOWN[part]:
            raise ModelError(f'{file}: unknown key {quoted(key)}: '
                             + describe_choices(key, _KNOWN[part]))


def check_interface(expected: Mapping[str, Any], actual: Mapping[str, Any], source: str) -> None:
    """
    Reject a policy in episodes that have another rate, order or unit than it was made for.

    :param expected: of the policy, as :func:`read_interface` returns it; missing values may
        be anything, and episodes may observe more
    :param actual: of the episodes, as :func:`interface_of` returns it
    :param source: of the former, for the message
    :raises ModelError: with the first difference
    """
    for name, needed, present in _values(expected, actual):
        if isinstance(needed, list) and isinstance(present, list) and len(needed) == len(present):
            for index, (item, other) in enumerate(zip(needed, present)):
                _compare(f'{name}, number {index}', item, other, source)
        _compare(name, needed, present, source)


def _values(expected: Mapping[str, Any], actual: Mapping[str, Any]
            ) -> Iterator[tuple[str, Any, Any]]:
    """Yield the name of each compared value, its expected and its actual value."""
    if 'control_hz' in expected:
        yield 'control_hz', expected['control_hz'], actual['control_hz']
    for key, needed in expected.get('action', {}).items():
        yield f'{key} of actions', needed, actual['action'][key]
    for name, described in expected.get('observation', {}).items():
        present = actual['observation'].get(name)
        if present is None:
            yield f'observation {quoted(name)}', 'there', 'not there'
        else:
            for key, needed in described.items():
                yield f'{key} of {name}', needed, present.get(key)


def _compare(name: str, needed: Any, present: Any, source: str) -> None:
    same = needed == present or (
        isinstance(needed, (int, float)) and isinstance(present, (int, float))
        and abs(needed - present) <= 1e-6 * abs(present))
    if not same:
        raise ModelError(f'{source}: the policy was made for other episodes: {name}: it needs '
                         f'{format_value(needed, 100)}, this is {format_value(present, 100)}')
