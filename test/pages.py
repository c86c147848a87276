# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The pages of the documentation as data: blocks of code, links and headings.

A comment on the line before a block says why it is not executed as it stands:
``<!-- needs: NAMES -->`` if programs are needed that are not there in CI, such as RViz, and
``<!-- tested by: NAMES -->`` if other tests execute it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import re
import shlex

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / 'docs'
PAGES = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md',
         *sorted(page for page in DOCS.rglob('*.md') if not page.is_symlink())]
BLOCK = re.compile(r"""
    (?:^`(?P<file>[\w./]+)`:\n\n)?                   # the file that the block is
    (?:<!--\ (?P<marker>needs|tested\ by):\ (?P<names>[^>]+?)\ -->\n)?
    ^```(?P<language>\S*)\n(?P<text>.*?)^```$""", re.DOTALL | re.MULTILINE | re.VERBOSE)
#: What a shell would put in place of these.
FOLDERS = {'$(ros2 pkg prefix --share manip_sim)': str(ROOT),
           '$(ros2 pkg prefix manip_sim)/share/manip_sim': str(ROOT)}


@dataclass(frozen=True)
class Block:
    """
    A block of code.

    :ivar where: its page and line
    :ivar language: after the fence, such as ``sh``
    :ivar file: that it is the content of, or None
    :ivar needs: programs that are not there in CI
    :ivar tested_by: tests that execute it
    """

    where: str
    language: str
    text: str
    file: str | None
    needs: frozenset[str]
    tested_by: frozenset[str]


def blocks(page: Path) -> list[Block]:
    """Return the blocks of code of a page, without directives of Sphinx."""
    text = page.read_text()
    found = []
    for match in BLOCK.finditer(text):
        if match['language'].startswith('{'):
            continue
        line = text.count('\n', 0, match.start('text'))
        names = frozenset(re.split(r', *', match['names'] or '')) - {''}
        found.append(Block(
            f'{page.relative_to(ROOT)}:{line}', match['language'], match['text'], match['file'],
            names if match['marker'] == 'needs' else frozenset(),
            names if match['marker'] == 'tested by' else frozenset()))
    return found


def commands(text: str, folder: Path) -> Iterator[list[str]]:
    """
    Yield the commands of a block of shell, as words.

    :param folder: the working directory
    """
    for words, value in {**FOLDERS, '$PWD': str(folder), '\\\n': ' '}.items():
        text = text.replace(words, value)
    line = ''
    for part in text.splitlines():
        line += part
        try:
            words = shlex.split(line, comments=True)
        except ValueError:  # A quotation goes on in the next line.
            line += '\n'
            continue
        line = ''
        while words:
            end = words.index('&&') if '&&' in words else len(words)
            if words[:end]:
                yield words[:end]
            words = words[end + 1:]
    assert not line, f'a quotation does not end: {line}'


def links(page: Path) -> Iterator[tuple[Path, str]]:
    """Yield the file and the heading that each link of a page leads to, within the project."""
    text = re.sub(r'^```.*?^```$', '', page.read_text(), flags=re.DOTALL | re.MULTILINE)
    for target in re.findall(r'\]\(([^)\s]+)\)', text):
        if not re.match(r'[a-z]+:', target):
            file, _, heading = target.partition('#')
            yield (page.parent / file).resolve() if file else page, heading


def headings(page: Path) -> set[str]:
    """Return the names of the headings of a page, as links have them."""
    text = re.sub(r'^```.*?^```$', '', page.read_text(), flags=re.DOTALL | re.MULTILINE)
    return {re.sub(r'[^a-z0-9_ -]', '', heading.lower()).replace(' ', '-')
            for heading in re.findall(r'^#+ (.*)$', text, re.MULTILINE)}
