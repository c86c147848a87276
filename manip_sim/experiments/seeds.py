# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which seeds a run has: read from texts such as ``0:1000`` and ``2/4``."""

from __future__ import annotations

import re

from manip_sim.errors import ModelError
from manip_sim.quoting import quoted

#: More seeds than anybody runs: most likely a mistake.
MOST = 10_000_000
_PIECE = re.compile(r'(\d{1,18})(?::(\d{1,18})(?::(\d{1,18}))?)?', re.ASCII)
_SHARD = re.compile(r'(\d{1,9})/(\d{1,9})', re.ASCII)


def parse_seeds(text: str) -> list[int]:
    """
    Return the seeds that a text stands for, in its order.

    :param text: such as ``7``, ``0:1000``, which is 0 to 999, ``0:1000:10`` or ``1,5,10:20``
    :raises ModelError: if it is none of these, or empty, or has a seed twice
    """
    seeds: list[int] = []
    for piece in text.split(','):
        match = _PIECE.fullmatch(piece.strip())
        if match is None:
            raise ModelError(f'seeds {quoted(text)}: {quoted(piece)} must be like 7, 0:1000 or '
                             '0:1000:10, of whole numbers from 0')
        first, stop, step = (None if group is None else int(group) for group in match.groups())
        assert first is not None
        found = range(first, first + 1 if stop is None else stop, 1 if step is None else step or 1)
        if not found or step == 0:
            raise ModelError(f'seeds {quoted(text)}: {quoted(piece)} has no seed; 0:1000 is 0 to '
                             '999')
        if len(seeds) + len(found) > MOST:
            raise ModelError(f'seeds {quoted(text)}: more than {MOST} seeds')
        seeds += found
    if len(set(seeds)) != len(seeds):
        raise ModelError(f'seeds {quoted(text)}: a seed appears twice')
    return seeds


def parse_shard(text: str) -> tuple[int, int]:
    """
    Return number and count of a shard.

    :param text: from ``1/4`` to ``4/4``
    :raises ModelError: if it is not like that
    """
    match = _SHARD.fullmatch(text.strip())
    number, count = (int(group) for group in match.groups()) if match else (0, 0)
    if not 1 <= number <= count:
        fits = f'from 1/{count} to {count}/{count}' if count else 'like 1/4'
        raise ModelError(f'shard {quoted(text)} must be {fits}')
    return number, count
