# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim list``: the parts and tasks that there are."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
import json
from typing import Any

import mujoco
import numpy as np

from manip_sim.cli.command_line import KINDS
from manip_sim.cli.composing_options import arena_parameters, origin, package_of
from manip_sim.cli.output import number, table, terminal_width
from manip_sim.errors import ModelError
from manip_sim.models import arena_names, create_arena
from manip_sim.models.bases import base_names, create_base, MobileBaseModel
from manip_sim.models.grippers import create_gripper, gripper_names
from manip_sim.models.object_model import SIZES
from manip_sim.models.robots import create_robot, ManipulatorModel, robot_names
from manip_sim.quoting import one_line
from manip_sim.resources import PACKAGE, share_directory
from manip_sim.tasks import task_names
from manip_sim.tasks.task import TASKS

Row = dict[str, Any]
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def list_parts(options: argparse.Namespace) -> tuple[str, int]:
    """Return tables of all kinds or one, or JSON, and 1 if a part cannot be created, else 0."""
    kinds = KINDS if options.kind is None else (options.kind,)
    rows_by_title = {title: rows for kind in kinds for title, rows in _SECTIONS[kind]().items()}
    failed = any('error' in row for rows in rows_by_title.values() for row in rows)
    if options.json:
        plain = {_key(title): [{_key(name): value for name, value in row.items()} for row in rows]
                 for title, rows in rows_by_title.items()}
        return json.dumps(plain, indent=2, allow_nan=False), int(failed)
    texts = [_table(title, rows) for title, rows in rows_by_title.items()]
    location = f'Files of {PACKAGE} lie in {share_directory()}'
    return '\n\n'.join([*filter(None, texts), location]), int(failed)


def _key(name: str) -> str:
    return name.replace(' ', '_')


def _table(title: str, rows: list[Row]) -> str:
    header = next((list(row) for row in rows if 'error' not in row), ['name', 'error'])
    cells = [[row['name'], *['-'] * (len(header) - 2), row['error']] if 'error' in row else
             [_cell(row[name]) for name in header] for row in rows]
    return table(title.capitalize(), header, cells, terminal_width())


def _cell(value: Any) -> str:
    if isinstance(value, dict):
        value = [f'{name}={str(default).lower()}' for name, default in value.items()]
    if isinstance(value, list):
        return ', '.join(value) or '-'
    return number(value) if isinstance(value, float) else '-' if value is None else str(value)


def _part_rows(kind: str, names: list[str], create: Callable[[str], Any],
               columns: Callable[[str, Any], Row]) -> dict[str, list[Row]]:
    """Return a row for each part of a kind; for one that cannot be created, with the reason."""
    def row(name: str) -> Row:
        try:
            part = create(name)
            properties = columns(name, part)
        except Exception as error:  # A class of another package may raise anything.
            reason = f'cannot be created: {type(error).__name__}: {error}'
            return {'name': name, 'error': one_line(reason)}
        source, file = origin(part, kind)
        return {'name': name, **properties, 'from': source, 'file': file}
    return {kind: [row(name) for name in names]}


def _robots() -> dict[str, list[Row]]:
    def columns(_: str, robot: Any) -> Row:
        has_arms = isinstance(robot, ManipulatorModel)
        return {'arms': len(robot.arms) if has_arms else 0, 'joints': len(robot.joints),
                'default gripper': list(dict.fromkeys(
                    robot.declared_grippers.values() if has_arms else ())),
                'default base': robot.default_base}
    return _part_rows('robots', robot_names(), create_robot, columns)


def _objects() -> dict[str, list[Row]]:
    """Return the shapes of objects, and the free bodies of arenas, also the optional ones."""
    return {'shapes of objects': [{'name': shape, 'size m': size}
                                  for shape, size in (
                                      *((shape, size) for shape, (_, size) in SIZES.items()),
                                      ('mesh', 'that of its file, with a scale'))],
            'objects': list(_free_bodies_of_arenas())}


def _free_bodies_of_arenas() -> Iterator[Row]:
    for name in arena_names():
        switches = [key for key, default in arena_parameters(name).items()
                    if isinstance(default, bool)]
        always = free_bodies(create_arena(name, **dict.fromkeys(switches, False)).compile())
        everything = create_arena(name, **dict.fromkeys(switches, True))
        source, file = origin(everything, 'arenas')
        for body, mass in free_bodies(everything.compile()).items():
            yield {'name': body, 'mass kg': mass, 'arena': name, 'parameters': (
                {} if body in always else dict.fromkeys(switches, True)), 'from': source,
                'file': file}


def _tasks() -> dict[str, list[Row]]:
    def row(name: str) -> Row:
        try:
            task = TASKS.get(name)
        except ModelError as error:
            return {'name': name, 'error': one_line(str(error))}
        arms = max(task.arms_needed, task.arms_in_all)
        return {'name': name, 'instruction': task.instruction, 'arms': arms,
                'horizon s': task.horizon_s, 'not for': [*task.unable],
                'expert fails': [f'{robot}: {often}' for robot, often in (
                    task.expert_fails.items())],
                'from': package_of(task, 'tasks')}
    return {'tasks': [row(name) for name in task_names()]}


def free_bodies(model: mujoco.MjModel) -> dict[str, float]:
    """Return the bodies of a model with free joints, and their masses [kg]."""
    bodies = model.jnt_bodyid[np.flatnonzero(model.jnt_type == _FREE)].tolist()
    return {model.body(body).name: float(model.body_subtreemass[body]) for body in bodies}


_SECTIONS: dict[str, Callable[[], dict[str, list[Row]]]] = {
    'robots': _robots,
    'grippers': lambda: _part_rows('grippers', gripper_names(), create_gripper, lambda _, part: {
        'joints': len(part.joints), 'actuators': len(part.actuators),
        'length of actions': part.dof}),
    'bases': lambda: _part_rows('bases', base_names(), create_base, lambda _, base: {
        'kind': 'mobile' if isinstance(base, MobileBaseModel) else 'mount',
        'joints': len(base.joints)}),
    'arenas': lambda: _part_rows('arenas', arena_names(), create_arena, lambda name, _: {
        'parameters and defaults': arena_parameters(name)}),
    'objects': _objects, 'tasks': _tasks}
