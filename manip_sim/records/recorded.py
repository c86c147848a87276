# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Read records of episodes and of nodes, whole or cut off.

They may come from anybody: bytes, pixels and names are bounded, and damaged records rejected with
a RecordError.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
import io
import json
from pathlib import Path
import re
from typing import Any, BinaryIO, NamedTuple, TypeVar
import warnings
import zipfile
import zlib

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import RecordError
from manip_sim.models.user_files import opened
from manip_sim.quoting import one_line, quoted
from manip_sim.records.record_file import decoder, full_name
from manip_sim.records.recorder import (
    ACTION, DIGEST, EPISODE, FORMAT, MODEL, NODE, RESULT, STATE, TAKEN)

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
    """Return a name, which must be printable and not too long."""
    if len(name) > _MAX_NAME or not name.isprintable():
        raise RecordError(f'damaged: {quoted(name)} cannot be the name of a {kind}')
    return name


def check_topic(name: str) -> str:
    """Return the name of a topic; files are named after it, so it must not leave a folder."""
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
    """Check what describes an episode: its version, keys, numbers and names."""
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
    """Return the content of an ``mcap.records.Chunk``, which must have the size that it says."""
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
    Return an image, rgb, shape (height, width, 3); one of too many pixels is not unpacked.

    :param content: JPEG or PNG
    :param noun: it is, for the message
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
    """Return the MJCF in a model archive; one that is too large is not unpacked."""
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
    """Return numbers, which must be finite; the message of the error names them by a noun."""
    if not np.isfinite(values).all():
        raise RecordError(f'{noun} has numbers that are not finite')
    return values


class CutOff(Exception):
    """More was asked for than there is."""


