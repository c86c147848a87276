# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Verbs that other packages add to the command ``manip_sim``."""

from __future__ import annotations

from abc import ABC, abstractmethod
import argparse
import inspect
import re
import sys

from manip_sim.errors import ManipSimError, ModelError
from manip_sim.resources import Offer

GROUP = 'manip_sim.commands'
_NAME = re.compile(r'[a-z][a-z0-9_-]*')


class Verb(ABC):
    """
    A verb of the command line, ``manip_sim VERB``; its name is that of the entry point.

    :cvar summary: what it does, in a line for ``manip_sim --help``
    """

    summary: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:  # noqa: B027
        """Add options and arguments; by default there are none but ``--help``."""

    @abstractmethod
    def run(self, options: argparse.Namespace) -> tuple[str, int]:
        """
        Do it.

        :returns: the text to print, and the exit code: 0, or 1 if something is wrong
        :raises ManipSimError: if it cannot be done; printed as one line, exit code 1
        """


class OfferedVerb(Verb):
    """
    A verb of another package; whatever that raises is an error that names the package.

    :raises ModelError: if it cannot be used
    """

    def __init__(self, offer: Offer) -> None:
        self._offer = offer
        verb = offer.load()
        if not (inspect.isclass(verb) and issubclass(verb, Verb)
                and not inspect.isabstract(verb)
                and isinstance(getattr(verb, 'summary', None), str)):
            raise ModelError(f'{offer} must be a class that derives from Verb, with run() and a '
                             f'summary, got {verb!r:.60}')
        if not _NAME.fullmatch(offer.name):
            raise ModelError(f'{offer} needs a name of lower-case letters, digits, _ and -')
        try:
            self._verb: Verb = verb()
        except Exception as error:  # A class of another package may raise anything.
            raise self._failure(error) from error
        self.summary = verb.summary

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """
        Add the options of the verb.

        :raises ModelError: if the verb raises anything
        """
        try:
            self._verb.add_arguments(parser)
        except Exception as error:
            raise self._failure(error) from error

    def run(self, options: argparse.Namespace) -> tuple[str, int]:
        """
        Run the verb.

        :raises ModelError: if it raises any error but a ManipSimError or OSError
        """
        try:
            result = self._verb.run(options)
        except (ManipSimError, OSError):
            raise
        except Exception as error:
            if sys.flags.dev_mode:
                raise
            raise self._failure(error) from error
        if not (isinstance(result, tuple) and [*map(type, result)] == [str, int]):
            raise ModelError(f'{self._offer} must return a text and an exit code, got '
                             f'{result!r:.60}')
        return result

    def _failure(self, error: Exception) -> ModelError:
        return ModelError(f'{self._offer}: {type(error).__name__}: {error}')
