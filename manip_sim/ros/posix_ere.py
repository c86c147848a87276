# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
POSIX Extended regular expressions that are searched in a bounded time.

The time grows at most with the length of the text times that of the expression, repetitions
written out: all paths through the expression are followed at once (K. Thompson, "Regular
expression search algorithm", 1968). Python's ``re`` backtracks, which may take exponential time.
"""

from __future__ import annotations

from collections.abc import Callable

from manip_sim.ros.posix_ere_parser import Node, parse

_MAX_LENGTH = 200
_MAX_INSTRUCTIONS = 500


class PosixExpression:
    """
    A POSIX Extended regular expression in the C locale; without back-references.

    :param pattern: the expression
    :raises ValueError: if it is not one, or is too long
    """

    def __init__(self, pattern: str) -> None:
        if len(pattern) > _MAX_LENGTH:
            raise ValueError(f'longer than {_MAX_LENGTH} characters')
        #: Instructions: kind, test of a character, and the instructions that may follow.
        self._program: list[tuple[str, Callable[[str], bool] | None, list[int]]] = []
        self._emit(parse(pattern))
        self._add('match')

    def _add(self, kind: str, test: Callable[[str], bool] | None = None) -> list[int]:
        if len(self._program) >= _MAX_INSTRUCTIONS:
            raise ValueError(f'more than {_MAX_INSTRUCTIONS} parts when repetitions are written '
                             'out')
        following = [len(self._program) + 1]
        self._program.append((kind, test, following))
        return following

    def _emit(self, node: Node) -> None:
        if node.kind in ('test', 'begin', 'end'):
            self._add(node.kind, node.test)
        elif node.kind == 'sequence':
            for part in node.parts:
                self._emit(part)
        elif node.kind == 'choice':
            self._emit_choice(node.parts)
        else:
            self._emit_repeat(node)

    def _emit_choice(self, branches: tuple[Node, ...]) -> None:
        ends = []
        for branch in branches[:-1]:
            fork = self._add('go')
            self._emit(branch)
            ends.append(self._add('go'))
            fork.append(len(self._program))
        self._emit(branches[-1])
        for end in ends:
            end[:] = [len(self._program)]

    def _emit_repeat(self, node: Node) -> None:
        (part,) = node.parts
        for _ in range(node.least):
            self._emit(part)
        if node.most is None:
            begin = len(self._program)
            fork = self._add('go')
            self._emit(part)
            self._add('go')[:] = [begin]
            fork.append(len(self._program))
            return
        forks = []
        for _ in range(node.most - node.least):
            forks.append(self._add('go'))
            self._emit(part)
        for fork in forks:
            fork.append(len(self._program))

    def found_in(self, text: str) -> bool:
        """Return whether a part of a text matches."""
        waiting: set[int] = set()
        for position in range(len(text) + 1):
            waiting.add(0)
            waiting = self._reachable(waiting, position == 0, position == len(text))
            if len(self._program) - 1 in waiting:
                return True
            if position < len(text):
                waiting = {at + 1 for at in waiting if self._passes(at, text[position])}
        return False

    def _passes(self, at: int, character: str) -> bool:
        test = self._program[at][1]
        return test is not None and test(character)

    def _reachable(self, places: set[int], begin: bool, end: bool) -> set[int]:
        """Return all instructions that are reached without a further character."""
        reached: set[int] = set()
        left = list(places)
        while left:
            at = left.pop()
            if at in reached:
                continue
            reached.add(at)
            kind, _, following = self._program[at]
            if kind == 'go' or (kind == 'begin' and begin) or (kind == 'end' and end):
                left += following
        return reached
