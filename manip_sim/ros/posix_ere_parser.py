# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Parse POSIX Extended regular expressions; ``posix_ere`` searches them in texts."""

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


class _Parser:
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

    :param pattern: the expression
    :raises ValueError: if it is not one
    """
    return _Parser(pattern).parse()
