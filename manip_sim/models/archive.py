# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A model and its files as a zip archive that loads anywhere, or as MuJoCo's exact binary."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
import hashlib
import io
from pathlib import Path, PurePosixPath
import re
import struct
from xml.etree import ElementTree
import zipfile
import zlib

import mujoco
import numpy as np

from manip_sim.errors import ModelError
from manip_sim.models.asset_files import MAX_ASSET_BYTES
from manip_sim.models.loading import compile_spec, spec_from_string
from manip_sim.models.regular_files import InMemoryFile, read_file
from manip_sim.models.untrusted_models import compile_held, LIGHT, try_to_do
from manip_sim.models.xml_check import Budget, Limits, product, XmlModel
from manip_sim.quoting import quoted


def to_binary(model: mujoco.MjModel) -> bytes:
    """
    Return a model as MuJoCo writes it in a file ``.mjb``, exact to the last bit.

    Only the same release of MuJoCo reads it.
    """
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def roundings(model: mujoco.MjModel, other: mujoco.MjModel) -> dict[str, float]:
    """
    Return the greatest differences of two models by field, in its unit, the greatest first.

    :param other: of the same world, such as one loaded from its MJCF
    """
    differences = {}
    for field in dir(model):
        if field.startswith('_'):
            continue
        ours, theirs = getattr(model, field), getattr(other, field)
        if not isinstance(ours, np.ndarray) or ours.dtype.kind != 'f' or not ours.size:
            continue
        if ours.shape != theirs.shape:
            differences[field] = np.inf
        elif not np.array_equal(ours, theirs, equal_nan=True):
            differences[field] = float(np.nanmax(np.abs(ours - theirs)))
    return dict(sorted(differences.items(), key=lambda item: -item[1]))


def describe_rounding(model: mujoco.MjModel, other: mujoco.MjModel) -> str:
    """
    Return a sentence on what the text of MJCF changes.

    :param model: the ``mujoco.MjModel`` that was written
    :param other: the model that was read again
    """
    differences = roundings(model, other)
    if not differences:
        return 'the text of MJCF gives this model to the last bit'
    worst = ', '.join(f'{field} by {most:.1e}' for field, most in list(differences.items())[:3])
    return (f'the text of MJCF changes {len(differences)} fields of the model, at most {worst}; '
            '.mjb is exact to the last bit')


#: Largest archive, and largest total size of its unpacked files [bytes].
MAX_ARCHIVE_BYTES, _MAX_UNPACKED_BYTES = 2**26, 2**27
#: Greatest ratio to its size that an archive of more than a megabyte may unpack to.
_MAX_RATIO = 200
#: Number of files, size of the list of them [bytes], and length of their names.
_MAX_FILES, _MAX_LIST_BYTES, _MAX_NAME = 1000, 2**18, 200
_LIMITS = Limits(elements=200_000, nested=100)
#: CPU time that a model may take to compile [s]; robots with large meshes take seconds.
_MAX_CPU_S = 10
#: Elements, their number and pixels of a texture that compile within 0.1 s for sure.
_LIGHT = LIGHT | {
    'size', 'visual', 'global', 'headlight', 'texture', 'equality', 'actuator', 'general', 'motor',
    'position', 'velocity', 'sensor', 'force', 'torque', 'accelerometer', 'gyro', 'framequat',
    'touch'}
_MAX_LIGHT_ELEMENTS, _MAX_LIGHT_PIXELS = 5000, 2**20
#: The record at the end of an archive: signature, list of files and length of the comment.
_END = struct.Struct('<4s4H2LH')
_LOCATOR_64 = b'PK\x06\x07'

#: The model file that MuJoCo looks for in an archive.
_MODEL = 'model.xml'
_FOLDER = 'assets'
_NAMES_A_FILE = re.compile(r'file(right|left|up|down|front|back)?')


