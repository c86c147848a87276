# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find model classes by name; a class that is defined is a class that can be created."""

from __future__ import annotations

from collections.abc import Iterable
import importlib
import inspect
import pkgutil
from typing import Generic, TypeVar

from manip_sim.errors import UnknownNameError

T = TypeVar('T')


class Registry(Generic[T]):
    """
    Classes of one kind, by class name.

    :param kind: what the classes are, for messages: ``robot``, ``gripper``, ``base``
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._classes: dict[str, type[T]] = {}

    def register(self, cls: type[T]) -> None:
        """Make a class known under its name; a later class of that name replaces it."""
        self._classes[cls.__name__] = cls

    def names(self) -> list[str]:
        """Return the names of all classes that can be created, sorted."""
        return sorted(n for n, cls in self._classes.items() if not inspect.isabstract(cls))

    def get(self, name: str, available: Iterable[str] = ()) -> type[T]:
        """
        Return the class of a name.

        :param available: other names that exist, for the message
        :raises UnknownNameError: naming the nearest ones
        """
        if name not in self.names():
            raise UnknownNameError(self.kind, name, sorted({*self.names(), *available}))
        return self._classes[name]


def import_submodules(package: str, path: list[str]) -> None:
    """
    Import every module of a package, so that the classes in it are registered.

    :param package: the package's name
    :param path: the package's ``__path__``
    """
    for module in pkgutil.iter_modules(path):
        importlib.import_module(f'{package}.{module.name}')
