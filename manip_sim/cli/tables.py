# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tables as plain text: aligned, and no wider than the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
import re
import shutil

_GAP, _INDENT = '  ', '  '
#: No column gets narrower than this by wrapping.
_NARROWEST = 10
#: Where the output is no terminal, lines are not wrapped, for grep and the like.
_ENDLESS = 1_000_000
_NUMERIC = re.compile(r'-?\d[\d.e+-]*|-')
_NUMERIC_OR_SPAN = re.compile(rf'({_NUMERIC.pattern})( to {_NUMERIC.pattern})?')
#: Text may be wrapped after a space, and names between their words.
_PIECES = re.compile(r'\S*?[_/](?=\w)|\S+ ?| +')


def terminal_width() -> int:
    """Return how many characters fit into a line; the variable ``COLUMNS`` overrides it."""
    return shutil.get_terminal_size(fallback=(_ENDLESS, 24)).columns


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> str:
    """
    Return a table, or nothing where there are no rows.

    Cells are wrapped to keep to the width, the widest columns first; numbers never, and the first
    column only where there is no other way.

    :param title: the line above it
    :param header: the names of the columns
    :param rows: the cells, one for each column
    :param width: of a line [characters]
    """
    if not rows:
        return ''
    columns = list(zip(header, *rows, strict=True))
    room = width - len(_INDENT) - len(_GAP) * (len(columns) - 1)
    widths = [max(map(len, column)) for column in columns]
    text = [not _all_match(_NUMERIC_OR_SPAN, column) for column in columns]
    widths = _fitted(widths, room, [False, *text[1:]])
    widths = _fitted(widths, room, text)
    to_the_right = [_all_match(_NUMERIC, column) for column in columns]
    lines = [title]
    for row in (header, *rows):
        cells = [_wrapped(cell, space) for cell, space in zip(row, widths)]
        for pieces in zip_longest(*cells, fillvalue=''):
            line = _GAP.join(
                piece.rjust(space) if right else piece.ljust(space)
                for piece, space, right in zip(pieces, widths, to_the_right))
            lines.append((_INDENT + line).rstrip())
    return '\n'.join(lines)


def _all_match(pattern: re.Pattern[str], column: Sequence[str]) -> bool:
    """Return whether all cells below the header match."""
    return all(pattern.fullmatch(cell) for cell in column[1:])


def _fitted(widths: Sequence[int], room: int, shrinks: Sequence[bool]) -> list[int]:
    """Return widths that fit into a room if they can: the widest that may shrink do so first."""
    fitted = list(widths)
    while sum(fitted) > room:
        widest = max((w for w, may in zip(fitted, shrinks) if may), default=0)
        if widest <= _NARROWEST:
            break
        fitted[next(i for i, may in enumerate(shrinks) if may and fitted[i] == widest)] -= 1
    return fitted


def _wrapped(cell: str, width: int) -> list[str]:
    if len(cell) <= width:
        return [cell]
    lines = ['']
    for piece in _PIECES.findall(cell):
        if len(lines[-1]) + len(piece.rstrip()) > width and lines[-1]:
            lines.append('')
        while len(piece.rstrip()) > width:  # A word that no line can hold.
            lines[-1], piece = piece[:width], piece[width:]
            lines.append('')
        lines[-1] += piece
    return [line.rstrip() for line in lines]


def number(value: float | None) -> str:
    """Return a number rounded to a millionth, with four digits at most; ``-`` for None."""
    return '-' if value is None else f'{round(value, 6) + 0.0:.4g}'


def span(limits: Sequence[float] | None) -> str:
    """Return a lowest and a highest value as text; ``-`` for None."""
    return '-' if limits is None else ' to '.join(map(number, limits))
