# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every block of code and every link of the documentation, page by page, as a reader uses it."""

from pathlib import Path
import re

from page_runner import needed_program, PageRunner
from pages import blocks, commands, headings, links, PAGES, ROOT
import pytest

pytestmark = pytest.mark.full

WITH_BLOCKS = [page for page in PAGES if blocks(page)]
#: Blocks with a line that needs a program which CI has not: to be raised knowingly.
NOT_EXECUTED = 53


def name(page):
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize('page', WITH_BLOCKS, ids=name)
def test_every_block_of_a_page_is_executed(page, client, tmp_path, monkeypatch, request):
    if any('manip_sim render' in block.text for block in blocks(page)):
        request.getfixturevalue('renderer')
    runner = PageRunner(client, tmp_path, monkeypatch)
    try:
        for block in blocks(page):
            if block.tested_by:
                continue
            try:
                runner.run(block)
            except Exception as error:
                raise AssertionError(f'{block.where}: {error}') from error
    finally:
        runner.close()


def test_what_is_not_executed_is_counted_and_what_others_test_is_tested():
    found = [block for page in PAGES for block in blocks(page)]
    assert len([block for block in found if block.needs]) == NOT_EXECUTED
    tests = {test for file in (ROOT / 'test').rglob('test_*.py')
             for test in re.findall(r'^def (test_\w+)', file.read_text(), re.MULTILINE)}
    for block in found:
        assert block.tested_by <= tests, block.where


@pytest.mark.parametrize('page', [*PAGES, *sorted((ROOT / 'assets').rglob('*.md'))], ids=name)
def test_every_link_leads_to_a_file_and_a_heading(page):
    for target, heading in links(page):
        assert target.exists(), target
        assert not heading or heading in headings(target), f'{target}#{heading}'


@pytest.mark.parametrize('page', PAGES, ids=name)
def test_text_behind_a_table_is_not_taken_for_a_row(page):
    text = re.sub(r'^```.*?^```$', '', page.read_text(), flags=re.DOTALL | re.MULTILINE)
    assert not re.findall(r'^ *\|.*\n(?! *\||- |\n|\Z)(.*)$', text, re.MULTILINE)


def test_a_shell_block_is_read_as_a_shell_reads_it():
    text = "a 'b # c' \\\n  d  # e\n\nf \"g\nh\" && i $PWD\n"
    assert list(commands(text, Path('/x'))) == [['a', 'b # c', 'd'], ['f', 'g\nh'], ['i', '/x']]


def test_programs_of_others_are_recognised():
    assert needed_program(['ros2', 'bag', 'record']) == 'rosbag2'
    assert needed_program(['ros2', 'run', 'joy', 'joy_node']) == 'joy'
    assert needed_program(['ros2', 'run', 'manip_sim', 'sim_node']) is None
