# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the model and the description that belong together."""

from __future__ import annotations

import logging
from pathlib import Path

from manip_sim.errors import ModelError
from manip_sim.models.files.part_descriptions import (
    ArenaDescription, describes_model, Description, DescriptionT, read_description,
    RobotDescription)
from manip_sim.models.files.xacro_expansion import split_arguments, stem_of, SUFFIX
from manip_sim.models.regular_files import Files
from manip_sim.models.sources import find_source, is_of_others, is_path
from manip_sim.quoting import one_line

YAML = ('.yaml', '.yml')
MODELS = ('.xml', '.mjcf', '.urdf', SUFFIX)


def find_model(path: Path, kind: type[DescriptionT], stem: str, files: Files | None = None
               ) -> tuple[Path, DescriptionT, str]:
    """
    Return the file of a model, its description, and the file that the latter was read from.

    A model ``panda.xml`` is described by ``panda.yaml`` beside it, or by a file of a fixed name,
    such as ``robot.yaml``, that names it or has no other model beside it.

    :param path: a model, a YAML file, or a folder; arguments may follow the name of a xacro file;
        or a name of Menagerie or robosuite, as for ``find_source``
    :param stem: the fixed name of a YAML file, without its suffix, such as ``robot``
    :raises ModelError: if a file is missing, or it is not clear which one is meant
    """
    try:
        if files is None and is_of_others(str(path)):
            path = find_source(str(path), f'{stem}s') or path
        file, arguments = split_arguments(str(path))
        found, description, where = _find(Path(file).expanduser(), kind, stem, files)
        if arguments:
            description.xacro_args = {**description.xacro_args, **arguments}
        return found, description, where
    except (OSError, RuntimeError) as error:
        raise ModelError(f'cannot read {one_line(str(path), 200)}: '
                         f'{getattr(error, "strerror", None) or error}') from error


def _find(path: Path, kind: type[DescriptionT], stem: str, files: Files | None
          ) -> tuple[Path, DescriptionT, str]:
    at = files or Files()
    if at.is_folder(path):
        path = _in_folder(path, stem, at)
    if not at.is_file(path):
        raise ModelError(f'no such file: {one_line(str(path), 200)}')
    if path.suffix.lower() in YAML:
        description = _described(path, kind, files)
        return _model_of(path, description, stem, at), description, str(path)
    if path.suffix.lower() not in MODELS:
        raise ModelError(f'{path} is neither a model ({", ".join(MODELS)}) nor a description '
                         f'({", ".join(YAML)})')
    for name in (stem_of(path), stem):
        for suffix in YAML:
            beside = path.with_name(name + suffix)
            if not at.is_file(beside):
                continue
            if not describes_model(beside, kind, files):
                logging.getLogger(__name__).warning(
                    '%s is not read: it has no key of a description, such as %s', beside,
                    next(iter(kind.model_fields)))
                continue
            description = _described(beside, kind, files)
            if _model_of(beside, description, stem, at).resolve() == path.resolve():
                return path, description, str(beside)
    return path, kind(), str(path)


def _described(file: Path, kind: type[DescriptionT], files: Files | None) -> DescriptionT:
    """Read a description; relative paths of other files in it start from its folder."""
    description = read_description(file, kind, files)
    if isinstance(description, RobotDescription):
        for part in (*description.by_arm.values(), description):
            key = 'base' if part is description else 'gripper'
            named = getattr(part, key)
            if named is not None and is_path(named):
                setattr(part, key, str(file.parent / Path(named).expanduser()))
    return description


def _in_folder(folder: Path, stem: str, files: Files) -> Path:
    names = [*(stem + suffix for suffix in YAML),
             *(name + suffix for name in (folder.name, stem) for suffix in (*YAML, *MODELS))]
    for name in names:
        if files.is_file(folder / name):
            return folder / name
    models = _models_in(folder, files)
    # In Menagerie, a scene includes the model, and adds floor and light.
    apart = [file for file in models if not file.stem.startswith('scene')]
    for candidates in (models, apart):
        if len(candidates) == 1:
            return candidates[0]
    found = ', '.join(file.name for file in models[:5]) or 'no model'
    raise ModelError(f'{folder} has neither {stem}.yaml nor {folder.name}.xml nor one model '
                     f'alone, but {found}')


def _models_in(folder: Path, files: Files) -> list[Path]:
    """Return the models in a folder; of xacro files those that are whole robots by their name."""
    return [file for file in files.listed(folder) if file.suffix.lower() in MODELS
            and not (file.suffix.lower() == SUFFIX and stem_of(file) == file.stem)]


def _model_of(file: Path, description: Description, stem: str, files: Files) -> Path:
    """Return the model that a YAML file describes."""
    if description.model is not None:
        model = file.parent / Path(description.model).expanduser()
        if not files.is_file(model):
            raise ModelError(f"'model' of {file}: no such file: {model}{files.rule}")
        return model
    if isinstance(description, ArenaDescription) and description.arena is not None:
        return file
    for suffix in (*MODELS, f'.urdf{SUFFIX}'):
        if files.is_file(file.with_suffix(suffix)):
            return file.with_suffix(suffix)
    models = _models_in(file.parent, files) if file.stem == stem else []
    if len(models) == 1:
        return models[0]
    if isinstance(description, ArenaDescription) and description.has_parts:
        return file
    raise ModelError(f"{file} must say which 'model' it describes: there is no "
                     f'{file.with_suffix(".xml").name} beside it')
