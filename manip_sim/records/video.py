# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write images as a video, such as two episodes side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import tempfile
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import RecordError, UnknownNameError
from manip_sim.models.archive import load_archive
from manip_sim.quoting import one_line
from manip_sim.records.recorded import RecordedEpisode
from manip_sim.records.recorder import STATE_PARTS
from manip_sim.rendering import OffscreenRenderer

_VIDEO_MB = 200
#: H.264 with a key frame every other image, as LeRobot reads images in any order.
_CODEC, _OPTIONS, _PIXELS = 'libx264', {'crf': '18', 'g': '2', 'bf': '0'}, 'yuv420p'


class VideoFile:
    """
    A video file with several episodes, each of which begins with a key frame.

    :param path: of the file; its folder is created
    :param number: of the file, from 0
    :param shape: of the images, (height, width, 3), both even
    :raises RecordError: if one of them is odd
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


#: Width and height of the picture of an episode [pixels].
_SIZE = 400, 300
_MARGIN, _TEXT_SIZE = 8, 16
_TITLE_LENGTH = 50


class _Shown:
    """An episode whose instants are drawn."""

    def __init__(self, episode: RecordedEpisode, camera: str) -> None:
        self.states = episode.states
        self._camera = camera
        self._model = load_archive(episode.model)
        cameras = [str(self._model.camera(i).name) for i in range(self._model.ncam)]
        if camera not in cameras:
            raise UnknownNameError('camera', camera, cameras)
        size = mujoco.mj_stateSize(self._model, STATE_PARTS)
        if not len(self.states) or self.states.shape[1] != size:
            raise RecordError(f'seed {episode.seed} has no states of its model')
        self._data = mujoco.MjData(self._model)
        self._renderer = OffscreenRenderer(self._model, *_SIZE)

    def image(self, period: int) -> NDArray[np.uint8]:
        """Draw an instant, or the last one; shape (height, width, 3)."""
        state: FloatArray = self.states[min(period, len(self.states) - 1)]
        mujoco.mj_setState(self._model, self._data, state, STATE_PARTS)
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        mujoco.mj_flex(self._model, self._data)
        mujoco.mj_tendon(self._model, self._data)
        picture = self._renderer.render(self._data, self._camera, *_SIZE, depth=False)
        assert picture.rgb is not None
        return picture.rgb

    def close(self) -> None:
        """Free the OpenGL resources."""
        self._renderer.close()


def write_side_by_side(file: Path, episodes: Sequence[RecordedEpisode], titles: Sequence[str],
                       camera: str = 'frontview') -> None:
    """
    Write a video of episodes beside each other; the last picture of a shorter one stays.

    :param file: of the video, such as ``7.mp4``; replaced if it is there
    :param episodes: of one length of a control period
    :raises RecordError: if an episode has no states, or the package for videos is missing
    :raises UnknownNameError: if the camera is unknown, naming the available ones
    :raises ManipSimError: if nothing can be rendered
    """
    shown: list[_Shown] = []
    try:
        for episode in episodes:
            shown.append(_Shown(episode, camera))
        with tempfile.TemporaryDirectory(prefix='.unfinished', dir=file.parent) as folder:
            unfinished = Path(folder, file.name)
            _write(unfinished, shown, titles, episodes[0].period_s)
            unfinished.replace(file)
    except ImportError as error:
        raise RecordError(f"a video needs the package {error.name}: "
                          "pip install 'manip_sim[records]'") from error
    finally:
        for view in shown:
            view.close()


def _write(file: Path, shown: Sequence[_Shown], titles: Sequence[str], period_s: float) -> None:
    from PIL import Image, ImageDraw
    video = VideoFile(file, 0, max(1, round(1.0 / period_s)), (_SIZE[1], _SIZE[0] * len(shown), 3))
    for period in range(max(len(view.states) for view in shown)):
        images = []
        for view, title in zip(shown, titles):
            picture = Image.fromarray(view.image(period))
            ImageDraw.Draw(picture).multiline_text(
                (_MARGIN, _MARGIN), f'{one_line(title, _TITLE_LENGTH)}\n'
                f'{min(period, len(view.states) - 1) * period_s:.2f} s', 'white',
                font_size=_TEXT_SIZE, stroke_width=1, stroke_fill='black')
            images.append(np.asarray(picture))
        video.add(np.concatenate(images, axis=1), period == 0)
    video.close()
