# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write an MCAP file as rosbag2 does, so that what was written can be read if the writer dies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import os
from pathlib import Path
import time
from typing import Any, TypeVar

from manip_sim.errors import RecordError

#: A chunk is written at this size [bytes], and after this time [s].
_CHUNK_BYTES, _FLUSH_S = 2**18, 1.0
#: Greater than any chunk: we decide when one is written.
_NEVER = 2**40
_T = TypeVar('_T')


class RecordFile:
    """
    An MCAP file that is being written, in the profile ``ros2``.

    Chunks are handed to the operating system once they are complete, at the latest a second after
    their first message, so that the file can be read up to there when the process is killed. If
    the disk is full, what is incomplete is cut off.

    :param path: of the file
    :param overwrite: replace a file that is there
    :raises RecordError: if it is there, or cannot be written, or ``mcap`` is not installed
    :ivar path: of the file
    """

    def __init__(self, path: Path, overwrite: bool = False) -> None:
        try:
            from mcap.writer import CompressionType, LIBRARY_IDENTIFIER, Writer
        except ImportError as error:
            raise RecordError(f"records need the package {error.name or 'mcap'}: "
                              "pip install 'manip_sim[records]'") from error
        self.path = path
        self._error: RecordError | None = None
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._pending, self._written_s, self._complete = 0, time.monotonic(), 0
        try:
            self._file = _WholeWrites(path, overwrite)
        except FileExistsError:
            raise RecordError(f'{path} already exists and is not overwritten') from None
        except OSError as error:
            raise RecordError(f'{path}: {error.strerror or error}') from error
        self._writer = Writer(self._file, chunk_size=_NEVER, compression=CompressionType.LZ4,
                              enable_data_crcs=True)
        self._do(lambda: self._writer.start('ros2', f'{LIBRARY_IDENTIFIER} manip_sim'))

    def channel(self, topic: str, type_name: str, definition: str,
                metadata: Mapping[str, str] | None = None) -> int:
        """
        Add a topic, once.

        :param topic: its name
        :param type_name: such as ``std_msgs/msg/Bool``
        :param definition: of the type and those in it, as ``ros2msg``
        :param metadata: of the topic, such as its quality of service
        :returns: its number for :meth:`write`
        """
        if topic not in self._channels:
            if type_name not in self._schemas:
                self._schemas[type_name] = self._writer.register_schema(
                    type_name, 'ros2msg', definition.encode())
            self._channels[topic] = self._writer.register_channel(
                topic, 'cdr', self._schemas[type_name], dict(metadata or {}))
        return self._channels[topic]

    def write(self, channel: int, time_ns: int, data: bytes, published_ns: int | None = None
              ) -> None:
        """
        Write a message.

        :param channel: from :meth:`channel`
        :param time_ns: when it was recorded [ns]
        :param data: serialized, as CDR
        :param published_ns: when it was published [ns]; None for the same time
        :raises RecordError: if the file cannot be written
        """
        self._check()
        self._writer.add_message(
            channel, time_ns, data, time_ns if published_ns is None else published_ns)
        self._pending += len(data)
        if self._pending > _CHUNK_BYTES:
            self.flush()
        self.flush_when_due()

    def flush_when_due(self) -> None:
        """
        Write the chunk that is begun if a second has passed; call it where no messages come.

        :raises RecordError: if the file cannot be written
        """
        if self._pending and time.monotonic() - self._written_s > _FLUSH_S:
            self.flush()

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int = 0) -> None:
        """
        Attach a file.

        :param name: such as ``model.mjz``
        :param media_type: such as ``application/zip``
        :param data: its content
        :param time_ns: when [ns]
        :raises RecordError: if the file cannot be written
        """
        self.flush()
        self._do(lambda: self._writer.add_attachment(time_ns, time_ns, name, media_type, data))

    def describe(self, name: str, values: Mapping[str, str]) -> None:
        """
        Write what belongs to all that follows, or to all that went before.

        :param name: of the record of metadata
        :param values: its content
        :raises RecordError: if the file cannot be written
        """
        self.flush()
        self._do(lambda: self._writer.add_metadata(name, dict(values)))

    def flush(self) -> None:
        """
        Write the chunk that is begun.

        :raises RecordError: if the file cannot be written
        """
        self._do(self._writer.flush)
        self._pending, self._written_s = 0, time.monotonic()

    def close(self) -> None:
        """
        Write the index and close the file; what could not be written was reported before.

        :raises RecordError: if the file cannot be written
        """
        if self._error is None and not self._file.closed:
            self._do(self._writer.finish)
            self._file.close()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _do(self, write: Callable[[], _T]) -> _T:
        self._check()
        try:
            result = write()
        except OSError as error:
            self._file.cut(self._complete)
            self._error = RecordError(
                f'{self.path}: {error.strerror or error}; what was recorded before can be read')
            raise self._error from error
        self._complete = self._file.tell()
        return result


class _WholeWrites:
    """A new file that is written without a buffer, and each time completely or with an error."""

    def __init__(self, path: Path, overwrite: bool) -> None:
        flags = os.O_WRONLY | os.O_CREAT | (os.O_TRUNC if overwrite else os.O_EXCL)
        self._descriptor = os.open(path, flags | os.O_CLOEXEC, 0o666)
        self._size = 0
        self.closed = False

    def write(self, data: Any) -> int:
        left = memoryview(data)
        while left:
            written = os.write(self._descriptor, left)
            self._size += written
            left = left[written:]
        return len(data)

    def tell(self) -> int:
        return self._size

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def cut(self, size: int) -> None:
        """Cut off what is behind a size, and close the file."""
        os.ftruncate(self._descriptor, size)
        self.close()

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            os.close(self._descriptor)
