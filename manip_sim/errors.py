# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The exceptions that a caller can act on.

Each message says what was asked, what was found and what is available.
"""

from __future__ import annotations

from collections.abc import Iterable
import difflib


class ManipSimError(Exception):
    """Base class of every error that manip_sim raises on purpose."""


class ModelError(ManipSimError, ValueError):
    """A model file or a composition of models is not usable as it is."""


class CommandError(ManipSimError, ValueError):
    """A command has the wrong length, an unknown joint or a number that is not finite."""


class ParameterError(ManipSimError, ValueError):
    """A parameter of the node has an unknown name or a value that cannot be used."""


class SimulationEnded(ManipSimError):
    """The simulation is not running any more."""


class UnknownNameError(ModelError, KeyError):
    """
    A name is not among those available.

    :ivar kind: what was looked up, such as ``robot``
    :ivar name: the name that was asked for
    :ivar available: the names that exist
    """

    def __init__(self, kind: str, name: object, available: Iterable[str]) -> None:
        self.kind = kind
        self.name = name
        self.available = list(available)
        super().__init__(f"unknown {kind} '{name}': {describe_choices(name, self.available)}")

    def __str__(self) -> str:
        # KeyError would print the repr of the message.
        return str(self.args[0])


def describe_choices(name: object, available: Iterable[str]) -> str:
    """
    Say which of the available names is nearest, and which there are.

    :param name: what was asked for
    :param available: the names that exist
    :returns: a sentence part such as ``did you mean 'Panda'? available: Panda, UR5e``
    """
    names = list(available)
    by_lower_case = {candidate.lower(): candidate for candidate in names}
    near = difflib.get_close_matches(str(name).lower(), by_lower_case, n=3, cutoff=0.5)
    hint = ''
    if near:
        hint = 'did you mean ' + ' or '.join(f"'{by_lower_case[match]}'" for match in near) + '? '
    return f"{hint}available: {', '.join(names) if names else 'none'}"
