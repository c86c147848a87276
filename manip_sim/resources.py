# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Installed resources: data files, version and cache of the package, and classes of other packages.

Other packages offer their classes as Python entry points, which are found without importing them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
import logging
import os
from pathlib import Path
import re
import sys
from typing import Any, TYPE_CHECKING

from manip_sim.errors import ModelError

if TYPE_CHECKING:
    from importlib import metadata

PACKAGE = 'manip_sim'
_LOGGER = logging.getLogger('manip_sim.models')
_OUR_GROUPS = re.compile(r'^\s*\[manip_sim\.', re.MULTILINE)


@lru_cache(maxsize=1)
def share_directory() -> Path:
    """
    Return the folder that holds ``assets/`` and ``config/``.

    That is the source tree when the package runs from one (also with an editable or symlinked
    install), else ``share/manip_sim`` of the prefix that this package is installed under: a
    virtual environment, a user or system prefix, or a colcon install space.

    :raises ModelError: if neither holds the assets
    """
    package = Path(__file__).resolve().parent
    source_tree = package.parent
    if (source_tree / 'package.xml').is_file() and (source_tree / 'assets').is_dir():
        return source_tree
    for prefix in package.parents:
        share = prefix / 'share' / PACKAGE
        if (share / 'assets').is_dir():
            return share
    raise ModelError(f'the assets of {PACKAGE} are not installed: no share/{PACKAGE}/assets in '
                     f'any folder above {package}')


@lru_cache(maxsize=1)
def package_version() -> str:
    """Return the version that ``package.xml`` declares."""
    from xml.etree import ElementTree  # Not needed to start a node.
    version = ElementTree.parse(share_directory() / 'package.xml').findtext('version')
    assert version is not None
    return version


def asset_path(kind: str, name: str) -> Path:
    """
    Return the MJCF file of one part.

    :param kind: ``robots``, ``grippers``, ``bases`` or ``arenas``
    """
    return share_directory() / 'assets' / kind / name / f'{name}.xml'


def cache_folder(kind: str) -> Path:
    """
    Return the user's folder of files derived from others; it need not exist.

    :param kind: ``meshes``, which were made from others, or ``laws``, compiled ones of control
    """
    home = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    return Path(home, 'manip_sim', kind)


def keep_in_cache(file: Path, content: bytes) -> None:
    """Write a file as a whole; another process may write the same at the same time."""
    import tempfile  # Commands start without it.
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile('wb', dir=file.parent, delete=False) as stream:
        stream.write(content)
    os.replace(stream.name, file)


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
    from importlib import metadata  # It takes a while, and most programs need it later.
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
