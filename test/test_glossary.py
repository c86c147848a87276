# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The words of the glossary are those of the code, and the code uses no others for them."""

import ast
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted((ROOT / 'manip_sim').rglob('*.py'))
ROWS = re.findall(r'^\| (?!word |---)(.+?) \| .+ \|$',
                  (ROOT / 'docs' / 'glossary.md').read_text(), re.MULTILINE)
#: Where each word's code begins, as the page on the architecture has it.
PLACES = re.findall(r'^\| ([^|`]+) \| `([a-z_/]+(?:\.py)?)` \|$',
                    (ROOT / 'docs' / 'explanation' / 'architecture.md').read_text()
                    .partition('## Threads')[0].rpartition('| word |')[2], re.MULTILINE)
#: What the style of the project says with other words: report, log, need, support, handle, speed.
NOT_USED = {'tell', 'tells', 'told', 'untold', 'heard', 'bear', 'bears', 'borne', 'mend', 'mends'}


def named(node):
    """Return the name that a node of the syntax tree gives to something."""
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
        return node.name
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
        return node.attr
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        return node.id
    return node.arg if isinstance(node, ast.arg) else ''


def in_lower_case(text):
    """Return a text as one line of words in lower case."""
    return re.sub(r'[\s_-]+', ' ', text.lower())


def words_of(name):
    """Return the words of a name such as ``report_failure`` or ``SimNode``, in lower case."""
    return [word.lower() for word in re.findall(r'[A-Z]?[a-z]+|[A-Z]+(?![a-z])', name)]


def test_the_glossary_is_in_order_and_names_each_word_once():
    words = [word.strip('`').lower() for word in ROWS]
    assert len(words) > 30
    assert words == sorted(set(words))


def test_the_glossary_lists_the_arenas():
    from manip_sim.models.arenas import arena_names
    row, = re.findall(r'^\| arena \| (.*) \|$', (ROOT / 'docs' / 'glossary.md').read_text(), re.M)
    assert re.findall('`(.+?)`', row) == list(arena_names())


@pytest.fixture(scope='module')
def code():
    """Return all sources, as :func:`in_lower_case` has them."""
    return in_lower_case(' '.join(file.read_text() for file in SOURCES))


@pytest.mark.parametrize('word', ROWS)
def test_the_code_uses_the_word(word, code):
    assert re.search(rf"\b{re.sub('[-_]', ' ', word.strip('`').lower())}", code)


@pytest.mark.parametrize(('word', 'place'), PLACES, ids=[word for word, _ in PLACES])
def test_the_code_of_a_word_is_where_the_architecture_says(word, place):
    path = ROOT / 'manip_sim' / place
    text = (path if path.is_file() else path / '__init__.py').read_text()
    assert word in ROWS
    assert all(part in in_lower_case(text) for part in in_lower_case(word).split())


def test_most_places_have_the_name_of_their_word():
    found = {word for word, place in PLACES if word.split()[-1] in place}
    assert len(found) > 18, {word for word, _ in PLACES} - found


@pytest.fixture(scope='module')
def names():
    """Return the names that the code gives, each with its file."""
    return {(str(file.relative_to(ROOT)), named(node)) for file in SOURCES
            for node in ast.walk(ast.parse(file.read_text()))}


@pytest.mark.full
def test_names_avoid_words_that_the_style_replaces(names):
    # What is written like a file has its method tell.
    assert {(file, name) for file, name in names if NOT_USED & set(words_of(name))} == {
        ('manip_sim/records/record_file.py', 'tell')}


@pytest.mark.full
def test_only_models_have_hands_as_what_is_commanded_is_an_end_effector(names):
    assert {name for file, name in names if {'hand', 'hands'} & set(words_of(name))
            and not file.startswith('manip_sim/models/')} == {
        'hand_over', 'HandOver', 'HandOverDemonstration'}
