# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Arenas: floor, light and furniture; the world of a simulation before a robot is in it.

Every module here is imported, which registers its arenas.
"""

from __future__ import annotations

from collections.abc import Mapping
import inspect
from os import PathLike
from typing import Any

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.arenas.arena import Arena, ArenaParameter, ARENAS
from manip_sim.models.arenas.catalogue_arenas import BinsArena, EmptyArena, TableArena
from manip_sim.models.registry import check_no_parameters, import_submodules

import_submodules(__name__, __path__)


def arena_names() -> list[str]:
    """Return the names that :func:`create_arena` takes, also those in the user's folders."""
    return ARENAS.all_names()


def create_arena(name: str | PathLike[str], **parameters: Any) -> Arena:
    """
    Create an arena by its name, such as ``table``, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.registry.find_source`` takes
    :param parameters: as in the arena's :attr:`Arena.parameters`, by name or by the keyword of its
        constructor
    :raises UnknownNameError: if the arena or parameter is unknown, naming the nearest ones
    :raises ModelError: if a value is not within the limits of its parameter, a file cannot be
        used, or the arena of another package cannot be imported
    """
    file = ARENAS.find_file(name)
    if file is None:
        return ARENAS.create(str(name), **_arguments(str(name), parameters))
    check_no_parameters(name, parameters)
    return ARENAS.load_file(file)


def _arguments(name: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of an arena of the catalogue as keywords of its constructor."""
    kind = ARENAS.get(name)
    argument_of = {parameter.name: parameter.argument for parameter in kind.parameters}
    keywords = {name: keyword for name, keyword in inspect.signature(kind).parameters.items()
                if name != 'fname'}
    takes_any = any(keyword.kind is keyword.VAR_KEYWORD for keyword in keywords.values())
    arguments: dict[str, Any] = {}
    for key, value in parameters.items():
        argument = argument_of.get(key, key)
        if argument not in keywords and not takes_any:
            raise UnknownNameError(f'parameter of the arena {name}', key,
                                   argument_of or keywords)
        if argument in arguments:
            raise ModelError(f"parameter '{key}' of the arena {name} is given twice")
        arguments[argument] = value
    return arguments


def arena_parameters(name: str | PathLike[str]) -> tuple[ArenaParameter, ...]:
    """
    Return the parameters of an arena; one from a file has none.

    :param name: of the catalogue, or a file
    :raises UnknownNameError: if the arena is unknown, naming the nearest ones
    """
    if ARENAS.find_file(name) is not None:
        return ()
    return ARENAS.get(str(name)).parameters


__all__ = [
    'Arena', 'ArenaParameter', 'BinsArena', 'EmptyArena', 'TableArena', 'arena_names',
    'arena_parameters', 'create_arena']
