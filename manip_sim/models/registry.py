# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find model classes by name: those already defined, and those that other packages offer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import importlib
import inspect
import logging
from os import PathLike
from pathlib import Path
import pkgutil
from typing import Any, Generic, TypeVar

from manip_sim.entry_points import Offer, offers
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.sources import find_source, names_in_folders

T = TypeVar('T')
_LOGGER = logging.getLogger('manip_sim.models')
#: The offers of other packages whose import is under way, the latest last.
_importing: list[Offer] = []


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
        self.kind = kind
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
        if _importing and self._is_another(name, cls):
            _LOGGER.warning('%s defines a %s %r, which is already registered and is kept',
                            _importing[-1], self.kind, name)
            return
        self._classes[name] = cls

    def _is_another(self, name: str, cls: type[T]) -> bool:
        there = self._classes.get(name)
        return there is not None and (there.__module__, there.__qualname__) != (
            cls.__module__, cls.__qualname__)

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
        if name in self._classes or name in offers(self._group):
            return None
        return find_source(name, self._folder)

    def get(self, name: str) -> type[T]:
        """
        Return the class of a name.

        :raises ModelError: if the class cannot be created by name, or another package offers it
            and it cannot be imported
        """
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
        """Create an instance of the class of a name; raises as :meth:`get` does."""
        create: Callable[..., T] = self.get(name)
        return create(**arguments)

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

    @property
    def _folder(self) -> str:
        return f'{self.kind}s'

    @property
    def _group(self) -> str:
        return f'manip_sim.{self._folder}'

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
        with _importing_from(offer):
            try:
                cls = offer.load()
            except ModelError as error:
                raise ModelError(f'{self.kind} {error}') from error.__cause__
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


@contextmanager
def _importing_from(offer: Offer) -> Iterator[None]:
    _importing.append(offer)
    try:
        yield
    finally:
        _importing.pop()


def import_submodules(package: str, path: list[str]) -> None:
    """Import every module of a package, which registers its classes."""
    for module in pkgutil.iter_modules(path):
        importlib.import_module(f'{package}.{module.name}')
