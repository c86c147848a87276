# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the classes that other packages offer as Python entry points, without importing them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
import logging
import os
import re
import sys
from typing import Any

from manip_sim.errors import ModelError

_LOGGER = logging.getLogger('manip_sim.models')
_OUR_GROUPS = re.compile(r'^\s*\[manip_sim\.', re.MULTILINE)


@dataclass(frozen=True)
class Offer:
    """
    An entry point of another package.

    :ivar name: of the robot, gripper, base or arena
    :ivar value: where its class is, such as ``my_robots.arms:MyArm``
    :ivar package: name and version of the package that offers it
    """

    name: str
    value: str
    package: str
    _entry_point: metadata.EntryPoint

    def load(self) -> Any:
        """
        Import the module and return what the entry point names.

        :raises ModelError: if the import raises anything
        """
        try:
            return self._entry_point.load()
        except (Exception, SystemExit) as error:
            reason = ' '.join(str(error).split()) or 'no message'
            raise ModelError(f'{self} cannot be imported: {type(error).__name__}: {reason}'
                             ) from error

    def __str__(self) -> str:
        return f"'{self.name}' of the package {self.package} ({self.value})"


def offers(group: str) -> dict[str, Offer]:
    """
    Return what the packages on ``sys.path`` offer, by name; the first on the path counts.

    :param group: such as ``manip_sim.robots``
    """
    by_name: dict[str, Offer] = {}
    # '' is the working directory, which may be on the path by its name too.
    path = tuple(dict.fromkeys(map(os.path.abspath, sys.path)))
    for entry_group, offer in _all_offers(path):
        if entry_group == group:
            by_name.setdefault(offer.name, offer)
    return by_name


@lru_cache(maxsize=4)
def _all_offers(path: tuple[str, ...]) -> tuple[tuple[str, Offer], ...]:
    distributions = list(metadata.distributions(path=list(path)))
    # Reading names takes long; they are needed because only the first package of a name counts.
    if not _offer_some(distributions):
        return ()
    collected, packages = [], set()
    for distribution in distributions:
        try:
            name, version = distribution.name, distribution.version
            offered = list(_of_ours(distribution, f'{name} {version}'))
        except Exception as error:
            # One damaged package must not hide the others.
            _LOGGER.warning('cannot read the entry points of %s: %s: %s',
                            getattr(distribution, '_path', 'a package'), type(error).__name__,
                            ' '.join(str(error).split()))
            continue
        if name not in packages:
            packages.add(name)
            collected += offered
    return tuple(collected)


def _offer_some(distributions: list[metadata.Distribution]) -> bool:
    for distribution in distributions:
        try:
            if _OUR_GROUPS.search(distribution.read_text('entry_points.txt') or ''):
                return True
        except Exception:  # The caller reads it again and logs the error.
            return True
    return False


def _of_ours(distribution: metadata.Distribution, package: str) -> Iterator[tuple[str, Offer]]:
    if not _offer_some([distribution]):
        return
    for point in distribution.entry_points:
        if point.group.startswith('manip_sim.'):
            yield point.group, Offer(point.name, point.value, package, point)
