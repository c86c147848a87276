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
import string
from typing import NamedTuple

_MAX_DEPTH = 20
_CLASSES = {
    'alpha': string.ascii_letters, 'digit': string.digits, 'xdigit': string.hexdigits,
    'alnum': string.ascii_letters + string.digits, 'upper': string.ascii_uppercase,
    'lower': string.ascii_lowercase, 'punct': string.punctuation, 'blank': ' \t',
    'space': string.whitespace, 'print': string.printable[:95], 'graph': string.printable[:94],
    'cntrl': ''.join(map(chr, [*range(32), 127]))}
_MAX_LENGTH = 200
_MAX_INSTRUCTIONS = 500


class Node(NamedTuple):
    """
    A part of an expression.

    :ivar kind: ``test``, ``begin``, ``end``, ``sequence``, ``choice`` or ``repeat``
    :ivar parts: of a sequence or choice, or what is repeated
    :ivar test: of a ``test``, whether it matches a character
    :ivar least: how often a ``repeat`` has to match
    :ivar most: how often it may match; None: without end
    """

    kind: str
    parts: tuple[Node, ...] = ()
    test: Callable[[str], bool] | None = None
    least: int = 0
    most: int | None = None


class _EreParser:
    """A recursive descent parser."""

    def __init__(self, pattern: str) -> None:
        self._pattern = pattern
        self._at = 0
        self._depth = 0

    def _peek(self, text: str) -> bool:
        return self._pattern.startswith(text, self._at)

    def _skip(self, text: str) -> bool:
        found = self._peek(text)
        self._at += len(text) if found else 0
        return found

    @property
    def _more(self) -> bool:
        return self._at < len(self._pattern)

    def parse(self) -> Node:
        node = self._choice()
        if self._more:
            raise ValueError("unmatched ')'")
        return node

    def _choice(self) -> Node:
        branches = [self._sequence()]
        while self._skip('|'):
            branches.append(self._sequence())
        return Node('choice', tuple(branches))

    def _sequence(self) -> Node:
        pieces = []
        while self._more and not self._peek('|') and not self._peek(')'):
            pieces.append(self._repeated(self._atom()))
        return Node('sequence', tuple(pieces))

    def _repeated(self, node: Node) -> Node:
        while self._more and self._pattern[self._at] in '*+?{':
            if node.kind in ('begin', 'end'):
                raise ValueError(f"nothing to repeat before '{self._pattern[self._at]}'")
            least, most = self._bounds()
            node = Node('repeat', (node,), None, least, most)
        return node

    def _bounds(self) -> tuple[int, int | None]:
        for sign, least, most in (('*', 0, None), ('+', 1, None), ('?', 0, 1)):
            if self._skip(sign):
                return least, most
        inside, brace, _ = self._pattern[self._at + 1:].partition('}')
        lower, comma, upper = inside.partition(',')
        numbers = [lower] + [upper] * bool(upper)
        if not brace or not all(n.isascii() and n.isdigit() and len(n) < 4 for n in numbers):
            raise ValueError("bad bounds after '{'")
        self._at += len(inside) + 2
        least = int(lower)
        most = int(upper) if upper else None if comma else least
        if most is not None and most < least:
            raise ValueError(f"bad bounds '{{{inside}}}'")
        return least, most

    def _atom(self) -> Node:
        character = self._pattern[self._at]
        self._at += 1
        if character == '(':
            return self._group()
        if character == '[':
            return self._bracket()
        if character in '^$':
            return Node('begin' if character == '^' else 'end')
        if character in '*+?{':
            raise ValueError(f"nothing to repeat before '{character}'")
        if character == '.':
            return Node('test', test=lambda other: True)
        if character == '\\':
            character = self._pattern[self._at:self._at + 1]
            if not character or character not in string.punctuation:
                raise ValueError('a backslash must be followed by punctuation, which it makes '
                                 'literal')
            self._at += 1
        return Node('test', test=character.__eq__)

    def _group(self) -> Node:
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise ValueError(f'groups are nested more than {_MAX_DEPTH} deep')
        node = self._choice()
        if not self._skip(')'):
            raise ValueError("unmatched '('")
        self._depth -= 1
        return node

    def _bracket(self) -> Node:
        negated = self._skip('^')
        members: set[str] = set()
        ranges: list[tuple[str, str]] = []
        first = True
        while first or not self._peek(']'):
            first = False
            if self._skip('[:'):
                name, end, _ = self._pattern[self._at:].partition(':]')
                if not end or name not in _CLASSES:
                    raise ValueError("unknown class after '[:'")
                self._at += len(name) + 2
                members.update(_CLASSES[name])
                continue
            low = self._member()
            if self._peek('-') and not self._peek('-]'):
                self._at += 1
                high = self._member()
                if high < low:
                    raise ValueError(f"bad range '{low}-{high}'")
                ranges.append((low, high))
            else:
                members.add(low)
        self._at += 1

        def test(character: str) -> bool:
            return negated != (character in members or any(
                low <= character <= high for low, high in ranges))
        return Node('test', test=test)

    def _member(self) -> str:
        if not self._more:
            raise ValueError("unmatched '['")
        if self._peek('[.') or self._peek('[=') or self._peek('[:'):
            raise ValueError('collating elements and equivalence classes are not supported')
        self._at += 1
        return self._pattern[self._at - 1]


def parse(pattern: str) -> Node:
    """
    Return the tree of an expression.

    :raises ValueError: if it is not one
    """
    return _EreParser(pattern).parse()


class PosixExpression:
    """
    A POSIX Extended regular expression in the C locale; without back-references.

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
