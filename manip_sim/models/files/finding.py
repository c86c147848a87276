# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the model and the description that belong together."""

from __future__ import annotations

from pathlib import Path

from manip_sim.errors import ModelError
from manip_sim.models.files.part_descriptions import (
    Description, DescriptionT, read_description, RobotDescription)
from manip_sim.models.sources import is_path
from manip_sim.quoting import one_line

YAML = ('.yaml', '.yml')
MODELS = ('.xml', '.mjcf', '.urdf')


def find_model(path: Path, kind: type[DescriptionT], stem: str) -> tuple[Path, DescriptionT, str]:
    """
    Return the file of a model, its description, and the file that the latter was read from.

    A model ``panda.xml`` is described by ``panda.yaml`` beside it, or by a file of a fixed name,
    such as ``robot.yaml``, that names it or has no other model beside it.

    :param path: a model, a YAML file, or a folder
    :param kind: the type of the description
    :param stem: the fixed name of a YAML file, without its suffix, such as ``robot``
    :raises ModelError: if a file is missing, or it is not clear which one is meant
    """
    try:
        return _find(path.expanduser(), kind, stem)
    except (OSError, RuntimeError) as error:
        raise ModelError(f'cannot read {one_line(str(path), 200)}: '
                         f'{getattr(error, "strerror", None) or error}') from error


def _find(path: Path, kind: type[DescriptionT], stem: str) -> tuple[Path, DescriptionT, str]:
    if path.is_dir():
        path = _in_folder(path, stem)
    if not path.is_file():
        raise ModelError(f'no such file: {one_line(str(path), 200)}')
    if path.suffix.lower() in YAML:
        description = _described(path, kind)
        return _model_of(path, description, stem), description, str(path)
    if path.suffix.lower() not in MODELS:
        raise ModelError(f'{path} is neither a model ({", ".join(MODELS)}) nor a description '
                         f'({", ".join(YAML)})')
    for name in (path.stem, stem):
        for suffix in YAML:
            beside = path.with_name(name + suffix)
            if not beside.is_file():
                continue
            description = _described(beside, kind)
            if _model_of(beside, description, stem).resolve() == path.resolve():
                return path, description, str(beside)
    return path, kind(), str(path)


def _described(file: Path, kind: type[DescriptionT]) -> DescriptionT:
    """Read a description; relative paths of other files in it start from its folder."""
    description = read_description(file, kind)
    if isinstance(description, RobotDescription):
        for part in (*description.by_arm.values(), description):
            key = 'base' if part is description else 'gripper'
            named = getattr(part, key)
            if named is not None and is_path(named):
                setattr(part, key, str(file.parent / Path(named).expanduser()))
    return description


def _in_folder(folder: Path, stem: str) -> Path:
    names = [*(stem + suffix for suffix in YAML),
             *(name + suffix for name in (folder.name, stem) for suffix in (*YAML, *MODELS))]
    for name in names:
        if (folder / name).is_file():
            return folder / name
    models = sorted(file for file in folder.iterdir() if file.suffix.lower() in MODELS)
    if len(models) == 1:
        return models[0]
    found = ', '.join(file.name for file in models[:5]) or 'no model'
    raise ModelError(f'{folder} has neither {stem}.yaml nor {folder.name}.xml nor one model '
                     f'alone, but {found}')


def _model_of(file: Path, description: Description, stem: str) -> Path:
    """Return the model that a YAML file describes."""
    if description.model is not None:
        model = file.parent / Path(description.model).expanduser()
        if not model.is_file():
            raise ModelError(f"'model' of {file}: no such file: {model}")
        return model
    for suffix in MODELS:
        if file.with_suffix(suffix).is_file():
            return file.with_suffix(suffix)
    models = sorted(other for other in file.parent.iterdir()
                    if other.suffix.lower() in MODELS and file.stem == stem)
    if len(models) == 1:
        return models[0]
    raise ModelError(f"{file} must say which 'model' it describes: there is no "
                     f'{file.with_suffix(".xml").name} beside it')
