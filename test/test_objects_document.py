# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What ``docs/how_to/objects.md`` says is what the code does."""

from pathlib import Path
import re

import pytest

from manip_sim.models.arenas import arena_names, arena_parameters
from manip_sim.models.descriptions import FileDescription, MeshDescription, ShapeDescription
from manip_sim.models.object_creation import load_objects

TEXT = (Path(__file__).resolve().parents[1] / 'docs' / 'how_to' / 'objects.md').read_text()
BLOCKS = re.findall(r'^```(\w+)\n(.*?)^```$', TEXT, re.DOTALL | re.MULTILINE)


@pytest.fixture
def listed(tmp_path):
    """Write the list of the document into the working directory."""
    text = next(text for language, text in BLOCKS if language == 'yaml')
    path = tmp_path / 'objects.yaml'
    path.write_text(text)
    return path


def test_the_list_is_read(listed):
    brick, can = load_objects(listed)
    assert brick.mass_kg == pytest.approx(0.3)
    assert can.mass_kg == pytest.approx(400.0 * 3.14159 * 0.03**2 * 0.12, rel=1e-4)


def test_the_table_of_arenas_is_that_of_the_classes():
    rows = []
    for arena in arena_names():
        for one in arena_parameters(arena):
            default = 'true' if one.default is True else f'{one.default:g}'
            rows.append(f'| `{arena}` | `{one.name}` | {default} | {one.limits} | '
                        f'{one.description} |')
    told = [line for line in TEXT.splitlines()
            if re.match(r'\| `(bins|conveyor|table|empty)`', line)]
    assert told == rows


def test_the_table_of_keys_is_that_of_the_descriptions():
    told = re.findall(r'^\| `(\w+)` \| (all|(?:shapes|files|meshes)[\w, ]*) \|', TEXT,
                      re.MULTILINE)
    for kind, description in (('shapes', ShapeDescription), ('files', FileDescription),
                              ('meshes', MeshDescription)):
        assert {key for key, of in told if of == 'all' or kind in of.split(', ')} == set(
            description.model_fields)
