# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim describe``: what a composition is made of, as tables or JSON."""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
from typing import Any

import yaml

from manip_sim.cli.composing_options import compose_from
from manip_sim.cli.composition_description import describe
from manip_sim.cli.tables import number, span, table, terminal_width
from manip_sim.errors import ModelError
from manip_sim.models import World
from manip_sim.quoting import counted

Row = dict[str, Any]
#: By section of the description: the names of the columns, and the cells of a row.
_COLUMNS: dict[str, tuple[tuple[str, ...], Callable[[Row], tuple[str, ...]]]] = {
    'models': (
        ('kind', 'class', 'prefix', 'mass kg', 'joints', 'actuators', 'from'),
        lambda r: (_kind(r), r['class'], r['prefix'],
                   number(r['mass_kg']), str(r['joints']), str(r['actuators']), r['from'])),
    'parts': (
        ('part', 'consists of', 'joints', 'actuators', 'control mode'),
        lambda r: (r['name'], ', '.join(n for n in r['consists_of'] if n != r['name']) or '-',
                   str(len(r['joints'])), str(len(r['actuators'])), r['control_mode'] or '-')),
    'joints': (
        ('joint', 'part', 'start', 'position', 'unit', 'velocity', 'effort', 'driven by'),
        lambda r: (r['name'], r['part'], number(r['start']), span(r['position']), r['unit'],
                   number(r['velocity']), span(r['effort']), _driver(r))),
    'actuators': (
        ('actuator', 'part', 'type', 'drives', 'control', 'force'),
        lambda r: (r['name'], r['part'], r['type'], f'{r["drives"]} {r["target"]}',
                   span(r['control']), span(r['force']))),
    'sensors': (
        ('sensor', 'type', 'of', 'length'),
        lambda r: (r['name'], r['type'], r['of'] or '-', str(r['length']))),
    'frames': (
        ('frame', 'kind', 'parent', 'mass kg', 'x m', 'y m', 'z m'),
        lambda r: (r['name'], r['kind'], r['parent'], number(r['mass_kg']),
                   *(f'{round(value, 3) + 0.0:.3f}' for value in r['position_m']))),
    'cameras': (
        ('camera', 'body', 'field of view rad', 'resolution'),
        lambda r: (r['name'], r['body'], number(r['fovy_rad']),
                   'x'.join(map(str, r['resolution'])) if r['resolution'] else '-')),
    'objects': (('object', 'mass kg'), lambda r: (r['name'], number(r['mass_kg']))),
    'topics': (
        ('topic', 'type', 'node', 'meaning'),
        lambda r: (r['name'], r['type'], {'published': 'publishes'}.get(
            r['direction'], 'subscribes'), r['meaning'])),
    'services': (('service', 'type', 'meaning'),
                 lambda r: (r['name'], r['type'], r['meaning'])),
    'actions': (('action', 'type', 'meaning'),
                lambda r: (r['name'], r['type'], r['meaning'])),
    'parameters': (
        ('parameter', 'value', 'unit', 'live', 'meaning'),
        lambda r: (r['name'], _value(r['value']), r['unit'] or '-', 'yes' if r['live'] else '-',
                   r['meaning'])),
}
_TITLES = {
    'models': 'Models', 'parts': 'Parts',
    'joints': 'Joints: velocity limits per second, effort limits in N m or N',
    'actuators': 'Actuators, as the files have them', 'sensors': 'Sensors',
    'frames': 'Frames, at the start in world', 'cameras': 'Cameras',
    'objects': 'Objects', 'topics': 'Topics of the node',
    'services': 'Services of the node',
    'actions': 'Actions of the node, where control_msgs is installed',
    'parameters': 'Parameters of the node'}


def run(options: argparse.Namespace) -> tuple[str, int]:
    composed = compose_from(options)
    if options.yaml:
        return _as_yaml(composed.composition.world), 0
    description = describe(composed)
    if options.json:
        return json.dumps(description, indent=2, allow_nan=False), 0
    width = terminal_width()
    tables = [table(_TITLES[section], header, [cells(row) for row in description[section]], width)
              for section, (header, cells) in _COLUMNS.items()]
    return '\n\n'.join([_summary(description), *filter(None, tables)]), 0


def _as_yaml(world: World) -> str:
    """Return what was inferred of the robot's file, as the YAML file that describes it."""
    from manip_sim.models.files import FileRobot  # That needs pydantic.
    if len(world.robots) != 1 or not isinstance(world.robots[0], FileRobot):
        raise ModelError('describe --yaml is for one robot from a file, such as --robot arm.xml; '
                         'robots of the catalogue are described in assets/robots')
    robot = world.robots[0]
    lines = [f'# Save this as {robot.file.stem}.yaml beside {robot.file.name}, and edit what was '
             'inferred wrongly:', *(f'# - {sentence}' for sentence in robot.inferred)]
    return '\n'.join([*lines, yaml.safe_dump(
        robot.described, sort_keys=False, default_flow_style=None, width=100)]).rstrip('\n')


def _summary(description: Row) -> str:
    lines = [f'{description["name"]} in arena {description["arena"]}, '
             f'{description["mass_kg"]:.4g} kg, {counted(len(description["joints"]), "joint")}, '
             f'{counted(len(description["actuators"]), "actuator")}']
    defects = description['start_defects']
    if defects:
        lines.append(f"The start has {counted(len(defects), 'defect')}, see 'manip_sim check'")
    return '\n'.join(lines)


def _kind(model: Row) -> str:
    robot = f'{model["robot"]}: ' if model['robot'] else ''
    return f'{robot}{model["kind"]}{" (" + model["arm"] + ")" if model["arm"] else ""}'


def _driver(joint: Row) -> str:
    if joint['driven_by']:
        return ', '.join(joint['driven_by'])
    return 'a coupling' if joint['coupled'] else 'nothing'


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f'[{", ".join(map(str, value))}]'
    return str(value) if value != '' else "''"
