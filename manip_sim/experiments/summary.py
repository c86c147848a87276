# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Rows of episodes, how often they succeed, with its interval, and a picture of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from html import escape
import math
import statistics
from typing import Any

#: Columns of wall times.
TIMES = ('wall_time_s', 'answer_mean_s', 'answer_max_s')
#: Of the normal distribution, for 95 %.
Z_95 = 1.959964


@dataclass(frozen=True)
class Row:
    """
    An episode.

    :ivar seed: that drew its start
    :ivar success: whether it ended in success
    :ivar returned: the sum of its rewards
    :ivar periods: number of its control periods
    :ivar digest: of its final state
    :ivar error: why it ended early, such as what the policy raised; empty if it did not
    :ivar faults: that were injected, as JSON; empty if none were planned
    :ivar wall_time_s: how long it took, wall time [s]; this and what follows is another one each
        time, so that rows are equal without it
    :ivar answer_mean_s: mean of the wall times of the policy's answers [s]
    :ivar answer_max_s: longest of them [s]
    """

    seed: int
    success: bool
    returned: float
    periods: int
    digest: str
    error: str = ''
    faults: str = ''
    wall_time_s: float = field(default=0.0, compare=False)
    answer_mean_s: float = field(default=0.0, compare=False)
    answer_max_s: float = field(default=0.0, compare=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the columns of the row."""
        columns = asdict(self)
        return {'return' if key == 'returned' else key: value for key, value in columns.items()}

    @classmethod
    def of(cls, columns: dict[str, Any]) -> Row:
        """
        Return the row of some columns.

        :param columns: as :meth:`as_dict` returns them
        :raises TypeError: if one is missing or unknown, or has another type
        """
        row = cls(**{'returned' if key == 'return' else key: value
                     for key, value in columns.items()})
        for name, kind in (('seed', int), ('success', bool), ('returned', float),
                           ('periods', int), ('digest', str), ('error', str), ('faults', str),
                           *((name, float) for name in TIMES)):
            if type(getattr(row, name)) is not kind:
                raise TypeError(f'{name} must be {kind.__name__}')
        return row


def wilson_interval(successes: int, count: int) -> tuple[float, float]:
    """
    Return the 95 % interval of Wilson's score for a share of successes.

    :param successes: of ``count``
    :param count: number of episodes, from 1
    """
    share, z2 = successes / count, Z_95 * Z_95
    middle = (share + z2 / (2.0 * count)) / (1.0 + z2 / count)
    half = Z_95 / (1.0 + z2 / count) * math.sqrt(
        share * (1.0 - share) / count + z2 / (4.0 * count * count))
    # At the ends, rounding must not turn 0 or 1 into a little more or less.
    return (max(middle - half, 0.0) if successes else 0.0,
            min(middle + half, 1.0) if successes < count else 1.0)


def summarize(rows: Iterable[Row], seeds: int, period_s: float) -> dict[str, Any]:
    """
    Return the summary of a run, as JSON can hold it.

    :param rows: of the episodes so far
    :param seeds: number of episodes that there will be
    :param period_s: length of a control period [s]
    """
    finished = list(rows)
    times_s = [row.periods * period_s for row in finished if row.success]
    successes = len(times_s)
    low, high = wilson_interval(successes, len(finished)) if finished else (0.0, 1.0)
    return {
        'episodes': len(finished), 'of': seeds, 'complete': len(finished) == seeds,
        'successes': successes,
        'success_rate': successes / len(finished) if finished else None,
        'success_rate_95': [low, high],
        'mean_return': statistics.fmean(row.returned for row in finished) if finished else None,
        'wall_time_s': sum(row.wall_time_s for row in finished),
        'answer_time_s': {
            'mean': statistics.fmean(row.answer_mean_s for row in finished) if finished else None,
            'max': max((row.answer_max_s for row in finished), default=None)},
        'median_time_of_success_s': statistics.median(times_s) if times_s else None,
        'errors': dict(Counter(row.error for row in finished if row.error).most_common(20))}


#: Size of the picture, and its margins on the left, right, top and bottom [pixels].
_WIDTH, _HEIGHT = 640, 400
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 20, 45, 55
#: Half of the width of the ends of an interval [pixels].
_CAP = 5
#: Lines of the success [%].
_PERCENT = (0, 25, 50, 75, 100)


def success_over(title: str, head: str, summaries: Sequence[tuple[float, dict[str, Any]]]) -> str:
    """
    Return an SVG of success rates with their 95 % intervals over latencies.

    :param title: above the picture
    :param head: of the horizontal axis
    :param summaries: latencies [s], in any order, two of which differ, and the summary of each
        run
    """
    summaries = sorted(summaries, key=lambda entry: entry[0])
    lowest, highest = summaries[0][0], summaries[-1][0]
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM

    def across(late_s: float) -> float:
        share = (late_s - lowest) / (highest - lowest)
        return round(_LEFT + 20 + share * (right - _LEFT - 40), 1)

    def up(rate: float) -> float:
        return round(bottom - rate * (bottom - _TOP), 1)

    parts = [_label(_WIDTH / 2, 24, title, 'middle'),
             _label((_LEFT + right) / 2, _HEIGHT - 14, f'{head} [s]', 'middle'),
             _label(18, _TOP - 12, 'success [%]', 'start')]
    for percent in _PERCENT:
        y = up(percent / 100.0)
        parts += [_line(_LEFT, y, right, y, '#ddd'), _label(_LEFT - 8, y + 4, str(percent), 'end')]
    parts += [_label(across(late_s), bottom + 20, f'{late_s:g}', 'middle')
              for late_s, _ in summaries]
    points = []
    for late_s, summary in summaries:
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


def _label(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(text)}</text>'


def _line(x: float, y: float, to_x: float, to_y: float, color: str = '#1f77b4') -> str:
    return f'<line x1="{x:g}" y1="{y:g}" x2="{to_x:g}" y2="{to_y:g}" stroke="{color}"/>'
