# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim list``: robots, grippers, bases, arenas and objects, and where they come from."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from typing import Any

import mujoco
import numpy as np

from manip_sim.cli.composition import arena_parameters
from manip_sim.cli.parser import KINDS
from manip_sim.cli.tables import number, table, terminal_width
from manip_sim.models import arena_names, create_arena
from manip_sim.models.bases import base_names, create_base, MobileBaseModel
from manip_sim.models.grippers import create_gripper, gripper_names
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.robots import create_robot, ManipulatorModel, robot_names
from manip_sim.quoting import one_line
from manip_sim.resources import PACKAGE, share_directory

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
Row = tuple[str, ...]


def run(options: argparse.Namespace) -> tuple[str, int]:
    """Return tables of all kinds or one, and 1 if a part cannot be created."""
    kinds = KINDS if options.kind is None else (options.kind,)
    failed: list[str] = []
    texts = [_ROWS[kind](kind, failed) for kind in kinds]
    where = f'Files of {PACKAGE} lie in {share_directory()}'
    return '\n\n'.join([*texts, where]), int(bool(failed))


def origin(part: MujocoXMLModel, kind: str) -> tuple[str, str]:
    """
    Return where a part comes from, and its file.

    :param kind: such as ``robots``
    :returns: ``manip_sim``, the entry point and distribution, the package, or the folder that
        declares it; and the file, below the folder of the package's own assets where it is there
    """
    package = type(part).__module__.partition('.')[0]
    share = share_directory()
    if package != PACKAGE:
        for entry in entry_points(group=f'{PACKAGE}.{kind}'):
            if entry.value.partition(':')[0].partition('.')[0] == package:
                source = f' of {entry.dist.name}' if entry.dist else ''
                return f'entry point {entry.name}{source}', str(part.file)
        return f'package {package}', str(part.file)
    if part.file.is_relative_to(share):
        return PACKAGE, str(part.file.relative_to(share))
    return f'folder {part.file.parent}', part.file.name


def _create(kind: str, names: list[str], create: Callable[[str], Any], failed: list[str]
            ) -> Iterator[tuple[str, Any]]:
    """Yield the parts by name; for one that cannot be created, the reason."""
    for name in names:
        try:
            yield name, create(name)
        except Exception as error:  # A class of another package may raise anything.
            failed.append(name)
            yield name, one_line(f'cannot be created: {type(error).__name__}: {error}')


def _parts(kind: str, failed: list[str], names: list[str], create: Callable[[str], Any],
           header: Row, tell: Callable[[str, Any], Row]) -> str:
    rows: list[Row] = []
    for name, part in _create(kind, names, create, failed):
        if isinstance(part, str):
            rows.append((name, *['-'] * len(header), '-', part))
        else:
            rows.append((name, *tell(name, part), *origin(part, kind)))
    return table(kind.capitalize(), ('name', *header, 'from', 'file'), rows, terminal_width())


def _robots(kind: str, failed: list[str]) -> str:
    def tell(_: str, robot: Any) -> Row:
        has_arms = isinstance(robot, ManipulatorModel)
        grippers = dict.fromkeys(robot.default_gripper.values()) if has_arms else {}
        arms = len(robot.arms) if has_arms else 0
        return (str(arms), str(len(robot.joints)), ', '.join(grippers) or '-',
                robot.default_base or '-')
    return _parts(kind, failed, robot_names(), create_robot,
                  ('arms', 'joints', 'default gripper', 'default base'), tell)


def _grippers(kind: str, failed: list[str]) -> str:
    def tell(_: str, gripper: Any) -> Row:
        return str(len(gripper.joints)), str(len(gripper.actuators)), str(gripper.dof)
    return _parts(kind, failed, gripper_names(), create_gripper,
                  ('joints', 'actuators', 'length of actions'), tell)


def _bases(kind: str, failed: list[str]) -> str:
    def tell(_: str, base: Any) -> Row:
        kind_of_base = 'mobile' if isinstance(base, MobileBaseModel) else 'mount'
        return kind_of_base, str(len(base.joints))
    return _parts(kind, failed, base_names(), create_base, ('kind', 'joints'), tell)


def _arenas(kind: str, failed: list[str]) -> str:
    def tell(name: str, _: Any) -> Row:
        return (', '.join(f'{parameter}={str(default).lower()}' for parameter, default
                          in arena_parameters(name).items()) or '-',)
    return _parts(kind, failed, arena_names(), create_arena, ('parameters and defaults',), tell)


def _objects(kind: str, failed: list[str]) -> str:
    """Tell the free bodies of each arena, also those that a switch of the arena puts there."""
    rows: list[Row] = []
    for name in arena_names():
        switches = [key for key, default in arena_parameters(name).items() if default is False]
        present = free_bodies(create_arena(name).compile())
        everything = create_arena(name, **dict.fromkeys(switches, True))
        for body, mass in free_bodies(everything.compile()).items():
            how = '' if body in present else ', '.join(f'{switch}=true' for switch in switches)
            rows.append((body, number(mass), name, how or '-', *origin(everything, 'arenas')))
    return table(kind.capitalize(), ('name', 'mass kg', 'arena', 'parameters', 'from', 'file'),
                 rows, terminal_width())


def free_bodies(model: Any) -> dict[str, float]:
    """Return the bodies of a model with free joints, and their masses [kg]."""
    bodies = model.jnt_bodyid[np.flatnonzero(model.jnt_type == _FREE)].tolist()
    return {model.body(body).name: float(model.body_subtreemass[body]) for body in bodies}


_ROWS: dict[str, Callable[[str, list[str]], str]] = {
    'robots': _robots, 'grippers': _grippers, 'bases': _bases, 'arenas': _arenas,
    'objects': _objects}
