# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The folders of compiled laws of control, one for each version of their dependencies."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import fcntl
from functools import cache
import hashlib
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform
import shutil
import tempfile

import mujoco

from manip_sim.resources import cache_folder

#: So many folders of other versions stay, those used last.
_OTHERS = 12
#: File in a folder of laws, once all of them are there; and one that is locked until they are.
_ALL, _LOCK = 'all', 'lock'
#: Modules of the same folder in which nothing is compiled.
_NO_LAWS = ('kept.py', 'loading.py')
#: The first release of numba that asks others where it keeps functions.
_TAKES_LOCATORS = (0, 62)


def _version() -> str:
    """Return a name for the versions of everything that the compiled code depends on."""
    content = hashlib.sha256()
    for word in (_version_of_numba(), mujoco.__version__, platform.python_version(), _processor(),
                 # An older numba finds what it has kept by the path of the source.
                 '' if takes_locators() else str(Path(__file__).parent)):
        content.update(f'{word}\n'.encode())
    # numba looks only at the file of the function that is called, not at those it calls, nor at
    # the arrays whose types compiled code reads rows by.
    laws = Path(__file__).parent
    for path in (*sorted(laws.glob('*.py')), laws.parents[1] / 'physics' / 'physics.py'):
        if path.name not in _NO_LAWS:
            content.update(path.read_bytes())
    return content.hexdigest()[:16]


def _processor() -> str:
    """Return the kind of the processor; a home may be on several machines."""
    with contextlib.suppress(OSError):
        first, _, _ = Path('/proc/cpuinfo').read_text().partition('\n\n')
        return '\n'.join(line for line in first.splitlines() if line.startswith(
            ('model name', 'flags', 'Features', 'CPU part')))
    return f'{platform.machine()} {platform.processor()}'


def _version_of_numba() -> str:
    """Return the version of numba, if possible without importing it."""
    try:
        return version('numba')
    except PackageNotFoundError:
        import numba
        return str(numba.__version__)


@cache
def takes_locators() -> bool:
    """Return whether copies of one version of the laws can share what is compiled of them."""
    major, minor = _version_of_numba().split('.')[:2]
    return (int(major), int(minor)) >= _TAKES_LOCATORS


@cache
def laws_folder() -> Path | None:
    """Return where compiled laws are kept, or None if they can be kept nowhere."""
    for parent in (cache_folder('laws'), Path(tempfile.gettempdir(), f'manip_sim-{os.getuid()}')):
        folder = parent / _version()
        with contextlib.suppress(OSError):
            if not folder.exists():
                _remove_old(parent)
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            # Code of this folder is run: nobody else may put it there.
            if os.access(folder, os.W_OK) and all(
                    path.stat().st_uid == os.getuid() for path in (folder, parent)):
                os.utime(folder)
                return folder
    return None


def _remove_old(parent: Path) -> None:
    """Remove the laws of all but some of other versions; a process has what it runs."""
    with contextlib.suppress(OSError):  # Another process may remove the same.
        others = sorted(parent.glob('[0-9a-f]' * 16), key=lambda folder: folder.stat().st_mtime)
        for folder in others[:-_OTHERS]:
            shutil.rmtree(folder, ignore_errors=True)


def all_are_kept() -> bool:
    """Return whether nothing has to be compiled."""
    folder = laws_folder()
    return folder is not None and (folder / _ALL).exists()


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """Wait while another process compiles the same laws."""
    folder = laws_folder()
    with contextlib.ExitStack() as stack:
        if folder is not None and not all_are_kept():
            with contextlib.suppress(OSError):  # Some file systems lock nothing.
                lock = stack.enter_context(open(folder / _LOCK, 'w'))
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def note_that_all_are_kept() -> None:
    """Note that the folder holds all laws."""
    folder = laws_folder()
    if folder is not None:
        (folder / _ALL).touch()