def pack(xml: str, assets: Mapping[str, bytes | str]) -> bytes:
    """
    Return a zip of a model's XML, ``model.xml``, and its files, in the folder ``assets``.

    Files of equal content and suffix are packed once; files of equal name and different content
    get a number. The same model gives the same bytes.

    :param xml: MJCF that names its files by absolute paths, or as they are named in ``assets``
    :param assets: contents of files by their name
    :raises ModelError: if a file cannot be read, or is neither in the assets nor an absolute path
    """
    root = ElementTree.fromstring(xml)
    files = _Files(assets)
    for element in root.iter():
        for attribute, value in element.items():
            if value and _NAMES_A_FILE.fullmatch(attribute):
                element.set(attribute, files.name_in_archive(value))
    return _zip({_MODEL: ElementTree.tostring(root), **files.contents})


class _Files:
    """The files of an archive; each is read once."""

    def __init__(self, held: Mapping[str, bytes | str]) -> None:
        self.contents: dict[str, bytes] = {}
        self._held = {PurePosixPath(name): content for name, content in held.items()}
        self._name_of_file: dict[str, str] = {}
        self._name_of_content: dict[tuple[str, str], str] = {}

    def name_in_archive(self, file: str) -> str:
        """Return the name in the archive of a file that the XML names."""
        if file not in self._name_of_file:
            self._name_of_file[file] = self._add(PurePosixPath(file), self._read(file))
        return self._name_of_file[file]

    def _read(self, file: str) -> bytes:
        held = self._held.get(PurePosixPath(file))
        if held is not None:
            return held if isinstance(held, bytes) else held.encode()
        if not Path(file).is_absolute():
            raise ModelError(f'cannot pack {quoted(file)}: it is neither an absolute path nor in '
                             'the assets of the model')
        return read_file(Path(file), 'asset file', MAX_ASSET_BYTES)

    def _add(self, file: PurePosixPath, content: bytes) -> str:
        suffix = file.suffix.lower()
        key = (hashlib.sha256(content).hexdigest(), suffix)
        if key not in self._name_of_content:
            name = self._free_name(re.sub(r'[^A-Za-z0-9._-]', '_', file.stem), suffix)
            self._name_of_content[key] = name
            self.contents[name] = content
        return self._name_of_content[key]

    def _free_name(self, stem: str, suffix: str) -> str:
        # Some file systems, and MuJoCo's virtual one, do not distinguish upper and lower case.
        taken = {name.lower() for name in self.contents}
        name, number = f'{_FOLDER}/{stem}{suffix}', 1
        while name.lower() in taken:
            number += 1
            name = f'{_FOLDER}/{stem}_{number}{suffix}'
        return name


def _zip(contents: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, 'w', zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            info = zipfile.ZipInfo(name)  # Without the time of writing.
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, content)
    return buffer.getvalue()


def load_archive(data: bytes) -> mujoco.MjModel:
    """
    Return the compiled model of an archive from anywhere; it names no files but its own.

    A model that may take long, or crash MuJoCo, is compiled in another process first.

    :param data: as :func:`pack` returns it
    :raises ModelError: if it is another file, is too large, names other files, or holds no
        model that MuJoCo compiles, or takes too long or too much memory
    """
    contents = _unpacked(data)
    if _MODEL not in contents:
        raise ModelError(f'the archive has no {_MODEL}')
    name = 'the model of the archive'
    text = InMemoryFile(contents.pop(_MODEL), name, '; the model of an archive loads no other')
    model = XmlModel(text.file, Budget(_LIMITS), files=text)
    if model.is_urdf:
        raise ModelError(f"{name} begins with 'robot', and MJCF with 'mujoco'")
    is_light = model.elements <= _MAX_LIGHT_ELEMENTS
    for element in model.tree.iter():
        _check_names(element, contents)
        is_light = is_light and _is_light(element.tag, element.attrib)
    # MuJoCo reads the text as it was understood here.
    xml = ElementTree.tostring(model.tree, encoding='unicode')
    if not is_light:
        try_to_do(name, compile_held, xml, {}, contents, max_cpu_s=_MAX_CPU_S)
    return compile_spec(spec_from_string(xml, Path(name), {}, contents), name)


