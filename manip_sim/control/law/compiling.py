# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Compile control laws with numba, once per installation.

Importing this module imports numba, which takes a while: only modules of this folder do, and
others import those where a law is first needed. With ``NUMBA_DISABLE_JIT=1`` the laws are plain
Python, with the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import hashlib
import logging
import os
from pathlib import Path
import platform
import shutil
import tempfile
from typing import Any, cast, TypeVar

import mujoco
import numba
from numba.core import config
import numpy as np

from manip_sim.resources import cache_folder, package_version

F = TypeVar('F', bound=Callable[..., Any])

#: So many folders of other versions stay.
_OTHERS = 3
_LOGGER = logging.getLogger(__name__)


def _version() -> str:
    """Return a name for all that the compiled code depends on, beside the processor."""
    content = hashlib.sha256()
    for version in (package_version(), numba.__version__, mujoco.__version__, np.__version__,
                    platform.python_version()):
        content.update(f'{version}\n'.encode())
    # numba looks only at the file of the function that is called, not at those it calls.
    for path in sorted(Path(__file__).parent.glob('*.py')):
        content.update(path.read_bytes())
    return content.hexdigest()[:16]


def _writable_folder() -> Path | None:
    """Return where compiled laws are kept, or None if they can be kept nowhere."""
    for parent in (cache_folder('laws'), Path(tempfile.gettempdir(), f'manip_sim-{os.getuid()}')):
        folder = parent / _version()
        with contextlib.suppress(OSError):
            if not folder.exists():
                _remove_old(parent)
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            # What is kept there is run: nobody else may put it there.
            if os.access(folder, os.W_OK) and all(
                    path.stat().st_uid == os.getuid() for path in (folder, parent)):
                return folder
    return None


def _remove_old(parent: Path) -> None:
    """Remove the laws of all but the newest of other versions; a process has what it runs."""
    with contextlib.suppress(OSError):  # Another process may remove the same.
        others = sorted(parent.glob('[0-9a-f]' * 16), key=lambda folder: folder.stat().st_mtime)
        for folder in others[:-_OTHERS]:
            shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def kept_in(folder: Path) -> Iterator[None]:
    """Let numba keep what is declared meanwhile in a folder."""
    settings: Any = config
    before, settings.CACHE_DIR = settings.CACHE_DIR, str(folder)
    try:
        yield
    finally:
        settings.CACHE_DIR = before


_PLAIN = bool(config.DISABLE_JIT)
_FOLDER = None if _PLAIN else _writable_folder()
if not _PLAIN and (_FOLDER is None or next(_FOLDER.rglob('*.nbi'), None) is None):
    _LOGGER.warning('Compiling control laws, which takes up to a minute, %s',
                    f'once: they are kept in {_FOLDER}' if _FOLDER else
                    'in every process: no folder for them can be written')


def compiled(function: F) -> F:
    """
    Compile a function when it is called, without contraction or reordering of sums.

    Powers would have other last bits than in plain Python: laws multiply instead.
    """
    with contextlib.nullcontext() if _FOLDER is None else kept_in(_FOLDER):
        return cast('F', numba.njit(
            cache=_FOLDER is not None, nogil=True, error_model='numpy', no_cfunc_wrapper=True
        )(function))


def inner(function: F) -> F:
    """Compile a function in the same way that only compiled functions call."""
    return cast('F', numba.njit(nogil=True, error_model='numpy', no_cfunc_wrapper=True,
                                no_cpython_wrapper=True)(function))
