# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read files that users name: no devices, pipes or folders, and none that is too large."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import stat

from manip_sim.errors import ModelError
from manip_sim.quoting import one_line


def read_file(file: Path, kind: str, max_bytes: int) -> bytes:
    """
    Return the content of a file.

    :param kind: what it is, for the message, such as ``MJCF file``
    :raises ModelError: if it is missing, not a regular file, too large or not readable
    """
    check_file(file, kind, max_bytes)
    with _told(file, kind):
        return file.read_bytes()


def check_file(file: Path, kind: str, max_bytes: int) -> None:
    """
    Check that a file can be read, without reading it.

    :param kind: what it is, for the message, such as ``mesh file``
    :raises ModelError: if it is missing, not a regular file, too large or not readable
    """
    with _told(file, kind):
        status = file.stat()
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(0, 'it is a folder')
        if not stat.S_ISREG(status.st_mode):
            raise OSError(0, 'it is a device or a pipe')
        if status.st_size > max_bytes:
            raise OSError(0, f'it has {status.st_size / 1e6:.0f} MB, and at most '
                             f'{max_bytes / 1e6:.0f} MB are loaded')
        file.open('rb').close()


@contextmanager
def _told(file: Path, kind: str) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError as error:
        raise ModelError(f'no such {kind}: {one_line(str(file))}') from error
    except (OSError, ValueError) as error:  # ValueError: a null character in the path.
        reason = getattr(error, 'strerror', None) or str(error)
        raise ModelError(f'cannot read {kind} {one_line(str(file))}: {reason}') from error
