# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The exceptions that a caller can act on.

Each message names the request, the finding and the available choices.
"""

from __future__ import annotations

from collections.abc import Iterable
import difflib
import itertools
import re

from manip_sim.quoting import quoted

#: Least similarity of a suggested name, from 0 to 1.
_ALIKE = 0.5
#: Number of characters of a requested name that are compared; a longer one resembles none.
_COMPARED_CHARACTERS = 100
#: Longest suggestions, and longest suggestions and list of names together [characters].
_MAX_HINT, _MAX_CHOICES = 120, 240


class ManipSimError(Exception):
    """Base class of every error that manip_sim raises on purpose."""


class ModelError(ManipSimError, ValueError):
    """A model file or a composition of models is not usable as it is."""


class KindError(ModelError, TypeError):
    """A value is of a kind that cannot be used in its place."""


class MessageError(ManipSimError, ValueError):
    """A message cannot be read, or holds what cannot be used."""


class CommandError(ManipSimError, ValueError):
    """A command is invalid (length, joint names, numbers) or cannot be carried out at present."""


class ParameterError(ManipSimError, ValueError):
    """A parameter of the node has an unknown name or a value that cannot be used."""


class DivergenceError(ManipSimError):
    """The physics has diverged; the simulation holds its last good state until it is reset."""


class SimulationEnded(ManipSimError):
    """The simulation has ended."""


class RecordError(ManipSimError):
    """A record cannot be written, read, repeated or converted."""


class UnknownNameError(ModelError, KeyError):
    """
    A name is not among those available.

    :ivar kind: of thing that was looked up, such as ``robot``
    :ivar name: the name that was requested
    :ivar available: the names that exist
    """

    def __init__(self, kind: str, name: object, available: Iterable[str]) -> None:
        self.kind = kind
        self.name = name
        self.available = list(available)
        super().__init__(f'unknown {kind} {quoted(name)}: '
                         f'{describe_choices(name, self.available)}')

    def __str__(self) -> str:
        # KeyError would print the repr of the message.
        return str(self.args[0])


def describe_choices(name: object, available: Iterable[str]) -> str:
    """
    Suggest the nearest names, and list the available ones, in at most 240 characters.

    :returns: a sentence part such as ``did you mean 'Panda'? available: Panda, UR5e``, with
        ``... and 3 more`` in place of the names that do not fit
    """
    names = [choice for choice in available if choice]  # An empty one stands for nothing at all.
    near = [f"'{candidate}'" for candidate in _nearest(str(name)[:_COMPARED_CHARACTERS], names)]
    while len(near) > 1 and sum(map(len, near)) > _MAX_HINT:
        near.pop()
    hint = f"did you mean {' or '.join(near)}? " if near else ''
    begin = f'{hint}available: '
    return begin + _listing(names, _MAX_CHOICES - len(begin))


def _listing(names: list[str], room: int) -> str:
    listed = ', '.join(names) if names else 'none'
    shown = len(names)
    while len(listed) > room and shown:
        shown -= 1
        listed = ', '.join([*names[:shown], f'... and {len(names) - shown} more'])
    return listed


def _nearest(asked: str, names: list[str]) -> list[str]:
    """
    Return up to three names, the nearest first.

    These are names of the same words in any order, singular or plural; else names that end with
    the same words, as ``robot0_joint1`` does for ``joint1``; else names that look alike.
    """
    words, asked_words = {name: _singulars(name) for name in names}, _singulars(asked)
    ending = {name: _common_end(asked_words, words[name]) for name in names}
    longest = max(ending.values(), default=0)
    near = [name for name in names if sorted(words[name]) == sorted(asked_words)]
    if not near and longest:
        near = [name for name in names if ending[name] == longest]
    likeness = {name: _likeness(asked, name) for name in near or names}
    if not near:
        near = [name for name in names if likeness[name] >= _ALIKE]
    return sorted(near, key=lambda name: -likeness[name])[:3]


def _words(name: str) -> list[str]:
    return re.findall(r'[a-z0-9]+', name.lower())


def _singulars(name: str) -> list[str]:
    return [word.removesuffix('s') for word in _words(name)]


def _common_end(first: list[str], second: list[str]) -> int:
    pairs = zip(reversed(first), reversed(second))
    return sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], pairs))


def _likeness(first: str, second: str) -> float:
    """Return the similarity of two names, or of their sorted words if higher, from 0 to 1."""
    return max(
        difflib.SequenceMatcher(None, second.lower(), first.lower()).ratio(),
        difflib.SequenceMatcher(None, ' '.join(sorted(_words(second))),
                                ' '.join(sorted(_words(first)))).ratio())
