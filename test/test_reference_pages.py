# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The tables of parameters and of the catalogue in the documentation are complete."""

from pathlib import Path
import re

from manip_sim.interface.parameters import (
    actuation_parameters, arena_specs, camera_parameters, composition_parameters,
    keyframe_parameter, MODEL_PATH, node_parameters, place_parameters)
from manip_sim.interface.part_parameters import (
    cartesian_parameters, integral_parameters, mode_parameters, payload_parameters,
    reflex_parameters, sensing_parameters, speed_parameter, stream_parameters, timeout_parameters,
    wrench_parameters)
from manip_sim.interface.topics import Scope
from manip_sim.models.cameras import ImageSettings

ROOT = Path(__file__).resolve().parents[1]
REFERENCE = ROOT / 'docs' / 'reference'


def table_rows(page):
    """Return the cells of all table rows of a page, without the header rows."""
    rows = re.findall(r'^\| (`.*) \|$', (REFERENCE / page).read_text(), re.MULTILINE)
    return [re.split(r' *\| *', row) for row in rows]


def test_every_part_of_the_catalogue_is_listed():
    from manip_sim.models.arenas import arena_names
    from manip_sim.models.bases import base_names
    from manip_sim.models.grippers import gripper_names
    from manip_sim.models.robots import robot_names
    catalogue = (REFERENCE / 'catalogue.md').read_text()
    for name in [*robot_names(), *gripper_names(), *base_names(), *arena_names()]:
        assert f'`{name}`' in catalogue, name
    front_page = (ROOT / 'README.md').read_text()
    assert [name for name in robot_names() if f'`{name}`' not in front_page] == []


def test_every_parameter_is_listed_with_type_default_and_unit():
    types = {str: 'string', bool: 'bool', int: 'integer', float: 'double'}
    scope, place = Scope(), [0.1, 0.2, 0.3]
    specs = [MODEL_PATH, *node_parameters(), keyframe_parameter(()),
             *arena_specs('table'), *arena_specs('bins'), *arena_specs('conveyor'),
             *composition_parameters(scope), *actuation_parameters(scope, ['arm']),
             *place_parameters(scope, place), *mode_parameters(scope, ['arm', 'base']),
             *timeout_parameters(scope, ['arm', 'base']),
             *stream_parameters(scope, ['arm', 'base']),
             *camera_parameters('<camera>', ImageSettings()),
             *cartesian_parameters(scope, ['right']),
             *reflex_parameters(scope, ['right', 'base'], ['right']),
             *wrench_parameters(scope, ['right']), *payload_parameters(scope, ['right']),
             *integral_parameters(scope, ['arm', 'base']), *sensing_parameters(scope),
             speed_parameter(scope)]
    rows = {row[0].strip('`'): row for row in table_rows('parameters.md')}
    expected = set()
    for spec in specs:
        name = re.sub(r'\.(arm|base)$', '.<part>', spec.name)
        name = re.sub(r'^(cartesian|payload)\.right\.', r'\1.<arm>.', name)
        name = re.sub(r'^reflex\.\w+\.(velocity|effort|discontinuity|collision)',
                      r'reflex.<part>.\1', name)
        name = name.replace('reflex.right.', 'reflex.<arm>.')
        name = re.sub(r'^(wrench_cutoff|cartesian_\w+|null_\w+)\.right', r'\1.<arm>', name)
        expected.add(name)
        _, kind, default, unit, live, meaning = rows[name]
        if isinstance(spec.default, list):
            assert kind == f'{types[type(spec.default[0])]} array', name
        else:
            assert kind == types[type(spec.default)], name
        if spec.default != place:  # That depends on the arena.
            assert f'`{spec.default or repr(spec.default)}`' in default, name
        assert unit == spec.unit, name
        assert live == ('yes' if spec.live else ''), name
        assert len(meaning) > 10, name
    assert set(rows) == {*expected, 'law.<part>.<parameter>'}  # Which are those of the law.


def test_every_rule_of_trajectories_names_its_test():
    page = ROOT / 'docs' / 'reference' / 'trajectories.md'
    rules = re.findall(r'`(test_\w+)` \|$', page.read_text(), re.M)
    tests = {name for file in (ROOT / 'test').rglob('test_*.py')
             for name in re.findall(r'^def (test_\w+)', file.read_text(), re.M)}
    assert len(rules) > 15
    assert set(rules) <= tests
