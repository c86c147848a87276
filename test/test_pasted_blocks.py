# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Blocks of Python on pages can be pasted into ``python3``, which takes statement by statement."""

from codeop import CommandCompiler
import re

from pages import blocks, PAGES, ROOT
import pytest

pytestmark = pytest.mark.full


def rejected_line(text):
    """Return the line at which a Python before 3.13 rejects a pasted text, or None."""
    compiler, pending = CommandCompiler(), []
    for line in [*text.splitlines(), '']:
        pending.append(line)
        try:
            # A compound statement ends at an empty line, another one as soon as it is complete.
            if compiler('\n'.join(pending), symbol='single') is not None:
                pending = []
        except SyntaxError:
            return line
    return None


def statements(page):
    """Return the blocks of a page that no file holds, as lessons and packages have them."""
    of_files = page.parent.name == 'tutorials' or page.name.startswith('add_')
    return [block for block in blocks(page) if block.language == 'python' and not block.file
            and not (of_files and re.search('^class ', block.text, re.MULTILINE))
            and not block.text.startswith(' ')]


@pytest.mark.parametrize('page', [page for page in PAGES if statements(page)],
                         ids=lambda page: str(page.relative_to(ROOT)))
def test_blocks_can_be_pasted_into_a_terminal(page):
    for block in statements(page):
        assert rejected_line(block.text) is None, f'{block.where}: an empty line is missing'


def test_a_loop_needs_an_empty_line_behind_it():
    loop = 'for i in range(2):\n    print(i)\n'
    assert rejected_line(f'{loop}print(3)') == 'print(3)'
    assert rejected_line(f'a = [\n    1]\n{loop}\nprint(3)') is None
