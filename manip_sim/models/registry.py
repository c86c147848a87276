# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Find models by name: classes, also those that other packages offer, or files.

Files are paths, those in folders of the user, Menagerie's and robosuite's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
import importlib
import importlib.util
import inspect
import logging
import os
from os import PathLike
from pathlib import Path
import pkgutil
import re
from typing import Any, Generic, TypeVar

from manip_sim.errors import ManipSimError, ModelError, UnknownNameError
from manip_sim.models.user_files import YAML_SUFFIXES
from manip_sim.quoting import one_line, quoted
from manip_sim.resources import Offer, offers
from manip_sim.validation import check_kind

T = TypeVar('T')
_LOGGER = logging.getLogger('manip_sim.models')
#: The offers of other packages whose import is under way, the latest last.
_importing: list[Offer] = []
#: Environment variable of the folders to add to the catalogue, separated as in PATH.
PATH_VARIABLE = 'MANIP_SIM_PATH'
#: Environment variables of the path of a checkout of google-deepmind/mujoco_menagerie; the package
#: reads the first.
MENAGERIE_VARIABLES = ('MENAGERIE_ROOT', 'MENAGERIE')
#: The remedy where models cannot be fetched.
_OFFLINE = ('without internet, bring a clone of '
            "https://github.com/google-deepmind/mujoco_menagerie and type 'export "
            "MENAGERIE_ROOT=FOLDER', or name its folder in model_path")
KINDS = ('robots', 'grippers', 'bases', 'arenas')
_SUFFIXES = (*YAML_SUFFIXES, '.xml', '.mjcf', '.urdf')
#: A xacro file, which arguments may follow.
_XACRO = re.compile(r'\.xacro(\s|$)', re.IGNORECASE)
_SCHEMES = ('menagerie:', 'robosuite:')
_INCLUDE = re.compile(r'<include\s+file\s*=\s*"([^"]+)"')
_model_path: list[Path] = []


