# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Pack a model and the files that it refers to into a zip archive that loads on any machine."""

from __future__ import annotations

from collections.abc import Mapping
import hashlib
import io
from pathlib import Path, PurePosixPath
import re
from xml.etree import ElementTree
import zipfile

from manip_sim.errors import ModelError
from manip_sim.models.asset_files import MAX_ASSET_BYTES
from manip_sim.models.regular_files import read_file
from manip_sim.quoting import quoted

#: The model file that MuJoCo looks for in an archive.
_MODEL = 'model.xml'
_FOLDER = 'assets'
_NAMES_A_FILE = re.compile(r'file(right|left|up|down|front|back)?')


def pack(xml: str, assets: Mapping[str, bytes | str]) -> bytes:
    """
    Return a zip of a model's XML, ``model.xml``, and its files, in the folder ``assets``.

    Files of equal content and suffix are packed once; those of equal name and different content
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
