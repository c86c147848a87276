# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A measured figure against its target: rounds, median, spread, verdict, as table and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
import statistics
from typing import Any

COLUMNS = ('what', 'target', 'figure', 'spread', 'plain loop', 'C++ loop', 'verdict')
#: Two figures that differ by less are level.
_LEVEL = 0.02


class MeasureError(Exception):
    """A row could not be measured."""


@dataclass(frozen=True)
class Settings:
    """
    Number of rounds, durations and reports of the rows.

    :ivar rounds: of each figure, A B A B
    :ivar scale: of durations; 1 is what the targets are meant for
    :ivar hours: simulated time of the row ``memory``; 0 is what fits
    :ivar report: shows a line of progress
    :ivar smoke: whether the first figure of a row is enough
    :ivar series: data for the pictures, by name
    """

    rounds: int
    scale: float
    hours: float
    report: Callable[[str], None]
    smoke: bool = False
    series: dict[str, Any] = field(default_factory=dict)

    @property
    def wait_scale(self) -> float:
        """Return the scale of the waits without which figures mean nothing."""
        return self.scale if self.smoke else 1.0


@dataclass(frozen=True)
class Target:
    """
    Bound of a figure.

    :ivar sign: ``>=``, ``<=``
    """

    sign: str
    value: float

    def met(self, figure: float) -> bool:
        """Return whether a figure reaches the target."""
        return figure >= self.value if self.sign == '>=' else figure <= self.value


@dataclass(frozen=True)
class Figure:
    """
    Values measured in some rounds.

    :ivar row: name of the measurement, as for ``--only``
    :ivar what: in words
    :ivar rounds: a value of each round
    :ivar unit: of the values; empty for ratios
    :ivar target: None if there is none
    :ivar digits: after the decimal point
    :ivar plain: the same of the plain loop of rclpy and MuJoCo
    :ivar cpp: the same of that loop in C++, which is no target; None where it is not built
    :ivar more_is_better: for the comparison with the plain loop
    """

    row: str
    what: str
    rounds: Sequence[float]
    unit: str = ''
    target: Target | None = None
    digits: int = 2
    plain: Sequence[float] = ()
    cpp: Sequence[float] | None = ()
    more_is_better: bool = True

    @property
    def median(self) -> float:
        """Return the median of the rounds."""
        return statistics.median(self.rounds)

    @property
    def ok(self) -> bool | None:
        """True if the target is met, or None without a target."""
        return None if self.target is None else self.target.met(self.median)

    @property
    def against_plain(self) -> str:
        """``ahead``, ``level`` or ``behind``; empty where the plain loop was not measured."""
        if not self.plain:
            return ''
        ours, theirs = self.median, statistics.median(self.plain)
        if abs(ours - theirs) <= _LEVEL * max(abs(ours), abs(theirs)):
            return 'level'
        return 'ahead' if (ours > theirs) == self.more_is_better else 'behind'

    @property
    def missed(self) -> bool:
        """True if the target is missed, or the plain loop is better."""
        return self.ok is False or self.against_plain == 'behind'

    def cells(self) -> tuple[str, ...]:
        """Return the row of the table, as :data:`COLUMNS` says."""
        def shown(value: float) -> str:
            return f'{value:.{self.digits}f}'
        unit = f' {self.unit}' if self.unit else ''
        target = '-' if self.target is None else f'{self.target.sign} {self.target.value:g}{unit}'
        plain, cpp = '-', '-' if self.cpp is not None else '- (no rclcpp)'
        if self.plain:
            plain = f'{shown(statistics.median(self.plain))}{unit}, {self.against_plain}'
        if self.cpp:
            cpp = f'{shown(statistics.median(self.cpp))}{unit}'
        return (self.what, target, f'{shown(self.median)}{unit}',
                f'{shown(min(self.rounds))} to {shown(max(self.rounds))}', plain, cpp,
                {None: '-', True: 'ok', False: '**misses**'}[self.ok])

    def as_json(self) -> dict[str, Any]:
        """Return all that is known of it."""
        target = None if self.target is None else [self.target.sign, self.target.value]
        return {'row': self.row, 'what': self.what, 'unit': self.unit, 'target': target,
                'figure': self.median, 'spread': [min(self.rounds), max(self.rounds)],
                'rounds': list(self.rounds), 'ok': self.ok, 'plain_loop': list(self.plain),
                'cpp_loop': list(self.cpp or ()),
                'against_plain_loop': self.against_plain}


def table(figures: Iterable[Figure]) -> str:
    """Return a table in Markdown, aligned to be read as text too."""
    rows = [COLUMNS, *(figure.cells() for figure in figures)]
    widths = [max(len(row[n]) for row in rows) for n in range(len(COLUMNS))]
    lines = ['| ' + ' | '.join(cell.ljust(width) for cell, width in zip(row, widths)) + ' |'
             for row in rows]
    lines.insert(1, '|' + '|'.join('-' * (width + 2) for width in widths) + '|')
    return '\n'.join(lines)
