# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Keep commands until the next control period; the newest wins and nothing piles up."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from manip_sim.simulation.commands import Command, Goal


class Staging:
    """
    Commands that wait.

    :param lockstep_parts: the parts that must each have one for :attr:`complete`
    """

    def __init__(self, lockstep_parts: Iterable[str] = ()) -> None:
        self._needed = frozenset(lockstep_parts)
        self._waiting: dict[tuple[str, type], Command] = {}

    def add(self, command: Command) -> None:
        """Keep a command; of the same kind and part the newer one wins, joint by joint."""
        key = command.part, type(command)
        older = self._waiting.pop(key, None)
        if isinstance(command, Goal) and isinstance(older, Goal) and older.mode == command.mode:
            command = _merge(older, command)
        self._waiting[key] = command

    @property
    def complete(self) -> bool:
        """Whether every one of the lockstep parts has a command."""
        return self._needed <= {part for part, _ in self._waiting}

    def take(self) -> list[Command]:
        """Return the commands in the order of their arrival, and forget them."""
        commands = list(self._waiting.values())
        self._waiting.clear()
        return commands

    def clear(self) -> None:
        """Forget all commands."""
        self._waiting.clear()


def _merge(older: Goal, newer: Goal) -> Goal:
    kept = ~np.isin(older.indices, newer.indices)
    return Goal(newer.part, newer.mode,
                np.concatenate([older.indices[kept], newer.indices]),
                np.concatenate([older.values[kept], newer.values]), newer.clamped)
