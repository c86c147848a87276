# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Text from outside as messages show it: on one line, without control characters, shortened."""

from __future__ import annotations

from collections.abc import Sequence

_TEXT_LIMIT = 60
_NAMES_LIMIT = 5
_LINE_LIMIT = 500


def quoted(text: object, limit: int = _TEXT_LIMIT) -> str:
    """
    Return a name or value in quotes, shortened, with unprintable characters escaped.

    :param text: what came from outside; a long one costs no more than a short one
    """
    text = text if isinstance(text, str) else str(text)
    return f'{text[:limit]!r}{"..." if len(text) > limit else ""}'


def format_value(value: object, limit: int = _TEXT_LIMIT) -> str:
    """Return a value that came from outside: a text in quotes, any other on one line."""
    return quoted(value, limit) if isinstance(value, str) else one_line(str(value), limit)


def quoted_names(names: Sequence[object], limit: int = _NAMES_LIMIT) -> str:
    """
    Return names in quotes, separated by commas.

    :param names: what came from outside; only the first of many are shown
    """
    shown = ', '.join(quoted(name) for name in names[:limit])
    return shown if len(names) <= limit else f'{shown} and {len(names) - limit} more'


def one_line(text: str, limit: int = _LINE_LIMIT) -> str:
    """Return a text, shortened, with line ends and control characters escaped."""
    cut = text if len(text) <= limit else f'{text[:limit]}...'
    if cut.isprintable():
        return cut
    return ''.join(c if c.isprintable() else repr(c)[1:-1] for c in cut)


def pluralize(count: int, noun: str) -> str:
    """Return a count and the counted noun, such as ``1 body`` and ``2 bodies``."""
    if count == 1:
        return f'{count} {noun}'
    return f'{count} {noun[:-1]}ies' if noun.endswith('dy') else f'{count} {noun}s'
