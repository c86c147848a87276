# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A model and its files as a zip archive that loads anywhere, or as MuJoCo's exact binary."""

from __future__ import annotations

import codecs
from collections.abc import Mapping
import hashlib
import io
from pathlib import Path, PurePosixPath
import re
from xml.etree import ElementTree
import zipfile
import zlib

import mujoco
import numpy as np

from manip_sim.errors import ModelError
from manip_sim.models.loading import compile_spec, Document, spec_from_documents
from manip_sim.models.untrusted_models import run_limited
from manip_sim.models.user_files import read_file
from manip_sim.quoting import one_line, quoted


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
    """Return a sentence on what the text of MJCF changes."""
    differences = roundings(model, other)
    if not differences:
        return 'the text of MJCF gives this model to the last bit'
    worst = ', '.join(f'{field} by {most:.1e}' for field, most in list(differences.items())[:3])
    return (f'the text of MJCF changes {len(differences)} fields of the model, at most {worst}; '
            '.mjb is exact to the last bit')


# The module of the names in archives, which the process that unpacks them can no longer open.
codecs.lookup('cp437')

#: Largest archive that is loaded [bytes].
MAX_ARCHIVE_BYTES = 2**26
#: CPU time that a model may take to compile [s]; robots with large meshes take seconds.
_MAX_CPU_S = 10

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
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, 'w', zipfile.ZIP_DEFLATED) as archive:
        for name, content in {_MODEL: ElementTree.tostring(root), **files.contents}.items():
            info = zipfile.ZipInfo(name)  # Without the time of writing.
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, content)
    return buffer.getvalue()


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
            path, content = PurePosixPath(file), self._read(file)
            key = (hashlib.sha256(content).hexdigest(), path.suffix.lower())
            if key not in self._name_of_content:
                name = self._free_name(re.sub(r'[^A-Za-z0-9._-]', '_', path.stem), key[1])
                self._name_of_content[key] = name
                self.contents[name] = content
            self._name_of_file[file] = self._name_of_content[key]
        return self._name_of_file[file]

    def _read(self, file: str) -> bytes:
        held = self._held.get(PurePosixPath(file))
        if held is not None:
            return held if isinstance(held, bytes) else held.encode()
        if not Path(file).is_absolute():
            raise ModelError(f'cannot pack {quoted(file)}: it is neither an absolute path nor in '
                             'the assets of the model')
        return read_file(Path(file), 'asset file')

    def _free_name(self, stem: str, suffix: str) -> str:
        # Some file systems, and MuJoCo's virtual one, do not distinguish upper and lower case.
        taken = {name.lower() for name in self.contents}
        name, number = f'{_FOLDER}/{stem}{suffix}', 1
        while name.lower() in taken:
            number += 1
            name = f'{_FOLDER}/{stem}_{number}{suffix}'
        return name


def load_archive(data: bytes) -> mujoco.MjModel:
    """
    Return the model of an archive from anywhere, which another process compiles.

    :param data: as :func:`pack` returns it
    :raises ModelError: if it is another file, is too large, or holds no model that MuJoCo
        compiles from its files alone, or takes too long or too much memory
    """
    if len(data) > MAX_ARCHIVE_BYTES:
        raise ModelError(f'the archive has {len(data)} bytes, and at most {MAX_ARCHIVE_BYTES} '
                         'are unpacked')
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise ModelError('the archive cannot be unpacked: it is no zip file')
    binary = run_limited('the archive', _compiled, data, max_cpu_s=_MAX_CPU_S)
    return mujoco.MjModel.from_binary_path('it.mjb', {'it.mjb': binary})


def _compiled(data: bytes) -> bytes:
    """Return the model of an archive as :func:`to_binary` does."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            contents = {info.filename: archive.read(info) for info in archive.infolist()
                        if not info.is_dir()}
    # RuntimeError: it is encrypted.
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:
        raise ModelError(f'cannot be unpacked: {one_line(str(error))}') from error
    if _MODEL not in contents:
        raise ModelError(f'has no {_MODEL}')
    try:
        document = Document(ElementTree.fromstring(contents.pop(_MODEL)), {})
    except (ElementTree.ParseError, LookupError) as error:
        raise ModelError(f'is not well-formed XML: {error}') from error
    return to_binary(compile_spec(spec_from_documents([document], Path('it'), contents), 'it'))