class Registry(Generic[T]):
    """
    Classes of one kind by name; a class is registered when it is defined.

    Other packages offer theirs as entry points of the group ``manip_sim.{kind}s``. They are
    imported when they are requested by name, or when all names are listed. One that cannot be used
    does not hide the others, and none replaces a class that is registered already.

    :param kind: what the classes are, for messages: ``robot``, ``gripper``, ``base``, ``arena``
    :param takes: the keyword arguments with which a class is created by name
    :param key: returns the name of a class, or None if it cannot be created by name
    :ivar load_file: creates an instance from a file; set by what reads files of this kind
    """

    load_file: Callable[..., T]

    def __init__(self, kind: str, base: type[T], takes: tuple[str, ...] = ('idn',),
                 key: Callable[[type[T]], str | None] = lambda cls: cls.__name__) -> None:
        self.kind, self._folder, self._group = kind, f'{kind}s', f'manip_sim.{kind}s'
        self._base = base
        self._takes = takes
        self._key = key
        self._classes: dict[str, type[T]] = {}
        #: Reason why a class cannot be created by name, once that was asked; empty if it can.
        self._missing: dict[type[T], str] = {}
        #: By offer, the class, or the error of its import.
        self._loaded: dict[Offer, type[T] | ModelError] = {}

    def register(self, cls: type[T]) -> None:
        """Register a class; it replaces one of that name, unless another package offers it."""
        name = self._key(cls)
        if name is None:
            return
        there = self._classes.get(name, cls)
        if _importing and (there.__module__, there.__qualname__) != (
                cls.__module__, cls.__qualname__):
            _LOGGER.warning('%s defines a %s %r, which is already registered and is kept',
                            _importing[-1], self.kind, name)
            return
        self._classes[name] = cls

    def names(self) -> list[str]:
        """Return the names of all classes that can be created, sorted."""
        for name, offer in offers(self._group).items():
            first_time = offer not in self._loaded
            try:
                self._load(name, offer)
            except ModelError as error:
                if first_time:
                    _LOGGER.warning('%s', error)
        return sorted([name for name, cls in self._classes.items()
                       if self._is_public(name, cls) and not self._missing_arguments(cls)])

    def all_names(self) -> list[str]:
        """Return all names to create models by, also of files in the user's folders."""
        return sorted({*self.names(), *names_in_folders(self._folder)})

    def find_file(self, name: str | PathLike[str]) -> Path | None:
        """
        Return the file or folder that a name stands for; None if it is a class or unknown.

        Nothing is imported.
        """
        check_kind(name, (str, PathLike), self.kind, 'a name or a file')
        if name in self._classes or name in offers(self._group):
            return None
        return find_source(name, self._folder)

    def get(self, name: str) -> type[T]:
        """
        Return the class of a name.

        :raises ModelError: if the class cannot be created by name, or another package offers it
            and it cannot be imported
        """
        check_kind(name, (str, PathLike), self.kind, 'a name')
        if name not in self._classes:
            offer = offers(self._group).get(name)
            if offer is not None:
                return self._load(name, offer)
        cls = self._classes.get(name)
        if cls is None or not self._is_public(name, cls):
            raise UnknownNameError(self.kind, name, self.all_names())
        missing = self._missing_arguments(cls)
        if missing:
            raise ModelError(f"{self.kind} '{name}' cannot be created by its name: {missing}")
        return cls

    def create(self, name: str, /, **arguments: Any) -> T:
        """
        Create an instance of the class of a name.

        :raises ModelError: as :meth:`get` does, and if a class of another package raises anything
        """
        create: Callable[..., T] = self.get(name)
        try:
            return create(**arguments)
        except ManipSimError:
            raise
        except Exception as error:
            offer = offers(self._group).get(name)
            if self._loaded.get(offer) is not create:  # type: ignore[arg-type]
                raise
            raise ModelError(f'{self.kind} {offer} cannot be created: {type(error).__name__}: '
                             f'{one_line(str(error))}') from error

    def create_or_load(self, name: str | PathLike[str], **arguments: Any) -> T:
        """Create a model by its name, as :meth:`create` does, or from the file it stands for."""
        file = self.find_file(name)
        return (self.create(str(name), **arguments) if file is None
                else self.load_file(file, **arguments))

    def attribute(self, module: str, name: str) -> type[T]:
        """Return the class of a name as an attribute of a module, for its ``__getattr__``."""
        try:
            if not name.startswith('_'):
                return self.get(name)
        except UnknownNameError:
            pass
        except ModelError as error:
            raise AttributeError(f"module '{module}' has no '{name}': {error}") from error
        raise AttributeError(f"module '{module}' has no attribute '{name}'")

    def _load(self, name: str, offer: Offer) -> type[T]:
        if offer not in self._loaded:
            # The answer to a module that requests its own name while it is imported.
            self._loaded[offer] = ModelError(f'{self.kind} {offer} is being imported')
            try:
                self._loaded[offer] = self._import(name, offer)
            except ModelError as error:
                self._loaded[offer] = error
        cls = self._loaded[offer]
        if isinstance(cls, ModelError):
            raise ModelError(str(cls)) from cls.__cause__
        self._classes.setdefault(name, cls)
        return cls

    def _import(self, name: str, offer: Offer) -> type[T]:
        _importing.append(offer)
        try:
            cls = offer.load()
        except ModelError as error:
            raise ModelError(f'{self.kind} {error}') from error.__cause__
        finally:
            _importing.pop()
        if not (inspect.isclass(cls) and issubclass(cls, self._base)):
            raise ModelError(f'{self.kind} {offer} must be a class that derives from '
                             f'{self._base.__name__}, got {cls!r:.60}')
        missing = self._missing_arguments(cls)
        if missing or not self._is_public(name, cls):
            raise ModelError(f'{self.kind} {offer} cannot be created by its name: '
                             f'{missing or "it is abstract or private"}')
        if self._classes.get(name, cls) is not cls:
            raise ModelError(f'{self.kind} {offer} is ignored: that name is registered already')
        return cls

    @staticmethod
    def _is_public(name: str, cls: type[T]) -> bool:
        return not (name.startswith('_') or inspect.isabstract(cls))

    def _missing_arguments(self, cls: type[T]) -> str:
        """Return why a class cannot be created by name; empty if it can."""
        if cls not in self._missing:
            takes = ', '.join(self._takes) or 'no argument'
            self._missing[cls] = ''
            try:
                inspect.signature(cls).bind(**dict.fromkeys(self._takes))
            except (TypeError, ValueError) as error:
                self._missing[cls] = (f'its constructor must take {takes}, and have defaults for '
                                      f'all else ({error})')
        return self._missing[cls]