def unpacked_file(data: bytes, name: str, max_bytes: int) -> bytes:
    """
    Return a file of an archive from anywhere.

    :raises ModelError: if the file is missing, larger, or cannot be unpacked
    """
    _check_list(data)
    with _explained(), zipfile.ZipFile(io.BytesIO(data)) as archive:
        info = {info.filename: info for info in archive.infolist()}.get(name)
        if info is None:
            raise ModelError(f'the archive has no {name}')
        if info.file_size > max_bytes:
            raise ModelError(f'{name} in the archive has {info.file_size} bytes, and at most '
                             f'{max_bytes} are unpacked')
        return _read(archive, info)


def _unpacked(data: bytes) -> dict[str, bytes]:
    """Return the files of an archive by their names; all bounds are checked before."""
    if len(data) > MAX_ARCHIVE_BYTES:
        raise ModelError(f'the archive has {len(data)} bytes, and at most {MAX_ARCHIVE_BYTES} '
                         'are unpacked')
    _check_list(data)
    with _explained(), zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = [info for info in archive.infolist() if not info.is_dir()]
        _check_files(files, len(data))
        return {info.filename: _read(archive, info) for info in files}


@contextmanager
def _explained() -> Iterator[None]:
    try:
        yield
    # RuntimeError: it is encrypted.
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, RuntimeError, OSError) as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f'the archive cannot be unpacked: {error}') from error


def _read(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    with archive.open(info) as stream:
        # Without a number, a gigabyte may be unpacked before the size of the file is looked at.
        return stream.read(info.file_size + 1)


def _check_list(data: bytes) -> None:
    """Check the size of the list of files, which zipfile reads as a whole."""
    if len(data) < _END.size:
        raise ModelError('the archive is not a zip archive')
    signature, *_, count, size, _, comment = _END.unpack(data[-_END.size:])
    begin = len(data) - _END.size - len(_LOCATOR_64) - 16
    if signature != b'PK\x05\x06' or comment or data[begin:begin + 4] == _LOCATOR_64:
        raise ModelError('the archive is not a zip archive that ends without a comment')
    if count > _MAX_FILES or size > _MAX_LIST_BYTES:
        raise ModelError(f'the archive has {count} files in a list of {size} bytes, and at most '
                         f'{_MAX_FILES} in {_MAX_LIST_BYTES} are unpacked')


def _check_files(files: list[zipfile.ZipInfo], size: int) -> None:
    total = sum(info.file_size for info in files)
    most = min(_MAX_UNPACKED_BYTES, 2**20 + _MAX_RATIO * size)
    if total > most:
        raise ModelError(f'the archive unpacks to {total} bytes, and at most {most} are unpacked '
                         f'from one of {size}')
    seen = set()
    for info in files:
        name = info.filename
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ModelError(f'the file {quoted(name)} of the archive is neither stored nor '
                             'deflated')
        path = PurePosixPath(name)
        if (len(name) > _MAX_NAME or not name.isprintable() or '\\' in name or '..' in path.parts
                or path.is_absolute() or path.as_posix() != name):
            raise ModelError(f'the archive has a file of the name {quoted(name)}')
        if name in seen:
            raise ModelError(f'the archive has the file {quoted(name)} twice')
        seen.add(name)


def _check_names(element: ElementTree.Element, files: Collection[str]) -> None:
    """Reject an element of a model that names files beside these."""
    for attribute, value in element.items():
        if attribute in ('meshdir', 'texturedir', 'assetdir') and value:
            raise ModelError(f'the model of the archive names the folder {quoted(value)}')
        if attribute.startswith('file') and value and value not in files:
            raise ModelError(f'the model of the archive names the file {quoted(value)}, which is '
                             'not in the archive')


def _is_light(tag: str, attributes: Mapping[str, str]) -> bool:
    """Return whether an element compiles quickly for sure, if there are not too many of them."""
    if tag == 'size':
        return all(name.startswith('nuser_') for name in attributes)
    if tag == 'texture':
        width, height = product(attributes, 'width'), product(attributes, 'height')
        return ('builtin' in attributes and not any(map(_NAMES_A_FILE.fullmatch, attributes))
                and width * max(width, height) <= _MAX_LIGHT_PIXELS)
    return tag in _LIGHT
