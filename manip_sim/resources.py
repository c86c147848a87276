# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Places of the data files of the package and of its cache, and the version of the package."""

from __future__ import annotations

from functools import lru_cache
import os
from pathlib import Path
import tempfile

from manip_sim.errors import ModelError

PACKAGE = 'manip_sim'


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
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile('wb', dir=file.parent, delete=False) as stream:
        stream.write(content)
    os.replace(stream.name, file)
