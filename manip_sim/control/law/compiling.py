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
import logging
from pathlib import Path
from typing import Any, cast, TypeVar

import numba
from numba.core import config

from manip_sim.control.law.joint_records import PLAIN
from manip_sim.control.law.kept import laws_folder

F = TypeVar('F', bound=Callable[..., Any])

_LOGGER = logging.getLogger(__name__)


@contextlib.contextmanager
def kept_in(folder: Path) -> Iterator[None]:
    """Let numba keep functions that are declared meanwhile in a folder."""
    settings: Any = config
    before, settings.CACHE_DIR = settings.CACHE_DIR, str(folder)
    try:
        yield
    finally:
        settings.CACHE_DIR = before


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

    A function is optimized once for itself, and again with each caller up to
    the outermost one: the end of a chain of five long functions would be compiled five times. And
    a call with all arrays of a robot takes up to 1.8 us.
    """
    return compiled(function, 'always')
