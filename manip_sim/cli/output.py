# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write a file as a whole or not at all; the error that is wrong use."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import tempfile

from manip_sim.errors import ManipSimError


class UsageError(ManipSimError):
    """Arguments that cannot be used; exit code 2, as for a wrong command line."""


def check_folder(file: Path) -> None:
    """
    Check that there is a folder for a file.

    :raises ManipSimError: if there is none, or the file itself is a folder
    """
    if file.is_dir():
        raise ManipSimError(f'{file} is a folder, give the name of a file')
    if not file.parent.is_dir():
        raise ManipSimError(f'no such folder: {file.parent}')


def write_whole(file: Path, write: Callable[[Path], object]) -> None:
    """
    Let a function write a file, and put it into place when it is complete.

    :param file: overwritten if it is there
    :param write: takes the path to write to, which has the same suffix
    :raises OSError: with the name of the file, if it cannot be written
    """
    check_folder(file)
    # A file made by mkstemp is readable by its owner alone.
    mask = os.umask(0)
    os.umask(mask)
    descriptor, name = tempfile.mkstemp(prefix=f'.{file.stem}_', suffix=file.suffix,
                                        dir=file.parent)
    os.close(descriptor)
    unfinished = Path(name)
    try:
        write(unfinished)
        unfinished.chmod(0o666 & ~mask)
        unfinished.replace(file)
    except OSError as error:
        if error.filename in (None, name):
            error.filename = str(file)
        raise
    finally:
        unfinished.unlink(missing_ok=True)
