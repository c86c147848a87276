# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read the messages of one type from bags of rosbag2, and from records."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from pathlib import Path
import sqlite3
from typing import Any

from manip_sim.errors import RecordError
from manip_sim.models.regular_files import opened
from manip_sim.quoting import one_line
from manip_sim.records.record_file import decoder, full_name
from manip_sim.records.recorded import Record
from manip_sim.records.untrusted_records import check_topic, MAX_BYTES, MESSAGE_BYTES

_SUFFIXES = ('.mcap', '.db3')
_MESSAGES = ('SELECT topics.name, messages.timestamp, messages.data FROM messages '
             'JOIN topics ON messages.topic_id = topics.id '
             'WHERE topics.type = ? ORDER BY messages.timestamp, messages.id')


def bag_messages(path: Path, type_name: str) -> Iterator[tuple[str, int, Any]]:
    """
    Yield topic, time of recording [ns] and message of all messages of a type.

    :param path: of an MCAP file, a file of SQLite of rosbag2, or a folder with such files
    :param type_name: such as ``std_msgs/Bool``
    :raises RecordError: if the bag is missing, damaged or too large
    """
    decode, size = decoder(type_name), 0
    for file in _files(path):
        read = _read_sqlite if file.suffix == '.db3' else _read_mcap
        for topic, time_ns, content in read(file, type_name):
            size += len(content) + MESSAGE_BYTES
            if size > MAX_BYTES:
                raise RecordError(f'{path}: it has more than {MAX_BYTES} bytes of {type_name}')
            try:
                message = decode(content)
            except Exception as error:  # The reader raises whatever its operations do.
                raise RecordError(f'{file}: a message of {topic} cannot be read: '
                                  f'{one_line(str(error))}') from error
            yield topic, time_ns, message


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)
    if not found:
        raise RecordError(f'{path}: this folder has no *.mcap and no *.db3 file')
    return found


def _read_mcap(file: Path, type_name: str) -> Iterator[tuple[str, int, bytes]]:
    return Record(file).messages(type_name)


def _read_sqlite(file: Path, type_name: str) -> Iterator[tuple[str, int, bytes]]:
    try:
        # SQLite would say only that it cannot open it.
        with open(opened(file), 'rb'), contextlib.closing(sqlite3.connect(
                f'{file.absolute().as_uri()}?mode=ro', uri=True)) as bag:
            for topic, time_ns, content in bag.execute(_MESSAGES, [full_name(type_name)]):
                yield check_topic(topic), int(time_ns), bytes(content)
    except OSError as error:
        raise RecordError(f'{file}: {error.strerror or error}') from error
    except (sqlite3.Error, TypeError, ValueError, RecordError) as error:
        raise RecordError(f'{file}: no bag of rosbag2, or damaged: {one_line(str(error))}'
                          ) from error
