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
#: What the style of the project says with other words: report, log, need, support, handle, speed.
NOT_USED = {'tell', 'tells', 'told', 'untold', 'heard', 'bear', 'bears', 'borne', 'mend', 'mends'}


def named(node):
    """Return the name that a node of the syntax tree gives to something."""
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        return node.name
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
        return node.attr
    return node.arg if isinstance(node, ast.arg) else ''


def words_of(name):
    """Return the words of a name such as ``report_failure`` or ``SimNode``, in lower case."""
    return [word.lower() for word in re.findall(r'[A-Z]?[a-z]+|[A-Z]+(?![a-z])', name)]


def test_the_glossary_is_in_order_and_names_each_word_once():
    words = [word.strip('`').lower() for word in ROWS]
    assert len(words) > 30
    assert words == sorted(set(words))


@pytest.fixture(scope='module')
def code():
    """Return all sources as one line of words in lower case."""
    return re.sub(r'[\s_-]+', ' ', ' '.join(file.read_text() for file in SOURCES).lower())


@pytest.mark.parametrize('word', ROWS)
def test_the_code_uses_the_word(word, code):
    assert re.search(rf"\b{re.sub('[-_]', ' ', word.strip('`').lower())}", code)


def test_names_avoid_words_that_the_style_replaces():
    names = {(str(file.relative_to(ROOT)), named(node)) for file in SOURCES
             for node in ast.walk(ast.parse(file.read_text()))}
    # A file has a method tell.
    assert not {(file, name) for file, name in names
                if name != 'tell' and NOT_USED & set(words_of(name))}