def import_submodules(package: str, path: list[str]) -> None:
    """Import every module of a package, which registers its classes."""
    for module in pkgutil.iter_modules(path):
        importlib.import_module(f'{package}.{module.name}')


def set_model_path(folders: Iterable[str | os.PathLike[str]]) -> None:
    """
    Add the models in folders to the catalogue, before the folders of ``MANIP_SIM_PATH``.

    In a folder, ``robots/NAME.yaml``, ``robots/NAME.xml``, ``robots/NAME.urdf`` or a folder
    ``robots/NAME`` with such a file or ``robot.yaml`` is the robot ``NAME``; likewise
    ``grippers``, ``bases`` and ``arenas``.

    :param folders: they replace the folders of the last call
    :raises ModelError: if one is not a folder
    """
    paths = [Path(folder).expanduser() for folder in folders]
    for folder in paths:
        if not folder.is_dir():
            raise ModelError(f'no such folder in the model path: {folder}')
    _model_path[:] = paths


def model_path() -> list[Path]:
    """
    Return the folders whose models are in the catalogue.

    :raises ModelError: if one of ``MANIP_SIM_PATH`` is not a folder
    """
    of_environment = [Path(folder).expanduser() for folder in
                      os.environ.get(PATH_VARIABLE, '').split(os.pathsep) if folder]
    for folder in of_environment:
        if not folder.is_dir():
            raise ModelError(f'no such folder in {PATH_VARIABLE}: {folder}')
    return [*_model_path, *of_environment]


def names_in_folders(kind: str) -> dict[str, Path]:
    """
    Return the models of the user's folders by name; of equal names that of the first folder.

    :param kind: ``robots``, ``grippers``, ``bases`` or ``arenas``
    """
    models: dict[str, Path] = {}
    for folder in model_path():
        if not (folder / kind).is_dir():
            continue
        # Descriptions come before the models that they describe.
        for entry in sorted((folder / kind).iterdir(), key=lambda entry: (
                [*_SUFFIXES, entry.suffix].index(entry.suffix), entry.name)):
            if entry.is_dir() and _of_folder(entry, kind) is not None:
                models.setdefault(entry.name, entry)
            elif entry.is_file() and entry.suffix in _SUFFIXES:
                models.setdefault(entry.stem, entry)
    return models


def _of_folder(folder: Path, kind: str) -> Path | None:
    names = [f'{kind[:-1]}{suffix}' for suffix in YAML_SUFFIXES]
    names += [f'{folder.name}{suffix}' for suffix in _SUFFIXES]
    return next((folder / name for name in names if (folder / name).is_file()), None)


def find_source(name: str | os.PathLike[str], kind: str) -> Path | None:
    """
    Return the file or folder that a name stands for; None if it is none of the following.

    :param name: a path (a string with a slash, or ending as models and descriptions do),
        ``menagerie:NAME``, ``menagerie:NAME/FILE.xml``, ``robosuite:NAME``, or a name of the
        user's folders
    :param kind: ``robots``, ``grippers``, ``bases`` or ``arenas``
    :raises ModelError: if a package or a folder that it needs is missing, or it is ambiguous
    :raises UnknownNameError: if Menagerie or robosuite has no such model, naming the nearest
    """
    if not isinstance(name, str):
        return Path(name)
    scheme, colon, rest = name.partition(':')
    if colon and scheme == 'menagerie':
        return _of_menagerie(rest)
    if colon and scheme == 'robosuite':
        return _of_robosuite(rest, kind)
    if is_path(name):
        return Path(name)
    return names_in_folders(kind).get(name)


def _of_menagerie(name: str) -> Path:
    model, _, file = name.partition('/')
    checkout = _checkout_of_menagerie(model)
    if checkout is None:
        folder, file = _of_menagerie_package(model, file)
    else:
        folder = checkout
    if not file:
        return _main_file(folder)
    if not (folder / file).is_file():
        raise UnknownNameError(f'file of menagerie:{model}', file,
                               sorted(entry.name for entry in folder.glob('*.xml')))
    return folder / file


