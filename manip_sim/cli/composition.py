# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Make a world of the options of a command line."""

from __future__ import annotations

import argparse
from typing import Any

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import arenas, compose, World
from manip_sim.models.arenas import Arena, create_arena
from manip_sim.models.composing import DEFAULT, NONE
from manip_sim.models.robots import robot_names
from manip_sim.quoting import quoted
from manip_sim.simulation.camera_choice import described_cameras

#: The options, and what each is where it is not given.
_DEFAULTS = {'robot': 'Panda', 'gripper': DEFAULT, 'base': DEFAULT, 'arena': 'empty', 'idn': '0',
             'prefix': '', 'position': None, 'orientation': None, 'timestep': 0.002,
             'arena_param': (), 'no_gravity_compensation': False, 'cameras': ()}
_BOOL = {'true': True, 'false': False}


def value_of(options: argparse.Namespace, name: str) -> Any:
    """Return the value of an option, or its default."""
    value = getattr(options, name)
    return _DEFAULTS[name] if value is None else value


def compose_from(options: argparse.Namespace) -> World:
    """
    Return the world that the options ask for.

    :raises UnknownNameError: if a name is not known
    :raises ModelError: if a parameter has a wrong value, or the parts do not fit together
    """
    def value(name: str) -> Any:
        return value_of(options, name)

    if value('robot') == NONE:
        raise UnknownNameError('robot', NONE, robot_names())
    return compose(
        value('robot'), value('gripper'), value('base'), arena_from(options), idn=value('idn'),
        prefix=value('prefix'), position=value('position'), orientation=value('orientation'),
        timestep_s=value('timestep'), gravity_compensation=not value('no_gravity_compensation'),
        cameras=described_cameras(value('cameras')))


def arena_from(options: argparse.Namespace) -> Arena:
    """Return the arena that the options ask for; raises as :func:`compose_from`."""
    name = value_of(options, 'arena')
    return create_arena(name, **arena_values(options))


def arena_values(options: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters of the arena that are given; raises as :func:`compose_from`."""
    given = value_of(options, 'arena_param')
    if not given:
        return {}
    name = value_of(options, 'arena')
    known = arena_parameters(name)
    values = {}
    for parameter, text in given:
        if parameter not in known:
            raise UnknownNameError(f"parameter of arena '{name}'", parameter, known)
        values[parameter] = _as(known[parameter], f'{name}: {parameter}', text)
    return values


def arena_parameters(name: str) -> dict[str, Any]:
    """
    Return the parameters of an arena with their defaults.

    :raises UnknownNameError: if there is no such arena
    """
    return {parameter.name: parameter.default for parameter in arenas.arena_parameters(name)}


def _as(default: Any, name: str, text: str) -> Any:
    """Return what a text says, as the type of a default."""
    if isinstance(default, bool):
        if text.lower() not in _BOOL:
            raise ModelError(f'{name} must be true or false, got {quoted(text)}')
        return _BOOL[text.lower()]
    if isinstance(default, (int, float)):
        try:
            return type(default)(text)
        except ValueError as error:
            raise ModelError(f'{name} must be a number, got {quoted(text)}') from error
    return text
