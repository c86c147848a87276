# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Success over latency as a picture in SVG, without a library that draws."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

#: Size of the picture, and its margins on the left, right, top and bottom [pixels].
_WIDTH, _HEIGHT = 640, 400
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 20, 45, 55
#: Half of the width of the ends of an interval [pixels].
_CAP = 5
#: Lines of the success [%].
_PERCENT = (0, 25, 50, 75, 100)


def success_over(title: str, head: str, found: Sequence[tuple[float, dict[str, Any]]]) -> str:
    """
    Return an SVG of success rates with their 95 % intervals over latencies.

    :param title: above the picture
    :param head: of the horizontal axis
    :param found: latencies [s], in any order, two of which differ, with the summary of each run
    """
    found = sorted(found, key=lambda entry: entry[0])
    lowest, highest = found[0][0], found[-1][0]
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM

    def across(late_s: float) -> float:
        share = (late_s - lowest) / (highest - lowest)
        return float(np.round(_LEFT + 20 + share * (right - _LEFT - 40), 1))

    def up(rate: float) -> float:
        return float(np.round(bottom - rate * (bottom - _TOP), 1))

    parts = [_text(_WIDTH / 2, 24, title, 'middle'),
             _text((_LEFT + right) / 2, _HEIGHT - 14, f'{head} [s]', 'middle'),
             _text(18, _TOP - 12, 'success [%]', 'start')]
    for percent in _PERCENT:
        y = up(percent / 100.0)
        parts += [_line(_LEFT, y, right, y, '#ddd'), _text(_LEFT - 8, y + 4, str(percent), 'end')]
    parts += [_text(across(late_s), bottom + 20, f'{late_s:g}', 'middle') for late_s, _ in found]
    points = []
    for late_s, summary in found:
        x, (low, high) = across(late_s), map(up, summary['success_rate_95'])
        parts += [_line(x, low, x, high), _line(x - _CAP, low, x + _CAP, low),
                  _line(x - _CAP, high, x + _CAP, high)]
        points.append((x, up(summary['success_rate'] or 0.0)))
    parts.append('<polyline fill="none" stroke="#1f77b4" points="'
                 + ' '.join(f'{x:g},{y:g}' for x, y in points) + '"/>')
    parts += [f'<circle cx="{x:g}" cy="{y:g}" r="4" fill="#1f77b4"/>' for x, y in points]
    return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
            f'font-family="sans-serif" font-size="13">\n'
            f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>\n'
            + '\n'.join(parts) + '\n</svg>\n')


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(text)}</text>'


def _line(x: float, y: float, to_x: float, to_y: float, color: str = '#1f77b4') -> str:
    return f'<line x1="{x:g}" y1="{y:g}" x2="{to_x:g}" y2="{to_y:g}" stroke="{color}"/>'
