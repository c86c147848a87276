# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Convert records to data sets; an unfinished data set is never left behind."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
import tempfile

from manip_sim.errors import RecordError
from manip_sim.records.episode_arrays import Frames
from manip_sim.records.hdf5 import write_hdf5
from manip_sim.records.lerobot import write_lerobot
from manip_sim.records.recorded import Record

#: By name: what writes a format.
FORMATS: dict[str, Callable[[Iterable[Frames], Path], int]] = {
    'lerobot': write_lerobot, 'hdf5': write_hdf5}


def convert(paths: Iterable[Path], name: str, target: Path,
            progress: Callable[[int], object] = lambda done: None,
            only_success: bool = False) -> tuple[int, int, list[str]]:
    """
    Convert the complete episodes of records to one data set.

    :param paths: of the records, in order
    :param name: one of :data:`FORMATS`
    :param target: of the data set; it must not be there
    :param progress: is called with the number of episodes that are done
    :param only_success: leave out episodes without success
    :returns: numbers of episodes and of control periods, and notes on what was left out
    :raises RecordError: if a record cannot be read, or an episode cannot be written
    """
    if target.exists():
        raise RecordError(f'{target} already exists and is not overwritten')
    if not target.parent.is_dir():
        raise RecordError(f'no such folder: {target.parent}')
    notes: list[str] = []
    done, where = 0, ''

    def frames() -> Iterator[Frames]:
        nonlocal done, where
        for path in paths:
            for recorded in Record(path).episodes():
                if recorded.result is None or recorded.result.get('error'):
                    notes.append(f'{path}: episode {recorded.number} is not complete, and was '
                                 'left out')
                elif recorded.success or not only_success:
                    where = f'{path}: '
                    yield Frames(recorded)
                    where = ''
                    done += 1
                    progress(done)
    try:
        # Of its own name, as another process may write the same data set.
        with tempfile.TemporaryDirectory(prefix='.unfinished', dir=target.parent) as folder:
            unfinished = Path(folder, 'set')
            periods = FORMATS[name](frames(), unfinished)
            if target.exists():
                raise RecordError(f'{target} is there by now, and is not overwritten')
            unfinished.rename(target)
    except RecordError as error:
        left_out = f'; {len(notes)} incomplete' if notes and not done else ''
        raise RecordError(f'{where}{error}{left_out}') from error
    except OSError as error:
        raise RecordError(f'{target}: {error.strerror or error}') from error
    except ImportError as error:
        raise RecordError(f"{name} needs the package {error.name}: "
                          "pip install 'manip_sim[records]'") from error
    return done, periods, notes


def records_in(paths: Iterable[Path]) -> list[Path]:
    """
    Return files, and in place of folders the records in them by name.

    :param paths: of files and folders
    :raises RecordError: if a folder has no records
    """
    found: list[Path] = []
    for path in paths:
        files = sorted(path.rglob('*.mcap')) if path.is_dir() else [path]
        if not files:
            raise RecordError(f'{path}: this folder has no *.mcap file')
        found += files
    return found
