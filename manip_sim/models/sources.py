# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find models that are not classes: paths, user's folders, Menagerie's and robosuite's."""

from __future__ import annotations

from collections.abc import Iterable
import importlib
import importlib.util
import os
from pathlib import Path
import re
from typing import Any

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.quoting import one_line, quoted

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
_YAML = ('.yaml', '.yml')
_SUFFIXES = (*_YAML, '.xml', '.mjcf', '.urdf')
#: A xacro file, which arguments may follow.
_XACRO = re.compile(r'\.xacro(\s|$)', re.IGNORECASE)
_SCHEMES = ('menagerie:', 'robosuite:')
_INCLUDE = re.compile(r'<include\s+file\s*=\s*"([^"]+)"')

_model_path: list[Path] = []


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
        for entry in sorted((folder / kind).iterdir(), key=_rank):
            if entry.is_dir() and _of_folder(entry, kind) is not None:
                models.setdefault(entry.name, entry)
            elif entry.is_file() and entry.suffix in _SUFFIXES:
                models.setdefault(entry.stem, entry)
    return models


def _rank(entry: Path) -> tuple[int, str]:
    """Return a key that sorts descriptions before the models that they describe."""
    is_suffix = entry.suffix in _SUFFIXES
    return (_SUFFIXES.index(entry.suffix) if is_suffix else len(_SUFFIXES), entry.name)


def _of_folder(folder: Path, kind: str) -> Path | None:
    names = [f'{kind[:-1]}{suffix}' for suffix in _YAML]
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
            folders = {entry.name: entry for entry in sorted(_folders_of(Path(root), variable))}
            if model not in folders:
                raise UnknownNameError(f'model of {variable} ({root})', model, folders)
            return folders[model]
    for folder in model_path():
        for place in (folder / model, folder / 'mujoco_menagerie' / model):
            if model and place.is_dir() and any(place.glob('*.xml')):
                return place
    return None


def _folders_of(root: Path, variable: str) -> list[Path]:
    root = root.expanduser()
    if not root.is_dir():
        raise ModelError(f'no such folder in {variable}: {root}')
    return [entry for entry in root.iterdir() if entry.is_dir() and any(entry.glob('*.xml'))]


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
