# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A part of the catalogue: a folder of ``assets`` with an MJCF file and a ``part.yaml``."""

from __future__ import annotations

import functools
import os
from pathlib import Path
from typing import Any, ClassVar

import mujoco

from manip_sim.errors import UnknownNameError
from manip_sim.models.loading import load_spec
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.strict_yaml import read_yaml
from manip_sim.resources import asset_path


class FromYaml:
    """A class attribute that is read from ``part.yaml`` when it is first needed."""

    def __init__(self, key: str, default: Any) -> None:
        self.key = key
        self.default = default

    def __get__(self, part: CatalogueModel | None, owner: type[CatalogueModel]) -> Any:
        return owner.data().get(self.key, self.default) if owner._folder else self.default


class CatalogueModel(MujocoXMLModel):
    """
    A part whose class is created with a ``folder`` of ``assets``; the numbers are in it.

    ``part.yaml`` has the keys of descriptions of users' files, and a few more. A folder without
    one has only what its MJCF file says.

    :param idn: number or word in the prefix
    """

    #: Place of its folder: ``robots``, ``grippers`` or ``bases``, and the folder.
    _kind: ClassVar[str]
    _folder: ClassVar[str] = ''
    #: Content of ``part.yaml``, of each class once it is read.
    _data: ClassVar[dict[str, Any]]
    #: The MJCF file, relative to the folder; by default it is named like the folder.
    _model = FromYaml('model', None)

    def __init_subclass__(cls, folder: str = '', **kwargs: Any) -> None:
        cls._folder = folder or cls._folder
        super().__init_subclass__(**kwargs)

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(self.model_file(), idn=idn)

    def _read(self) -> mujoco.MjSpec:
        # Reading files would be half of composing a Panda (28 ms, 16 without).
        return _load(self.file).copy()

    @classmethod
    def model_file(cls) -> Path:
        """Return the MJCF file."""
        file = asset_path(cls._kind, cls._folder)
        return file if cls._model is None else Path(os.path.normpath(file.parent / cls._model))

    @classmethod
    def data(cls) -> dict[str, Any]:
        """
        Return what ``part.yaml`` says.

        :raises ModelError: if the file cannot be read
        :raises UnknownNameError: if it has a key that no attribute of the class reads
        """
        if '_data' not in vars(cls):
            cls._data = _read(
                asset_path(cls._kind, cls._folder).with_name('part.yaml'),
                {attribute.key for base in cls.__mro__ for attribute in vars(base).values()
                 if isinstance(attribute, FromYaml)})
        return cls._data


@functools.cache
def _load(file: Path) -> mujoco.MjSpec:
    return load_spec(file)


def _read(file: Path, keys: set[str]) -> dict[str, Any]:
    values = read_yaml(file) if file.is_file() else {}
    for key in values:
        if key not in keys:
            raise UnknownNameError(f'key of {file}', key, keys)
    return values
