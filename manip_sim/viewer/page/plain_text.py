# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Text on the page: all that came over ROS is shown as it is, never as Markdown or HTML.

Markdown of viser renders HTML and reads pictures of this machine, so the page has none. This is
the only module that gives HTML to viser.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import html
from typing import Any

from manip_sim.quoting import one_line

#: Length of a name on the page at most.
_MAX_NAME = 60
#: The labels of the page are grey and narrow otherwise.
_STYLE = ('<style>.mantine-Text-root{color:inherit!important;letter-spacing:-0.1px!important}'
          '</style>')


def plain(text: str) -> str:
    """Return a name for labels and hints, which show text as it is, on one line, shortened."""
    return one_line(text, _MAX_NAME)


@dataclass(frozen=True)
class Line:
    """
    A line of text on the page.

    :ivar text: as it is shown
    :ivar title: stands before it in bold
    :ivar color: of a dot before both, such as ``#2f9e44``; empty for none
    """

    text: str
    title: str = ''
    color: str = ''


class PlainText:
    """
    Lines of text in the panel.

    :param lines: that it begins with
    """

    def __init__(self, gui: Any, lines: Iterable[Line] = ()) -> None:
        self._shown = _as_html(lines)
        self._element = gui.add_html(self._shown)

    def show(self, lines: Iterable[Line]) -> None:
        """Show these lines in place of the former ones."""
        shown = _as_html(lines)
        if shown != self._shown:
            self._shown = self._element.content = shown


def _as_html(lines: Iterable[Line]) -> str:
    found = []
    for line in lines:
        dot = f'<span style="color:{html.escape(line.color)}">●</span> ' if line.color else ''
        title = f'<b>{html.escape(plain(line.title))}</b>: ' if line.title else ''
        found.append('<div style="padding:0 0.7em 0.5em;font-size:0.9em;overflow-wrap:anywhere">'
                     f'{dot}{title}{html.escape(one_line(line.text))}</div>')
    return _STYLE + ''.join(found)
