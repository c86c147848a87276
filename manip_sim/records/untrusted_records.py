# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Limits and checks of records, which may come from anybody.

They bound bytes, pixels and names, and check the description of an episode.
"""

from __future__ import annotations

from collections.abc import Mapping
import io
import json
import re
from typing import Any, BinaryIO
import warnings
import zipfile
import zlib

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import RecordError
from manip_sim.quoting import one_line, quoted
from manip_sim.records.recorder import FORMAT

#: Largest record in a file, largest chunk, and largest model file [bytes].
MAX_RECORD, _MAX_CHUNK, _MAX_MODEL = 2**28, 2**26, 2**26
#: Most content of one episode or world, and what a message takes beside its content [bytes].
MAX_BYTES, MESSAGE_BYTES = 2**31, 128
#: Pixels of the largest picture that ``manip_sim run --record`` takes.
_MAX_PIXELS = 8192**2
#: Length of a name, and least and longest control period [s].
_MAX_NAME, _PERIODS_S = 255, (1e-6, 100.0)
#: Reads from a file without any record of a known kind.
_MOST_READS = 100_000
_TOPIC = re.compile(r'(/[^/\\]+)+')
_KEYS = ('number', 'seed', 'task', 'instruction', 'arguments', 'robot', 'robots', 'period_s',
         'action', 'action_names', 'latency', 'settings', 'steps', 'manip_sim', 'mujoco')
_OBJECTS = 'arguments', 'latency', 'robots', 'settings', 'drawn', 'noise'
#: Deepest nesting: their readers and writers call themselves.
_MAX_DEPTH = 30
#: Most items of a text of JSON, each of which takes some hundred bytes. The state of GR1 has
#: 46 000 with a latency of two seconds.
_MAX_ITEMS = 5_000_000


def check_name(name: str, kind: str) -> str:
    """
    Return a name that is printable and not too long.

    :raises RecordError: if it is none
    """
    if len(name) > _MAX_NAME or not name.isprintable():
        raise RecordError(f'damaged: {quoted(name)} cannot be the name of a {kind}')
    return name


def check_topic(name: str) -> str:
    """
    Return the name of a topic, of which files can be named.

    :raises RecordError: if it is none, or leads out of a folder
    """
    if not _TOPIC.fullmatch(check_name(name, 'topic')) or {'.', '..'} & set(name.split('/')):
        raise RecordError(f'damaged: {quoted(name)} cannot be the name of a topic')
    return name


def parse_json(text: str) -> Any:
    """
    Return what a text of JSON says.

    :raises ValueError: if it is none, or has very many items
    :raises RecursionError: if it is nested too deeply
    """
    if sum(map(text.count, ',[{')) > _MAX_ITEMS:
        raise ValueError(f'it has more than {_MAX_ITEMS} items')
    return json.loads(text)


def check_about(about: Mapping[str, str]) -> None:
    """
    Check what describes an episode.

    :raises RecordError: if it is of another version, or damaged
    """
    if about.get('format') != FORMAT:
        raise RecordError(f'the record has the format {quoted(about.get("format", ""))}, and '
                          f'manip_sim reads {FORMAT}')
    missing = [key for key in _KEYS if key not in about]
    if missing:
        raise RecordError(f'damaged: an episode has no {missing[0]}')
    try:
        read = {key: parse_json(about[key]) for key in (*_OBJECTS, 'action_names')
                if key in about}
        number, steps = int(about['number']), int(about['steps'])
        int(about['seed'])
        period_s = float(about['period_s'])
    except (ValueError, RecursionError) as error:
        raise RecordError('damaged: the description of an episode cannot be read: '
                          + one_line(str(error))) from error
    robots, (least, longest) = read['robots'], _PERIODS_S
    if (not all(isinstance(read[key], dict) for key in _OBJECTS if key in read)
            or any(map(_is_deep, read.values())) or not _are_names(read['action_names'])
            or not all(isinstance(parts, dict) and all(map(_are_names, parts.values()))
                       for parts in robots.values())
            or not least <= period_s <= longest or not 0 <= steps < 2**53
            or not 0 <= number < 2**31):
        raise RecordError('damaged: the description of an episode cannot be used')


def _is_deep(value: Any, room: int = _MAX_DEPTH) -> bool:
    inner = value.values() if isinstance(value, dict) else value if isinstance(
        value, list) else ()
    return not room or any(_is_deep(item, room - 1) for item in inner)


def _are_names(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(name, str) and name.isprintable() and len(name) <= _MAX_NAME
        for name in value)


def unpacked(chunk: Any) -> bytes:
    """
    Return the content of a chunk, which has the size that it says.

    :param chunk: an ``mcap.records.Chunk``
    :raises RecordError: if it is larger, too large, or compressed in an unknown way
    """
    size: int = chunk.uncompressed_size
    if size > _MAX_CHUNK:
        raise RecordError(f'a chunk has {size} bytes, and at most {_MAX_CHUNK} are read')
    if chunk.compression == 'lz4':
        import lz4.frame
        decompressor = lz4.frame.LZ4FrameDecompressor()
        data: bytes = decompressor.decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == 'zstd':
        import zstandard
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = reader.read(size + 1)
    elif chunk.compression:
        raise RecordError(f'the compression {quoted(chunk.compression)} is unknown')
    else:
        data = chunk.data
    if len(data) != size:
        raise RecordError('damaged: a chunk does not have the size that it states')
    return data


def image(content: bytes, noun: str = 'an image') -> NDArray[np.uint8]:
    """
    Return a compressed image.

    :param content: JPEG or PNG
    :param noun: it is, for the message
    :returns: rgb, shape (height, width, 3)
    :raises RecordError: if it cannot be read, or has too many pixels; they are not unpacked then
    """
    from PIL import Image, UnidentifiedImageError
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('error', Image.DecompressionBombWarning)
            picture = Image.open(io.BytesIO(content), formats=['JPEG', 'PNG'])
        if picture.width * picture.height <= _MAX_PIXELS:
            return np.asarray(picture.convert('RGB'))
        reason = f'it has {picture.width} times {picture.height} pixels'
    except (Image.DecompressionBombWarning, Image.DecompressionBombError):
        reason = 'it has too many pixels'
    except UnidentifiedImageError:
        reason = 'it is neither JPEG nor PNG'
    except Exception as error:  # The library raises whatever its operations do.
        reason = one_line(str(error))
    raise RecordError(f'{noun} cannot be read: {reason}')


def model_xml(archive: bytes) -> str:
    """
    Return the MJCF in a model archive.

    :raises RecordError: if it cannot be read, or is too large; it is not unpacked then
    """
    try:
        with zipfile.ZipFile(io.BytesIO(archive)) as file:
            if file.getinfo('model.xml').file_size > _MAX_MODEL:
                raise RecordError('the model of the record cannot be read: at most '
                                  f'{_MAX_MODEL} are unpacked')
            text = file.read('model.xml').decode()
    # RuntimeError: it is encrypted.
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, OSError, RuntimeError, ValueError
            ) as error:
        raise RecordError(f'the model of the record cannot be read: {error}') from error
    if '\0' in text:
        raise RecordError('the model of the record cannot be read: it is no text')
    return text


def files_of(archive: bytes) -> dict[str, tuple[int, int]] | None:
    """Return sizes and check sums of the files in an archive by name; None if it is none."""
    try:
        with zipfile.ZipFile(io.BytesIO(archive)) as file:
            return {info.filename: (info.file_size, info.CRC) for info in file.infolist()}
    except (zipfile.BadZipFile, OSError, ValueError, EOFError, NotImplementedError):
        return None


def finite(values: FloatArray, noun: str) -> FloatArray:
    """
    Return numbers, which are finite.

    :param noun: they are, for the message
    :raises RecordError: if one is not
    """
    if not np.isfinite(values).all():
        raise RecordError(f'{noun} has numbers that are not finite')
    return values


class CutOff(Exception):
    """More was asked for than there is."""


class BoundedFile:
    """
    A file that never reads, or reserves memory for, more than it has.

    :param file: at its begin
    :param size: of the file [bytes]
    :ivar reads: since the last record of a known kind; the caller sets it to 0
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size
        self.position = self.reads = 0

    def read(self, length: int) -> bytes:
        """
        Return some bytes.

        :raises CutOff: if there are less
        :raises RecordError: after many records of unknown kinds, such as in a file of zeros
        """
        self.reads += 1
        if self.reads > _MOST_READS:
            raise RecordError(f'damaged before byte {self.position}: no record of a known kind')
        if length > self._size - self.position:
            raise CutOff
        data = self._file.read(length)
        self.position += len(data)
        return data
