# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What mesh and image files hold, checked before MuJoCo reads files of unknown origin."""

from __future__ import annotations

from collections.abc import Callable
import struct

from manip_sim.errors import ModelError
from manip_sim.quoting import one_line

#: Greatest size of a file [bytes].
MAX_FILE_BYTES = 20_000_000
#: Greatest number of faces of a mesh, and of pixels of an image.
MAX_FACES, MAX_PIXELS = 100_000, 4096**2
_PNG_SIGNATURE = b'\x89PNG\r\n\x1a\n'
_STL_HEADER_BYTES, _STL_FACE_BYTES = 84, 50
_OBJ_WORDS = (b'v', b'vt', b'vn', b'vp', b'f', b'g', b'o', b's', b'l', b'p', b'mtllib', b'usemtl')
_MAX_CORNERS = 100


def check_content(kind: str, suffix: str, content: bytes, name: str) -> None:
    """
    Check that a file is what its suffix says, and not too much work.

    :param kind: ``mesh`` or ``texture``
    :param suffix: of the file, in lower case
    :param name: of the file, for messages
    :raises ModelError: if there is anything else in it, or too many faces or pixels
    """
    checks = _CHECKS.get(kind, {})
    where = f'{kind} file {one_line(name)}'
    if suffix not in checks:
        raise ModelError(f'{where} is of no type that can be spawned: these are '
                         + ', '.join(known for each in _CHECKS.values() for known in each))
    problem = checks[suffix](content)
    if problem:
        raise ModelError(f'{where} {problem}')


def png_pixels(head: bytes) -> tuple[int, int] | None:
    """
    Return width and height of a PNG image; None if it is something else.

    :param head: its first 24 bytes or more
    """
    if not head.startswith(_PNG_SIGNATURE) or head[12:16] != b'IHDR' or len(head) < 24:
        return None
    width, height = struct.unpack('>II', head[16:24])
    return width, height


def _png(content: bytes) -> str:
    size = png_pixels(content)
    if size is None:
        return 'is not a PNG image'
    if size[0] * size[1] > MAX_PIXELS:
        return f'has {size[0]} times {size[1]} pixels, and at most {MAX_PIXELS} can be spawned'
    return ''


def _stl(content: bytes) -> str:
    faces = int.from_bytes(content[80:_STL_HEADER_BYTES], 'little')
    if faces > MAX_FACES:
        return _too_many_faces(faces)
    if len(content) != _STL_HEADER_BYTES + faces * _STL_FACE_BYTES or not faces:
        return 'is not a binary STL: its size does not fit the number of faces in its header'
    return ''


def _obj(content: bytes) -> str:
    faces = 0
    for number, line in enumerate(content.splitlines(), start=1):
        words = line.split(maxsplit=1)
        if not words or words[0].startswith(b'#'):
            continue
        if words[0] not in _OBJ_WORDS or not line.isascii():
            return f'is not an OBJ: line {number} is none of that format'
        if words[0] == b'f':
            corners = len(line.split()) - 1
            if corners > _MAX_CORNERS:
                return (f'has a face of {corners} corners in line {number}, and at most '
                        f'{_MAX_CORNERS} can be spawned')
            faces += max(corners - 2, 1)
            if faces > MAX_FACES:
                return _too_many_faces(faces)
    return ''


def _too_many_faces(faces: int) -> str:
    return f'has {faces} faces or more, and at most {MAX_FACES} can be spawned'


_CHECKS: dict[str, dict[str, Callable[[bytes], str]]] = {
    'mesh': {'.stl': _stl, '.obj': _obj}, 'texture': {'.png': _png}}
