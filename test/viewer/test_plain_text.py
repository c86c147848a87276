# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Text on the page: shown as it is."""

import ast
from html.parser import HTMLParser
from pathlib import Path

import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, strategies as st  # noqa: E402

import manip_sim.viewer.page  # noqa: E402
from manip_sim.viewer.page.latest import Line, plain, PlainText  # noqa: E402

PAGE = Path(manip_sim.viewer.page.__file__).parent
#: What viser shows as Markdown or HTML, or takes from files and elsewhere.
INTERPRETED = {'add_markdown', 'add_html', 'add_plotly', 'add_modal', 'add_3d_gui_container',
               'content', 'icon', 'tab_icon', 'image_root', 'add_icon'}


class Read(HTMLParser):
    """Reads HTML as a browser does: elements, and the text in them."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.text = [], ''
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.elements.append(tag)

    def handle_data(self, data):
        self.text += data


class Gui:
    def add_html(self, content):
        self.content = content
        return self


@given(st.text(max_size=40), st.text(max_size=40))
def test_a_line_has_the_same_elements_whatever_its_text_is(text, title):
    gui = Gui()
    shown = PlainText(gui, [Line('text', 'title', '#ff0000')])
    elements = Read(gui.content).elements
    shown.show([Line(text, title or 'x', '#ff0000')])
    read = Read(gui.content)
    assert read.elements == elements == ['style', 'div', 'span', 'b']
    assert read.text.endswith(f'● {plain(title or "x")}: ' + ''.join(
        c if c.isprintable() else repr(c)[1:-1] for c in text))


def test_names_are_shortened_and_control_characters_escaped():
    assert plain('a\u202e\x1b[31m\n') == 'a\\u202e\\x1b[31m\\n'
    assert plain('x' * 61) == 'x' * 60 + '...'


@pytest.mark.parametrize('path', sorted(PAGE.parent.rglob('*.py')),
                         ids=lambda path: str(path.relative_to(PAGE.parent)))
def test_only_one_module_gives_html_to_viser(path):
    if path.name == 'latest.py':
        return
    nodes = list(ast.walk(ast.parse(path.read_text())))
    used = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    used |= {node.arg for node in nodes if isinstance(node, ast.keyword)}
    assert not used & INTERPRETED
