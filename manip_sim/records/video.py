# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write images as a video."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.errors import RecordError

_VIDEO_MB = 200
#: H.264 with a key frame every other image, as LeRobot reads images in any order.
_CODEC, _OPTIONS, _PIXELS = 'libx264', {'crf': '18', 'g': '2', 'bf': '0'}, 'yuv420p'


class VideoFile:
    """
    A video file with several episodes, each of which begins with a key frame.

    :param path: of the file; its folder is created
    :param number: of the file, from 0
    :param fps: images in a second
    :param shape: of the images, (height, width, 3), both even
    :raises RecordError: if one of them is odd
    :ivar number: as above
    :ivar frames: number of images so far
    :ivar info: what a data set of LeRobot says of the file
    """

    def __init__(self, path: Path, number: int, fps: int, shape: Sequence[int]) -> None:
        import av
        height, width, _ = shape
        if height % 2 or width % 2:
            raise RecordError(f'images of {width} x {height} pixels cannot be written as video, '
                              'both must be even')
        path.parent.mkdir(parents=True, exist_ok=True)
        self.number, self.frames = number, 0
        self._path = path
        self._container: Any = av.open(str(path), 'w')
        self._stream: Any = self._container.add_stream(_CODEC, rate=fps, options=_OPTIONS)
        self._stream.width, self._stream.height, self._stream.pix_fmt = width, height, _PIXELS
        self.info = {'video.height': height, 'video.width': width, 'video.codec': 'h264',
                     'video.pix_fmt': _PIXELS, 'video.is_depth_map': False, 'video.fps': fps,
                     'video.channels': 3, 'has_audio': False}

    def add(self, image: NDArray[np.uint8], is_first: bool) -> None:
        """Add an image; the first one of an episode becomes a key frame."""
        import av
        from av.video.frame import PictureType
        frame = av.VideoFrame.from_ndarray(image, format='rgb24')
        frame.pts = self.frames
        if is_first:
            frame.pict_type = PictureType.I
        self.frames += 1
        self._container.mux(self._stream.encode(frame))

    @property
    def is_large(self) -> bool:
        """True if the next episode should begin another file."""
        return self._path.stat().st_size > _VIDEO_MB * 2**20 * 0.9

    def close(self) -> None:
        """Complete the file."""
        self._container.mux(self._stream.encode())
        self._container.close()
