# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Output of commands: tables as plain text, progress on a terminal, and whole files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import io
import os
from pathlib import Path
import re
import shutil
import sys
import tempfile
import time

from manip_sim.errors import ManipSimError

_GAP, _INDENT = '  ', '  '
#: No column gets narrower than this by wrapping.
_NARROWEST = 10
#: Lines are wrapped only on a terminal, for grep and the like.
_ENDLESS = 1_000_000
_NUMERIC = re.compile(r'-?\d[\d.e+-]*|-')
_NUMERIC_OR_SPAN = re.compile(rf'({_NUMERIC.pattern})( to {_NUMERIC.pattern})?')


def terminal_width() -> int:
    """Return how many characters fit into a line; the variable ``COLUMNS`` overrides it."""
    return shutil.get_terminal_size(fallback=(_ENDLESS, 24)).columns


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> str:
    """
    Return a table, or nothing without rows.

    Cells are wrapped to keep to the width, but numbers never.

    :param width: of a line [characters]
    """
    if not rows:
        return ''
    from rich.console import Console
    from rich.table import Column, Table
    columns, least = [], -len(_GAP)
    for name, *cells in zip(header, *rows, strict=True):
        is_fixed = all(map(_NUMERIC_OR_SPAN.fullmatch, cells))
        widest = max(map(len, (name, *cells)))
        least += (widest if is_fixed else min(widest, _NARROWEST)) + len(_GAP)
        columns.append(Column(
            name, no_wrap=is_fixed, overflow='fold',
            justify='right' if all(map(_NUMERIC.fullmatch, cells)) else 'left'))
    drawn = Table(*columns, box=None, pad_edge=False, padding=(0, len(_GAP), 0, 0))
    for row in rows:
        drawn.add_row(*row)
    text = io.StringIO()
    Console(file=text, width=max(width - len(_INDENT), least), color_system=None, markup=False,
            emoji=False, highlight=False).print(drawn)
    lines = [title, *(_INDENT + line for line in text.getvalue().splitlines())]
    return '\n'.join(line.rstrip() for line in lines)


def number(value: float | None) -> str:
    """Return a number rounded to a millionth, with four digits at most; ``-`` for None."""
    return '-' if value is None else f'{round(value, 6) + 0.0:.4g}'


def span(limits: Sequence[float] | None) -> str:
    """Return a lowest and a highest value as text; ``-`` for None."""
    return '-' if limits is None else ' to '.join(map(number, limits))


#: Shortest time between two lines [s].
_PERIOD_S = 0.2


class ProgressBar:
    """
    A line on standard error, if that is a terminal.

    :param unit: is counted, such as ``episodes``
    """

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._shows = sys.stderr is not None and sys.stderr.isatty()
        self._last_s = 0.0

    def show(self, done: int, more: str = '') -> None:
        """Show how much is done, and a text behind it."""
        if self._shows and time.monotonic() - self._last_s > _PERIOD_S:
            self._last_s = time.monotonic()
            print(f'\r\x1b[K{done} {self._unit}{more}', end='', file=sys.stderr, flush=True)

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shows:
            print('\r\x1b[K', end='', file=sys.stderr, flush=True)


class UsageError(ManipSimError):
    """Arguments that cannot be used; exit code 2, as for a wrong command line."""


def check_folder(file: Path) -> None:
    """
    Check that there is a folder for a file.

    :raises ManipSimError: if there is none, or the file itself is a folder
    """
    if file.is_dir():
        raise ManipSimError(f'{file} is a folder, give the name of a file')
    if not file.parent.is_dir():
        raise ManipSimError(f'no such folder: {file.parent}')


def write_whole(file: Path, write: Callable[[Path], object]) -> None:
    """
    Let a function write a file, and put it into place when it is complete.

    :param file: overwritten if it is there
    :param write: takes the path to write to, which has the same suffix
    :raises OSError: with the name of the file, if it cannot be written
    """
    check_folder(file)
    # A file made by mkstemp is readable by its owner alone.
    mask = os.umask(0)
    os.umask(mask)
    descriptor, name = tempfile.mkstemp(prefix=f'.{file.stem}_', suffix=file.suffix,
                                        dir=file.parent)
    os.close(descriptor)
    unfinished = Path(name)
    try:
        write(unfinished)
        unfinished.chmod(0o666 & ~mask)
        unfinished.replace(file)
    except OSError as error:
        if error.filename in (None, name):
            error.filename = str(file)
        raise
    finally:
        unfinished.unlink(missing_ok=True)