class BoundedFile:
    """
    A file, at its begin, that never reads or reserves memory for more than its size [bytes].

    :ivar reads: since the last record of a known kind; the caller sets it to 0
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size
        self.position = self.reads = 0

    def read(self, length: int) -> bytes:
        """
        Return some bytes.

        :raises CutOff: if there are less
        """
        self.reads += 1
        if self.reads > _MOST_READS:
            # Such as in a file of zeros.
            raise RecordError(f'damaged before byte {self.position}: no record of a known kind')
        if length > self._size - self.position:
            raise CutOff
        data = self._file.read(length)
        self.position += len(data)
        return data


T = TypeVar('T')
#: Types of the messages of nodes that are kept.
_SHOWN = {full_name(name) for name in (
    'geometry_msgs/PoseStamped', 'geometry_msgs/WrenchStamped', 'sensor_msgs/CompressedImage',
    'sensor_msgs/JointState')}
_MAGIC = b'\x89MCAP0\r\n'


class _Received(NamedTuple):
    topic: str
    type_name: str
    time_ns: int
    content: bytes


@dataclass
class Recorded:
    """
    A record of one model.

    :ivar about: metadata that its recorder wrote at its begin
    :ivar model: the model archive, as ``load_archive`` takes it
    :ivar messages: time [ns] and serialized content, by topic, in the order of the file
    """

    about: Mapping[str, str]
    model: bytes
    types: dict[str, str] = field(default_factory=dict)
    messages: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    _size: int = field(default=0, init=False, repr=False)

    def add(self, topic: str, type_name: str, time_ns: int, content: bytes) -> None:
        """Add a message; too much content is rejected."""
        self._size += len(content) + MESSAGE_BYTES
        if self._size > MAX_BYTES:
            raise RecordError(f'an episode, or a world of a node, has more than {MAX_BYTES} '
                              'bytes')
        self.types[topic] = type_name
        self.messages.setdefault(topic, []).append((time_ns, content))

    def decoded(self, topic: str, type_name: str) -> list[Any]:
        """
        Return the messages of a topic; there are none if nothing was recorded.

        :param type_name: that it must have, such as ``std_msgs/Bool``
        :raises RecordError: if it has another type, or a message cannot be read
        """
        kind = self.types.get(topic)
        if kind not in (None, full_name(type_name)):
            raise RecordError(f'{topic} should be {full_name(type_name)}, not {quoted(kind)}')
        decode = _decoder(type_name)
        return [decode(content) for _, content in self.messages.get(topic, ())]


class RecordedWorld(Recorded):
    """
    A world of a node: what it sent while its model was the same.

    Only messages of types that can be shown are kept: joints, poses, wrenches and compressed
    images.
    """

    @property
    def node(self) -> str:
        """The full name of the node."""
        return self.about.get('node', '')


@dataclass
class RecordedEpisode(Recorded):
    """
    An episode of a record.

    :ivar result: what its recorder wrote at its end; None if the record ends before
    """

    result: Mapping[str, str] | None = None

    @property
    def number(self) -> int:
        """Number of the episode in the record, from 0."""
        return int(self.about['number'])

    @property
    def seed(self) -> int:
        """The seed that it was reset with."""
        return int(self.about['seed'])

    @property
    def period_s(self) -> float:
        """Length of a control period [s]."""
        return float(self.about['period_s'])

    @property
    def success(self) -> bool:
        """True if it ended with success."""
        return self.result is not None and self.result['success'] == 'true'

    @property
    def versions(self) -> str:
        """Versions that it was recorded with."""
        return f'manip_sim {self.about["manip_sim"]} with MuJoCo {self.about["mujoco"]}'

    def json(self, key: str) -> dict[str, Any]:
        """
        Return arguments of the task or settings of the run.

        :param key: ``arguments``, ``latency``, ``settings`` or ``drawn``
        """
        values: dict[str, Any] = json.loads(self.about.get(key, '{}'))
        return values

    def arrays(self, topic: str) -> FloatArray:
        """
        Return the numbers of a topic, shape (messages, n).

        :param topic: of the type ``std_msgs/Float64MultiArray``
        :raises RecordError: if the messages are not of that type and of one length
        """
        arrays = [np.array(message.data, dtype=np.float64)
                  for message in self.decoded(topic, 'std_msgs/Float64MultiArray')]
        if len({len(numbers) for numbers in arrays}) > 1:
            raise RecordError(f'{topic} has arrays of different lengths')
        return np.stack(arrays) if arrays else np.empty((0, 0))

    @property
    def actions(self) -> FloatArray:
        """The action of each control period, shape (periods, n)."""
        return self.arrays(ACTION)

    @property
    def taken(self) -> dict[int, list[tuple[int, FloatArray]]] | None:
        """
        Actions of late answers by control period from 0, each with the steps until its effect.

        It is None if each period has the action that took effect at its beginning.
        """
        if 'answer_time' not in self.json('settings'):
            return None
        begins = {time_ns: period for period, (time_ns, _) in enumerate(
            self.messages.get(STATE, ()))}
        actions: dict[int, list[tuple[int, FloatArray]]] = {}
        for (time_ns, _), numbers in zip(self.messages.get(TAKEN, ()), self.arrays(TAKEN)):
            if time_ns not in begins or not (len(numbers) and 0 <= numbers[0] < 2**31):
                raise RecordError(f'{TAKEN} has what is no action of a control period')
            actions.setdefault(begins[time_ns], []).append((int(numbers[0]), numbers[1:]))
        return actions

    @property
    def states(self) -> FloatArray:
        """qpos, qvel and mocap poses at the start and after each period, (periods + 1, n)."""
        return self.arrays(STATE)

    @property
    def digests(self) -> dict[int, str]:
        """Digests by control period; 0 is the start."""
        start = self.messages.get(STATE, [(0, b'')])[0][0]
        digests = self.decoded(DIGEST, 'std_msgs/String')
        return {round((time_ns - start) / (self.period_s * 1e9)): message.data
                for (time_ns, _), message in zip(self.messages.get(DIGEST, ()), digests)}


def _decoder(type_name: str) -> Callable[[bytes], Any]:
    decode = decoder(type_name)

    def checked(content: bytes) -> Any:
        try:
            return decode(content)
        except Exception as error:  # The reader raises whatever its operations do.
            raise RecordError(f'a message of {type_name} cannot be read: '
                              f'{one_line(str(error))}') from error
    return checked


class Record:
    """
    A record of episodes.

    :ivar path: of the file
    :ivar cut_off: whether the file has turned out to end before its end was written, as when its
        writer was killed
    :ivar begun: number of the episode of which the file has turned out to have the begin alone,
        or None
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.cut_off = False
        self.begun: int | None = None

    def episodes(self) -> Iterator[RecordedEpisode]:
        """
        Yield the episodes, each once it is read; the last one may have no end.

        :raises RecordError: if it is not a record of episodes, of another version, or damaged
        """
        for content in self.contents():
            if not isinstance(content, RecordedEpisode):
                raise RecordError(
                    f'{self.path} is a record of the node {quoted(content.node)}, which has no '
                    'episodes; manip_sim replay repeats it, and sim_view --record shows it')
            yield content

    @property
    def of_node(self) -> bool:
        """
        True if it is the record of a node.

        :raises RecordError: if it cannot be read up to what it is of
        """
        return any(name == NODE for name, _ in self._read(self._kinds))

    def journal(self) -> Iterator[str]:
        """
        Yield the messages of a node's journal, in the order of the file.

        :raises RecordError: if the file is damaged
        """
        return self._read(self._journal)

    def messages(self, type_name: str) -> Iterator[tuple[str, int, bytes]]:
        """
        Yield topic, time [ns] and content of all messages of a type, in any MCAP file of ROS 2.

        :param type_name: such as ``std_msgs/Bool``
        :raises RecordError: if the file is damaged
        """
        return self._read(lambda file: self._messages(file, full_name(type_name)))

    def contents(self) -> Iterator[RecordedEpisode | RecordedWorld]:
        """
        Yield the episodes, or the worlds of a node, each once it is read.

        :raises RecordError: if it is not such a record, of another version, or damaged
        """
        return self._read(self._contents)

    def _read(self, parse: Callable[[BinaryIO], Iterator[T]]) -> Iterator[T]:
        try:
            with open(opened(self.path), 'rb') as file:
                yield from parse(file)
        except OSError as error:
            raise RecordError(f'{self.path}: {error.strerror or error}') from error
        except ImportError as error:
            raise RecordError(f"records need the package {error.name}: pip install "
                              "'manip_sim[records]'") from error
        except RecordError as error:
            raise RecordError(f'{self.path}: {error}') from error

    def _kinds(self, file: BinaryIO) -> Iterator[tuple[str, Mapping[str, str]]]:
        """Yield the first description of what the record is of."""
        from mcap.records import Metadata
        for item in self._items(file):
            if isinstance(item, Metadata) and item.name in (EPISODE, NODE):
                yield item.name, item.metadata
                return

    def _journal(self, file: BinaryIO) -> Iterator[str]:
        from mcap.records import Metadata
        topic, decode = '', _decoder('std_msgs/String')
        for item in self._described(file, full_name('std_msgs/String')):
            if isinstance(item, _Received):
                if item.topic == topic:
                    yield decode(item.content).data
            elif isinstance(item, Metadata) and item.name == NODE:
                topic = f"{item.metadata.get('node', '')}/journal"

    def _messages(self, file: BinaryIO, kind: str) -> Iterator[tuple[str, int, bytes]]:
        return ((item.topic, item.time_ns, item.content) for item in self._described(file, kind)
                if isinstance(item, _Received))

    def _described(self, file: BinaryIO, kind: str = '') -> Iterator[Any]:
        """Yield messages of a type, or of all, with their topics; and other MCAP records."""
        from mcap.records import Channel, Message, Schema
        schemas: dict[int, str] = {}
        channels: dict[int, tuple[str, str]] = {}
        for item in self._items(file):
            if isinstance(item, Schema):
                schemas[item.id] = check_name(item.name, 'type')
            elif isinstance(item, Channel):
                name = schemas.get(item.schema_id, '')
                if kind in ('', name):
                    channels[item.id] = check_topic(item.topic), name
            elif not isinstance(item, Message):
                yield item
            elif item.channel_id in channels:
                yield _Received(*channels[item.channel_id], item.log_time, item.data)
            elif not kind:
                raise RecordError('damaged: a message of a topic that is not described')

    def _contents(self, file: BinaryIO) -> Iterator[RecordedEpisode | RecordedWorld]:
        from mcap.records import Attachment, Metadata
        model, any_yet = b'', False
        open_one: RecordedEpisode | RecordedWorld | None = None
        for item in self._described(file):
            if isinstance(item, Attachment) and item.name == MODEL:
                if isinstance(open_one, RecordedWorld):
                    if open_one.model and open_one.messages:
                        yield open_one
                        open_one = RecordedWorld(open_one.about, item.data)
                    open_one.model = item.data
                model = item.data
            elif isinstance(item, Metadata) and item.name in (EPISODE, NODE):
                if open_one is not None:
                    yield open_one
                any_yet = True
                if item.name == NODE:
                    open_one = RecordedWorld(item.metadata, b'')
                else:
                    check_about(item.metadata)
                    open_one = RecordedEpisode(item.metadata, model)
            elif isinstance(item, Metadata) and item.name == RESULT and isinstance(
                    open_one, RecordedEpisode):
                if item.metadata.get('number') != open_one.about['number'] or not {
                        'success', 'digest'} <= item.metadata.keys():
                    raise RecordError(f'the end of episode {open_one.number} is damaged')
                open_one.result = item.metadata
                yield open_one
                open_one = None
            elif isinstance(item, _Received) and open_one is not None and (
                    item.type_name in _SHOWN or isinstance(open_one, RecordedEpisode)):
                open_one.add(*item)
        if open_one is not None and open_one.messages:
            yield open_one
        elif isinstance(open_one, RecordedEpisode):
            self.begun = open_one.number
        if not any_yet:
            raise RecordError('it contains no episodes of tasks' + (
                ' and ends early' if self.cut_off else ''))

    def _items(self, file: BinaryIO) -> Iterator[Any]:
        """Yield the MCAP records of the file up to the end of its data, or to its cut-off."""
        from mcap.records import Chunk, DataEnd
        from mcap.stream_reader import breakup_chunk, StreamReader
        size = self.path.stat().st_size
        if file.read(len(_MAGIC)) != _MAGIC:
            raise RecordError('no MCAP file')
        file.seek(max(0, size - len(_MAGIC)))
        whole = file.read() == _MAGIC
        file.seek(0)
        stream = BoundedFile(file, size)
        try:
            for item in StreamReader(stream, emit_chunks=True, validate_crcs=True,
                                     record_size_limit=MAX_RECORD).records:
                stream.reads = 0
                if isinstance(item, DataEnd):
                    return
                if isinstance(item, Chunk):
                    whole_chunk = replace(item, data=unpacked(item), compression='')
                    yield from breakup_chunk(whole_chunk, validate_crc=True)
                else:
                    yield item
        except CutOff:
            if whole:
                raise RecordError(f'damaged before byte {stream.position}') from None
            self.cut_off = True
        except (RecordError, GeneratorExit, OSError):
            raise
        except Exception as error:  # The library raises whatever its operations do.
            raise RecordError(f'damaged before byte {stream.position}: {type(error).__name__} '
                              f'{one_line(str(error))}') from error
