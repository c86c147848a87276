# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Text on the page: text from ROS is shown as it is, never as Markdown or HTML.

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
#: The labels of the page are grey and narrow otherwise, and the boxes and ends of sliders cut.
#: Hints are beside the panel, not over its buttons. On a phone the panel is as wide as the screen
#: and lower than half of it.
_STYLE = """<style>
.mantine-Text-root{color:inherit!important;letter-spacing:-0.1px!important}
.mantine-Slider-root~.mantine-NumberInput-root{width:3.9rem!important}
.mantine-Slider-markWrapper:first-of-type .mantine-Slider-markLabel
{transform:translate(-0.1rem,0.05rem)!important}
.mantine-Slider-markWrapper:last-of-type .mantine-Slider-markLabel
{transform:translate(-85%,0.05rem)!important}
.mantine-Tooltip-tooltip{margin-left:-24rem}
.mantine-Tooltip-arrow{display:none}
.mantine-Tabs-list{flex-wrap:nowrap!important;overflow-x:auto!important}
@media (max-width:36em){
.mantine-Paper-root[style*="fixed"]{width:100%!important;max-height:45%!important}
.mantine-Paper-root[style*="fixed"] [style*="20em"]{width:100%!important}
.mantine-Tabs-tab{padding:0.75em 0.5em!important}
.mantine-Tooltip-tooltip{display:none!important}
}</style>"""


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
    blocks = []
    for line in lines:
        dot = f'<span style="color:{html.escape(line.color)}">●</span> ' if line.color else ''
        title = f'<b>{html.escape(plain(line.title))}</b>: ' if line.title else ''
        blocks.append('<div style="padding:0 0.7em 0.5em;font-size:0.9em;overflow-wrap:anywhere">'
                      f'{dot}{title}{html.escape(one_line(line.text))}</div>')
    return _STYLE + ''.join(blocks)
