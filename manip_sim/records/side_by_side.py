# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Show recorded episodes beside each other in a video, drawn again from their states."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import tempfile

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import RecordError, UnknownNameError
from manip_sim.models.archive import load_archive
from manip_sim.quoting import one_line
from manip_sim.records.recorded import RecordedEpisode
from manip_sim.records.recorder import STATE_PARTS
from manip_sim.records.video import VideoFile
from manip_sim.rendering.gl import choose_gl, create_context
from manip_sim.rendering.offscreen import OffscreenRenderer

#: Width and height of the picture of an episode [pixels].
_SIZE = 400, 300
_MARGIN, _TEXT_SIZE = 8, 16
_TITLE_LENGTH = 50


class _Shown:
    """
    An episode whose instants are drawn, with an OpenGL context of its own.

    :param episode: with states
    :param camera: of its model
    """

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
        self._context = create_context(choose_gl(), *_SIZE)
        self._context.make_current()
        self._renderer = OffscreenRenderer(self._model, *_SIZE)

    def image(self, period: int) -> NDArray[np.uint8]:
        """Draw an instant, or the last one; shape (height, width, 3)."""
        self._context.make_current()
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
        self._context.make_current()
        self._renderer.close()
        self._context.free()


def write_side_by_side(file: Path, episodes: Sequence[RecordedEpisode], titles: Sequence[str],
                       camera: str = 'frontview') -> None:
    """
    Write a video of episodes beside each other; the last picture of a shorter one stays.

    :param file: of the video, such as ``7.mp4``; replaced if it is there
    :param episodes: of one length of a control period
    :param titles: above each
    :param camera: of their models
    :raises RecordError: if an episode has no states, or the package for videos is missing
    :raises UnknownNameError: if there is no such camera, naming those that are
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
        for one in shown:
            one.close()


def _write(file: Path, shown: Sequence[_Shown], titles: Sequence[str], period_s: float) -> None:
    video = VideoFile(file, 0, max(1, round(1.0 / period_s)), (_SIZE[1], _SIZE[0] * len(shown), 3))
    for period in range(max(len(one.states) for one in shown)):
        images = [_titled(one.image(period), f'{one_line(title, _TITLE_LENGTH)}\n'
                          f'{min(period, len(one.states) - 1) * period_s:.2f} s')
                  for one, title in zip(shown, titles)]
        video.add(np.concatenate(images, axis=1), period == 0)
    video.close()


def _titled(image: NDArray[np.uint8], title: str) -> NDArray[np.uint8]:
    """Return an image with a text in its upper left corner."""
    from PIL import Image, ImageDraw
    picture = Image.fromarray(image)
    ImageDraw.Draw(picture).multiline_text(
        (_MARGIN, _MARGIN), title, 'white', font_size=_TEXT_SIZE, stroke_width=1,
        stroke_fill='black')
    return np.asarray(picture)
