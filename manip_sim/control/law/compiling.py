# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Compile control laws with numba, once for all copies of their sources.

Importing this module imports numba, which takes a while: only modules of this folder do, and
others import those where a law is first needed. With ``NUMBA_DISABLE_JIT=1`` the laws are plain
Python, with the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import logging
from pathlib import Path
from typing import Any, cast, TypeVar

import numba
from numba.core import caching, config

from manip_sim.control.law.joint_records import PLAIN
from manip_sim.control.law.kept import laws_folder, takes_locators

F = TypeVar('F', bound=Callable[..., Any])

_LOGGER = logging.getLogger(__name__)


if takes_locators():
    class SharedLocator(caching.UserProvidedCacheLocator):  # type: ignore[misc]
        """Locator of functions in a folder for one version of their sources and all copies."""

        @classmethod
        def get_suitable_cache_subpath(cls, py_file: str) -> str:
            """Return the folder of a source."""
            return Path(py_file).parent.name

        def get_source_stamp(self) -> str:
            """Return the same for each copy of a source."""
            return ''


@contextlib.contextmanager
def kept_in(folder: Path) -> Iterator[None]:
    """
    Let numba keep functions that are declared meanwhile in a folder.

    :param folder: for one version of their sources; copies of these share it
    """
    settings: Any = config
    kept = {'CACHE_DIR': str(folder)}
    if takes_locators():
        kept['CACHE_LOCATOR_CLASSES'] = f'{__name__}.SharedLocator'
    before = {name: getattr(settings, name) for name in kept}
    vars(settings).update(kept)
    try:
        yield
    finally:
        vars(settings).update(before)


_FOLDER = None if PLAIN else laws_folder()
if not PLAIN and (_FOLDER is None or next(_FOLDER.rglob('*.nbi'), None) is None):
    _LOGGER.warning('Compiling control laws, which takes about a minute, %s',
                    f'once: they are kept in {_FOLDER}' if _FOLDER else
                    'in every process: no folder for them can be written')


def compiled(function: F, inline: str = 'never') -> F:
    """
    Compile a function when it is called, without contraction or reordering of sums.

    Powers would have other last bits than in plain Python: laws multiply instead.

    :param inline: whether numba makes it a part of other functions, ``always`` or ``never``
    """
    with contextlib.nullcontext() if _FOLDER is None else kept_in(_FOLDER):
        return cast('F', numba.njit(
            cache=_FOLDER is not None, nogil=True, error_model='numpy', no_cfunc_wrapper=True,
            inline=inline)(function))


def inner(function: F) -> F:
    """Compile a function in the same way that only compiled functions call."""
    return cast('F', numba.njit(nogil=True, error_model='numpy', no_cfunc_wrapper=True,
                                no_cpython_wrapper=True)(function))


def inlined(function: F) -> F:
    """
    Compile a function into each of the few compiled functions that call it.

    Others are optimized once for themselves, and again with each caller up to the outermost one:
    the end of a chain of five long functions would be compiled five times.
    """
    return compiled(function, 'always')