def _checkout_of_menagerie(model: str) -> Path | None:
    """Return the folder of a model in a checkout; None if no checkout has it."""
    for variable in MENAGERIE_VARIABLES:
        root = os.environ.get(variable)
        if root:
            folder = Path(root).expanduser()
            if not folder.is_dir():
                raise ModelError(f'no such folder in {variable}: {folder}')
            folders = {entry.name: entry for entry in sorted(folder.iterdir())
                       if entry.is_dir() and any(entry.glob('*.xml'))}
            if model not in folders:
                raise UnknownNameError(f'model of {variable} ({root})', model, folders)
            return folders[model]
    for folder in model_path():
        for place in (folder / model, folder / 'mujoco_menagerie' / model):
            if model and place.is_dir() and any(place.glob('*.xml')):
                return place
    return None


def _of_menagerie_package(model: str, file: str) -> tuple[Path, str]:
    if importlib.util.find_spec('mujoco_menagerie') is None:
        raise ModelError(f'menagerie:{model} needs the package mujoco-menagerie, or a checkout '
                         f"of Menagerie in {MENAGERIE_VARIABLES[0]}: type 'pip install "
                         f"mujoco-menagerie'; {_OFFLINE}")
    package: Any = importlib.import_module('mujoco_menagerie')
    if model not in package.names():
        raise UnknownNameError('model of mujoco_menagerie', model, package.names())
    try:
        entry = package.get(model)
        return Path(entry.path()), file or entry.entry(entry.default_model).file
    except Exception as error:
        remedy = f'; {_OFFLINE}' if type(error).__name__ == 'DownloadError' else ''
        raise ModelError(f'menagerie:{model} cannot be loaded: '
                         f'{one_line(str(error), 200)}{remedy}') from error


def _main_file(folder: Path) -> Path:
    """Return the model of a Menagerie folder: that of its scene, the only one, or its namesake."""
    models = sorted(file.name for file in folder.glob('*.xml')
                    if not file.stem.startswith('scene'))
    scene = folder / 'scene.xml'
    if scene.is_file():
        included: list[str] = [name for name in models if name in _INCLUDE.findall(
            scene.read_text(errors='replace'))]
        if included:
            return folder / included[0]
    likely = [name for name in models if name.removesuffix('.xml') == folder.name]
    for candidates in (models, likely):
        if len(candidates) == 1:
            return folder / candidates[0]
    raise ModelError(f'menagerie:{folder.name} has several models, say which: '
                     + ' or '.join(f'menagerie:{folder.name}/{name}' for name in models))


def _of_robosuite(name: str, kind: str) -> Path:
    files: dict[str, Path] = {}
    for package, assets in (('robosuite', 'models/assets'), ('robosuite_models', 'assets')):
        # Importing them would load their simulator as well.
        spec = importlib.util.find_spec(package)
        for place in (spec.submodule_search_locations or []) if spec is not None else []:
            folder = Path(place) / assets / kind
            pattern = '*/robot.xml' if kind == 'robots' else '*.xml'
            files.update({file.parent.name if kind == 'robots' else file.stem: file
                          for file in sorted(folder.glob(pattern))})
    if not files:
        raise ModelError(f'robosuite:{name} needs the package robosuite or robosuite_models')
    for known, file in files.items():
        if _letters(known) == _letters(name):
            return file
    raise UnknownNameError(f'{kind[:-1]} of robosuite', name, files)


def _letters(name: str) -> str:
    """Return a name in a form that is the same for ``PandaGripper`` and ``panda_gripper``."""
    return ''.join(character for character in name.lower() if character.isalnum())


def is_of_others(name: str) -> bool:
    """Return whether a name is one of Menagerie or robosuite."""
    return name.startswith(_SCHEMES)


def is_path(name: str) -> bool:
    """Return whether a name is a path: it has a slash, or ends as models and descriptions do."""
    return not is_of_others(name) and (
        '/' in name or os.sep in name or Path(name).suffix.lower() in _SUFFIXES
        or _XACRO.search(name) is not None)


def check_no_parameters(name: object, parameters: Any) -> None:
    """Reject parameters for a model from a file."""
    if parameters:
        raise ModelError(f'{quoted(name)} is a file, which takes no parameters, '
                         f'got {", ".join(parameters)}')
