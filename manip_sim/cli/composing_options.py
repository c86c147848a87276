# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Compose a world from options, through the parameters of the node; the origin of its parts."""

from __future__ import annotations

import argparse
import contextlib
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.interface.composition import (
    compose_arena, compose_world, Composition, declare_node, declare_parts)
from manip_sim.interface.parameter_spec import GivenParameters, read_parameters
from manip_sim.models import arenas
from manip_sim.models.arenas import Arena
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.physics.parts import find_parts
from manip_sim.quoting import quoted
from manip_sim.resources import PACKAGE, share_directory

#: The options with the values of the parameters of the same name.
_PARAMETERS = ('robot', 'gripper', 'base', 'arena', 'idn', 'prefix', 'position', 'orientation',
               'timestep', 'tactile', 'cameras')
#: Files of noise in the package, ``config/noise_NAME.yaml``.
_PROFILES = ('franka', 'ideal', 'ur')
_BOOL = {'true': True, 'false': False}


@dataclass(frozen=True)
class Composed:
    """
    The composition that the options describe.

    :ivar composition: the world, and the scope in which the node serves each robot
    :ivar parameters: those that the node needs for it
    """

    composition: Composition
    parameters: GivenParameters


def compose_from(options: argparse.Namespace) -> Composed:
    """
    Return the composition that the options describe.

    :raises ManipSimError: if a parameter cannot be used, or the parts do not fit together
    """
    parameters = GivenParameters(_given(options))
    composition = compose_world(parameters)
    world = composition.world
    # A world that cannot be controlled has no parts; it is reported later.
    with contextlib.suppress(ModelError):
        model = world.compile()
        parts = [find_parts(model, robot) for robot in world.robots]
        declare_parts(parameters, zip(composition.scopes, parts))
        parameters.check_names()
    return Composed(composition, parameters)


def arena_from(options: argparse.Namespace) -> Arena:
    """Return the arena that the options describe; raises as :func:`compose_from`."""
    values = _given(options)
    parameters = GivenParameters({name: value for name, value in values.items()
                                  if name not in ('robot', 'gripper', 'base', 'tactile')})
    declare_node(parameters)
    return compose_arena(parameters)


def _given(options: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters that the node needs for the same composition."""
    if options.params_file is not None:
        return read_parameters(options.params_file)
    values = {name: getattr(options, name) for name in _PARAMETERS
              if getattr(options, name) is not None}
    if options.no_gravity_compensation:
        values['gravity_compensation'] = False
    if options.object is not None:
        values['objects'] = options.object
    arena = options.arena or 'empty'
    known = {} if options.arena_param is None else arena_parameters(arena)
    for name, text in options.arena_param or ():
        if name not in known:
            raise UnknownNameError(f"parameter of arena '{arena}'", name, known)
        values[name if name == 'cube' else f'arena.{name}'] = _as(
            known[name], f'{arena}: {name}', text)
    return values


def arena_parameters(name: str) -> dict[str, Any]:
    """
    Return the parameters of an arena with their defaults.

    :raises UnknownNameError: if the arena is unknown
    """
    return {parameter.name: parameter.default for parameter in arenas.arena_parameters(name)}


def noise_parameters(name: str) -> dict[str, Any]:
    """Return the parameters of a profile of noise or of a file, UnknownNameError without both."""
    if name in _PROFILES:
        return read_parameters(share_directory() / 'config' / f'noise_{name}.yaml')
    if not Path(name).is_file():
        raise UnknownNameError('noise', name, _PROFILES)
    return read_parameters(Path(name))


def _as(default: bool | float, name: str, text: str) -> bool | float:
    """Return a text converted to the type of a default."""
    if isinstance(default, bool):
        if text.lower() not in _BOOL:
            raise ModelError(f'{name} must be true or false, got {quoted(text)}')
        return _BOOL[text.lower()]
    try:
        return float(text)
    except ValueError as error:
        raise ModelError(f'{name} must be a number, got {quoted(text)}') from error


def origin(part: MujocoXMLModel, kind: str) -> tuple[str, str]:
    """
    Return where a part comes from, and its file.

    :param kind: such as ``robots``
    :returns: ``manip_sim``, the entry point and distribution, the package, or the folder that
        declares it; and the file, relative to the share folder of ``manip_sim`` if it is in there
    """
    share, source = share_directory(), package_of(type(part), kind)
    if source != PACKAGE:
        return source, str(part.file)
    if part.file.is_relative_to(share):
        return PACKAGE, str(part.file.relative_to(share))
    return f'folder {part.file.parent}', part.file.name


def package_of(cls: type, kind: str) -> str:
    """Return the package of a class, with the entry point that offers it."""
    package = cls.__module__.partition('.')[0]
    if package == PACKAGE:
        return PACKAGE
    for entry in entry_points(group=f'{PACKAGE}.{kind}'):
        if entry.value.partition(':')[0].partition('.')[0] == package:
            source = f' of {entry.dist.name}' if entry.dist else ''
            return f'entry point {entry.name}{source}'
    return f'package {package}'
